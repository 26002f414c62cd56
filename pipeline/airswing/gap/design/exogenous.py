"""Heading and airspeed for design columns, free of the residual's own noise.

Assumptions: aircraft hold their *track*: they crab into the wind they meet. The indicated heading
``arg(V_G - W_reported)`` then moves with the very model error that is in the residual, and the
indicated airspeed with the noise of the report. Within a straight flight little else moves them, so
columns evaluated at them correlate with the residual by construction (a false two-cycle deviation
of 0.3 m/s rms and a false airspeed factor in trials). Columns are therefore evaluated at

* the heading that the large-scale wind implies, ``arg(V_G - W)``, plus the aircraft's smooth
  deviation (regression of the difference on two harmonics); with the reference wind in its place
  the drift holds the error of the reference (a false heading error by drift in one of two archives
  of 24 days), and
* the large-scale part of the *reported* wind, a fit by day to position and level: the reference
  wind holds the model error of the residual, which makes the regression of reports on model winds
  flatter than 1 (0.87 whitened in trials; 0.99 to 1.03 on the reported wind's large-scale part);
* the airspeed of the aircraft's own profile by level and phase, plus the flight's mean departure.

Validity: random heading differences s between the two leave a factor exp(-k^2 s^2 / 2) on harmonic
k: 0.1 % for one cycle at 2.5 degrees.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.physics.robust_spread import robust_sd
from airswing.physics.splines import hats
from airswing.physics.triangle import wrap_signed
from airswing.units import DAY

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


TERMS = 13
"""Terms of the large-scale wind."""


def exogenous(frame: Frame, winds: LargeScale | None = None) -> Frame:
    """Frame whose heading and airspeed may stand in design columns.

    Parameters
    ----------
    winds : LargeScale, optional
        Large-scale reported wind of the archive, where the frame holds only some of its aircraft.

    Returns
    -------
    Frame
        With ``heading``, ``magnetic_heading`` (rad) and ``airspeed`` (m s-1) replaced, the
        reference's wind and shear by the large-scale reported ones.
    """
    smooth, shear = (winds or LargeScale.of(frame)).at(frame)
    implied = np.arctan2(frame.ground_u - smooth[:, 0], frame.ground_v - smooth[:, 1])
    difference = wrap_signed(frame.heading - implied)
    declination = np.nan_to_num(wrap_signed(frame.heading - frame.magnetic_heading))
    known = np.isfinite(frame.dudlnp) & np.isfinite(frame.dvdlnp)
    heading = implied + smooth_deviation(difference, implied - declination, frame.aircraft)
    return replace(
        frame,
        u_ref=smooth[:, 0],
        v_ref=smooth[:, 1],
        dudlnp=np.where(known, shear[:, 0], np.nan),
        dvdlnp=np.where(known, shear[:, 1], np.nan),
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(heading - declination, 2 * np.pi),
        airspeed=typical_airspeed(
            frame.airspeed, np.log(frame.pressure), frame.phase, frame.aircraft, frame.flight
        ),
    )


@dataclass(frozen=True)
class LargeScale:
    """Fit by day of the reported wind to a constant, position, level, products and the hour."""

    epoch: float  # s since 1970; days are counted from it
    centre: Floats  # (3, 2): mean and spread of longitude, latitude (degrees) and ln p
    first: int  # day of the first coefficients
    coefficients: Floats  # (D, 13, 2): m s-1

    @classmethod
    def of(cls, frame: Frame) -> LargeScale:
        """Fit to the reports of a frame."""
        centre = centre_of(frame)
        return cls.solved([day_sums(frame, centre)], float(frame.epoch), centre)

    @classmethod
    def solved(
        cls, sums: Iterable[tuple[Integers, Floats]], epoch: float, centre: Floats
    ) -> LargeScale:
        """Fit to the sums of some frames.

        Parameters
        ----------
        sums : iterable of (days, sums)
            From `day_sums`; added in the order they come.
        epoch : float
            Of all the frames, s since 1970.
        centre : (3, 2) float
            That of the sums.
        """
        total: dict[int, Floats] = {}
        for days, parts in sums:
            for day, part in zip(days.tolist(), parts, strict=True):
                total[day] = total[day] + part if day in total else part
        first = min(total)
        found = np.zeros((max(total) - first + 1, TERMS, 2))
        # two reports' worth on all but the constant: a day with few keeps its mean wind
        ridge = 2.0 * np.diag(np.arange(TERMS) > 0) + 1e-6 * np.eye(TERMS)
        for day, part in total.items():
            found[day - first] = np.linalg.solve(part[:, :TERMS] + ridge, part[:, TERMS:])
        return cls(epoch, centre, first, found)

    def at(self, frame: Frame) -> tuple[Floats, Floats]:
        """Wind and its derivative by ln p at the reports of a frame, each (n, 2), m s-1."""
        design, rates = _large_scale_terms(frame, self.centre)
        own = self.coefficients[_day_of_archive(frame) - self.first]
        fit = np.einsum("nt,ntc->nc", design, own)
        return fit, np.einsum("nt,ntc->nc", rates, own) / self.centre[2, 1]


def centre_of(frame: Frame) -> Floats:
    """Mean and spread of longitude, latitude (degrees) and ln p, (3, 2)."""
    places = (frame.longitude, frame.latitude, np.log(frame.pressure))
    return np.array([[v.mean(), v.std() if v.std() > 0 else 1.0] for v in places])


def day_sums(frame: Frame, centre: Floats) -> tuple[Integers, Floats]:
    """Sums of the large-scale fit: days (d,) and X'[X y] of each, (d, 13, 15)."""
    design, _ = _large_scale_terms(frame, centre)
    table = np.concatenate([design, frame.u_rep[:, None], frame.v_rep[:, None]], axis=1)
    day = _day_of_archive(frame)
    # stable: rows of one group keep their order, so that their sums are the same bit for bit
    order = np.argsort(day, kind="stable")
    cuts = np.flatnonzero(np.diff(day[order])) + 1
    parts = [table[own][:, :TERMS].T @ table[own] for own in np.split(order, cuts)]
    return day[order][np.r_[0, cuts]], np.stack(parts)


