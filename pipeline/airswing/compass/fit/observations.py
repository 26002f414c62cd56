"""Reports of one aircraft against one reference, as they stand and made ready for the passes.

Degrees where they stand in the Datasets, radians and single precision once ready; m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Values = NDArray[np.floating]
ROOM = 8
"""Numbers of a report made ready, but for its flight's."""


def _changes(values: Index) -> Index:
    """Where a new value begins."""
    change = np.ones(values.size, dtype=np.bool_)
    np.not_equal(values[1:], values[:-1], out=change[1:])
    return np.flatnonzero(change)


@dataclass(frozen=True)
class Observations:
    """Reports of one aircraft against one reference, made ready for the passes; all (n,)."""

    turned: Single  # sine and cosine of the abscissa, (2, n)
    heading: Single  # indicated true heading, radians
    error: Single  # its error, radians
    airspeed: Single  # |V_A|, m/s
    implied: Single  # |V'_A|, m/s
    variance: Single  # known variance of each component, m2/s2
    flight: Index  # number of the flight within the aircraft, never falling
    gain: Single  # what the one-cycle part of the deviation is multiplied by

    @property
    def size(self) -> int:
        """Number of reports."""
        return int(self.flight.size)

    @cached_property
    def opens(self) -> Index:
        """First report of every flight."""
        return _changes(self.flight)

    def take(self, keep: slice, room: Single | None = None) -> Observations:
        """Part of the reports (the flight numbers are kept); needs no room."""
        return Observations(*(getattr(self, name)[..., keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Reports:
    """Reports of one aircraft against one reference as they stand in the Datasets; all (n,)."""

    heading: Values  # indicated true heading psi, degrees
    abscissa: Values  # the argument m of the deviation, degrees
    airspeed: Values  # |V_A|, m/s
    heading_error: Values  # arg V_A - arg V'_A, degrees
    airspeed_error: Values  # |V_A| - |V'_A|, m/s
    standard_error: Values  # what is known of that of the heading error, degrees
    flight: Index  # 0, 1, 2 ... within the aircraft; those of one need not stand together
    # Mean horizontal field over the report's: iron's one cycle of deviation grows as the field
    # that turns the compass weakens. One where it is not known.
    gain: Values = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """One gain a report, also where none is known."""
        if self.gain is None:
            # one number seen as many: nothing is stored for each report
            object.__setattr__(self, "gain", np.broadcast_to(np.float32(1.0), self.flight.shape))

    @property
    def size(self) -> int:
        """Number of reports."""
        return int(self.flight.size)

    @cached_property
    def opens(self) -> Index:
        """First report of every flight, where they are sorted by flight."""
        return _changes(self.flight)

    @property
    def in_order(self) -> bool:
        """Whether they are sorted by flight."""
        flights = self.flight[self.opens]
        return not np.any(flights[1:] < flights[:-1])

    def sorted(self) -> Reports:
        """The same reports, flight by flight."""
        if self.in_order:
            return self
        # stable: rows of one group keep their order, so that their sums are the same bit for bit
        return self.at(np.argsort(self.flight, kind="stable"))

    def at(self, index: Index) -> Reports:
        """Some of the reports, or all in another order."""
        return Reports(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def take(self, keep: slice, room: Single | None = None) -> Observations:
        """Make part of the reports ready; they must be sorted by flight.

        ``room``, (8, as many reports) of float32, is where to put them: new memory costs more than
        the work.
        """
        flight = self.flight[keep]
        if room is None:
            room = np.empty((ROOM, flight.size), dtype=np.float32)
        sine, cosine, heading, error, known, airspeed, implied, gain = room
        cosine[:] = self.abscissa[keep]
        heading[:] = self.heading[keep]
        error[:] = self.heading_error[keep]
        known[:] = self.standard_error[keep]
        # four rows that stand side by side are degrees: one pass over the memory for all of them
        room[1:5] *= np.float32(np.pi / 180.0)
        np.sin(cosine, out=sine)
        np.cos(cosine, out=cosine)
        airspeed[:] = self.airspeed[keep]
        implied[:] = self.airspeed_error[keep]
        np.subtract(airspeed, implied, out=implied)
        known *= airspeed
        known *= known
        # A sum is finite where every term is: NaN is looked for only where one is.
        if not np.isfinite(known.sum()):
            np.nan_to_num(known, copy=False, posinf=0.0)
        gain[:] = self.gain[keep]
        return Observations(room[:2], heading, error, airspeed, implied, known, flight, gain)
