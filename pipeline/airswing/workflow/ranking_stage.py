"""The evaluation's further stages: stability, whom to correct, and the virtual field test.

Takes the products of :mod:`airswing.workflow`, calls the evaluation's functions with plain
arguments, and writes one product each.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from datetime import date
from typing import TYPE_CHECKING, Literal, TypeVar

import xarray as xr

from airswing.errors import InputError
from airswing.products.ragged import time_span
from airswing.products.whole_files import write_json, write_text
from airswing.workflow.job import Job, main_reference

if TYPE_CHECKING:
    from airswing.evaluation.results import Content

Found = TypeVar("Found")
STABILITY, RANKING, VIRTUAL = "stability.json", "ranking.csv", "virtual_field_test.json"
# Each fit still has four fifths of the flights.
FOLDS = 5
# Share of the archive's days that is learned from where no field test gives a date.
_LEARNED_SHARE = 2.0 / 3.0


def make_stability(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> Content:
    """Fits by month, or by quarter in archives over a year, and changes: ``stability.json``.

    Returns
    -------
    StabilityContent
        ``reference``, ``changes`` of
        :attr:`airswing.evaluation.monitoring.CompassWatch.changes` and ``windows`` of
        :func:`~airswing.evaluation.monitoring.fit_by_window`.
    """
    from airswing.evaluation.monitoring import fit_by_window

    config, reference = job.config, main_reference(job.config)
    pools = config.pools()
    with job.progress.stage("stability") as stage:
        first, last = (day.astype("datetime64[D]") for day in time_span(headings))
        days = (last - first).astype(int)
        # Months of several years would be more than anyone looks at.
        window: Literal["month", "quarter"] = "month" if days <= 400 else "quarter"
        windows = fit_by_window(
            headings, pools=pools, reference=reference, window=window, **config.fit.model_dump()
        )
        result, stage.note = written_stability(job, fits, window, windows)
    return result


def written_stability(
    job: Job, fits: xr.Dataset, window: str, windows: list[Content]
) -> tuple[Content, str]:
    """Write ``stability.json``; what is in it, and in a few words.

    Parameters
    ----------
    windows : list of Content
        Of :func:`airswing.evaluation.monitoring.fit_by_window`.
    """
    from airswing.evaluation.monitoring import noted_changes

    result: Content = {
        "reference": main_reference(job.config),
        "window": window,
        "changes": (changes := noted_changes(fits)),
        "windows": windows,
    }
    write_json(job.output / STABILITY, result)
    changed = [entry["aircraft"] for entry in changes if entry["changes"]]
    return result, f"compass changed: {', '.join(changed) or 'none'}"


def make_ranking(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> list[Content]:
    """Whom to correct first: ``ranking.csv``.

    Returns
    -------
    list of Ranked
        Of :func:`airswing.evaluation.backtest.ranking.rank_aircraft`.
    """
    from airswing.evaluation.backtest.ranking import rank_aircraft

    with job.progress.stage("ranking") as stage:
        ranking = rank_aircraft(
            headings, fits, pools=job.config.pools(), reference=main_reference(job.config)
        )
        write_text(job.output / RANKING, _ranking_table(ranking))
        first = ranking[0]
        if first["expected_gain_kt"] is not None:
            stage.note = f"{first['aircraft']} would gain {first['expected_gain_kt']:.2f} kt"
    return ranking


def _ranking_table(ranking: Sequence[Content]) -> str:
    """The ranking as CSV."""
    titles = (
        "rank",
        "aircraft",
        "status",
        "reports",
        "disagreement_kt",
        "expected_gain_kt",
        "expected_gain_low_kt",
        "expected_gain_high_kt",
        "rank_low",
        "rank_high",
        "amplitude_deg",
    )
    text = io.StringIO()
    writer = csv.DictWriter(text, titles, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for entry in ranking:
        gain = entry.get("expected_gain_ci_kt") or (None, None)
        place = entry.get("rank_ci") or (None, None)
        row: dict[str, object] = {
            **entry,
            "expected_gain_low_kt": gain[0],
            "expected_gain_high_kt": gain[1],
            "rank_low": place[0],
            "rank_high": place[1],
        }
        writer.writerow(
            {
                key: f"{value:.3f}" if isinstance(value, float) else value
                for key, value in row.items()
            }
        )
    return text.getvalue()


def make_virtual(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, ranking: list[Content]
) -> Content:
    """Corrections learned from one part and judged on another: ``virtual_field_test.json``.

    Learned up to the start of the field test, where there is one, and applied to the aircraft
    that were not corrected in it; else learned from the first two thirds of the days.

    Parameters
    ----------
    ranking : list of Content
        Of :func:`make_ranking`.

    Returns
    -------
    VirtualContent
        ``later`` of :func:`airswing.evaluation.backtest.virtual_field_test.virtual_field_test` and
        ``held_out`` of :func:`~airswing.evaluation.backtest.crossvalidation.cross_validate`; where
        one cannot be computed its ``why``.
    """
    from airswing.evaluation.backtest.crossvalidation import cross_validate
    from airswing.evaluation.backtest.virtual_field_test import virtual_field_test

    config = job.config
    pools, reference = config.pools(), main_reference(config)
    resolution, fit = math.degrees(config.table.resolution), config.fit.model_dump()
    test, corrected = config.field_test, uncorrected(job, headings)
    until = test.start if test is not None else later_date(headings)
    with job.progress.stage("virtual field test") as stage:
        result: Content = {
            "later": tried(
                lambda: virtual_field_test(
                    headings,
                    learned_until=until,
                    pools=pools,
                    reference=reference,
                    corrected=corrected,
                    resolution=resolution,
                    **fit,
                )
            ),
            "held_out": tried(
                lambda: cross_validate(
                    headings,
                    pools=pools,
                    reference=reference,
                    folds=FOLDS,
                    whole=(fits, ranking),
                    resolution=resolution,
                    **fit,
                )
            ),
        }
        stage.note = written_virtual(job, result)
    return result


def written_virtual(job: Job, result: Content) -> str:
    """Write ``virtual_field_test.json``; what is in it in a few words.

    Parameters
    ----------
    result : Content
        As of :func:`make_virtual`.
    """
    write_json(job.output / VIRTUAL, result)
    told = [
        f"{words} {part['predicted_gain_kt']:.2f} kt predicted, "
        f"{part['realised_gain_kt']:.2f} realised"
        for words, part in (("later", result["later"]), ("held out", result["held_out"]))
        if "why" not in part and part["realised_gain_kt"] is not None
    ]
    return "; ".join(told) or "too few reports"


def uncorrected(job: Job, headings: xr.Dataset) -> list[str] | None:
    """Aircraft that were not corrected in the field test; None where there is none."""
    test = job.config.field_test
    if test is None:
        return None
    names = headings["aircraft"].to_numpy().astype(str)
    return [str(name) for name in names if name not in test.corrected]


def later_date(headings: xr.Dataset) -> date:
    """Day after the first two thirds of the archive's days."""
    first, last = (day.astype("datetime64[D]").astype(object) for day in time_span(headings))
    found: date = first + (last - first) * _LEARNED_SHARE
    return found


def tried(make: Callable[[], Found]) -> Found | Content:
    """Do a part; where the archive cannot carry it, say why instead."""
    try:
        return make()
    except InputError as err:
        return {"why": str(err)}
