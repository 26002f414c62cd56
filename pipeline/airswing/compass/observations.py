"""Reports of one aircraft against one reference, as they stand and made ready for the passes.

Degrees where they stand in the Datasets, radians and single precision once ready; m/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Values = NDArray[np.floating[Any]]


def radians32(degrees: Values) -> Single:
    """Radians in single precision.

    Parameters
    ----------
    degrees : array

    Returns
    -------
    array of float32, same shape
    """
    return degrees.astype(np.float32) * np.float32(np.pi / 180.0)


@dataclass(frozen=True)
class Observations:
    """Reports of one aircraft against one reference, made ready for the passes.

    Attributes
    ----------
    sin_m, cos_m, sin_psi, cos_psi : array, shape (n,)
        Abscissa and indicated true heading.
    error : array, shape (n,)
        Heading error, radians.
    along, cross : array, shape (n,)
        V'_A along and to the right of the indicated heading, m/s.
    airspeed : array, shape (n,)
        |V_A|, m/s.
    variance : array, shape (n,)
        Known variance of each component, m2/s2.
    flight : array of int, shape (n,)
        Number of the flight within the aircraft, never falling.
    gain : array, shape (n,)
        What the one-cycle part of the deviation is multiplied by.
    """

    sin_m: Single
    cos_m: Single
    sin_psi: Single
    cos_psi: Single
    error: Single
    along: Single
    cross: Single
    airspeed: Single
    variance: Single
    flight: Index
    gain: Single

    @property
    def size(self) -> int:
        """Number of reports."""
        return int(self.flight.size)

    def take(self, keep: slice) -> Observations:
        """Part of the reports (the flight numbers are kept)."""
        return Observations(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Reports:
    """Reports of one aircraft against one reference as they stand in the Datasets.

    Attributes
    ----------
    heading, abscissa : array, shape (n,)
        Indicated true heading psi and the argument m of the deviation, degrees.
    airspeed : array, shape (n,)
        |V_A|, m/s.
    heading_error, standard_error : array, shape (n,)
        arg V_A - arg V'_A and what is known of its standard error, degrees.
    airspeed_error : array, shape (n,)
        |V_A| - |V'_A|, m/s.
    flight : array of int, shape (n,)
        0, 1, 2 ... within the aircraft; reports of one flight need not stand together.
    gain : array, shape (n,), optional
        Mean horizontal field over the report's: iron's one cycle of deviation grows as the field
        that turns the compass weakens. One where it is not known.
    """

    heading: Values
    abscissa: Values
    airspeed: Values
    heading_error: Values
    airspeed_error: Values
    standard_error: Values
    flight: Index
    gain: Values = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """One gain a report, also where none is known."""
        if self.gain is None:
            object.__setattr__(self, "gain", np.broadcast_to(np.float32(1.0), self.flight.shape))

    @property
    def size(self) -> int:
        """Number of reports."""
        return int(self.flight.size)

    def sorted(self) -> Reports:
        """The same reports, flight by flight."""
        if not np.any(self.flight[1:] < self.flight[:-1]):
            return self
        return self.at(np.argsort(self.flight, kind="stable"))

    def at(self, index: Index) -> Reports:
        """Some of the reports, or all in another order."""
        return Reports(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def take(self, keep: slice) -> Observations:
        """Make part of the reports ready; they must be sorted by flight."""
        m, psi, error = (
            radians32(part[keep]) for part in (self.abscissa, self.heading, self.heading_error)
        )
        v = self.airspeed[keep].astype(np.float32)
        implied = v - self.airspeed_error[keep].astype(np.float32)
        known = radians32(self.standard_error[keep]) * v
        if not np.isfinite(known.sum()):
            known = np.nan_to_num(known, posinf=0.0)
        return Observations(
            np.sin(m),
            np.cos(m),
            np.sin(psi),
            np.cos(psi),
            error,
            implied * np.cos(error),
            -implied * np.sin(error),
            v,
            known * known,
            self.flight[keep],
            self.gain[keep].astype(np.float32),
        )
