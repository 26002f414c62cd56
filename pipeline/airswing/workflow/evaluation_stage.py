"""Evaluation of the corrections, one function for each product.

Each takes the products of the run, calls one function of :mod:`airswing.evaluation` and writes the
result: ``error_profiles.nc``, ``observation_errors.nc``, ``stability.json``, ``ranking.csv``,
``virtual_field_test.json``, ``field_test.json`` and ``sensitivity.json``.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from datetime import date
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
import xarray as xr

from airswing.errors import ConfigError, InputError
from airswing.evaluation.results import Evaluation
from airswing.products.ragged import time_span
from airswing.products.whole_files import (
    code_digest,
    findings,
    fingerprint,
    read_note,
    write_json,
    write_text,
)
from airswing.workflow.job import (
    FIELD_TEST,
    HEADINGS,
    INNOVATIONS,
    OBSERVATION_ERRORS,
    PROFILES,
    RANKING,
    SENSITIVITY,
    STABILITY,
    VIRTUAL,
    Job,
    main_reference,
    ready,
)
from airswing.workflow.monitoring_stage import make_monitoring

if TYPE_CHECKING:
    from airswing.evaluation import Content

Found = TypeVar("Found")
_TITLES = (
    "Wind error by phase of flight and level, as reported and as corrected",
    "Statistics of observation minus reference by aircraft, phase and level",
)
_LEARNED_SHARE = 2.0 / 3.0
"""Share of the days a correction is learned from where no field test gives a date."""
_MOST_DAYS_BY_MONTH = 400
"""Days of the longest archive whose stability is shown by month; longer ones go by quarter."""


def make_evaluation(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, corrected: xr.Dataset
) -> Evaluation:
    """Evaluate the corrections, as far as the configuration allows it.

    Parameters
    ----------
    job : Job
    headings, fits, corrected : Dataset
        Products of the run.

    Returns
    -------
    Evaluation
        With a field test where the configuration has one, and with a comparison of references
        where there are two or more.
    """
    ranking = make_ranking(job, headings, fits)
    profiles, innovations = make_innovations(job, headings, corrected)
    return Evaluation(
        profiles=profiles,
        innovations=innovations,
        observation_errors=make_observation_errors(job, headings, corrected),
        stability=make_stability(job, headings, fits),
        ranking=ranking,
        virtual=virtual_of_month(job, headings, fits, ranking),
        field_test=None if job.config.field_test is None else make_field_test(job, headings),
        sensitivity=make_sensitivity(job, headings) if len(job.config.references) > 1 else None,
        monitoring=make_monitoring(job, headings, fits, corrected),
    )


def make_innovations(
    job: Job, headings: xr.Dataset, corrected: xr.Dataset
) -> tuple[xr.Dataset, xr.Dataset]:
    """Wind errors by phase and level, and statistics of observation minus reference.

    ``error_profiles.nc`` and ``innovation_statistics.nc``.
    """
    from airswing.evaluation.innovations import innovation_products

    with job.progress.stage("innovations"):
        found = innovation_products(headings, corrected, pools=job.config.pools())
        for product, name, title in zip(found, (PROFILES, INNOVATIONS), _TITLES, strict=True):
            job.write(product, name, title=title, sources=(headings, corrected))
    return found


def make_observation_errors(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Errors of the reports alone by phase of flight and layer: ``observation_errors.nc``."""
    from airswing.evaluation.observation_errors import observation_errors

    with job.progress.stage("observation errors") as stage:
        found = observation_errors(
            headings,
            corrected,
            pools=job.config.pools(),
            reference=main_reference(job.config),
            covariance=job.config.observation_errors.reference_covariance,
        )
        job.write(
            found,
            OBSERVATION_ERRORS,
            title="Standard error of a wind component of the reports alone",
            sources=(headings, corrected),
        )
        stage.note = found.attrs["method"] or found.attrs["method_reason"]
    return found


