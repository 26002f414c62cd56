"""The stages in order, as a person would read them.

reports -> collocate -> headings -> screen -> fit -> table -> correct -> page. Each function here
takes the configuration and what the stage before made, calls the package's own functions with
plain arguments, and writes one product. A product carries the fingerprint of all it depends on;
with ``resume`` a product whose fingerprint still holds is read instead of made again.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from airswing.config import Config, as_json
from airswing.errors import ConfigError, InputError
from airswing.fingerprint import code_digest, file_identities, fingerprint
from airswing.products import as_stored, read_product, require_writable, write_json, write_product
from airswing.progress import Progress
from airswing.workspace import workspace

if TYPE_CHECKING:
    from airswing.reference.catalogue import Catalogue
    from airswing.reference.planning import Plan

HEADINGS, FITS, CORRECTED = "headings.nc", "fits.nc", "corrected.nc"
PROFILES, FIELD_TEST, SENSITIVITY = "error_profiles.nc", "field_test.json", "sensitivity.json"

COLLOCATING = (
    "airswing.reports.read",
    "airswing.reference.catalogue",
    "airswing.reference.collocate",
    "airswing.compass.headings",
)
FITTING = (
    "airswing.compass.deviation",
    "airswing.compass.table",
    "airswing.evaluation.stability",
)
"""Modules whose source, with all they use, a product depends on."""


@dataclass(frozen=True)
class Job:
    """One run: what is asked, who is told, and whether earlier work counts.

    Parameters
    ----------
    config : Config
    progress : Progress
    resume : bool, default False
        Use finished products and model times that still hold.
    """

    config: Config
    progress: Progress
    resume: bool = False

    @property
    def output(self) -> Path:
        """Folder of the products."""
        return self.config.output

    @property
    def store(self) -> Path:
        """Folder of finished model times, there while a run is under way, or kept on request."""
        return self.output / ".collocated"

    def clear_store(self) -> None:
        """Remove the finished model times, unless the configuration keeps them."""
        if not self.config.compute.keep_samples:
            shutil.rmtree(self.store, ignore_errors=True)


def run(job: Job) -> dict[str, Any]:
    """Do the main job: every stage, every product, the page.

    Parameters
    ----------
    job : Job

    Returns
    -------
    dict
        The closing summary (see :func:`airswing.summary.summarise`), and as ``accounts`` what
        each stage cost (see :meth:`airswing.progress.Progress.accounts`).
    """
    from airswing.summary import summarise

    with workspace(job.output):
        headings = make_headings(job)
        fits = make_fits(job, headings)
        corrected = make_corrected(job, headings, fits)
        summary = summarise(job.config, headings, fits, corrected)
        evaluation = make_evaluation(job, headings, fits, corrected)
        make_page(job, headings, fits, corrected, summary, evaluation)
    job.progress.say(job.progress.accounts_text())
    return summary | {"accounts": job.progress.accounts()}


def plan_run(job: Job) -> dict[str, Any]:
    """Say what a run would read and cost; nothing is decoded and nothing written.

    Parameters
    ----------
    job : Job

    Returns
    -------
    dict
        Per reference what :func:`airswing.reference.planning.plan` counts; ``reports``, and
        estimates ``seconds`` and ``memory_bytes`` from this package's own benchmarks.
    """
    from airswing.cost import estimate

    reports = read(job)
    models = catalogues(job, list(job.config.references))
    asked = job.config.collocation
    options = {"max_time_gap": asked.max_time_gap, "sparse": asked.sparse, "derivatives": False}
    plans = plans_of(job, reports, models, options)
    return {
        "reports": reports.sizes["report"],
        "aircraft": reports.sizes["aircraft"],
        **estimate(reports.sizes["report"], plans),
        "references": {name: one.as_dict() for name, one in plans.items()},
    }


def read(job: Job) -> xr.Dataset:
    """Read the aircraft reports the configuration names.

    Parameters
    ----------
    job : Job

    Returns
    -------
    Dataset
        Canonical reports.
    """
    from airswing.reports.read import read_reports

    asked = job.config.reports
    with job.progress.stage("reports") as stage:
        reports = read_reports(
            asked.files, format=asked.format, columns=asked.columns, on_bad_file=asked.on_bad_file
        )
        stage.note = f"{reports.sizes['report']:,} reports of {reports.sizes['aircraft']} aircraft"
        stage.reports = reports.sizes["report"]
        stage.octets = sum(size for _, size, _ in file_identities(asked.files))
    return reports


def catalogues(job: Job, names: list[str]) -> dict[str, Catalogue]:
    """Catalogue the GRIB folders of some references.

    Parameters
    ----------
    job : Job
    names : list of str

    Returns
    -------
    dict of str to Catalogue
    """
    from airswing.reference.catalogue import build_catalogue

    found = {}
    with job.progress.stage("catalogue") as stage:
        for name in names:
            asked = job.config.references[name]
            found[name] = build_catalogue(
                asked.files, name=name, lead=asked.lead, on_bad_file=asked.on_bad_file
            )
        stage.note = ", ".join(
            f"{name} {len(model):,} model times" for name, model in found.items()
        )
    for name, model in found.items():
        for note in model.notes:
            job.progress.say(f"  {name}: {note}")
    return found


def plans_of(
    job: Job, reports: xr.Dataset, models: dict[str, Catalogue], options: dict[str, Any]
) -> dict[str, Plan]:
    """What the collocation will read, and which reports have no model.

    Parameters
    ----------
    job : Job
    reports : Dataset
    models : dict of str to Catalogue
    options : dict
        ``max_time_gap``, ``sparse`` and ``derivatives`` of the collocation.

    Returns
    -------
    dict of str to Plan
    """
    from airswing.cost import stage_seconds
    from airswing.reference.planning import plan

    with job.progress.stage("plan") as stage:
        plans = plan(reports, models, **options)
        messages = sum(one.messages for one in plans.values())
        stage.note = f"{messages:,} messages to read"
    job.progress.expected = stage_seconds(
        reports.sizes["report"], plans, threads=job.progress.threads
    )
    return plans


def collocated_headings(job: Job, *, names: list[str], derivatives: bool = False) -> xr.Dataset:
    """Reports with model winds and headings, not yet screened or written.

    Parameters
    ----------
    job : Job
    names : list of str
        References to sample.
    derivatives : bool, default False
        Also sample the reference wind's derivatives, which the gap diagnosis needs.

    Returns
    -------
    Dataset
        In memory; ``reading_audit`` and ``reference_audit`` in the attributes.
    """
    from airswing.compass.headings import derive_headings
    from airswing.reference.collocate import ACCOUNT, collocate
    from airswing.reference.planning import require_overlap

    reports = read(job)
    models = catalogues(job, names)
    asked = job.config.collocation
    options: dict[str, Any] = {
        "max_time_gap": asked.max_time_gap,
        "sparse": asked.sparse,
        "derivatives": derivatives,
    }
    plans = plans_of(job, reports, models, options)
    require_overlap(plans)
    with job.progress.stage("collocate") as stage:
        winds = collocate(reports, models, store=job.store, account=True, **options).compute()
        matched = ", ".join(f"{name} {one.matched:,}" for name, one in plans.items())
        stage.note = f"reports within the model: {matched}"
        stage.reports = max(one.matched for one in plans.values())
        stage.messages = int(winds["decoded_messages"].sum())
        stage.octets = int(winds["decoded_bytes"].sum())
        stage.decoding = float(winds["decoding_seconds"].sum())
    unread = winds["unread_messages"].to_series().to_dict()
    with job.progress.stage("headings") as stage:
        headings = derive_headings(reports, winds.drop_vars(list(ACCOUNT))).compute()
        stage.reports = headings.sizes["report"]
    headings.attrs["reference_audit"] = {
        name: plans[name].as_dict()
        | {"notes": model.notes, "skipped": model.skipped, "unread_messages": unread[name]}
        for name, model in models.items()
    }
    return headings


def make_headings(job: Job) -> xr.Dataset:
    """Reports, model winds, headings and screening: ``headings.nc``.

    Parameters
    ----------
    job : Job

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If no report is left after screening.
    """
    from airswing.compass.screening import mark_corrected_units, screen

    config = job.config
    names = list(config.references)
    unscreened = fingerprint(
        config.model_dump(include={"reports", "references", "collocation"}),
        file_identities(config.reports.files),
        [file_identities(model.files) for model in config.references.values()],
        code_digest(*COLLOCATING),
    )

    def make() -> xr.Dataset:
        headings = _unscreened(job, unscreened)
        if headings is None:
            if not job.resume:
                job.clear_store()
            headings = as_stored(collocated_headings(job, names=names))
        headings.attrs["unscreened_fingerprint"] = unscreened
        with job.progress.stage("screen") as stage:
            headings = screen(headings, **config.screening.model_dump())
            if config.field_test is not None:
                test = config.field_test
                headings = mark_corrected_units(
                    headings,
                    aircraft=test.corrected,
                    start=np.datetime64(test.start),
                    end=None if test.end is None else np.datetime64(test.end),
                )
            kept = int((headings["screening"] == 0).sum())
            stage.note = f"{kept:,} of {headings.sizes['report']:,} reports kept"
            stage.reports = kept
        require_kept(headings)
        return headings

    headings = _product(
        job,
        HEADINGS,
        make,
        title="Heading errors of aircraft reports against model winds",
        depends=(
            unscreened,
            config.model_dump(include={"screening", "field_test"}),
            code_digest("airswing.compass.screening"),
        ),
    )
    job.clear_store()
    return headings


def make_fits(job: Job, headings: xr.Dataset | None = None) -> xr.Dataset:
    """Deviation fits and 8-point tables: ``fits.nc``, ``tables.csv`` and the swing cards.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Dataset
    """
    from airswing.compass.deviation import fit_deviation
    from airswing.compass.swingcard import write_swing_cards, write_tables_csv
    from airswing.compass.table import add_tables
    from airswing.evaluation.stability import add_changes, find_changes

    config, ready = job.config, _ready(job, headings, HEADINGS)

    def make() -> xr.Dataset:
        with job.progress.stage("fit") as stage:
            fits = fit_deviation(ready, pools=config.pools(), **config.fit.model_dump())
            resolution = math.degrees(config.table.resolution)
            fits = add_tables(fits, ready, resolution=resolution, sign=config.table.sign)
            members = config.pools()[main_reference(config)]
            fits = add_changes(
                fits, find_changes(ready, members=members, abscissa=config.fit.abscissa)
            )
            good = int((fits["status"] == 0).sum())
            stage.note = f"{good} of {fits['status'].size} fits to be trusted"
        return fits

    fits = _product(
        job,
        FITS,
        make,
        title="Compass deviation per aircraft and 8-point correction tables",
        depends=(
            config.model_dump(include={"fit", "table", "pool"}),
            ready.attrs["uuid"],
            code_digest(*FITTING),
        ),
        sources=(ready,),
    )
    write_tables_csv(fits, job.output / "tables.csv")
    write_swing_cards(fits, job.output / "swing_cards", reference=main_reference(config))
    return fits


def make_corrected(
    job: Job, headings: xr.Dataset | None = None, fits: xr.Dataset | None = None
) -> xr.Dataset:
    """The archive with corrected winds: ``corrected.nc``.

    Parameters
    ----------
    job : Job
    headings, fits : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Dataset
    """
    from airswing.compass.correction import correct

    ready, fitted = _ready(job, headings, HEADINGS), _ready(job, fits, FITS)

    def make() -> xr.Dataset:
        with job.progress.stage("correct"):
            return correct(ready, fitted, reference=main_reference(job.config))

    return _product(
        job,
        CORRECTED,
        make,
        title="Aircraft reports with winds corrected for compass deviation",
        depends=(
            main_reference(job.config),
            ready.attrs["uuid"],
            fitted.attrs["uuid"],
            code_digest("airswing.compass.correction"),
        ),
        sources=(ready, fitted),
    )


def make_page(
    job: Job,
    headings: xr.Dataset,
    fits: xr.Dataset,
    corrected: xr.Dataset,
    summary: dict[str, Any],
    evaluation: dict[str, Any],
) -> Path:
    """The page a person opens first: ``report/index.html``.

    Parameters
    ----------
    job : Job
    headings, fits, corrected : Dataset
    summary : dict
        Of :func:`airswing.summary.summarise`.
    evaluation : dict
        Of :func:`make_evaluation`.

    Returns
    -------
    Path
    """
    from airswing.compass.screening import audit
    from airswing.report.page import write_page

    with job.progress.stage("page") as stage:
        page = write_page(
            job.output / "report",
            headings=headings,
            fits=fits,
            corrected=corrected,
            audit=audit(headings),
            summary=summary,
            **evaluation,
        )
        stage.note = str(page)
    return page


def make_evaluation(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, corrected: xr.Dataset
) -> dict[str, Any]:
    """Everything that judges the corrections, as far as the configuration allows it.

    Parameters
    ----------
    job : Job
    headings, fits, corrected : Dataset

    Returns
    -------
    dict
        ``profiles``, ``stability``, ``ranking``, ``virtual``, and ``field_test`` and
        ``sensitivity`` where there are groups and more than one reference; the keywords of
        :func:`airswing.report.page.write_page`.
    """
    from airswing.evaluation_workflow import make_ranking, make_stability, make_virtual

    found: dict[str, Any] = {
        "profiles": make_profiles(job, headings, corrected),
        "stability": make_stability(job, headings),
        "ranking": make_ranking(job, headings, fits),
        "virtual": make_virtual(job, headings),
    }
    if job.config.field_test is not None:
        found["field_test"] = make_field_test(job, headings)
    if len(job.config.references) > 1:
        found["sensitivity"] = make_sensitivity(job, headings)
    return found


def make_profiles(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Error profiles by phase of flight and level: ``error_profiles.nc``.

    Parameters
    ----------
    job : Job
    headings, corrected : Dataset

    Returns
    -------
    Dataset
    """
    from airswing.evaluation.profiles import error_profiles

    with job.progress.stage("profiles"):
        profiles = error_profiles(headings, corrected, pools=job.config.pools())
        write_product(
            profiles,
            job.output / PROFILES,
            title="Wind error by phase of flight and level, as reported and as corrected",
            config_json=as_json(job.config),
            source_uuids=[headings.attrs["uuid"], corrected.attrs["uuid"]],
        )
    return profiles


