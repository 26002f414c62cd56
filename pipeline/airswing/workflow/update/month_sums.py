"""What one month keeps for the fit: sums of its aircraft at their bases, and marks of its reports.

Assumes a base for each aircraft and group of references
(:class:`airswing.compass.kept_sums.period_sums.Base`). An aircraft whose base is another than the
one it was summed at is summed again; the other aircraft of the month are not read for it. Kept in
one file a month whose every array carries a checksum (that of the zip format); what is not whole is
made again.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.deviation import FITTED_FROM
from airswing.compass.kept_sums.packed import packed, unpacked
from airswing.compass.kept_sums.period_sums import Base, PeriodSums
from airswing.products.atomic import replacing
from airswing.products.checked import digest
from airswing.products.ragged import aircraft_of_report, blocks, row_bounds, some_reports
from airswing.workflow.collocating import written_to

Arrays = Mapping[str, NDArray[np.generic]]
Held = TypeVar("Held")
NEAR = 4
"""Aircraft not asked for that are read along rather than skipped: a cut in a lazy archive costs
tens of milliseconds whatever its length."""


def mark_of(base: Base) -> str:
    """Hash of a base, by which it is known whether sums are of it."""
    told = repr((base.scatters, base.field, base.durations, base.few, base.rms, base.reports))
    return digest(base.theta.tobytes(), base.free.tobytes(), told.encode()).hex()


@dataclass
class MonthSums:
    """Sums and marks of one month."""

    # hash of the reports of every aircraft of the month
    content: dict[str, str] = field(default_factory=dict)
    # of each group: aircraft -> mark of the base it was summed at
    made_at: dict[str, dict[str, str]] = field(default_factory=dict)
    # of each group: aircraft -> its sums; none where it has no report that counts
    periods: dict[str, dict[str, PeriodSums]] = field(default_factory=dict)

    def missing(self, marks: Mapping[str, Mapping[str, str]]) -> set[str]:
        """Aircraft of the month that are not summed at the base they have now.

        Parameters
        ----------
        marks : mapping
            Of the bases, by group and aircraft.
        """
        return {
            name
            for group, own in marks.items()
            for name in own.keys() & self.content.keys()
            if self.made_at[group].get(name) != own[name]
        }

    def set(self, group: str, name: str, mark: str, sums: PeriodSums | None) -> None:
        """Put the sums of an aircraft in place of those before.

        Parameters
        ----------
        sums : PeriodSums, optional
            None where it has no report that counts.
        """
        self.made_at[group][name] = mark
        self.periods[group].pop(name, None)
        if sums is not None:
            self.periods[group][name] = sums

    def as_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Everything as arrays, for a file."""
        found = _words("content", self.content)
        for k, group in enumerate(self.periods):
            found |= _words(f"{k}:made_at", self.made_at[group])
            found |= {f"{k}:{key}": one for key, one in packed(self.periods[group]).items()}
        return found

    @classmethod
    def of(cls, kept: Arrays | None, groups: Mapping[str, object]) -> MonthSums:
        """From the arrays of a file; empty without."""
        if kept is None:
            return cls({}, {group: {} for group in groups}, {group: {} for group in groups})
        made_at = {group: _worded(f"{k}:made_at", kept) for k, group in enumerate(groups)}
        return cls(_worded("content", kept), made_at, by_group(kept, groups, unpacked))


def contents(headings: xr.Dataset) -> dict[str, str]:
    """Hash of every aircraft's reports, as far as a fit looks at them."""
    found = {}
    for block in blocks(headings, FITTED_FROM):
        # flights are numbered over the fleet: what another aircraft flew moves the numbers
        names = [name for name in FITTED_FROM if name in block and name not in ("row_size",)]
        columns = [block[name].to_numpy() for name in names]
        bounds = zip(*row_bounds(block["row_size"].to_numpy()), strict=True)
        for name, (start, stop) in zip(block["aircraft"].to_numpy(), bounds, strict=True):
            own = [np.ascontiguousarray(column[..., start:stop]) for column in columns]
            if start < stop:
                flight = own[names.index("flight")]
                own[names.index("flight")] = flight - flight[0]
            found[str(name)] = digest(*(part.tobytes() for part in own)).hex()
    return found


def chosen_blocks(headings: xr.Dataset, names: set[str]) -> Iterator[xr.Dataset]:
    """Blocks that hold some aircraft with all their reports; others in them are without any.

    Yields
    ------
    Dataset
    """
    wanted = np.isin(headings["aircraft"].to_numpy().astype(str), list(names))
    start, stop = row_bounds(headings["row_size"].to_numpy())
    for some in _runs(np.flatnonzero(wanted)):
        reports = slice(int(start[some.start]), int(stop[some.stop - 1]))
        part = headings.isel(aircraft=slice(some.start, some.stop), report=reports)
        place = some.start
        for block in blocks(part, FITTED_FROM):
            own = wanted[place : place + block.sizes["aircraft"]]
            place += own.size
            yield block if own.all() else some_reports(block, own[aircraft_of_report(block)])


def _runs(places: NDArray[np.int64]) -> Iterator[range]:
    """Places with no more than `NEAR` others between them, each run together."""
    ends = np.flatnonzero(np.diff(places) > NEAR + 1) + 1
    for run in np.split(places, ends):
        if run.size:
            yield range(int(run[0]), int(run[-1]) + 1)


def kept_arrays(path: Path, mark: str) -> dict[str, NDArray[np.generic]] | None:
    """Arrays that were kept; None where there are none that are whole and of this mark."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            if str(stored["mark"]) != mark:
                return None
            return {name: stored[name] for name in stored.files if name != "mark"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        # torn, or of another version: what is kept saves time, and is made again
        return None


def keep_arrays(path: Path, mark: str, arrays: Arrays) -> None:
    """Keep arrays, whole or not at all.

    Parameters
    ----------
    mark : str
        Of what they are made from.
    """
    with (
        written_to(path.parent),
        replacing(path, lasting=False) as temporary,
        temporary.open("wb") as file,
    ):
        np.savez(file, allow_pickle=False, mark=np.array(mark), **arrays)


def by_group(
    arrays: Arrays, groups: Mapping[str, object], undo: Callable[[Arrays], Held]
) -> dict[str, Held]:
    """What the arrays of every group hold.

    Parameters
    ----------
    arrays : mapping of array
        Named by the number of the group, a colon, and the rest.
    undo : callable
        From one group's arrays.
    """
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


def _words(name: str, words: Mapping[str, str]) -> dict[str, NDArray[np.generic]]:
    pairs = np.array(list(words.items()), dtype=np.str_).reshape(-1, 2)
    return {name: pairs}


def _worded(name: str, arrays: Arrays) -> dict[str, str]:
    return {str(key): str(word) for key, word in arrays[name]}
