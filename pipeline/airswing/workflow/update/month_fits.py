"""Fits of all months from the sums each of them keeps.

All reports are fitted anew when a month is complete, and when settings or code change: that is the
base, from which every month is summed once (:mod:`airswing.compass.kept_sums.period_sums`). On the
nights between, a month that is touched is summed again and the fleet is fitted on the sums of all
months. An aircraft is fitted to all of its reports where sums do not tell it: it is new since the
base, has no curve to be trusted, or lies too far from the base for its weights to stand; where that
is one in five, there is a new base.

Sums stand in one file a month whose every array carries a checksum (that of the zip format); what
is not whole is summed again.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import MAX_CONDITION, AircraftSums, condition_number
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
from airswing.compass.kept_sums.packed import packed, packed_bases, unpacked, unpacked_bases
from airswing.compass.kept_sums.period_sums import (
    Base,
    PeriodSums,
    mean_field,
    merged_fit,
    sum_period,
)
from airswing.compass.table import heading_histogram
from airswing.evaluation.compass_changes.change_kernels import DaySums
from airswing.evaluation.compass_changes.stability import (
    FEWEST_DAYS,
    changes_of,
    fleet_day_sums,
)
from airswing.flags import STATUS
from airswing.products.atomic import replacing
from airswing.products.checked import digest
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.netcdf import read_product
from airswing.products.ragged import blocks, row_bounds
from airswing.workflow.collocating import written_to
from airswing.workflow.fits import Seen
from airswing.workflow.job import FITTING, HEADINGS, Job, main_reference

TOO_MANY = 0.2
"""Share of the aircraft that, fitted anew, ask for a new base."""
_CODE = (*FITTING, "airswing.compass.kept_sums.packed")

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class MonthlyFits:
    """Looks at the reports month by month; called by :func:`airswing.workflow.fits.make_fits`.

    Parameters
    ----------
    months : list of str
        All of them; the last is under way.
    """

    months: list[str]

    def __call__(self, job: Job, headings: xr.Dataset) -> Seen:
        """Fit the fleet on the sums of all months.

        Parameters
        ----------
        job : Job
        headings : Dataset
            Of all months, read lazily.

        Returns
        -------
        Seen
        """
        fleet = _Fleet(job, self.months, headings)
        sums = fleet.sums()
        histogram, total, count = fleet.counted()
        return Seen(
            fit_sums([sums]),
            histogram,
            np.divide(total, count, out=np.full(total.size, np.nan), where=count > 0),
            changes_of(fleet.names.tolist(), fleet.days()),
        )


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
        self.options: dict[str, Any] = job.config.fit.model_dump()
        self.options.pop("abscissa")
        self.abscissa = job.config.fit.abscissa
        self.names = headings["aircraft"].to_numpy().astype(str)
        self.groups = groups_of(headings, job.config.pools(), alone=True)
        self.folder = job.output / ".update"

    def sums(self) -> FleetSums:
        """Sums of every aircraft, ready to be fitted.

        Always those of the months: whatever is killed between, the same months give the same fits.
        """
        fresh = not self.bases
        if fresh:
            self._new_base()
        groups, anew = self._all_merged()
        known = {name for own in self.bases.values() for name in own}
        far = sum(self.names[k] in known for k in anew)
        if not fresh and far > TOO_MANY * len(known):
            self._new_base()
            groups, anew = self._all_merged()
        for some in _runs(anew):
            own = self._from_reports(some)
            for name in groups:
                groups[name][some.start : some.stop] = own.groups[name]
        empty = self._from_reports(range(0))
        whole = {name: [one for one in own if one is not None] for name, own in groups.items()}
        if anew:
            self.job.progress.say(f"  {len(anew)} aircraft fitted to all of their reports")
        return replace(empty, aircraft=self.names.astype(object), groups=whole)

    def counted(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Histogram of headings; sum of the declination and how many reports it is of."""
        histogram = np.zeros((self.names.size, 360), dtype=np.int64)
        total, count = np.zeros(self.names.size), np.zeros(self.names.size)
        for month in self.months:
            kept = self._counts(month)
            place = np.searchsorted(self.names, kept["aircraft"])
            histogram[place] += kept["histogram"]
            total[place] += kept["total"]
            count[place] += kept["count"]
        return histogram, total, count

    def days(self) -> list[DaySums | None]:
        """Daily sums of every aircraft, by which its compass is seen to change."""
        own: dict[str, list[DaySums]] = {}
        for month in self.months:
            kept = self._counts(month)
            ends = np.cumsum(kept["days"])
            for name, size, end in zip(kept["aircraft"], kept["days"], ends, strict=True):
                rows = slice(int(end - size), int(end))
                one = DaySums(*(kept[f"days/{part.name}"][rows] for part in fields(DaySums)))
                own.setdefault(str(name), []).append(one)
        return [_one_after_another(own.get(name, [])) for name in self.names.tolist()]

    @cached_property
    def bases(self) -> dict[str, dict[str, Base]]:
        """Where aircraft are summed, by group; empty where there is no base that holds."""
        found = _read(self.folder / "base.npz", self._of_base)
        return {} if found is None else _by_group(found, self.groups, unpacked_bases)

    @cached_property
    def _of_base(self) -> str:
        config = self.job.config.model_dump(include={"fit", "pool", "references"})
        return fingerprint(self.months[:-1], config["fit"], config["pool"], code_digest(*_CODE))

    def _new_base(self) -> None:
        """Fit all reports: what is kept is summed from there."""
        parts = [self._summed(part) for part in blocks(self.headings, FITTED_FROM)]
        groups = _together(parts)
        self.bases = {
            name: {
                str(tail): Base.of(one.fit, one.field)
                for tail, one in zip(self.names, own, strict=True)
                if one.fit is not None and one.status == STATUS["ok"] and one.fit.converged
            }
            for name, own in groups.items()
        }
        arrays = {
            f"{k}:{key}": values
            for k, name in enumerate(self.groups)
            for key, values in packed_bases(self.bases[name]).items()
        }
        self._write(self.folder / "base.npz", self._of_base, arrays)
        self._held.clear()

    def _all_merged(self) -> tuple[dict[str, list[AircraftSums | None]], list[int]]:
        """Sums of every group, and the aircraft for which they do not tell all fits."""
        groups = {name: self._merged(name) for name in self.groups}
        size = self.names.size
        return groups, [k for k in range(size) if any(own[k] is None for own in groups.values())]

    def _merged(self, group: str) -> list[AircraftSums | None]:
        """Sums of the aircraft of a group of references; None where they do not tell the fit."""
        months = [self._periods(month)[group] for month in self.months]
        found: list[AircraftSums | None] = []
        for name in self.names:
            base = self.bases[group].get(str(name))
            own = [month[str(name)] for month in months if str(name) in month]
            found.append(None if base is None or not own else self._one(own, base))
        return found

    def _one(self, periods: list[PeriodSums], base: Base) -> AircraftSums | None:
        """Sums of one aircraft; None where the whole fit may judge otherwise."""
        reports = sum(one.reports for one in periods)
        flights = sum(one.day.size for one in periods)
        counts = np.sum([one.points for one in periods], axis=0)
        points = int(np.count_nonzero(counts >= max(3, 0.002 * reports)))
        enough = reports >= self.options["min_reports"] and flights >= MIN_FLIGHTS
        if not enough or points < self.options["min_compass_points"]:
            return None
        fit = merged_fit(periods, base)
        if fit is None or condition_number(fit.normal, 2 if 4 in fit.free else 1) > MAX_CONDITION:
            return None
        return AircraftSums(reports, flights, points, fit, STATUS["ok"], mean_field(periods))

    def _periods(self, month: str) -> dict[str, dict[str, PeriodSums]]:
        """Sums of one month by group and aircraft; made where those kept do not hold."""
        if month in self._held:
            return self._held[month]
        path = self.folder / f"{month}.sums.npz"
        at = replace(self.job, month=month).place(HEADINGS)
        with read_product(at, lazy=True) as headings:
            mark = fingerprint(headings.attrs["uuid"], self._of_base, self._where)
            kept = _read(path, mark)
            if kept is None:
                kept = self._sum_month(headings)
                self._write(path, mark, kept)
        self._held[month] = _by_group(kept, self.groups, unpacked)
        return self._held[month]

    @cached_property
    def _held(self) -> dict[str, dict[str, dict[str, PeriodSums]]]:
        return {}

    @property
    def _where(self) -> str:
        """Hash of the base itself."""
        every = [one for own in self.bases.values() for one in own.values()]
        return digest(*(one.theta.tobytes() for one in every)).hex()

    def _sum_month(self, headings: xr.Dataset) -> dict[str, NDArray[Any]]:
        joint = bool(self.options["joint"])
        found: dict[str, dict[str, PeriodSums]] = {name: {} for name in self.groups}
        for block in blocks(headings, FITTED_FROM):
            columns = Columns(block, self.abscissa)
            for group, members in self.groups.items():
                columns.use(members)
                for k, name in enumerate(block["aircraft"].to_numpy().astype(str)):
                    base = self.bases[group].get(str(name))
                    if base is not None:
                        shared = joint and bool(self.options["shared_error"])
                        one = sum_period(columns, k, members, base, joint=joint, blocks=shared)
                        found[group] |= {} if one is None else {str(name): one}
        return {
            f"{k}:{key}": values
            for k, group in enumerate(self.groups)
            for key, values in packed(found[group]).items()
        }

    def _counts(self, month: str) -> Arrays:
        """What a month counts for the tables."""
        if month in self._counted:
            return self._counted[month]
        path = self.folder / f"{month}.counts.npz"
        config = self.job.config
        members = config.pools()[main_reference(config)]
        with read_product(replace(self.job, month=month).place(HEADINGS), lazy=True) as headings:
            mark = fingerprint(headings.attrs["uuid"], self.abscissa, members, code_digest(*_CODE))
            kept = _read(path, mark)
            if kept is None:
                total, count = declination_sums(headings)
                kept = {
                    "aircraft": headings["aircraft"].to_numpy().astype(np.str_),
                    "histogram": heading_histogram(headings, abscissa=self.abscissa),
                    "total": total,
                    "count": count,
                    **_packed_days(fleet_day_sums(headings, members, self.abscissa, fewest=1)),
                }
                self._write(path, mark, kept)
        self._counted[month] = kept
        return kept

    @cached_property
    def _counted(self) -> dict[str, Arrays]:
        return {}

    def _from_reports(self, some: range) -> FleetSums:
        """Sums of some aircraft fitted to all of their reports."""
        start, stop = row_bounds(self.headings["row_size"].to_numpy())
        own = slice(some.start, some.stop)
        reports = slice(int(start[own].min(initial=0)), int(stop[own].max(initial=0)))
        part = self.headings.isel(aircraft=own, report=reports)
        parts = [self._summed(block) for block in blocks(part, FITTED_FROM)] if some else []
        if not parts:
            return self._summed(part[[name for name in FITTED_FROM if name in part]].load())
        groups = _together(parts)
        return replace(parts[0], groups=groups)

    def _summed(self, part: xr.Dataset) -> FleetSums:
        pools = self.job.config.pools()
        return sum_aircraft(part, pools=pools, abscissa=self.abscissa, **self.options)

    def _write(self, path: Path, mark: str, arrays: Arrays) -> None:
        with (
            written_to(path.parent),
            replacing(path, lasting=False) as temporary,
            temporary.open("wb") as file,
        ):
            np.savez(file, allow_pickle=False, mark=np.array(mark), **arrays)


