"""What judges the corrections after an update, at the cost of the last months.

What tells of the winds as they are now (disagreement, ranking, profiles, the page's figures of
reports) looks at the reports of the last `RECENT` days and the rest of their months; fits and
tables are of all. Fits by calendar month are kept with their month. When a month is complete, the
tables of all months before it are tried out on it (the virtual field test: every month is judged
once by what had not seen it), and the field test and the comparison of references are made; they
stand until the next one is. Flights held out of the fit, which asks for a fit of all reports for
each part, are left to ``airswing run``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import xarray as xr

from airswing.evaluation.results import Evaluation
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.monthly import joined_months
from airswing.products.netcdf import read_product
from airswing.products.ragged import time_span
from airswing.workflow.evaluation_stage import (
    asked_field_test,
    expected_reduction,
    make_field_test,
    make_observation_errors,
    make_profiles,
    make_sensitivity,
)
from airswing.workflow.job import (
    CORRECTED,
    FIELD_TEST,
    FITTING,
    HEADINGS,
    SENSITIVITY,
    Job,
    main_reference,
)
from airswing.workflow.ranking_stage import (
    VIRTUAL,
    make_ranking,
    tried,
    uncorrected,
    written_stability,
    written_virtual,
)
from airswing.workflow.update.month_fits import fits_before
from airswing.workflow.update.months import keep_note, kept_note, span_of

if TYPE_CHECKING:
    from airswing.evaluation.results import Content

Found = TypeVar("Found")
# four weeks: with 31 days the month before would stay whole to the last night of every month
RECENT = 28


@dataclass(frozen=True)
class Recent:
    """The last months of an archive."""

    # headings, corrected: with every aircraft of the fits, also those without a report in them
    headings: xr.Dataset
    corrected: xr.Dataset
    since: str  # first month, empty where these are all


def recent_months(job: Job, months: list[str], fits: xr.Dataset) -> Recent:
    """The months of the last days."""
    with read_product(replace(job, month=months[-1]).place(HEADINGS), lazy=True) as latest:
        first = time_span(latest)[1].astype("datetime64[D]") - (RECENT - 1)
    chosen = [month for month in months if span_of(month)[1] > first]
    headings, corrected = (_of(job, chosen, fits, name) for name in (HEADINGS, CORRECTED))
    return Recent(headings, corrected, "" if chosen == months else chosen[0])


def _of(job: Job, months: list[str], fits: xr.Dataset, name: str = HEADINGS) -> xr.Dataset:
    """Some months of a product, with every aircraft of the fits."""
    return joined_months(
        [read_product(replace(job, month=month).place(name), lazy=True) for month in months],
        aircraft=fits["aircraft"].to_numpy().astype(str),
    )


def judged(
    job: Job, months: list[str], headings: xr.Dataset, fits: xr.Dataset, recent: Recent
) -> Evaluation:
    """Everything that judges the corrections, as of now.

    Parameters
    ----------
    headings, fits : Dataset
        Of all months.
    """
    config, later = job.config, _Monthly(job, months)
    return Evaluation(
        virtual=later.kept(VIRTUAL, lambda: _virtual(job, months[:-1], headings, fits)),
        field_test=later.kept(FIELD_TEST, lambda: _field_test(job, months, headings, fits))
        if config.field_test is not None
        else None,
        sensitivity=later.kept(SENSITIVITY, lambda: make_sensitivity(job, headings))
        if len(config.references) > 1
        else None,
        profiles=make_profiles(job, recent.headings, recent.corrected),
        observation_errors=make_observation_errors(job, recent.headings, recent.corrected),
        stability=_stability(job, months, fits),
        ranking=make_ranking(job, recent.headings, fits),
    )


def _virtual(job: Job, complete: list[str], headings: xr.Dataset, fits: xr.Dataset) -> Content:
    """The last complete month judged by the tables of those before it."""
    from airswing.evaluation.backtest.virtual_field_test import virtual_field_test

    config = job.config
    with job.progress.stage("virtual field test") as stage:
        later: Content = {"why": "fewer than two months are complete"}
        if len(complete) > 1:
            later = tried(
                lambda: virtual_field_test(
                    _of(job, complete[-2:], fits),
                    learned_until=span_of(complete[-1])[0].astype("M8[D]").astype(object),
                    corrected=uncorrected(job, headings),
                    fits=fits_before(job, complete[:-1], headings),
                    pools=config.pools(),
                    reference=main_reference(config),
                )
            )
        result: Content = {
            "later": later,
            "held_out": {"why": "left to `airswing run`"},
        }
        stage.note = written_virtual(job, result)
    return result


def _field_test(job: Job, months: list[str], headings: xr.Dataset, fits: xr.Dataset) -> Content:
    """The field test of the months of its dates; what was expected of it is kept."""
    test = asked_field_test(job)
    last = test.end or span_of(months[-1])[1].astype("M8[D]").astype(object)
    of = [one for one in months if str(test.before_start)[:7] <= one <= str(last)[:7]]
    before = [one for one in months if one <= str(test.start)[:7]]
    if not of or not before:
        return make_field_test(job, headings)  # which says what is missing
    path = job.output / ".update" / "expected.json"
    with _of(job, before, fits) as known:
        made = fingerprint(
            known.attrs["uuid"],
            job.config.model_dump(include={"fit", "pool", "field_test"}),
            code_digest(__name__, *FITTING),
        )
        note = kept_note(path)
        if note.get("made") != made:
            note = {"made": made, "found": _plain(expected_reduction(job, known))}
            keep_note(path, note)
    return make_field_test(job, _of(job, of, fits), expected=note["found"])


class _Monthly:
    """What is judged anew when a month is complete.

    Parameters
    ----------
    job : Job
    months : list of str
        The last of them is under way.
    """

    def __init__(self, job: Job, months: list[str]) -> None:
        self.job, self.complete = job, months[:-1]

    def kept(self, name: str, make: Callable[[], Found]) -> Found:
        """What stands since the last month was complete; made where nothing does."""
        config = self.job.config.model_dump(exclude={"compute", "output"})
        made = fingerprint(name, self.complete, config, code_digest(__name__, *FITTING))
        path = (self.job.output / ".update" / name).with_suffix(".json")
        before = kept_note(path)
        if self.complete and before.get("made") == made and (self.job.output / name).exists():
            self.job.progress.say(f"{name}: of the months to {self.complete[-1]}, kept")
            kept: Found = before["found"]
            return kept
        found = make()
        keep_note(path, {"made": made, "found": _plain(found)})
        return found


def _plain(found: object) -> object:
    """What JSON can hold, not-a-number included."""
    plain: object = json.loads(json.dumps(found, default=lambda value: value.tolist()))
    return plain


def _stability(job: Job, months: list[str], fits: xr.Dataset) -> Content:
    """Fits by calendar month, each made with its month alone, and the changes found."""
    windows: list[Content] = []
    with job.progress.stage("stability") as stage:
        for month in months:
            windows += _window(replace(job, month=month))
        windows.sort(key=lambda entry: (entry["aircraft"], entry["window"]))
        result, stage.note = written_stability(job, fits, "month", windows)
    return result


def _window(job: Job) -> list[Content]:
    """Fits of one month, kept while its headings and the fit stay as they are."""
    from airswing.evaluation.monitoring import fit_by_window

    config, path = job.config, job.output / ".update" / f"{job.month}.window.json"
    with read_product(job.place(HEADINGS), lazy=True) as headings:
        made = fingerprint(
            headings.attrs["uuid"],
            config.model_dump(include={"fit", "pool"}),
            code_digest(*FITTING),
        )
        before = kept_note(path)
        if before.get("made") == made:
            return list(before["found"])
        found = fit_by_window(
            headings,
            pools=config.pools(),
            reference=main_reference(config),
            **config.fit.model_dump(),
        )
    # a flight over the end of the month is of the month it began in
    first = f"{job.month}-01"
    found = [entry for entry in found if entry["window"] == first]
    keep_note(path, {"made": made, "found": _plain(found)})
    return found
