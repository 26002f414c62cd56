"""Stages after the headings, a function for each product: fit, correct, evaluate, monitor.

Each takes the products of the run, calls one function of :mod:`airswing.compass` or
:mod:`airswing.evaluation` and writes the result. Products that are not given are opened in the
output folder.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import date
from functools import partial
from itertools import chain
from typing import Any, Literal

import numpy as np
import pandas as pd
import xarray as xr

from airswing.compass.correction import add_tables, correct, write_tables_csv
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.plausibility import mean_declination, plausibility, with_implausible
from airswing.errors import ConfigError, InputError
from airswing.evaluation import Content, Evaluation
from airswing.evaluation.comparison import compare
from airswing.evaluation.field_test import field_test
from airswing.evaluation.gains import (
    cross_validate,
    predicted_reduction,
    rank_aircraft,
    virtual_field_test,
)
from airswing.evaluation.innovations import innovation_products
from airswing.evaluation.monitoring.changes import (
    add_changes,
    fit_by_window,
    noted_changes,
    watch_compasses,
)
from airswing.evaluation.monitoring.events import (
    Monitoring,
    UnitTable,
    changed_since,
    find_events,
    read_events,
    read_tables,
    tables_of,
    with_tables,
    write_events,
)
from airswing.evaluation.observation_errors import observation_errors
from airswing.flags import published
from airswing.products.netcdf import open_product, product_path
from airswing.products.ragged import aircraft_of_report, some_reports, time_span
from airswing.products.whole_files import (
    Findings,
    code_digest,
    fingerprint,
    read_note,
    write_json,
    write_text,
)
from airswing.vocabulary import describe
from airswing.workflow.job import CORRECTED, FITS, HEADINGS, PROFILES, Job, require_kept

_LEARNED_SHARE = 2.0 / 3.0
"""Share of the days that corrections are fitted to, without a field test."""
_MOST_DAYS_BY_MONTH = 400
"""Days of the longest archive whose stability is shown by month; longer ones by quarter."""


# --- fit and correction ------------------------------------------------------------------------


def make_fits(job: Job, headings: xr.Dataset | None = None) -> xr.Dataset:
    """Deviation fits and 8-point tables: ``fits.nc``, ``tables.csv`` and the swing cards."""
    from airswing.report.run.heading_error import write_swing_cards

    screened, members = job.opened(headings, HEADINGS), job.pools[job.reference]
    require_kept(screened)
    with job.progress.stage("fit") as stage:
        fits = _fitted(job, screened, sign=job.config.table.sign)
        fits = describe(fits.assign(mean_declination=("aircraft", mean_declination(screened))))
        fits = with_implausible(fits, plausibility(screened, references=members))
        watch = watch_compasses(screened, members=members, abscissa=job.config.fit.abscissa)
        job.shared["compass_watch"] = watch
        fits = add_changes(fits, watch.changes)
        stage.note = f"{int(published(fits['status']).sum())} of {fits['status'].size} fits usable"
        if (regions := int(fits["shared_error_regions"].max())) > 1:
            stage.note += f"; the references' shared error in {regions} regions"
        title = "Compass deviation per aircraft and 8-point correction tables"
        job.write(fits, FITS, title=title, sources=(screened,))
    fits = open_product(job.output / FITS).load()
    with job.progress.stage("swing cards") as stage:
        write_tables_csv(fits, job.output / "tables.csv")
        path = job.output / "swing_cards.pdf"
        number = write_swing_cards(fits, screened, path, reference=job.reference)
        stage.note = f"{number} of {fits.sizes['aircraft']} aircraft"
    return fits


def _fitted(job: Job, headings: xr.Dataset, **options: Any) -> xr.Dataset:
    fits = fit_deviation(headings, pools=job.pools, **job.config.fit.model_dump())
    resolution = math.degrees(job.config.table.resolution)
    return add_tables(fits, headings, resolution=resolution, **options).compute()


def make_corrected(job: Job, fits: xr.Dataset | None = None) -> xr.Dataset:
    """The archive with corrected winds, month by month: ``corrected/2008-07.nc``; lazy."""
    fitted, method = job.opened(fits, FITS), job.config.correction.method
    months = sorted((job.output / HEADINGS).glob("*.nc"))
    if not months:
        job.opened(None, HEADINGS)  # raises
    title = "Aircraft reports with winds corrected for compass deviation"
    with job.progress.stage("correct"):
        for path in months:
            with open_product(path) as month:
                # in memory, because writing reads times and places twice
                corrected = correct(month, fitted, reference=job.reference, method=method).load()
                name, sources = f"{CORRECTED}/{path.name}", (month, fitted)
                job.write(corrected, name, title=title, sources=sources)
    return open_product(job.output / CORRECTED)


# --- evaluation --------------------------------------------------------------------------------


def make_evaluation(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, corrected: xr.Dataset
) -> Evaluation:
    """Evaluate the corrections, as far as the configuration allows it.

    Includes the field test if it is configured, and a comparison of two or more references.
    """
    ranking = make_ranking(job, headings, fits)
    return Evaluation(
        innovations=make_innovations(job, headings, corrected),
        observation_errors=make_observation_errors(job, headings, corrected),
        stability=make_stability(job, headings, fits),
        ranking=ranking,
        virtual=virtual_of_month(job, headings, fits, ranking),
        field_test=None if job.config.field_test is None else make_field_test(job, headings),
        sensitivity=make_sensitivity(job, headings) if len(job.config.references) > 1 else None,
        monitoring=make_monitoring(job, headings, fits, corrected),
    )


def make_innovations(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Write ``error_profiles.nc`` and ``innovation_statistics.nc``; return the latter."""
    titles = {
        PROFILES: "Wind error by phase of flight and level, as reported and as corrected",
        "innovation_statistics.nc": "Statistics of observation minus reference by aircraft, phase "
        "and level",
    }
    with job.progress.stage("innovations"):
        products = innovation_products(headings, corrected, pools=job.pools)
        for product, (name, title) in zip(products, titles.items(), strict=True):
            job.write(product, name, title=title, sources=(headings, corrected))
    return products[1]


