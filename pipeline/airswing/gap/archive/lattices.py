"""Coarse steps of headings and of the directions of weak winds.

*Headings* in whole multiples of a step s: the mean of cos(2 pi psi / s) is exp(-2 pi^2 sigma^2 /
s^2) for an error sigma (Mardia and Jupp 2000, Directional Statistics, ch. 2). On 80 archives of a
blind check it was 0.15 at most for steps up to 5 degrees and 0.18 for 10. *Directions of weak
winds* in multiples of a step up to some speed; others are in whole degrees. Units: rad and m s-1;
steps in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats, Integers
from airswing.physics.triangle import wind_from_triangle


def in_steps(values: Floats, step: Floats | float) -> Floats:
    """Round values (n,) to multiples of a step (n,) or a float; unchanged where it is 0."""
    positive = np.where(np.asarray(step) > 0.0, step, 1.0)
    return np.where(np.asarray(step) > 0.0, np.round(values / positive) * positive, values)


@dataclass(frozen=True)
class HeadingLattice:
    """Steps of an aircraft's headings."""

    step: float  # degrees
    true_north: bool  # counted from true north; otherwise from magnetic north
    evidence: float  # log likelihood ratio against headings that are distributed evenly


@dataclass(frozen=True)
class HeadingSteps:
    """Steps of the headings of all reports of an archive."""

    step: Floats  # (n,) rad; 0 for headings without steps
    north: Floats  # (n,) rad: true heading from which steps are counted
    # (n,) m s-1
    ground_u: Floats
    ground_v: Floats

    @classmethod
    def of_archive(cls, frame: Frame) -> HeadingSteps | None:
        """Find the steps of the headings of each aircraft; None where there are none."""
        lattices = heading_lattices(frame)
        if not any(lattices):
            return None
        step = np.radians([x.step if x else 0.0 for x in lattices])[frame.aircraft]
        true_north = np.array([bool(x and x.true_north) for x in lattices])
        north = np.where(true_north[frame.aircraft], 0.0, np.nan_to_num(frame.declination))
        return cls(step, north, frame.ground_u, frame.ground_v)

    def apply(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Wind (u, v) that the unit derives from the rounded heading in a wind, m s-1."""
        air_u, air_v = self.ground_u - u, self.ground_v - v
        airspeed, heading = np.hypot(air_u, air_v), np.arctan2(air_u, air_v)
        rounded = in_steps(heading - self.north, self.step) + self.north
        return wind_from_triangle(
            self.ground_u, self.ground_v, airspeed, np.where(self.step > 0.0, rounded, heading)
        )


def heading_lattices(frame: Frame) -> list[HeadingLattice | None]:
    """Find the steps of each aircraft's headings, from the north with the larger mean cosine."""
    out: list[HeadingLattice | None] = []
    for a in range(len(frame.tails)):
        rows = np.flatnonzero((frame.aircraft == a) & np.isfinite(frame.magnetic_heading))
        flight = np.unique(frame.flight[rows], return_inverse=True)[1]
        if flight.max(initial=-1) + 1 < 10:  # too few flights for a standard error
            out.append(None)
            continue
        options = [
            (*_coarsest_step(heading[rows], flight), true_north)
            for true_north, heading in ((False, frame.magnetic_heading), (True, frame.heading))
        ]
        mean, step, true_north = max(options, key=lambda item: (item[1] > 0.0, *item))
        # a mean direction has two degrees of freedom (Rayleigh's test)
        lattice = HeadingLattice(step, true_north, float(rows.size * mean**2))
        out.append(lattice if step > 0.0 else None)
    return out


def _coarsest_step(heading: Floats, flight: Integers) -> tuple[float, float]:
    """Mean cosine and the coarsest significant step, degrees; (0, 0) without one."""
    best = (0.0, 0.0)
    reports = np.bincount(flight)
    # at least twice the mean cosine of headings without steps, see the module
    for step, least in {2.0: 0.35, 5.0: 0.35, 10.0: 0.4, 15.0: 0.5, 30.0: 0.6}.items():
        cosine = np.cos(2 * np.pi * np.degrees(heading) / step)
        mean = float(cosine.mean())
        by_flight = np.bincount(flight, cosine) / reports
        error = float(np.sqrt((reports**2 * (by_flight - mean) ** 2).sum())) / heading.size
        # beyond six standard errors; multiples of 10 are multiples of 5 as well: a coarser step
        # must hold most of the mean of a finer one
        if mean > max(least, 6.0 * error, 0.6 * best[0]):
            best = (mean, step)
    return best


@dataclass(frozen=True)
class DirectionLattice:
    """Steps of the directions of weak winds."""

    step: float  # degrees
    below: float  # largest speed, m s-1
    share: float  # share of the reports up to that speed, without those by chance


def direction_lattice(u: Floats, v: Floats) -> DirectionLattice | None:
    """Steps of the directions of winds up to a speed.

    None where none holds half of the reports, or no likelihood ratio exceeds the number of choices.
    """
    speed, angle = np.hypot(u, v), np.degrees(np.arctan2(u, v))
    order = np.argsort(speed)
    order = order[speed[order] > 0]  # calm has no direction
    speed, angle = speed[order], angle[order]
    number = np.arange(1, speed.size + 1)
    steps = (15.0, 20.0, 22.5, 30.0, 45.0, 60.0, 90.0)
    best, largest = None, float(np.log(max(1, len(steps) * speed.size)))
    for step in steps:
        on = np.abs(angle - step * np.round(angle / step)) < 0.75  # in whole degrees
        share, chance = np.clip(np.cumsum(on) / number, 1e-9, 1 - 1e-9), 1.5 / step
        ratio = share * np.log(share / chance) + (1 - share) * np.log((1 - share) / (1 - chance))
        ratio = np.where(share > 0.5, number * ratio, 0.0)
        if ratio.size and ratio.max() > largest:
            last = int(np.argmax(ratio))
            largest, excess = float(ratio[last]), (share[last] - chance) / (1 - chance)
            best = DirectionLattice(step, float(speed[last]), float(excess))
    return best
