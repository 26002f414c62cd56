"""Headings that come in coarse steps: whole fives or tens of degrees from one of the norths.

Assumptions: the heading that ground vector and reported wind imply is the one the unit used, to a
few tenths of a degree. Rounded to steps of s it lies near multiples of s, so that the mean of
cos(2 pi psi / s) over its reports, exp(-2 pi^2 sigma^2 / s^2) at a spread sigma, is near one;
routes and winds spread others evenly. The same over flights says how sure that is: a few flights
on a few courses may lie anywhere.

Validity: ten flights of an aircraft and more. On the 80 archives of a blind check, days among them,
the mean was 0.15 at most for steps to 5 degrees, 0.18 for 10.

Source: Mardia & Jupp (2000), Directional Statistics, ch. 2 (mean resultant length).

Units: rad, but for steps, in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.physics.triangle import wind_from_triangle

Floats = NDArray[np.float64]

#: Steps that headings may come in, degrees, and least mean cosine of each.
HEADING_STEPS = {2.0: 0.35, 5.0: 0.35, 10.0: 0.4, 15.0: 0.5, 30.0: 0.6}
#: Share of a finer step's mean that a coarser one's must have: multiples of 10 are of 5 as well.
COARSER = 0.6
#: Flights, at least, and standard errors between them.
LEAST_FLIGHTS, SIGNIFICANT = 10, 6.0


@dataclass(frozen=True)
class HeadingLattice:
    """Steps that an aircraft's headings come in."""

    step: float  # degrees
    true_north: bool  # whether they are counted from it; from magnetic north else
    evidence: float  # log likelihood ratio against headings that are spread evenly


def heading_lattice_of(frame: Frame, aircraft: int) -> HeadingLattice | None:
    """Find the steps of an aircraft's headings, counted from the north that shows them more."""
    own = np.flatnonzero((frame.aircraft == aircraft) & np.isfinite(frame.magnetic_heading))
    flight = np.unique(frame.flight[own], return_inverse=True)[1]
    if flight.max(initial=-1) + 1 < LEAST_FLIGHTS:
        return None
    found = [
        (mean, step, north)
        for north, heading in ((False, frame.magnetic_heading), (True, frame.heading))
        for mean, step in [_coarsest(heading[own], flight)]
        if step > 0.0
    ]
    if not found:
        return None
    mean, step, north = max(found)
    # two degrees of freedom of a mean direction: Rayleigh's test
    return HeadingLattice(step, north, float(own.size * mean**2))


@dataclass(frozen=True)
class HeadingSteps:
    """Steps in which the units of an archive take their headings, report by report."""

    step: Floats  # (n,) rad; 0 for as it is
    north: Floats  # (n,) rad: true heading from which they are counted
    ground_u: Floats  # (n,) m/s
    ground_v: Floats

    @classmethod
    def of_archive(cls, frame: Frame) -> HeadingSteps | None:
        """Return the steps each aircraft's headings show; None where none shows any."""
        found = heading_lattices(frame)
        if not any(found):
            return None
        step = np.radians([0.0 if one is None else one.step for one in found])[frame.aircraft]
        of_true = np.array([one is not None and one.true_north for one in found])[frame.aircraft]
        north = np.where(of_true, 0.0, np.nan_to_num(frame.declination))
        return cls(step, north, frame.ground_u, frame.ground_v)

    def apply(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Wind, m/s, that the unit computes with the heading that flying through (u, v) takes."""
        air_u, air_v = self.ground_u - u, self.ground_v - v
        airspeed, heading = np.hypot(air_u, air_v), np.arctan2(air_u, air_v)
        safe = np.where(self.step > 0.0, self.step, 1.0)
        rounded = np.round((heading - self.north) / safe) * safe + self.north
        return wind_from_triangle(
            self.ground_u, self.ground_v, airspeed, np.where(self.step > 0.0, rounded, heading)
        )


def heading_lattices(frame: Frame) -> list[HeadingLattice | None]:
    """Find the steps of every aircraft's headings."""
    return [heading_lattice_of(frame, a) for a in range(len(frame.tails))]


def step_cosines(heading: Floats, step: float) -> Floats:
    """Cosine of each heading in turns of a step, (n,): one on whole steps; `step` in degrees."""
    return np.asarray(np.cos(2 * np.pi * np.degrees(heading) / step))


def _coarsest(heading: Floats, flight: NDArray[np.int64]) -> tuple[float, float]:
    """Mean cosine and coarsest step that tells, degrees; (0, 0) where none does."""
    best = (0.0, 0.0)
    for step, least in HEADING_STEPS.items():
        cosine = step_cosines(heading, step)
        count = np.bincount(flight)
        each = np.bincount(flight, cosine) / count
        mean = float(cosine.mean())
        error = float(np.sqrt((count**2 * (each - mean) ** 2).sum())) / heading.size
        if mean > max(least, SIGNIFICANT * error, COARSER * best[0]):
            best = (mean, step)
    return best