def make_stability(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> Content:
    """Fits by month (by quarter in long archives) and changes of compasses: ``stability.json``.

    Windows before the first month that was made anew keep their fits of the last run.
    """
    from airswing.evaluation.monitoring.changes import fit_by_window, noted_changes

    config, reference = job.config, main_reference(job.config)
    with job.progress.stage("stability") as stage:
        first, last = (day.astype("datetime64[D]") for day in time_span(headings))
        days = (last - first).astype(int)
        window: Literal["month", "quarter"] = "month" if days <= _MOST_DAYS_BY_MONTH else "quarter"
        note, made = _months_note(job, headings)
        path, noted = job.output / STABILITY, job.notes / STABILITY
        earlier: list[Content] = []
        if not job.fresh and path.exists() and read_note(noted).get("settings") == note["settings"]:
            last_time = read_note(path)
            earlier = last_time["windows"] if last_time["window"] == window else []
        since = np.datetime64(min(made, default=str(last + 1)), "M").astype(np.int64)
        since -= since % (1 if window == "month" else 3)
        begin = np.datetime64(int(since), "M").astype("datetime64[D]")
        earlier = [entry for entry in earlier if np.datetime64(entry["window"]) < begin]
        windows = fit_by_window(
            headings,
            pools=config.pools(),
            reference=reference,
            window=window,
            since=begin if earlier else None,
            **config.fit.model_dump(),
        )
        windows = _with_new_aircraft(earlier, headings) + windows
        windows.sort(key=lambda entry: (entry["aircraft"], entry["window"]))
        changes = noted_changes(fits)
        result: Content = {
            "reference": reference,
            "window": window,
            "changes": changes,
            "windows": windows,
        }
        write_json(path, result)
        if note["months"]:
            write_json(noted, note)
        changed = [entry["aircraft"] for entry in changes if entry["changes"]]
        stage.note = f"compass changed: {', '.join(changed) or 'none'}"
    return result


def _months_note(job: Job, headings: xr.Dataset) -> tuple[Content, list[str]]:
    """Settings and months of a run, to compare with those of the next, and the months made."""
    months = json.loads(str(headings.attrs.get("months", "{}")))
    made = months.get("made", [])
    config = job.config.model_dump(exclude={"compute", "output", "metadata"})
    settings = fingerprint(config, code_digest())
    return {"settings": settings, "months": sorted([*made, *months.get("kept", [])])}, made


def _with_new_aircraft(windows: list[Content], headings: xr.Dataset) -> list[Content]:
    """Fits by window with entries of aircraft that had no report in these windows."""
    known = {entry["aircraft"] for entry in windows}
    new = [str(name) for name in headings["aircraft"].to_numpy() if str(name) not in known]
    return windows + [
        {"aircraft": name, "window": first, "reports": 0, "status": "too_few_reports"}
        for name in new
        for first in sorted({entry["window"] for entry in windows})
    ]


def make_ranking(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> list[Content]:
    """Aircraft in the order of the gain expected of a correction: ``ranking.csv``."""
    from airswing.evaluation.ranking import rank_aircraft

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
    columns = (
        "rank aircraft status reports disagreement_kt expected_gain_kt expected_gain_low_kt "
        "expected_gain_high_kt rank_low rank_high amplitude_deg"
    )
    text = io.StringIO()
    writer = csv.DictWriter(
        text, columns.split(), restval="", extrasaction="ignore", lineterminator="\n"
    )
    writer.writeheader()
    for entry in ranking:
        row = dict(entry)
        for interval, name, unit in (
            ("expected_gain_ci_kt", "expected_gain", "_kt"),
            ("rank_ci", "rank", ""),
        ):
            low, high = entry.get(interval) or (None, None)
            row |= {f"{name}_low{unit}": low, f"{name}_high{unit}": high}
        writer.writerow({key: f"{x:.3f}" if isinstance(x, float) else x for key, x in row.items()})
    return text.getvalue()


def virtual_of_month(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, ranking: list[Content]
) -> Content:
    """The virtual field test, made anew when a month begins or an earlier month was made anew.

    It fits the earlier reports again: a night that adds to the last month alone keeps that of the
    last time. Parameters and result as of :func:`make_virtual`.
    """
    note, made = _months_note(job, headings)
    names = note["months"]
    path, noted = job.output / VIRTUAL, job.notes / VIRTUAL
    kept = not job.fresh and set(made) <= set(names[-1:]) and read_note(noted) == note
    if kept and path.exists():
        job.progress.say(f"{VIRTUAL}: kept until the next month begins")
        return read_note(path)
    found = make_virtual(job, headings, fits, ranking)
    if names:
        write_json(noted, note)
    return found


def make_virtual(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, ranking: list[Content]
) -> Content:
    """Corrections learned from one part and judged on another: ``virtual_field_test.json``.

    ``later``: learned up to the start of the field test and applied to the aircraft that were not
    corrected in it; without a field test learned from the first two thirds of the days.
    ``held_out``: cross-validation over days. Where one of them cannot be computed it says why.
    """
    from airswing.evaluation.held_out import cross_validate, virtual_field_test

    config, test = job.config, job.config.field_test
    pools, reference = config.pools(), main_reference(config)
    resolution, fit = math.degrees(config.table.resolution), config.fit.model_dump()
    names = headings["aircraft"].to_numpy().astype(str)
    uncorrected = (
        None if test is None else [str(name) for name in names if name not in test.corrected]
    )
    with job.progress.stage("virtual field test") as stage:
        result: Content = {
            "later": _tried(
                lambda: virtual_field_test(
                    headings,
                    learned_until=_later_date(headings) if test is None else test.start,
                    pools=pools,
                    reference=reference,
                    corrected=uncorrected,
                    resolution=resolution,
                    **fit,
                )
            ),
            "held_out": _tried(
                lambda: cross_validate(
                    headings, fits, pools=pools, reference=reference, ranking=ranking
                )
            ),
        }
        write_json(job.output / VIRTUAL, result)
        gains = [
            f"{words} {part['predicted_gain_kt']:.2f} kt predicted, "
            f"{part['realised_gain_kt']:.2f} realised"
            for words, part in (("later", result["later"]), ("held out", result["held_out"]))
            if "why" not in part and part["realised_gain_kt"] is not None
        ]
        stage.note = "; ".join(gains) or "too few reports"
    return result


def _later_date(headings: xr.Dataset) -> date:
    first, last = (day.astype("datetime64[D]").astype(object) for day in time_span(headings))
    found: date = first + (last - first) * _LEARNED_SHARE
    return found


def _tried(make: Callable[[], Found]) -> Found | Content:
    try:
        return make()
    except InputError as err:
        return {"why": str(err)}


def make_field_test(job: Job, headings: xr.Dataset | None = None) -> Content:
    """The field test of the configuration: ``field_test.json``.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Content
        With the reduction that the fits to the reports before the test predict.

    Raises
    ------
    ConfigError
        If the configuration has no ``field_test``.
    """
    from airswing.evaluation.field_test import field_test
    from airswing.evaluation.held_out import predicted_reduction

    config, test = job.config, job.config.field_test
    if test is None:
        raise ConfigError(
            "there is no field test to evaluate",
            field="field_test",
            remedy="Add field_test with start, before_start, corrected and controls",
        )
    pools, reference = config.pools(), main_reference(config)
    with job.progress.stage("field test") as stage:
        screened = ready(job, headings, HEADINGS)
        found = field_test(screened, pools=pools, reference=reference, **test.model_dump())
        expected = predicted_reduction(
            screened,
            start=test.start,
            corrected=test.corrected,
            pools=pools,
            reference=reference,
            **config.fit.model_dump(),
        )
        content: Content = {**found, **expected}
        result = findings(content)
        write_json(job.output / FIELD_TEST, result)
        low, high = result["adjusted_reduction_ci_kt"]
        stage.note = (
            f"adjusted reduction {result['adjusted_reduction_kt']:.2f} kt ({low:.2f} to {high:.2f})"
        )
    return result


def make_sensitivity(
    job: Job, headings: xr.Dataset | None = None, *, intervals: bool = False
) -> Content:
    """Every reference and pool fitted on the same reports: ``sensitivity.json``.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.
    intervals : bool, default False
        Also compute what hourly references lose where only every third or sixth hour is used, which
        reads some of their files again. With one reference this is the whole result.
    """
    from airswing.evaluation.comparison import compare

    config = job.config
    screened = ready(job, headings, HEADINGS)
    costs = _interval_costs(job, screened) if intervals else {}
    if costs and len(config.references) == 1:
        alone: Content = {"time_interval": costs}
        write_json(job.output / SENSITIVITY, alone)
        return alone
    with job.progress.stage("compare") as stage:
        result = compare(
            screened,
            pools=config.pools(),
            never_pool=config.never_pool,
            **config.fit.model_dump(),
        )
        if costs:
            result["time_interval"] = costs
        write_json(job.output / SENSITIVITY, result)
        verdicts = (
            f"{' and '.join(pair['references'])}: "
            + ("poolable" if pair["poolable"] else "not poolable")
            for pair in result["pairs"]
        )
        stage.note = "; ".join(verdicts)
    return result


def _interval_costs(job: Job, headings: xr.Dataset) -> dict[str, list[Content]]:
    from airswing.evaluation.time_interval import interval_cost
    from airswing.workflow.months import catalogues

    models = catalogues(job)
    with job.progress.stage("time interval") as stage:
        costs = {name: interval_cost(headings, model) for name, model in models.items()}
        found = {name: rows for name, rows in costs.items() if rows}
        stage.note = "; ".join(
            f"{name} every {row['interval_h']} h: {row['rms_vector_difference_m_s']:.2f} m/s, "
            f"{row['rms_vector_difference_at_middle_m_s'] or float('nan'):.2f} at the middle"
            for name, rows in found.items()
            for row in rows
        )
    return found
