"""Which way an aircraft flies at a report beside a turn, and how far that can be trusted.

Assumptions: turns are short against the time between fixes, so one lies mostly within one leg. The
mean of the legs before and after then spreads a turn over two reports, where the unit's heading had
it between them: design columns change less than the residual, and whitening, which lives on
differences between neighbouring reports, makes every coefficient larger (by 11 % in trials of an
airspeed offset). So each leg counts by how straight the path goes on beyond it: at the report
before a turn the leg that led there speaks, after it the one that leads away (by 2 % in the same
trials). What direction is left unknown makes a column miss its residual by about airspeed x
deviation x heading error; that miss is added to the report's noise.

Validity: reports minutes apart. A turn that goes on over several reports is seen as by the mean.

SI units and radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.physics.triangle import wrap_signed

Floats = NDArray[np.float64]

SHARE = 1.0
"""Part of the turn to the neighbouring report by which the heading may be off."""


EARTH_RADIUS = 6371008.8
STRAIGHT = np.radians(3.0)
"""Changes of track under which a leg counts as straight, whatever its noise, rad."""
AGREE = 3.0
"""Median difference from the ground vectors given, from which on they are left alone, m s-1."""
DERIVED = 0.01
"""A heading further than this from that of ground vector minus wind was reported, rad."""


def ground_at_fixes(values: Mapping[str, Any]) -> dict[str, Floats]:
    """Ground velocity at each report from the leg whose path goes on straight, and what follows.

    Parameters
    ----------
    values : mapping of str to (n,) array
        Of a :class:`~airswing.gap.archive.frame.Frame`: ``latitude, longitude`` (degrees), ``time``
        (s), ``flight, ground_u, ground_v, u_rep, v_rep, airspeed`` (m s-1), ``heading,
        magnetic_heading`` (rad).

    Returns
    -------
    dict
        ``ground_u, ground_v, airspeed, heading, magnetic_heading`` anew. Where the unit reported
        its heading itself that one stays, and all five where a flight has no leg or where the
        ground vectors given are not those of the positions.

    References
    ----------
    Jiang & Shu 1996, J. Comput. Phys. 126: weights by the smoothness of each stencil.
    """
    u, v, centred = _ground(
        values["latitude"], values["longitude"], values["time"], values["flight"]
    )
    known = np.isfinite(u) & np.isfinite(v)
    apart = np.hypot(centred[0] - values["ground_u"], centred[1] - values["ground_v"])[known]
    if np.isnan(apart).all() or np.nanmedian(apart) > AGREE:
        known[:] = False  # the ground vectors came from elsewhere than these positions
    east, north = (
        (np.where(known, new, values[ground]) - values[wind], values[ground] - values[wind])
        for new, ground, wind in ((u, "ground_u", "u_rep"), (v, "ground_v", "v_rep"))
    )
    turned = wrap_signed(np.arctan2(east[0], north[0]) - np.arctan2(east[1], north[1]))
    told = wrap_signed(values["heading"] - np.arctan2(east[1], north[1]))
    derived = known & ~(np.abs(told) > DERIVED)
    out = {
        "ground_u": np.where(known, u, values["ground_u"]),
        "ground_v": np.where(known, v, values["ground_v"]),
        "airspeed": np.where(derived, np.hypot(east[0], north[0]), values["airspeed"]),
    }
    for name in ("heading", "magnetic_heading"):
        out[name] = np.where(
            derived, np.mod(values[name] + turned, 2 * np.pi), np.asarray(values[name])
        )
    return out


def _ground(
    latitude: Floats, longitude: Floats, time: Floats, flight: NDArray[np.integer]
) -> tuple[Floats, Floats, Floats]:
    """Mean of the legs before and after, each weighed by how straight the path is beyond it.

    Beside it the plain mean over both legs' time, (2, n).
    """
    order = np.lexsort((time, flight))
    phi, lam = np.radians(latitude[order]), np.radians(longitude[order])
    flight, time = flight[order], time[order]
    step = np.where(flight[1:] == flight[:-1], np.maximum(np.diff(time), 1.0), np.nan)
    leg = np.stack([np.cos(0.5 * (phi[1:] + phi[:-1])) * wrap_signed(np.diff(lam)), np.diff(phi)])
    leg *= EARTH_RADIUS / step
    none = np.full((2, 1), np.nan)
    before, after = np.hstack([none, leg]), np.hstack([leg, none])
    turn = np.nan_to_num(wrap_signed(np.arctan2(*after) - np.arctan2(*before)))
    weights = [
        np.where(np.isfinite(part[0]), 1.0 / (beyond**2 + STRAIGHT**2), 0.0)
        for part, beyond in ((before, np.r_[0.0, turn[:-1]]), (after, np.r_[turn[1:], 0.0]))
    ]
    total = weights[0] + weights[1]
    mean = np.nan_to_num(before) * weights[0] + np.nan_to_num(after) * weights[1]
    out, centred = np.empty_like(mean), np.empty_like(mean)
    out[:, order] = mean / np.where(total > 0, total, np.nan)
    took = [np.nan_to_num(part) for part in (np.r_[np.nan, step], np.r_[step, np.nan])]
    way = np.nan_to_num(before) * took[0] + np.nan_to_num(after) * took[1]
    centred[:, order] = way / np.where(total > 0, took[0] + took[1], np.nan)
    return out[0], out[1], centred


def turn_at_reports(track: Floats, flight: NDArray[np.integer], time: Floats) -> Floats:
    """Largest change of track to the report before or after in the same flight.

    Parameters
    ----------
    track : (n,) float
        rad.
    flight : (n,) int
    time : (n,) float
        s.

    Returns
    -------
    (n,) float
        rad, 0 to pi; 0 where a flight has one report.
    """
    order = np.lexsort((time, flight))
    change = np.abs(wrap_signed(np.diff(track[order])))
    change[np.diff(flight[order]) != 0] = 0.0
    change = np.nan_to_num(change)
    found = np.zeros(track.size)
    found[order] = np.maximum(np.r_[0.0, change], np.r_[change, 0.0])
    return found


def heading_doubt(frame: Any, columns_frame: Any) -> Floats:
    """Error of the deviation's columns at reports in a turn.

    Parameters
    ----------
    frame : Frame
        As reported.
    columns_frame : Frame
        With the heading that stands in the columns.

    Returns
    -------
    (n,) float
        Standard deviation per component, m s-1.
    """
    implied = np.arctan2(frame.ground_u - frame.u_ref, frame.ground_v - frame.v_ref)
    squared = wrap_signed(columns_frame.heading - implied) ** 2
    count = np.maximum(np.bincount(frame.aircraft, minlength=len(frame.tails)), 1)
    deviation = np.sqrt(np.bincount(frame.aircraft, squared, minlength=len(frame.tails)) / count)
    turn = turn_at_reports(np.arctan2(frame.ground_u, frame.ground_v), frame.flight, frame.time)
    off = SHARE * np.minimum(turn, np.pi / 2)
    return np.asarray(columns_frame.airspeed * deviation[frame.aircraft] * off)
