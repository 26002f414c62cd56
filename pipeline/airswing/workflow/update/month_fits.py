"""Fits of all months from the sums each of them keeps.

An aircraft is fitted to all of its reports once: that is its base, from which every month is summed
(:mod:`airswing.compass.kept_sums.period_sums`). From then on a month that is touched is summed
again, and the fleet is fitted on the sums of all months. Where the sums do not tell an aircraft's
fit, because it lies too far from its base for the weights to stand or other errors are left, it is
fitted to all of its reports again, which is its next base. An aircraft without a curve has no base:
its fit is kept as long as its reports stay as they are.

Whatever is killed between, the same update gives the same fits: what makes a new base of an
aircraft would make the same one of it again, and an aircraft with a new base is near it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import MAX_CONDITION, AircraftSums, condition_number
from airswing.compass.fit.aircraft import MIDDLE
from airswing.compass.fit.deviation import (
    FITTED_FROM,
    FleetSums,
    fit_sums,
    groups_of,
    sum_aircraft,
)
from airswing.compass.fit.offset_alone import MIN_FLIGHTS
from airswing.compass.fit.report_columns import Columns
from airswing.compass.heading_kind import declination_sums
from airswing.compass.kept_sums.packed import (
    Stored,
    packed_bases,
    packed_sums,
    unpacked_bases,
    unpacked_sums,
)
from airswing.compass.kept_sums.period_sums import (
    Base,
    PeriodSums,
    durations_of,
    mean_field,
    merged_fit,
    sum_period,
)
from airswing.compass.table import add_tables, heading_histogram
from airswing.evaluation.monitoring import watch_compasses
from airswing.flags import STATUS
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.netcdf import read_product
from airswing.workflow.fits import Seen
from airswing.workflow.job import FITTING, HEADINGS, Job, main_reference
from airswing.workflow.update.month_sums import (
    MonthSums,
    by_group,
    chosen_blocks,
    contents,
    keep_arrays,
    kept_arrays,
    mark_of,
)

AS_FITTED = 3.0
"""Standard errors that a fit of some of the months may lie from the bases, as the last step of a
fit to reports may be long; what it costs: :data:`.period_sums.FARTHEST`."""
MUCH_ALIKE = 1.25
"""Growth of an aircraft's reports, above some 16,000, until it is fitted to all of them again."""
_CODE = (*FITTING, "airswing.compass.kept_sums.packed")


@dataclass(frozen=True)
class MonthlyFits:
    """Looks at the reports month by month; called by :func:`airswing.workflow.fits.make_fits`."""

    months: list[str]  # all of them; the last is under way

    def __call__(self, job: Job, headings: xr.Dataset) -> Seen:
        """Fit the fleet on the sums of all months.

        Parameters
        ----------
        headings : Dataset
            Of all months, read lazily.
        """
        fleet = _Fleet(job, self.months, headings)
        sums = fleet.sums()
        histogram, total, count = fleet.counted()
        return Seen(
            fit_sums([sums]),
            histogram,
            np.divide(total, count, out=np.full(total.size, np.nan), where=count > 0),
            watch_compasses(
                headings,
                members=job.config.pools()[main_reference(job.config)],
                abscissa=job.config.fit.abscissa,
            ).changes,
        )


def fits_before(job: Job, months: list[str], headings: xr.Dataset) -> xr.Dataset:
    """Fits and tables of some months alone, from their sums; nothing is fitted to reports.

    Parameters
    ----------
    months : list of str
        All but the last ones, which were taken up before.
    headings : Dataset
        With every aircraft.

    Returns
    -------
    Dataset
        Of aircraft that the sums do not tell: no fit.
    """
    fleet = _Fleet(job, months, headings)
    # bases are of all months: a fit of some may lie farther from them than one of all
    found, _ = fleet.told(farthest=AS_FITTED, scatter=np.inf)
    none = AircraftSums(0, 0, 0, None, STATUS["too_few_reports"], np.nan)
    sums = fleet.together(
        {group: {name: own.get(name, none) for name in fleet.names} for group, own in found.items()}
    )
    resolution = math.degrees(job.config.table.resolution)
    return add_tables(fit_sums([sums]), fleet.counted()[0], resolution=resolution)