def _packed_days(sums: list[DaySums | None]) -> dict[str, NDArray[Any]]:
    known = [one for one in sums if one is not None]
    empty = DaySums(np.empty(0, np.int64), np.empty((0, 6, 6)), np.empty((0, 6)), np.empty(0))
    found = {"days": np.array([0 if one is None else one.day.size for one in sums], dtype=np.int64)}
    for part in fields(DaySums):
        every = [getattr(one, part.name) for one in [empty, *known]]
        found[f"days/{part.name}"] = np.concatenate(every)
    return found


def _one_after_another(parts: list[DaySums]) -> DaySums | None:
    """Days of one aircraft; a day in which a month ends may stand twice, each part a day's."""
    if sum(one.day.size for one in parts) < 2 * FEWEST_DAYS:
        return None
    names = [part.name for part in fields(DaySums)]
    return DaySums(*(np.concatenate([getattr(one, name) for one in parts]) for name in names))


def _together(parts: list[FleetSums]) -> dict[str, list[AircraftSums]]:
    return {name: [one for part in parts for one in part.groups[name]] for name in parts[0].groups}


def _read(path: Path, mark: str) -> dict[str, NDArray[Any]] | None:
    """Arrays that were kept; None where there are none that are whole and of this mark."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            if str(stored["mark"]) != mark:
                return None
            return {name: stored[name] for name in stored.files if name != "mark"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _by_group(arrays: Arrays, groups: Mapping[str, Any], undo: Any) -> dict[str, Any]:
    return {
        name: undo(
            {
                key.split(":", 1)[1]: values
                for key, values in arrays.items()
                if key.startswith(f"{k}:")
            }
        )
        for k, name in enumerate(groups)
    }


def _runs(places: list[int]) -> Iterator[range]:
    """Consecutive places, each run together."""
    ends = np.flatnonzero(np.diff(places) != 1) + 1
    for run in np.split(np.array(places, dtype=np.int64), ends):
        if run.size:
            yield range(int(run[0]), int(run[-1]) + 1)
