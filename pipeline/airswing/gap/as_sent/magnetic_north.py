"""Headings or wind directions of some aircraft that are given against magnetic north.

Assumptions: declination is added to what a compass shows; forgotten, a heading or the direction of
a wind is short of it by the declination d, added twice it is as much beyond, with the wrong sign
twice as much short. So the error is k d with k of -1, 1 or -2, no parameter free, and everywhere on
the routes. Of right ones k is near nothing. It is the regression

* of a heading's difference from the one that the reference implies, on d, beside a deviation of
  two cycles: an offset of the compass is not taken for it where d changes along the routes;
* of the winds less the reference's, on its winds turned by d, beside an error along the heading and
  the same deviation. There an angle that is everywhere the same, and by chance the declination's,
  is not told from it.

What a whole fleet's offsets say of the kind of its headings, the main job asks of its fits
(:mod:`airswing.compass.heading_kind`); here every aircraft is asked by itself.

Validity: five days of an aircraft and more; k known to 0.12 (by its scatter between days). Of what
all aircraft have, wind directions are the reference's as well, and are left to names.

Units: rad, m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.day_regression import regressed
from airswing.gap.as_sent.mended import Mended, days_of, in_aircraft, shortened
from airswing.gap.taken_off.closed_by_table import DRAWS, LASTS
from airswing.physics.triangle import wrap_signed

Floats = NDArray[np.float64]
Slopes = dict[int, tuple[float, float]]

#: What may have been done with the declination, by what it makes of it.
MADE = {
    -1.0: "without the declination",
    1.0: "with the declination added twice",
    -2.0: "with the declination's sign turned round",
}
#: How near k must be to one of these, how well it must be known, the same in standard errors; and
#: in standard errors on aircraft that join those on which it is clear. On 80 archives of a blind
#: check |k| of headings was 0.14 at most, of directions 0.25 on four nulls and a fleet of 60 with
#: deviations (``benchmarks.gap_kinds --look``).
NEAR, KNOWN, SIGNIFICANT, JOINS = 0.2, 0.12, 8.0, 4.0
LEAST_DAYS = 5
#: Largest error of a heading that is looked at, rad: beyond it is a gross error.
GROSS = np.radians(30.0)
#: Cells of the table by longitude.
CELLS = 8


@dataclass(frozen=True)
class OnDeclination:
    """What goes with the declination: its columns, and how it is told."""

    component: str
    what: str
    values: Floats  # (n, c): what errs, an angle or two components
    columns: Floats  # (n, c, k): the first is what a k of one would make of it
    rows: NDArray[np.bool_]  # reports that are looked at
    of_reference: bool  # whether the reference's error goes with it on all aircraft


def against_magnetic_north_of(frame: Frame) -> Mended | None:
    """Find aircraft whose headings or directions are against magnetic north, and turn them."""
    found = [_struck(frame, told, slopes) for told, slopes in declination_slopes(frame)]
    made = [_mended(frame, *one) for one in found if one is not None]
    return max(
        (one for one in made if one is not None), key=lambda one: one.saved.mean(), default=None
    )


def _headings(frame: Frame) -> OnDeclination:
    """Headings less those that the reference implies."""
    implied = np.arctan2(frame.ground_u - frame.u_ref, frame.ground_v - frame.v_ref)
    off = np.asarray(wrap_signed(frame.heading - implied))
    columns = np.stack([frame.declination, *_deviation(frame)], -1)[:, None]
    rows = (np.abs(off) < GROSS) & np.isfinite(frame.declination)
    return OnDeclination("heading_angle", "headings", off[:, None], columns, rows, False)


def _deviation(frame: Frame) -> list[Floats]:
    """Waves of a deviation of two cycles, (n,) each."""
    waves = [f(k * frame.magnetic_heading) for k in (1, 2) for f in (np.sin, np.cos)]
    return [np.ones(frame.size), *waves]


def _directions(frame: Frame) -> OnDeclination:
    """Winds less the reference's, beside an error along the heading and a deviation.

    Every compass deviates, and what that makes of winds goes with the routes as declination does.
    """
    nose = np.stack([np.sin(frame.heading), np.cos(frame.heading)], -1)
    beam = np.stack([nose[:, 1], -nose[:, 0]], -1) * frame.airspeed[:, None]
    right = np.stack([frame.v_ref, -frame.u_ref], -1)
    heading = [beam * wave[:, None] for wave in _deviation(frame)]
    columns = np.stack([right * frame.declination[:, None], nose, *heading], -1)
    rows = (np.hypot(*frame.residual.T) < GROSS * frame.airspeed) & np.isfinite(frame.declination)
    return OnDeclination("wind_angle", "wind directions", frame.residual, columns, rows, True)


def _struck(
    frame: Frame, told: OnDeclination, slopes: Slopes
) -> tuple[OnDeclination, float, list[int], float] | None:
    """Aircraft with one k, what it is and its standard error; None where there are none."""
    clear = [k for k in (_made_of(*one) for one in slopes.values()) if k is not None]
    if not clear:
        return None
    k = max(sorted(set(clear)), key=clear.count)
    own = [
        a
        for a, (slope, error) in slopes.items()
        if abs(slope - k) < max(NEAR, 3 * error) and abs(slope) > JOINS * error
    ]
    if told.of_reference and len(own) > len(slopes) / 2:
        return None
    return told, k, own, _slope(frame, told, told.rows & in_aircraft(frame, own))[1]


def declination_slopes(frame: Frame) -> list[tuple[OnDeclination, Slopes]]:
    """Return k and its standard error by aircraft: of headings, and of directions.

    Aircraft that flew on too few days are left out.
    """
    return [(told, _slopes(frame, told)) for told in (_headings(frame), _directions(frame))]


def _slopes(frame: Frame, told: OnDeclination) -> Slopes:
    """The same of one kind; of directions beside the fleet's."""
    looked = {a: told.rows & (frame.aircraft == a) for a in range(len(frame.tails))}
    slopes = {
        a: _slope(frame, told, rows)
        for a, rows in looked.items()
        if days_of(frame, rows) >= LEAST_DAYS
    }
    if not told.of_reference or not slopes:
        return slopes
    # what the reference's own error makes of all aircraft's directions
    usual = float(np.median([slope for slope, _ in slopes.values()]))
    return {a: (slope - usual, error) for a, (slope, error) in slopes.items()}


