"""Two references on the same reports, summed aircraft by aircraft.

Assumes both references were sampled at the same reports, and whole aircraft one after the other,
so that an archive of any size is gone through once and the sums do not depend on how many aircraft
were looked at together. Regions are thirds by latitude and, in each, by longitude, found from
counts in steps of `STEP`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.reference_comparison.pairs import (
    COEFFICIENTS,
    clustered_difference,
    common_equations,
    paired_design,
    region_sums,
)
from airswing.products.ragged import blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Thirds of the reports by latitude, and of each by longitude.
REGIONS = 9
STEP = 0.01  # degrees
LEAST_REPORTS = 50  # Reports below which an aircraft says nothing of a difference
# Days below which an aircraft cannot tell how far its own difference is to be trusted: eight
# coefficients leave no scatter to so few, and one day none at all.
LEAST_DAYS = 10


@dataclass(frozen=True)
class Rows:
    """Plain columns of one aircraft's reports, radians and SI; winds and leads by reference.

    Or of a block's, of which :meth:`of_aircraft` takes one aircraft after the other. Days count
    from the first of the archive; ``number`` is the aircraft's.
    """

    number: int
    day: Ints
    month: Ints
    region: Ints
    phase: Ints
    pressure: Floats
    heading: Floats
    magnetic: Floats
    airspeed: Floats
    kept: Mask
    kept_any_phase: Mask
    u: dict[str, Floats]
    v: dict[str, Floats]
    lead: dict[str, Floats]

    def of_aircraft(self, number: int, own: slice) -> Rows:
        """Those of one aircraft, where the columns are of several."""
        return Rows(
            number,
            day=self.day[own],
            month=self.month[own],
            region=self.region[own],
            phase=self.phase[own],
            pressure=self.pressure[own],
            heading=self.heading[own],
            magnetic=self.magnetic[own],
            airspeed=self.airspeed[own],
            kept=self.kept[own],
            kept_any_phase=self.kept_any_phase[own],
            u={name: values[own] for name, values in self.u.items()},
            v={name: values[own] for name, values in self.v.items()},
            lead={name: values[own] for name, values in self.lead.items()},
        )


class AircraftPair(NamedTuple):
    """Difference of one aircraft's coefficients between two references."""

    number: int  # of the aircraft
    values: Floats  # (5,): radians
    days: Ints  # (day,)
    influence: Floats  # (day, 5): what each day moves the values by


@dataclass
class PairSums:
    """What is known of a pair of references over some reports.

    Attributes
    ----------
    common : array, shape (days, 5, 6)
        Equations of the difference the fleet has in common.
    """

    one: str
    two: str
    days: int  # of the archive
    reports: int = 0
    distance: float = 0.0
    counted: int = 0  # aircraft in ``common``
    # those of them that have days enough for a difference of their own
    aircraft: list[AircraftPair] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.regions = np.zeros((3, REGIONS, self.days))
        self.common = np.zeros((self.days, COEFFICIENTS, COEFFICIENTS + 1))

    def add(self, rows: Rows, chosen: Mask) -> None:
        """Take up some reports of the next aircraft.

        Parameters
        ----------
        chosen : array of bool, shape (report,)
        """
        if not chosen.any():
            return
        du = rows.u[self.one][chosen] - rows.u[self.two][chosen]
        dv = rows.v[self.one][chosen] - rows.v[self.two][chosen]
        day = rows.day[chosen]
        self.reports += int(du.size)
        self.distance += float(np.hypot(du, dv).sum())
        self.regions += region_sums(du, dv, rows.region[chosen], day, REGIONS, self.days)
        if du.size < LEAST_REPORTS:
            return
        heading = rows.heading[chosen]
        design = paired_design(rows.magnetic[chosen], heading, rows.airspeed[chosen])
        # psi_err is n . (W_ref - W_rep) / V, and |V_A| - |V'_A| is h . (W_ref - W_rep).
        cross = du * np.cos(heading) - dv * np.sin(heading)
        along = du * np.sin(heading) + dv * np.cos(heading)
        days, equations = common_equations(*design, cross, along, day)
        self.common[days] += equations
        self.counted += 1
        if days.size < LEAST_DAYS:
            return
        values, moved, _ = clustered_difference(*design, cross, along, day)
        self.aircraft.append(
            AircraftPair(rows.number, values[:COEFFICIENTS], days, moved[:, :COEFFICIENTS])
        )


@dataclass(frozen=True)
class Regions:
    """Nine regions with about as many reports each."""

    south: Floats  # (2,): latitudes between the thirds, degrees
    west: Floats  # (3, 2): longitudes between the thirds of each

    @classmethod
    def of(cls, headings: xr.Dataset) -> Regions:
        """Find the regions of an archive."""
        latitudes = np.zeros(round(180.0 / STEP) + 1)
        for block in blocks(headings, ["latitude"]):
            latitudes += _counted(block["latitude"].to_numpy(), -90.0, latitudes.size)
        south = _thirds(latitudes, -90.0)
        longitudes = np.zeros((3, round(360.0 / STEP) + 1))
        for block in blocks(headings, ["latitude", "longitude"]):
            band = np.searchsorted(south, block["latitude"].to_numpy())
            for row in range(3):
                here = block["longitude"].to_numpy()[band == row]
                longitudes[row] += _counted(here, -180.0, longitudes.shape[1])
        return cls(south, np.array([_thirds(row, -180.0) for row in longitudes]))

    def at(self, reports: xr.Dataset) -> Ints:
        """Region of each report, 0 to 8; shape (report,)."""
        row = np.searchsorted(self.south, reports["latitude"].to_numpy())
        column = (reports["longitude"].to_numpy()[:, np.newaxis] > self.west[row]).sum(axis=1)
        return np.asarray(row * 3 + column, dtype=np.int64)


def _counted(values: Floats, low: float, size: int) -> Floats:
    """Count values by steps."""
    known = values[np.isfinite(values)]
    place = np.clip(np.floor((known - low) / STEP).astype(np.int64), 0, size - 1)
    return np.bincount(place, minlength=size).astype(np.float64)


def _thirds(counts: Floats, low: float) -> Floats:
    """Values below which a third and two thirds lie, to a step."""
    total = np.cumsum(counts)
    place = np.searchsorted(total, total[-1] * np.array([1.0, 2.0]) / 3.0)
    return np.asarray(low + STEP * (place + 1.0))
