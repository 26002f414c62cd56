"""The report columns a fit reads, as plain arrays, an aircraft at a time.

Assumes reports in the contiguous ragged form (those of one aircraft stand together). Reads the
errors of one group of references at a time, and nothing is copied where every report counts.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.observations import Reports, Values
from airswing.compass.fleet.flight_segments import Places
from airswing.products.ragged import row_bounds
from airswing.units import Picked


class Columns:
    """The report columns as plain arrays, read once."""

    def __init__(self, headings: xr.Dataset, abscissa: str) -> None:
        self.start, self.stop = row_bounds(headings["row_size"].to_numpy())
        self.heading = headings["heading"].to_numpy()
        self.abscissa = (
            headings["magnetic_heading"].to_numpy() if abscissa == "magnetic" else self.heading
        )
        self.airspeed = headings["airspeed"].to_numpy()
        self.screening = headings["screening"].to_numpy()
        self.flight = headings["flight"].to_numpy()
        self.time = headings["time"].to_numpy()
        self.errors = [
            headings[name].transpose("reference", "report")
            for name in ("heading_error", "airspeed_error", "heading_error_standard_error")
        ]
        self.where = [headings[name].to_numpy() for name in ("latitude", "longitude", "pressure")]
        self.field = (
            headings["horizontal_field"].to_numpy() if "horizontal_field" in headings else None
        )
        self.read: dict[int, list[Values]] = {}

    def use(self, members: list[int]) -> None:
        """Read the errors against these references; forget the others."""
        self.read = {
            k: self.read.get(k) or [part[k].to_numpy() for part in self.errors] for k in members
        }

    def observations(
        self, aircraft: int, members: list[int]
    ) -> tuple[list[Reports], NDArray[np.int64], Values, list[Places], float]:
        """Reports of one aircraft against some references that are in use.

        Returns
        -------
        sets : list of Reports
            One a member.
        days : array of int, shape (flights,)
            Days since 1970 on which the flights began.
        abscissa : array, shape (n,), degrees
            Of the reports that count for any member.
        places : list of Places
            One a member.
        field : float
            Mean horizontal field of the reports that count, nT; NaN where none is known.
        """
        row = slice(int(self.start[aircraft]), int(self.stop[aircraft]))
        common = [part[row] for part in (self.heading, self.abscissa, self.airspeed)]
        own = [[part[row] for part in self.read[k]] for k in members]
        latitude, longitude, pressure = (part[row] for part in self.where)
        place = Places(latitude, longitude, pressure, self.time[row])
        # the usual case: no masks, and slices in place of copies
        if self._all_good(row, [*common, *(part for errors in own for part in errors[:2])]):
            first, number = _numbered(self.flight[row])
            gain, field = self._gain(row, slice(None))
            return (
                [_reports(common, errors, number, gain) for errors in own],
                _days(self.time[row][first]),
                common[1],
                [place] * len(own),
                field,
            )
        good = (self.screening[row] == 0) & np.isfinite(common[0] + common[1] + common[2])
        masks = [good & np.isfinite(errors[0] + errors[1]) for errors in own]
        some = np.logical_or.reduce(masks)
        first, number = _numbered(self.flight[row][some])
        code = np.zeros(some.size, dtype=np.int64)
        code[some] = number
        gain, field = self._gain(row, some)
        sets = [
            _reports(
                [part[mask] for part in common],
                [part[mask] for part in errors],
                code[mask],
                gain[mask],
            )
            for mask, errors in zip(masks, own, strict=True)
        ]
        places = [place.at(mask) for mask in masks]
        return sets, _days(self.time[row][some][first]), common[1][some], places, field

    def _gain(self, row: slice, counted: Picked) -> tuple[Values, float]:
        """Mean horizontal field of the reports that count over that of every report; the mean."""
        if self.field is None:
            # one number seen as many: nothing is stored for each report
            return np.broadcast_to(np.float32(1.0), self.flight[row].shape), np.nan
        field = self.field[row]
        gain = np.ones(field.size, dtype=np.float32)
        # a magnet aboard turns the needle the more, the weaker the earth pulls it level
        known = np.isfinite(field) & (field > 0)
        mine = field[counted][known[counted]]
        if not mine.size:
            return gain, np.nan
        mean = mine.mean(dtype=np.float64)
        np.divide(mean, field, out=gain, where=known, casting="unsafe")
        return gain, float(mean)

    def _all_good(self, row: slice, parts: list[Values]) -> bool:
        """Whether every report counts: a sum is finite only where every term is."""
        return not self.screening[row].any() and all(np.isfinite(part.sum()) for part in parts)


def _reports(
    common: list[Values],
    errors: list[Values],
    flight: NDArray[np.int64],
    gain: Values,
) -> Reports:
    return Reports(common[0], common[1], common[2], errors[0], errors[1], errors[2], flight, gain)


def _days(time: NDArray[np.datetime64]) -> NDArray[np.int64]:
    return time.astype("datetime64[D]").astype(np.int64)


def _numbered(flight: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First report of every flight, and the flights numbered 0, 1, 2 ..."""
    # in order of flights it is enough to look for changes, without sorting
    if np.any(flight[1:] < flight[:-1]):
        _, first, number = np.unique(flight, return_index=True, return_inverse=True)
        return first, number
    new = np.ones(flight.size, dtype=np.bool_)
    np.not_equal(flight[1:], flight[:-1], out=new[1:])
    first = np.flatnonzero(new)
    return first, np.repeat(np.arange(first.size), np.diff(first, append=flight.size))