def _day_of_archive(frame: Frame) -> Integers:
    return np.asarray(np.floor((frame.time - frame.epoch) / DAY).astype(np.int64))


def _large_scale_terms(frame: Frame, centre: Floats) -> tuple[Floats, Floats]:
    """Terms of the large-scale fit and their derivatives by ln p (times its spread), (n, 13)."""
    places = (frame.longitude, frame.latitude, np.log(frame.pressure))
    x, y, z = (
        np.clip((v - mean) / spread, -3, 3)
        for v, (mean, spread) in zip(places, centre, strict=True)
    )
    hour = np.mod(frame.time / DAY, 1.0) - 0.5
    one, none = np.ones_like(x), np.zeros_like(x)
    terms = [one, x, y, z, z * z, z**3, x * z, y * z, hour, hour * z, x * x, y * y, x * y]
    rates = [none, none, none, one, 2 * z, 3 * z * z, x, y, none, hour, none, none, none]
    return np.stack(terms, -1), np.stack(rates, -1)


def smooth_deviation(difference: Floats, angle: Floats, aircraft: NDArray[np.integer]) -> Floats:
    """Per-aircraft regression of an angle on a constant and two cycles.

    Differences beyond three robust standard deviations do not enter.

    Parameters
    ----------
    difference : (n,) float
        rad.
    angle : (n,) float
        Magnetic heading, rad.
    aircraft : (n,) int

    Returns
    -------
    (n,) float
        Fitted difference, rad.
    """
    design = np.stack(
        [np.ones_like(angle), np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)],
        -1,
    )
    out = np.zeros_like(difference)
    for a in np.unique(aircraft):
        own = np.flatnonzero(aircraft == a)
        middle = np.median(difference[own])
        # of an aircraft without any scatter all are near
        spread = robust_sd(difference[own], middle) + 1e-9
        near = own[np.abs(difference[own] - middle) < 3.0 * spread]
        normal = design[near].T @ design[near]
        # an aircraft that flew few headings has no cycles rather than large ones
        ridge = (1e-3 * near.size + 1e-9) * np.eye(5)
        out[own] = design[own] @ np.linalg.solve(normal + ridge, design[near].T @ difference[near])
    return out


def typical_airspeed(
    airspeed: Floats,
    log_pressure: Floats,
    phase: NDArray[np.integer],
    aircraft: NDArray[np.integer],
    flight: NDArray[np.integer],
) -> Floats:
    """Airspeed from the aircraft's own profile and the flight's mean departure from it.

    Parameters
    ----------
    airspeed, log_pressure : (n,) float
        m s-1; ln of pressure.
    phase, aircraft, flight : (n,) int

    Returns
    -------
    (n,) float
        m s-1.
    """
    # a hair beyond the last: knots increase where all are flown at one level
    knots = np.linspace(log_pressure.min(), log_pressure.max() + 1e-6, 7)
    base = hats(log_pressure, knots).T
    climbing = np.stack([phase == 1, phase == 3], -1)[:, :, None]
    design = np.concatenate([base, (climbing * base[:, None, :]).reshape(base.shape[0], -1)], -1)
    out = np.empty_like(airspeed)
    for a in np.unique(aircraft):
        own = np.flatnonzero(aircraft == a)
        middle = np.median(airspeed[own])
        # worth one report: knots an aircraft never flew at fall back to its median
        normal = design[own].T @ design[own] + np.eye(design.shape[1])
        profile = np.linalg.solve(normal, design[own].T @ (airspeed[own] - middle))
        out[own] = middle + design[own] @ profile
    _, which = np.unique(flight, return_inverse=True)
    count = np.bincount(which)
    # two reports' worth of the profile: a flight of one or two would be its own typical airspeed
    return np.asarray(out + (np.bincount(which, airspeed - out) / (count + 2.0))[which])