def make_observation_errors(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Errors of the reports alone by phase of flight and layer: ``observation_errors.nc``."""
    covariance = job.config.observation_errors.reference_covariance
    with job.progress.stage("observation errors") as stage:
        errors = observation_errors(headings, corrected, covariance=covariance, **job.pooling)
        title = "Standard error of a wind component of the reports alone"
        job.write(errors, "observation_errors.nc", title=title, sources=(headings, corrected))
        stage.note = errors.attrs["method"] or errors.attrs["method_reason"]
    return errors


def make_stability(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> Content:
    """Fits by month (by quarter in long archives) and changes of compasses: ``stability.json``.

    Windows before the first remade month keep their fits of the last run.
    """
    with job.progress.stage("stability") as stage:
        first, last = (day.astype("datetime64[D]") for day in time_span(headings))
        by_month = (last - first).astype(int) <= _MOST_DAYS_BY_MONTH
        window: Literal["month", "quarter"] = "month" if by_month else "quarter"
        note, remade = _months_note(job, headings)
        path, noted = job.output / "stability.json", job.notes / "stability.json"
        # begin of the window of the first month made
        first_month = pd.Period(min(remade, default=str(last + 1)), "M" if by_month else "Q")
        begin = np.datetime64(first_month.start_time, "D")
        earlier: list[Content] = []
        if not job.fresh and read_note(noted).get("settings") == note["settings"]:
            last_time = read_note(path)
            if last_time.get("window") == window:
                windows = last_time["windows"]
                earlier = [fit for fit in windows if np.datetime64(fit["window"]) < begin]
        windows = fit_by_window(
            headings,
            window=window,
            since=begin if earlier else None,
            **job.pooling,
            **job.config.fit.model_dump(),
        )
        # aircraft that had no report in the earlier windows
        fitted = {entry["aircraft"] for entry in earlier}
        windows += earlier + [
            {"aircraft": name, "window": window_begin, "reports": 0, "status": "too_few_reports"}
            for name in headings["aircraft"].to_numpy().astype(str).tolist()
            for window_begin in sorted({entry["window"] for entry in earlier})
            if name not in fitted
        ]
        windows.sort(key=lambda entry: (entry["aircraft"], entry["window"]))
        changes = noted_changes(fits)
        result: Content = {"reference": job.reference, "window": window}
        result |= {"changes": changes, "windows": windows}
        write_json(path, result)
        if note["months"]:
            write_json(noted, note)
        changed = [entry["aircraft"] for entry in changes if entry["changes"]]
        stage.note = f"compass changed: {', '.join(changed) or 'none'}"
    return result


def _months_note(job: Job, headings: xr.Dataset) -> tuple[Content, list[str]]:
    """Settings and months of a run, to compare with those of the next, and the months made."""
    months = json.loads(str(headings.attrs.get("months", "{}")))
    remade = months.get("made", [])
    config = job.config.model_dump(exclude={"compute", "output", "metadata"})
    settings = fingerprint(config, code_digest())
    return {"settings": settings, "months": sorted([*remade, *months.get("kept", [])])}, remade


def make_ranking(job: Job, headings: xr.Dataset, fits: xr.Dataset) -> list[Content]:
    """Aircraft in the order of the gain expected of a correction: ``ranking.csv``."""
    with job.progress.stage("ranking") as stage:
        ranking = rank_aircraft(headings, fits, **job.pooling)
        rows = []
        for entry in ranking:
            ends = (entry.get(key) or (None, None) for key in ("expected_gain_ci_kt", "rank_ci"))
            names = ("expected_gain_low_kt", "expected_gain_high_kt", "rank_low", "rank_high")
            rows.append(entry | dict(zip(names, chain(*ends), strict=True)))
        columns = (
            "rank aircraft status reports disagreement_kt expected_gain_kt expected_gain_low_kt "
            "expected_gain_high_kt rank_low rank_high amplitude_deg"
        )
        table = pd.DataFrame(rows, columns=columns.split())
        table = table.astype(dict.fromkeys(("rank", "rank_low", "rank_high"), "Int64"))
        text = table.to_csv(index=False, float_format="%.3f", lineterminator="\n")
        write_text(job.output / "ranking.csv", text)
        first = ranking[0]
        if first["expected_gain_kt"] is not None:
            stage.note = f"{first['aircraft']} would gain {first['expected_gain_kt']:.2f} kt"
    return ranking


def virtual_of_month(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, ranking: list[Content]
) -> Content:
    """The virtual field test, remade when a month begins or an earlier month was remade.

    It fits the earlier reports again, so a run that adds only to the last month keeps the earlier
    result.
    """
    note, remade = _months_note(job, headings)
    names = note["months"]
    path, noted = job.output / "virtual_field_test.json", job.notes / "virtual_field_test.json"
    reusable = not job.fresh and set(remade) <= set(names[-1:]) and read_note(noted) == note
    if reusable and path.exists():
        job.progress.say("virtual_field_test.json: kept until the next month begins")
        return read_note(path)
    result = make_virtual(job, headings, fits, ranking)
    if names:
        write_json(noted, note)
    return result


def make_virtual(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, ranking: list[Content]
) -> Content:
    """Corrections fitted to one part and tested on another: ``virtual_field_test.json``.

    ``later``: fitted up to the start of the field test and applied to the aircraft that were not
    corrected in it; without a field test fitted to the first two thirds of the days. ``held_out``:
    cross-validation over days. If one cannot be computed, it states the reason.
    """
    config, test = job.config, job.config.field_test
    if test is None:
        first, last = (day.astype("datetime64[D]").astype(object) for day in time_span(headings))
        until: date = first + (last - first) * _LEARNED_SHARE
        uncorrected = None
    else:
        until, names = test.start, headings["aircraft"].to_numpy().astype(str).tolist()
        uncorrected = [name for name in names if name not in test.corrected]
    with job.progress.stage("virtual field test") as stage:
        tests = {
            "later": partial(
                virtual_field_test,
                headings,
                learned_until=until,
                corrected=uncorrected,
                resolution=math.degrees(config.table.resolution),
                **job.pooling,
                **config.fit.model_dump(),
            ),
            "held_out": partial(cross_validate, headings, fits, ranking=ranking, **job.pooling),
        }
        result: Content = {}
        for name, compute in tests.items():
            try:
                result[name] = compute()
            except InputError as err:
                result[name] = {"why": str(err)}
        gains = (
            f"{name.replace('_', ' ')} days: reduction by {outcome['realised_gain_kt']:.2f} kt, "
            f"predicted {outcome['predicted_gain_kt']:.2f}"
            for name, outcome in result.items()
            if outcome.get("realised_gain_kt") is not None
        )
        write_json(job.output / "virtual_field_test.json", result)
        stage.note = "; ".join(gains) or "too few reports"
    return result


def make_field_test(job: Job, headings: xr.Dataset | None = None) -> Content:
    """The field test of the configuration: ``field_test.json``.

    It includes the reduction predicted by fits to the reports before the test.
    """
    config, test = job.config, job.config.field_test
    if test is None:
        raise ConfigError(
            "there is no field test to evaluate",
            field="field_test",
            remedy="Add field_test with start, before_start, corrected and controls",
        )
    with job.progress.stage("field test") as stage:
        screened = job.opened(headings, HEADINGS)
        observed = field_test(screened, **job.pooling, **test.model_dump())
        options = {**job.pooling, **config.fit.model_dump(), "corrected": test.corrected}
        result = Findings(observed | predicted_reduction(screened, start=test.start, **options))
        write_json(job.output / "field_test.json", result)
        low, high = result["adjusted_reduction_ci_kt"]
        stage.note = (
            f"adjusted reduction {result['adjusted_reduction_kt']:.2f} kt ({low:.2f} to {high:.2f})"
        )
    return result


def make_sensitivity(job: Job, headings: xr.Dataset | None = None) -> Content:
    """Every reference and pool fitted on the same reports: ``sensitivity.json``."""
    config = job.config
    screened = job.opened(headings, HEADINGS)
    with job.progress.stage("compare") as stage:
        options: dict[str, Any] = {"pools": job.pools, "never_pool": config.never_pool}
        result = compare(screened, **options, **config.fit.model_dump())
        verdicts = (
            f"{' and '.join(pair['references'])}: "
            + ("poolable" if pair["poolable"] else "not poolable")
            for pair in result["pairs"]
        )
        stage.note = "; ".join(verdicts)
    write_json(job.output / "sensitivity.json", result)
    return result


# --- monitoring --------------------------------------------------------------------------------


def make_monitoring(
    job: Job,
    headings: xr.Dataset | None = None,
    fits: xr.Dataset | None = None,
    corrected: xr.Dataset | None = None,
) -> Monitoring:
    """States of the aircraft and events: ``events.json``, and the page that shows them.

    An event that ``events.json`` of an earlier run has is not reported again. Corrected winds are
    used if they exist.
    """
    from airswing.report.run.changes import write_monitoring_page

    path, in_use = job.output / "events.json", job.config.monitoring.tables_in_use
    tables = None if in_use is None else read_tables(in_use, reference=job.reference)
    with job.progress.stage("monitoring") as stage:
        screened, fitted = job.opened(headings, HEADINGS), job.opened(fits, FITS)
        if corrected is None and product_path(job.output, CORRECTED).exists():
            corrected = job.opened(None, CORRECTED)
        monitoring = find_events(
            screened,
            fitted,
            corrected=corrected,
            previous=read_events(path) if path.exists() else None,
            reference=job.reference,
            members=job.pools[job.reference],
            tables_in_use=tables,
            compass=job.shared.get("compass_watch"),
        )
        tables_now = _tables_since(job, screened, changed_since(monitoring))
        monitoring = with_tables(monitoring, tables_now)
        number = len(monitoring.new_events)
        monitoring = replace(monitoring, unsaid=number)
        write_events(monitoring, path)
        write_monitoring_page(job.output / "report" / "monitoring.html", monitoring)
        stage.note = f"{number:,} new event{'s' * (number != 1)}"
    return monitoring


def record_printed(job: Job, number: int) -> None:
    """Record that all `number` events have been printed; a later run may have found more."""
    path = job.output / "events.json"
    monitoring = read_events(path)
    if monitoring.unsaid:
        unsaid = min(max(len(monitoring.events) - number, 0), monitoring.unsaid)
        write_events(replace(monitoring, unsaid=unsaid), path)


def _tables_since(
    job: Job, headings: xr.Dataset, since: dict[str, str]
) -> dict[str, UnitTable | None]:
    """Tables of aircraft whose compass changed, from later reports; None with too few.

    Only these aircraft are fitted: without the others the reference's error is less certain, which
    increases the tables' standard errors.
    """
    if not since:
        return {}
    names = headings["aircraft"].to_numpy().astype(str)
    begin = np.array([since.get(name, "NaT") for name in names], dtype="datetime64[ns]")
    # a comparison with a missing time is false
    late = headings["time"].to_numpy() >= begin[aircraft_of_report(headings)]
    recent = some_reports(headings, late).isel(aircraft=np.isin(names, list(since))).load()
    now = tables_of(_fitted(job, recent).sel(reference=job.reference))
    return dict.fromkeys(since) | {name: now[name] for name in since if name in now}
