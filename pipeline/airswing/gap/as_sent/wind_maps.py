"""Winds of some aircraft that are a linear map of what they measured: a unit, a sign, an exchange.

Assumptions: W_sent = A W for every report of these aircraft: a factor where speeds are sent in
another unit, a turn, exchanged or mirrored components. Against the reference each aircraft's winds
have a slope M (2 x 2; what is constant is left out), those of right ones near the identity and near
one another: reference and route are much the same for all. So A = M M_0^-1, M_0 the median of the
aircraft whose winds are as strong as the reference's. Of compasses and airspeeds a slope is free
where legs are flown both ways. What differs by less than a tenth is left to tables and names.

Validity: five days of an aircraft and more, its slope known to a sixth of what it differs by (by
its scatter between days). Of 72 sealed archives, 40 without effect, no aircraft's slope differed by
0.1 from the median with five standard errors.

Units: m/s; A without unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.day_regression import regressed
from airswing.gap.as_sent.mended import Mended, days_of, in_aircraft, shortened
from airswing.gap.taken_off.closed_by_table import DRAWS, LASTS

Floats = NDArray[np.float64]

#: Least difference of a slope, the same in standard errors, and days of an aircraft.
LEAST, SIGNIFICANT, LEAST_DAYS = 0.1, 6.0, 5
#: How far from the identity right winds may be, and share of the aircraft that must be.
NEAR, LEAST_SHARE = 0.2, 0.2
#: How near a factor or a turn a map must be to be told as one.
PLAIN = 0.05
#: Strongest wind of the table of a factor, m/s; determinant of a map that leaves nothing; draws.
STRONGEST, SINGULAR, DRAWN = 200.0, 0.05, 16


def mapped_of(frame: Frame) -> Mended | None:
    """Find aircraft whose winds are a map of those measured, and turn them back.

    Returns
    -------
    Mended or None
        None where all aircraft's winds go with the reference alike.
    """
    count = len(frame.tails)
    flown = [a for a in range(count) if days_of(frame, frame.aircraft == a) >= LEAST_DAYS]
    told = {a: _slope(frame, frame.aircraft == a) for a in flown}
    near = [a for a in flown if np.abs(told[a][0] - np.eye(2)).max() < NEAR]
    if len(near) < max(2, LEAST_SHARE * count):
        return None
    right = _right(frame, near)
    middle = np.median([told[a][0] for a in right], axis=0)
    struck = [a for a in flown if _differs(told[a][0] - middle, told[a][1])]
    if not struck:
        return None
    # one map, of those nearer to the clearest than to right winds
    first = max(struck, key=lambda a: float(np.abs(told[a][0] - middle).max()))
    own = [a for a in flown if _nearer(told[a], told[first][0], middle)]
    if _otherwise(frame, own):
        return None
    slope, error = _slope(frame, in_aircraft(frame, own))
    return _mended(frame, tuple(own), slope @ np.linalg.inv(middle), error)


def _slope(frame: Frame, rows: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Slope of the winds sent on the reference's, (2, 2), and its standard errors."""
    x = np.stack([frame.u_ref[rows], frame.v_ref[rows], np.ones(rows.sum())], -1)
    y = np.stack([frame.u_rep[rows], frame.v_rep[rows]], -1)
    value, error = regressed(x, y, frame.day[rows])
    return value[:2].T, error[:2].T


def _otherwise(frame: Frame, own: list[int]) -> bool:
    """Whether a wrong height or time of these aircraft explains more of their residual than a map.

    Winds grow upward: an aircraft that is higher than it says has a slope of more than one.
    """
    changes = (frame.dudlnp, frame.dvdlnp), (frame.dudt, frame.dvdt)
    explained = np.zeros(1 + len(changes))
    for a in own:
        rows = frame.aircraft == a
        one = np.ones(rows.sum())
        for j, left in enumerate(frame.residual[rows].T):
            mapped = [frame.u_ref[rows], frame.v_ref[rows], one]
            others = [[np.nan_to_num(change[j][rows]), one] for change in changes]
            energies = [_energy(left, columns) for columns in (mapped, *others)]
            explained += np.asarray(energies)
    return bool(explained[1:].max() > explained[0])


def _energy(left: Floats, columns: list[Floats]) -> float:
    """Sum of squares of a residual that some columns explain."""
    x = np.stack(columns, -1)
    return float(((x @ np.linalg.lstsq(x, left, rcond=None)[0]) ** 2).sum())


