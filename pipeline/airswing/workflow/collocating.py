"""From files to headings, some aircraft at a time: read, catalogue, plan, collocate, derive.

Reports are set down by aircraft as they are read, their places by time; the model winds are found
stretch of time by stretch of time and taken back block by block of aircraft. Neither this process
nor a worker ever holds more than a block or a stretch.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from airswing.errors import InputError
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.monthly import FLIGHTS
from airswing.report.run.reading_warnings import model_warnings, reading_warnings, unread
from airswing.workflow.job import Blocks, Job

if TYPE_CHECKING:
    from airswing.compass.kept_headings import KeptHeadings
    from airswing.reference.geometry.wind_profiles import Catalogue
    from airswing.reference.places import Places
    from airswing.reference.planning import Need, Plan
    from airswing.reference.store import SampleStore
    from airswing.reports.report_blocks import Archive
    from airswing.reports.staging_store import Spool
    from airswing.workflow.progress import StageRecord


@dataclass(frozen=True)
class Sources:
    """Reports and models a job is to take instead of all that its configuration names."""

    mark: str  # hash of what they hold
    # gives the reports and the model of every reference; asked only where they are needed
    opened: Callable[[], tuple[Archive, dict[str, Catalogue]]]


def read(job: Job, folder: Path) -> Archive:
    """Read the aircraft reports the configuration names, and set them down by aircraft.

    Parameters
    ----------
    folder : Path
        Where; cleaned reports of files that are still the same are taken up from there.
    """
    from airswing.reports.report_blocks import Archive

    with job.progress.stage("reports") as stage:
        spool = filled(job, folder)
        with written_to(folder):
            archive = Archive(spool, folder / "blocks", interval=job.config.reports.interval)
        stage.note = f"{archive.reports:,} reports of {archive.aircraft} aircraft"
        stage.reports = archive.reports
        stage.octets = spool.octets_read
    for warning in reading_warnings(archive.audit.as_dict()):
        job.progress.say(f"  {warning}")
    return archive


def filled(job: Job, folder: Path) -> Spool:
    """Set the reports the configuration names down by aircraft, not yet in order of time.

    Parameters
    ----------
    folder : Path
        As for :func:`read`.
    """
    from airswing.reports.staging_store import Spool

    asked = job.config.reports
    options = asked.model_dump(include={"format", "columns", "only", "on_bad_file"})
    spool = Spool(
        folder / "reports",
        # the code too: cleaned reports of an older version are cleaned anew
        key=fingerprint(options, code_digest("airswing.reports.staging_store")),
    )
    spool.fill(
        asked.files, format=asked.format, columns=asked.mapping, on_bad_file=asked.on_bad_file
    )
    return spool


def catalogues(
    job: Job,
    names: list[str],
    archive: Archive | None = None,
    folder: Path | None = None,
    *,
    only: Mapping[str, list[str]] | None = None,
) -> dict[str, Catalogue]:
    """Catalogue the files of some references.

    Parameters
    ----------
    archive : Archive, optional
        What a wind of the fleet itself is made of.
    folder : Path, optional
        Where that is kept.
    only : mapping of str to list of str, optional
        Paths of each reference; by default all that its configuration names.
    """
    from airswing.reference.catalogues import build_catalogue
    from airswing.reference.fleet_wind import write_fleet_wind

    found = {}
    with job.progress.stage("catalogue") as stage:
        for name in names:
            asked = job.config.references[name]
            files, engine = (only or {}).get(name, asked.files), str(asked.engine)
            # made of the reports themselves, and from then on a reference like any other
            if engine == "fleet" and archive is not None and folder is not None:
                with written_to(folder):
                    files = [str(write_fleet_wind(archive, folder / f"{name}_wind.nc"))]
                engine = "netcdf"
            found[name] = build_catalogue(
                files,
                name=name,
                lead=asked.lead,
                member=asked.member,
                on_bad_file=asked.on_bad_file,
                engine=engine,
                naming=asked.naming(),
            )
        stage.note = ", ".join(
            f"{name} {len(model):,} model times" for name, model in found.items()
        )
    for name, model in found.items():
        for note in [*model_warnings(model.skipped), *model.notes]:
            job.progress.say(f"  {name}: {note}")
    return found


def set_places_down(archive: Archive, folder: Path) -> Places:
    """Sort the places of an archive into stretches of time."""
    from airswing.reference.places import Places, stretches

    with written_to(folder):
        places = Places(folder, stretches(archive.hours))
        for reports in archive:
            places.add(reports)
    return places


@contextlib.contextmanager
def written_to(folder: Path) -> Iterator[None]:
    """Tell in one message that a folder for work under way cannot be written to.

    Raises
    ------
    InputError
    """
    try:
        yield
    except OSError as err:
        raise InputError(
            "cannot keep the work under way; what was finished before is whole",
            file=folder,
            found=err.strerror or err,
            remedy="Free space or choose another folder with --output, then --resume",
        ) from err


def needs_of(
    job: Job,
    places: Places,
    models: dict[str, Catalogue],
    *,
    kept: SampleStore | None = None,
) -> dict[str, Need]:
    """What all reports need of each reference.

    Parameters
    ----------
    kept : SampleStore, optional
        Of an earlier run: says what need not be read again.
    """
    from airswing.reference.planning import Need, points_of

    gap, needs = job.config.collocation.max_time_gap, dict[str, Need]()
    # samples without derivatives do not serve: the gap's inputs are made in the same pass
    finished = None if kept is None else partial(kept.holds, derivatives=True)
    for number in range(len(places)):
        points = points_of(places.reports(number))
        for name, model in models.items():
            own = Need.of(points, model, max_time_gap=gap, derivatives=True, finished=finished)
            needs[name] = needs[name] + own if name in needs else own
    return needs


def _plans_of(
    job: Job,
    places: Places,
    models: dict[str, Catalogue],
    *,
    aircraft: int,
) -> dict[str, Plan]:
    """What the collocation will read, and which reports have no model."""
    from airswing.workflow.cost import stage_seconds

    with job.progress.stage("plan") as stage:
        plans = {
            name: need.plan(name, models[name], sparse=job.config.collocation.sparse)
            for name, need in needs_of(job, places, models).items()
        }
        messages = sum(one.messages for one in plans.values())
        stage.note = f"{messages:,} messages to read"
    # reports are the same for each; a reference without any has none counted
    reports = max(one.reports for one in plans.values())
    threads = job.progress.threads
    job.progress.expected = stage_seconds(reports, aircraft, plans, threads=threads)
    return plans


Problem = tuple[int, str, str]
"""Met in reading a reference: valid time (ns since 1970), file and reason."""


def collocate_places(
    job: Job,
    places: Places,
    models: dict[str, Catalogue],
    plans: dict[str, Plan],
    folder: Path,
) -> dict[str, set[Problem]]:
    """Find the model winds of every stretch of time.

    Parameters
    ----------
    places : Places
        Takes the winds.
    folder : Path
        For the finished model times; those of it that are no longer used are removed.

    Returns
    -------
    dict of str to set
        Problems met in reading each reference: valid time, file and reason.
    """
    from airswing.reference.collocate import ACCOUNT, PROBLEMS, collocate
    from airswing.reference.store import SampleStore

    asked = job.config.collocation
    problems: dict[str, set[Problem]] = {name: set() for name in models}
    with job.progress.stage("collocate") as stage:
        stage.tasks = sum(one.model_times for one in plans.values())
        store = SampleStore(folder)
        with written_to(folder):
            store.begin()
        for number in range(len(places)):
            # stretches of time one after the other: memory holds the winds of one
            winds = collocate(
                places.reports(number),
                models,
                store=folder,
                account=True,
                max_time_gap=asked.max_time_gap,
                sparse=asked.sparse,
                derivatives=True,
            ).compute()
            _account(stage, winds)
            for name, met in zip(models, winds[PROBLEMS].to_numpy(), strict=True):
                problems[name] |= met
            with written_to(folder):
                places.put(number, winds.drop_vars([*ACCOUNT, PROBLEMS]))
        # after all stretches: a model time may serve the next one as well
        store.forget_unused()
        matched = ", ".join(f"{name} {one.matched:,}" for name, one in plans.items())
        stage.note = f"reports within the model: {matched}"
        stage.reports = max(one.matched for one in plans.values())
    return problems


def _account(stage: StageRecord, winds: xr.Dataset) -> None:
    stage.messages += int(winds["decoded_messages"].sum())
    stage.octets += int(winds["decoded_bytes"].sum())
    stage.decoding += float(winds["decoding_seconds"].sum())


def collocated_blocks(
    job: Job,
    *,
    names: list[str],
    kept: KeptHeadings | None = None,
    given: Sources | None = None,
) -> Blocks:
    """Reports with model winds and headings, some aircraft at a time; not screened or written.

    Parameters
    ----------
    names : list of str
        References to sample.
    kept : KeptHeadings, optional
        What an earlier run derived.
    given : Sources, optional
        Reports and models; by default those the configuration names.

    Returns
    -------
    Blocks
        With the reference wind's derivatives, which the gap diagnosis needs; ``reading_audit``,
        ``reference_audit`` and ``ground_vector_evidence`` in the attributes.
    """
    from airswing.compass.kept_headings import KeptHeadings
    from airswing.reference.collocate import DERIVATIVES
    from airswing.reference.geometry.model_time import of_a_lost_file
    from airswing.reference.overlap import require_overlap

    if given is None:
        archive = read(job, job.store)
        models = catalogues(job, names, archive, job.store)
    else:
        archive, models = given.opened()
    places = set_places_down(archive, job.store / "blocks")
    plans = _plans_of(job, places, models, aircraft=archive.aircraft)
    if given is None:
        # before hours of reading: no report in the model's time or grid is a mistake of the
        # configuration
        require_overlap(plans)
    met = collocate_places(job, places, models, plans, job.store)
    lost = {file for one in met.values() for _, file, reason in one if of_a_lost_file(reason)}
    if lost:
        job.progress.say(
            f"  model files that vanished or changed before they were read: {len(lost):,}; their "
            "reports have no wind, --resume reads them again"
        )
    audit = {
        name: plans[name].as_dict()
        | {"notes": model.notes, "skipped": model.skipped}
        | {"unread_messages": len(met[name]), "unread": unread(met[name])}
        for name, model in models.items()
    }
    attrs: dict[str, object] = {
        "reading_audit": archive.audit.as_json(),
        "featureType": "trajectory",
        "reference_audit": audit,
    } | ({} if given is None else {FLIGHTS: archive.flights})

    found = kept or KeptHeadings()

    def each(stage: StageRecord) -> Iterator[xr.Dataset]:
        for number, reports in enumerate(archive):
            winds = places.winds(number, reports)
            headings = found.derive(reports, winds.drop_vars(DERIVATIVES))
            yield headings.assign(winds[list(DERIVATIVES)])
        # what derives headings learns on all blocks, so it is known after the last
        attrs["ground_vector_evidence"] = json.dumps(found.evidence)

    return Blocks(archive.reports, archive.aircraft, each, "headings", attrs, whole=not lost)
