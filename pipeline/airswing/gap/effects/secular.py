"""Change of the declination between an earlier epoch and the reports' dates.

Assumptions and validity: IGRF, 1900 to 2030; epochs outside are moved to its ends. Both epochs are
evaluated here, so the pattern is secular variation alone whatever declination the frame carries.
"""

from __future__ import annotations

import numpy as np

from airswing.gap.effects.base import FloatArray
from airswing.gap.effects.forms import known
from airswing.gap.frame import Frame
from airswing.physics.atmosphere import altitude_from_pressure
from airswing.physics.geomagnetism import FieldLattice

YEAR = 365.25 * 86400.0
FIRST, LAST = 1900.0, 2030.0
MOST = 500
"""Reports used to match an epoch with a coefficient."""


def mean_year(frame: Frame) -> float:
    """Return the mean date of the reports as a decimal year."""
    return 1970.0 + float(np.mean(frame.time)) / YEAR


def declination_change(
    frame: Frame, *, years: float | None = None, epoch_year: float | None = None
) -> FloatArray:
    """Return declination of an earlier epoch minus that of the date.

    Parameters
    ----------
    frame : Frame
        Reports.
    years : float
        How long before each report's date; or
    epoch_year : float
        Decimal year, the same for all.

    Returns
    -------
    ndarray (n,)
        rad.
    """
    if epoch_year is not None:
        seconds = np.full(frame.size, (epoch_year - 1970.0) * YEAR)
    else:
        seconds = frame.time - (years or 0.0) * YEAR
    seconds = np.clip(seconds, (FIRST - 1970.0) * YEAR + 86400.0, (LAST - 1970.0) * YEAR - 86400.0)
    place = (frame.latitude, frame.longitude, altitude_from_pressure(frame.pressure))
    now = FieldLattice.covering(*place, frame.time).at(*place, frame.time).declination
    old = FieldLattice.covering(*place, seconds).at(*place, seconds).declination
    return np.asarray(np.arctan2(np.sin(old - now), np.cos(old - now)))


def _thinned(frame: Frame) -> Frame:
    return frame.take(slice(None, None, max(1, frame.size // MOST)))


def project(frame: Frame, epoch_year: float) -> float:
    """Return the years of secular variation that best match a table of an epoch.

    Parameters
    ----------
    frame : Frame
        Reports.
    epoch_year : float
        Decimal year.

    Returns
    -------
    float
        Least-squares coefficient of the pattern of ten years' change, per year.
    """
    few = _thinned(frame)
    pattern = known(declination_change(few, years=10.0)) / 10.0
    change = known(declination_change(few, epoch_year=epoch_year))
    energy = float(pattern @ pattern)
    return float(pattern @ change) / energy if energy > 0.0 else 0.0


def year_matching(frame: Frame, years: float) -> float:
    """Return the epoch whose table projects on `years`: the inverse of `project`."""
    now = mean_year(frame)
    back = np.linspace(now + 20.0, now - 60.0, 33).clip(FIRST, LAST)
    matched = np.array([project(frame, float(year)) for year in back])
    order = np.argsort(matched)
    return float(np.interp(years, matched[order], back[order]))