def make_field_test(job: Job, headings: xr.Dataset | None = None) -> dict[str, Any]:
    """The field test of the configuration: ``field_test.json``.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    dict

    Raises
    ------
    ConfigError
        If the configuration has no ``field_test``.
    """
    from airswing.evaluation.fieldtest import field_test
    from airswing.evaluation.virtual import predicted_reduction

    config = job.config
    if config.field_test is None:
        raise ConfigError(
            "there is no field test to evaluate",
            field="field_test",
            remedy="Add field_test with start, before_start, corrected and controls",
        )
    with job.progress.stage("field test") as stage:
        ready = _ready(job, headings, HEADINGS)
        against: dict[str, Any] = {"pools": config.pools(), "reference": main_reference(config)}
        result = field_test(ready, **against, **config.field_test.model_dump())
        result |= predicted_reduction(
            ready,
            start=config.field_test.start,
            corrected=config.field_test.corrected,
            **against,
            **config.fit.model_dump(),
        )
        write_json(job.output / FIELD_TEST, result)
        low, high = result["adjusted_reduction_ci_kt"]
        stage.note = (
            f"adjusted reduction {result['adjusted_reduction_kt']:.2f} kt ({low:.2f} to {high:.2f})"
        )
    return result


def make_sensitivity(job: Job, headings: xr.Dataset | None = None) -> dict[str, Any]:
    """Every reference and pool fitted on the same reports: ``sensitivity.json``.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    dict
    """
    from airswing.evaluation.sensitivity import compare

    config = job.config
    with job.progress.stage("compare") as stage:
        result = compare(
            _ready(job, headings, HEADINGS),
            pools=config.pools(),
            never_pool=config.never_pool,
            **config.fit.model_dump(),
        )
        write_json(job.output / SENSITIVITY, result)
        verdicts = (
            f"{' and '.join(pair['references'])}: "
            + ("poolable" if pair["poolable"] else "not poolable")
            for pair in result["pairs"]
        )
        stage.note = "; ".join(verdicts)
    return result