class _Fleet:
    """The sums of a fleet's months, kept in a folder.

    Parameters
    ----------
    job : Job
    months : list of str
    headings : Dataset
    """

    def __init__(self, job: Job, months: list[str], headings: xr.Dataset) -> None:
        self.job, self.months, self.headings = job, months, headings
        self.options = job.config.fit.model_dump()
        # columns are made with it; the sums have no need of it
        self.options.pop("abscissa")
        self.abscissa = job.config.fit.abscissa
        self.names = headings["aircraft"].to_numpy().astype(str)
        self.groups = groups_of(headings, job.config.pools(), alone=True)
        self.folder = job.output / ".update"
        config = job.config.model_dump(include={"fit", "pool", "references"})
        # sums of other options or another version are not those asked for
        self.mark = fingerprint(config["fit"], config["pool"], code_digest(*_CODE))
        self._held: dict[str, MonthSums] = {}
        self._counted: dict[str, Stored] = {}

    def sums(self) -> FleetSums:
        """Sums of every aircraft, ready to be fitted."""
        found, untold = self.told()
        if untold:
            whole = self._from_reports(untold)
            self._take_in(whole)
            # again: a new base changes what the months tell of the aircraft
            found, left = self.told()
            for name in left:
                for group, own in found.items():
                    # even at its own base the months do not tell it: the fit to its reports stands
                    own[name] = whole[group][name]
            self.job.progress.say(f"  {len(untold)} aircraft fitted to all of their reports")
        return self.together(found)

    def together(self, found: dict[str, dict[str, AircraftSums]]) -> FleetSums:
        """Sums of every group and aircraft as one fleet's."""
        some = self.headings[[name for name in FITTED_FROM if name in self.headings]]
        # the frame of a fleet's sums, references and options in it, without a report
        empty = some.isel(aircraft=slice(0), report=slice(0)).load()
        groups = {group: [own[name] for name in self.names] for group, own in found.items()}
        return replace(self._summed(empty), aircraft=self.names.astype(object), groups=groups)

    def counted(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Histogram of headings; sum of the declination and how many reports it is of."""
        histogram = np.zeros((self.names.size, 360), dtype=np.int64)
        total, count = np.zeros(self.names.size), np.zeros(self.names.size)
        for month in self.months:
            kept = self._counts(month)
            # names are sorted in both; an aircraft may be in some months only
            place = np.searchsorted(self.names, kept["aircraft"])
            histogram[place] += kept["histogram"]
            total[place] += kept["total"]
            count[place] += kept["count"]
        return histogram, total, count

    @cached_property
    def bases(self) -> dict[str, dict[str, Base]]:
        """Where aircraft are summed, by group."""
        kept = kept_arrays(self.folder / "base.npz", self.mark)
        if kept is None:
            return {group: {} for group in self.groups}
        return by_group(kept, self.groups, unpacked_bases)

    @cached_property
    def _without(self) -> tuple[dict[str, str], dict[str, dict[str, AircraftSums]]]:
        """Of aircraft without a curve what their reports hold, and by group their fits."""
        kept = kept_arrays(self.folder / "without_curve.npz", self.mark)
        if kept is None:
            return {}, {group: {} for group in self.groups}
        content = dict(zip(kept["aircraft"].tolist(), kept["content"].tolist(), strict=True))
        return content, by_group(kept, self.groups, unpacked_sums)

    @property
    def _content(self) -> dict[str, str]:
        """What the reports of every aircraft hold."""
        months = [self._month(month).content for month in self.months]
        return {name: fingerprint([own.get(name) for own in months]) for name in self.names}

    def told(self, **near: float) -> tuple[dict[str, dict[str, AircraftSums]], set[str]]:
        """Sums by group and aircraft, and the aircraft that must be fitted to their reports.

        Parameters
        ----------
        **near
            As for :func:`airswing.compass.kept_sums.period_sums.merged_fit`.
        """
        content, (of, kept) = self._content, self._without
        months = [self._month(month) for month in self.months]
        found: dict[str, dict[str, AircraftSums]] = {group: {} for group in self.groups}
        untold = set()
        for group, own in found.items():
            for name in self.names:
                base = self.bases[group].get(name)
                if base is not None:
                    parts = [one.periods[group].get(name) for one in months]
                    one = self._one([part for part in parts if part is not None], base, **near)
                else:
                    # without a curve: its fit stays while none of its reports changed
                    one = kept[group].get(name) if of.get(name) == content[name] else None
                if one is None:
                    untold.add(name)
                else:
                    own[name] = one
        return found, untold

    def _one(self, periods: list[PeriodSums], base: Base, **near: float) -> AircraftSums | None:
        """Sums of one aircraft; None where a fit to its reports may judge otherwise."""
        if not periods:
            return None
        reports = sum(one.reports for one in periods)
        if not near and not _same_sample(reports, base.reports):
            return None  # a fit would take its scatter from other reports, and weigh by that
        if not near and durations_of(periods) != base.durations:
            return None  # a fit would cut its blocks otherwise
        flights = sum(one.day.size for one in periods)
        counts = np.sum([one.points for one in periods], axis=0)
        # as `compass_points` counts them
        points = int(np.count_nonzero(counts >= max(3, 0.002 * reports)))
        enough = reports >= self.options["min_reports"] and flights >= MIN_FLIGHTS
        if not enough or points < self.options["min_compass_points"]:
            return None
        fit = merged_fit(periods, base, **near)
        if fit is None or condition_number(fit.normal, 2 if 4 in fit.free else 1) > MAX_CONDITION:
            return None
        return AircraftSums(reports, flights, points, fit, STATUS["ok"], mean_field(periods))

    def _from_reports(self, names: set[str]) -> dict[str, dict[str, AircraftSums]]:
        """Sums of some aircraft fitted to all of their reports, by group."""
        found: dict[str, dict[str, AircraftSums]] = {group: {} for group in self.groups}
        for block in chosen_blocks(self.headings, names):
            for group, own in self._summed(block).groups.items():
                every = zip(block["aircraft"].to_numpy().astype(str), own, strict=True)
                found[group] |= {name: one for name, one in every if name in names}
        return found

    def _summed(self, part: xr.Dataset) -> FleetSums:
        pools = self.job.config.pools()
        return sum_aircraft(part, pools=pools, abscissa=self.abscissa, **self.options)

    def _take_in(self, whole: dict[str, dict[str, AircraftSums]]) -> None:
        """Make the bases of aircraft that were fitted; keep the fits of those without a curve."""
        content, (of, kept) = self._content, self._without
        for group, own in whole.items():
            for name, one in own.items():
                # it may have had a curve before and have none now, or the other way round
                self.bases[group].pop(name, None)
                kept[group].pop(name, None)
                of[name] = content[name]
                if one.fit is not None and one.status == STATUS["ok"] and one.fit.converged:
                    self.bases[group][name] = Base.of(one.fit, one.field, one.reports)
                else:
                    kept[group][name] = one
        bases: dict[str, NDArray[np.generic]] = {}
        fits: dict[str, NDArray[np.generic]] = {}
        for k, group in enumerate(self.groups):
            bases |= {f"{k}:{key}": one for key, one in packed_bases(self.bases[group]).items()}
            fits |= {f"{k}:{key}": one for key, one in packed_sums(kept[group]).items()}
        words = {"aircraft": np.array(list(of)), "content": np.array(list(of.values()))}
        # bases last: killed between, an aircraft has its old base yet and is fitted again, which
        # makes the same one
        keep_arrays(self.folder / "without_curve.npz", self.mark, fits | words)
        keep_arrays(self.folder / "base.npz", self.mark, bases)
        # cached of the bases before
        del self._marks

    def _month(self, month: str) -> MonthSums:
        """Sums of one month at the bases of now; those made that do not hold."""
        found = self._held.get(month)
        if found is not None and not found.missing(self._marks):
            return found
        path = self.folder / f"{month}.sums.npz"
        with read_product(replace(self.job, month=month).place(HEADINGS), lazy=True) as headings:
            mark = fingerprint(headings.attrs["uuid"], self.mark)
            if found is None:
                found = MonthSums.of(kept_arrays(path, mark), self.groups)
            # nothing kept of this month holds
            fresh = not found.content
            if fresh:
                found.content = contents(headings)
            if missing := found.missing(self._marks):
                self._add(found, headings, missing)
            if missing or fresh:
                keep_arrays(path, mark, found.as_arrays())
        self._held[month] = found
        return found

    @cached_property
    def _marks(self) -> dict[str, dict[str, str]]:
        """Marks of the bases, by group."""
        return {
            group: {name: mark_of(base) for name, base in own.items()}
            for group, own in self.bases.items()
        }

    def _add(self, month: MonthSums, headings: xr.Dataset, names: set[str]) -> None:
        """Sum some aircraft of a month at their bases."""
        joint = bool(self.options["joint"])
        asked = {"joint": joint, "blocks": joint and bool(self.options["shared_error"])}
        for block in chosen_blocks(headings, names):
            columns, own = Columns(block, self.abscissa), block["aircraft"].to_numpy().astype(str)
            for group, members in self.groups.items():
                columns.use(members)
                for k, name in enumerate(own):
                    base = self.bases[group].get(name)
                    if base is not None and name in names:
                        one = sum_period(columns, k, members, base, **asked)
                        month.set(group, name, self._marks[group][name], one)

    def _counts(self, month: str) -> Stored:
        """What a month counts for the tables."""
        if month in self._counted:
            return self._counted[month]
        # apart from the sums: counts need no base, and stay when bases move
        path = self.folder / f"{month}.counts.npz"
        with read_product(replace(self.job, month=month).place(HEADINGS), lazy=True) as headings:
            mark = fingerprint(headings.attrs["uuid"], self.abscissa, code_digest(*_CODE))
            kept = kept_arrays(path, mark)
            if kept is None:
                total, count = declination_sums(headings)
                kept = {
                    "aircraft": headings["aircraft"].to_numpy().astype(np.str_),
                    "histogram": heading_histogram(headings, abscissa=self.abscissa),
                    "total": total,
                    "count": count,
                }
                keep_arrays(path, mark, kept)
        self._counted[month] = kept
        return kept


def _same_sample(reports: int, before: int) -> bool:
    """Whether the scatter of so many reports is told by a sample much like that of before.

    It is that of every so manieth report, some 4,000 of them, which tell it to a hundredth and a
    half: of another sample an estimate moves by a hundredth of its error
    (:data:`airswing.compass.kept_sums.period_sums.SCATTER`). To fit anew for every 4,000 reports
    is not worth a year's.
    """
    every, then = (max(number // MIDDLE, 1) for number in (reports, before))
    return max(every, then) <= MUCH_ALIKE * min(every, then)
