"""Cross-validation: every flight corrected by a fit that never saw it.

Assumes compasses stay as they are (see :mod:`airswing.evaluation.monitoring.changes`) and
flights are independent but for the day they share: whole flights are dealt into folds, day by day
and aircraft by aircraft. What was predicted from the fit alone stands beside what came out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.backtest.folds import Folds, flight_folds, only
from airswing.evaluation.backtest.gains import Apart, Floats, compared, gains_of
from airswing.evaluation.backtest.learning import (
    TableOptions,
    fitted,
    judged_blocks,
    require_reference,
)
from airswing.evaluation.backtest.ranking import rank_aircraft
from airswing.evaluation.results import Content


def cross_validate(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    folds: int = 5,
    whole: tuple[xr.Dataset, list[Content]] | None = None,
    draws: int = 1000,
    seed: int = 0,
    **fit_options: Unpack[TableOptions],
) -> Content:
    """Correct every flight with a fit that never saw it, and compare with the prediction.

    Parameters
    ----------
    reference : str
        Key of ``pools``.
    folds : int, default 5
        Parts the flights are dealt into, day by day and aircraft by aircraft.
    whole : (Dataset, list of Content), optional
        Fits of all reports with the same options, with their tables, and the ranking of
        :func:`airswing.evaluation.backtest.ranking.rank_aircraft` by them; made when not given.
    **fit_options
        As for :func:`airswing.evaluation.backtest.learning.fitted`.

    Returns
    -------
    CrossValidation
        As :func:`airswing.evaluation.backtest.virtual_field_test.virtual_field_test` gives, without
        groups, and ``in_sample_gain_kt``: what the fit of all flights gains on its own reports.

    Raises
    ------
    InputError
        If there are fewer than two folds or fewer flights than folds.
    """
    require_reference(pools, reference)
    dealt = flight_folds(headings, folds=folds, seed=seed)

    def without(fold: int) -> xr.Dataset:
        return only(headings, lambda reports: dealt.of(reports) != fold)

    def learned(part: xr.Dataset) -> xr.Dataset:
        return fitted(part, pools, reference, **fit_options)

    apart = [learned(without(fold)) for fold in range(folds)]
    if whole is None:
        made = learned(headings)
        ranking = rank_aircraft(headings, made, pools=pools, reference=reference, seed=seed)
        whole = made, ranking
    fits, ranking = whole
    gains, own_gains = [], []
    for block, _ in judged_blocks(headings):
        before, after, done = _held_out(block, dealt, apart, pools[reference], reference)
        own = Apart.of(block, fits, pools[reference], reference)
        judged = (block["screening"].to_numpy() == 0) & np.isfinite(before + after) & done
        gains += gains_of(block, before - after, judged)
        own_gains += gains_of(block, own.before - own.after, judged)
    reports = sum(gain.reports for gain in gains)
    if not reports:
        raise InputError(
            "no held-out report could be corrected",
            field="folds",
            found=str(folds),
            remedy="Use fewer folds, or lower fit.min_reports",
        )
    return {
        "reference": reference,
        "folds": folds,
        "method": "table",
        "in_sample_gain_kt": sum(float(gain.total.sum()) for gain in own_gains) / reports,
        **compared(headings, gains, ranking, draws=draws, seed=seed),
    }


def _held_out(
    block: xr.Dataset,
    dealt: Folds,
    fits: list[xr.Dataset],
    members: list[str],
    reference: str,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Each report corrected by the fit that never saw its flight."""
    number = dealt.of(block)
    before = after = np.full(number.size, np.nan)
    done = np.zeros(number.size, dtype=bool)
    for fold, fit in enumerate(fits):
        own = Apart.of(block, fit, members, reference)
        held = number == fold
        before = own.before
        after = np.where(held, own.after, after)
        done = np.where(held, own.done, done)
    return before, after, done