def main_reference(config: Config) -> str:
    """Fits used for the correction and the cards: the first pool, else the first reference.

    Parameters
    ----------
    config : Config

    Returns
    -------
    str
    """
    return next(iter([*config.pool, *config.references]))


def require_kept(headings: xr.Dataset) -> None:
    """Refuse to go on when screening left nothing, and say which rules did it.

    Parameters
    ----------
    headings : Dataset
        Screened.

    Raises
    ------
    InputError
    """
    from airswing.compass.screening import audit

    if bool((headings["screening"] == 0).any()):
        return
    total = audit(headings)["together"].sum("aircraft").to_series()
    found = ", ".join(f"{rule} {count:,}" for rule, count in total[total > 0].items())
    raise InputError(
        "screening left no report",
        field="screening",
        found=f"of {headings.sizes['report']:,} reports, left out by {found}",
        remedy="Loosen the rule that removed most, or check the reports",
    )


def _unscreened(job: Job, mark: str) -> xr.Dataset | None:
    """Reports with model winds of an earlier run that still hold, to be screened anew."""
    path = job.output / HEADINGS
    if not (job.resume and path.exists()):
        return None
    found = read_product(path)
    if found.attrs.get("unscreened_fingerprint") != mark:
        return None
    job.progress.say(f"{HEADINGS}: model winds kept, screened anew")
    return found.drop_vars("screening")


def _ready(job: Job, given: xr.Dataset | None, name: str) -> xr.Dataset:
    return read_product(job.output / name) if given is None else given


def _product(
    job: Job,
    name: str,
    make: Callable[[], xr.Dataset],
    *,
    title: str,
    depends: tuple[Any, ...],
    sources: tuple[xr.Dataset, ...] = (),
) -> xr.Dataset:
    """Read a product that still holds, or make it and write it."""
    path, mark = job.output / name, fingerprint(name, *depends)
    if job.resume and path.exists():
        found = read_product(path)
        if found.attrs.get("fingerprint") == mark:
            job.progress.say(f"{name}: nothing changed, kept")
            return found
    require_writable(job.output)
    made = make()
    made.attrs["fingerprint"] = mark
    write_product(
        made,
        path,
        title=title,
        config_json=as_json(job.config),
        sources=[*job.config.reports.files, *job.config.references],
        source_uuids=[source.attrs["uuid"] for source in sources],
    )
    del made  # a year's product is not held twice
    return read_product(path)