def _right(frame: Frame, near: list[int]) -> list[int]:
    """Aircraft whose winds are as strong as the reference's: of two groups the nearer to it.

    Both err, so a slope either way is too small, and the root of one over the other is not. Where
    neither group is nearer by half of what is told, most are right.
    """
    strength = np.empty(len(near))
    for k, a in enumerate(near):
        rows = frame.aircraft == a
        winds = ((frame.u_rep, frame.u_ref), (frame.v_rep, frame.v_ref))
        sent, own = (np.sum([np.var(pair[j][rows]) for pair in winds]) for j in (0, 1))
        strength[k] = np.sqrt(sent / own)
    middle = float(np.median(strength))
    first = float(strength[np.argmin(np.abs(strength - 1))])
    about = first if abs(middle - 1) > abs(first - 1) + LEAST / 2 else middle
    chosen = [a for a, s in zip(near, strength, strict=True) if abs(s - about) <= LEAST / 2]
    return chosen or near


def _nearer(told: tuple[Floats, Floats], one: Floats, other: Floats) -> bool:
    """Whether a slope is nearer to one than to another, in its standard errors."""
    slope, error = told
    # a slope is taken as known to 0.02 at best: a formal error of nothing would decide by itself
    far = [(((slope - of) / np.maximum(error, 0.02)) ** 2).sum() for of in (one, other)]
    return bool(far[0] + SIGNIFICANT < far[1])


def _differs(apart: Floats, error: Floats) -> bool:
    return bool(((np.abs(apart) > LEAST) & (np.abs(apart) > SIGNIFICANT * error)).any())


def _mended(frame: Frame, tails: tuple[int, ...], made: Floats, error: Floats) -> Mended | None:
    """The archive with a map turned back, told as a factor or a turn where it is one."""
    if abs(np.linalg.det(made)) < SINGULAR:  # one component is not sent: nothing to turn back
        return None
    made, told = _told_as(made, 3 * float(error.max()))
    sent = np.stack([frame.u_rep, frame.v_rep], -1)
    own = in_aircraft(frame, tails)[:, None]

    def back(matrix: Floats) -> Floats:
        return np.where(own, sent @ np.linalg.inv(matrix).T, sent)

    winds, rng = back(made), np.random.default_rng(0)
    saved = shortened(frame, winds)
    others = [made + error * rng.standard_normal((2, 2)) for _ in range(DRAWN)]
    spread = float(np.std([shortened(frame, back(one)).mean() for one in others], ddof=1))
    mean = float(saved.mean())
    if mean <= 2 * spread:
        return None
    moved = np.hypot(*(sent - winds)[own[:, 0]].T)
    spread = float(np.hypot(spread, LASTS * mean))
    return Mended(
        told.component,
        ("wind_speed",),
        told.title,
        tails,
        0.5 * float((np.abs(made - np.eye(2)) / np.maximum(error, 1e-6)).max() ** 2),
        float(np.sqrt((moved**2).mean())),
        without(frame, winds - np.stack([frame.u_ref, frame.v_ref], -1)),
        saved,
        mean + spread * rng.standard_normal(DRAWS),
        told.labels,
        told.values,
        told.unit,
        told.edges,
    )


@dataclass(frozen=True)
class _Told:
    """How a map is told."""

    component: str
    title: str
    labels: tuple[str, ...]
    values: tuple[float, ...]
    unit: str
    edges: tuple[float, ...] | None = (0.0, STRONGEST)


def _told_as(made: Floats, doubt: float) -> tuple[Floats, _Told]:
    """A map, as a factor or a turn alone where it is one to its doubt, and how it is told."""
    real, imaginary = (made[0, 0] + made[1, 1]) / 2, (made[1, 0] - made[0, 1]) / 2
    factor, turn = float(np.hypot(real, imaginary)), float(np.arctan2(imaginary, real))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    whole = (f"0 to {STRONGEST:.0f}",)
    if np.abs(made - factor * rotation).max() >= PLAIN + doubt:
        parts = "u of u", "u of v", "v of u", "v of v"
        values = tuple(float(x) for x in made.ravel())
        return made, _Told("wind_map", "winds sent as a map of themselves", parts, values, "", None)
    if abs(factor - 1) > abs(turn):
        percent = (100.0 * (factor - 1),)
        title = "a factor of the winds sent"
        return factor * np.eye(2), _Told("wind_factor", title, whole, percent, "percent")
    # a table's angle turns the wind to the right
    right = (-float(np.degrees(turn)),)
    return rotation, _Told("wind_angle", "an angle of the winds sent", whole, right, "degree")