def _made_of(slope: float, error: float) -> float | None:
    """What was done with the declination, told by its slope; None where it is nothing of these."""
    if error > KNOWN or abs(slope) < SIGNIFICANT * error:
        return None
    near = min(MADE, key=lambda k: abs(slope - k))
    return near if abs(slope - near) < NEAR else None


def _slope(frame: Frame, told: OnDeclination, rows: NDArray[np.bool_]) -> tuple[float, float]:
    """Regression of what errs on what the declination makes, and its standard error over days."""
    x, y = told.columns[rows], told.values[rows].reshape(-1, 1)
    day = np.repeat(frame.day[rows], x.shape[1])
    value, error = regressed(x.reshape(-1, x.shape[-1]), y, day)
    return float(value[0, 0]), float(error[0, 0])


def _mended(
    frame: Frame, told: OnDeclination, k: float, own: Sequence[int], error: float
) -> Mended | None:
    rows = in_aircraft(frame, own) & np.isfinite(frame.declination)
    angle = np.where(rows, k * np.nan_to_num(frame.declination), 0.0)
    winds = _turned_back(frame, told, angle)
    saved = shortened(frame, winds)
    mean = float(saved.mean())
    spread = float(np.hypot(LASTS, error) * abs(mean))
    if mean <= 2 * spread:
        return None
    sent = np.stack([frame.u_rep, frame.v_rep], -1)
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    size = float(np.sqrt(((sent - winds)[rows] ** 2).sum(axis=1).mean()))
    left = float(((winds - reference)[rows] ** 2).sum(axis=1).mean())
    edges, values = _by_longitude(frame, angle, rows)
    made = Mended(
        told.component,
        ("longitude",),
        f"{told.what} {MADE[k]}",
        tuple(own),
        0.5 * float(rows.sum()) * size**2 / left,
        size,
        without(frame, winds - reference),
        saved,
        mean + spread * np.random.default_rng(0).standard_normal(DRAWS),
        tuple(f"{low:.1f} to {high:.1f}" for low, high in pairwise(edges)),
        tuple(float(x) for x in values),
        "degree",
        tuple(float(x) for x in edges),
    )
    if told.of_reference:  # winds against magnetic north have no name
        return made
    mean_deg = float(np.degrees(angle[rows].mean()))
    parameters = {"epoch_year": None, "factor": 1.0 + k, "mean_deg": mean_deg}
    return replace(
        made, name="declination_error", parameters=parameters, standard_errors={"factor": error}
    )


def _turned_back(frame: Frame, told: OnDeclination, angle: Floats) -> Floats:
    """Winds as they would be with headings, or directions, turned back by an angle, (n, 2)."""
    if told.component == "heading_angle":
        heading = frame.heading - angle
        air = frame.airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)
        winds = np.stack([frame.ground_u, frame.ground_v], -1) - air
        own = (angle != 0.0)[:, None]
        return np.where(own, winds, np.stack([frame.u_rep, frame.v_rep], -1))
    sine, cosine = np.sin(angle), np.cos(angle)
    u, v = frame.u_rep, frame.v_rep
    return np.stack([cosine * u - sine * v, cosine * v + sine * u], -1)


def _by_longitude(frame: Frame, angle: Floats, rows: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Edges of longitude, and the mean angle between them, degrees."""
    east = frame.longitude[rows]
    edges = np.unique(np.quantile(east, np.linspace(0, 1, CELLS + 1)))
    if edges.size < 2:
        edges = np.array([edges[0] - 0.5, edges[0] + 0.5])
    cell = np.clip(np.searchsorted(edges, east, "right") - 1, 0, edges.size - 2)
    count = np.maximum(np.bincount(cell, minlength=edges.size - 1), 1)
    return edges, np.degrees(np.bincount(cell, angle[rows], edges.size - 1) / count)
