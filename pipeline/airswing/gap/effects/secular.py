"""Change of the declination between an earlier epoch and the reports' dates.

Assumptions and validity: IGRF, 1900 to 2030; epochs outside are moved to its ends. Both epochs are
evaluated here, so the pattern is secular variation alone whatever declination the frame carries: at
whole degrees and years and interpolated linearly (it is smooth away from the magnetic poles, within
1 % there), so that a report has one value whatever others are asked for with it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.effects.base import FloatArray
from airswing.gap.effects.forms import known
from airswing.physics.geomagnetism import geomagnetic_field
from airswing.physics.triangle import wrap_signed
from airswing.units import DAY

YEAR = 365.25 * DAY
# what IGRF-14 spans, a hair inside: beyond its last epoch the field stands still
FIRST, LAST = 1900.01, 2029.99
HEIGHT = 5000.0
"""m: secular variation hardly depends on height."""
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
    years : float
        How long before each report's date; or
    epoch_year : float
        Decimal year, the same for all.

    Returns
    -------
    ndarray (n,)
        rad.
    """
    date = 1970.0 + frame.time / YEAR
    lon, lat = _bounds(frame.longitude), _bounds(frame.latitude)
    first = int(np.floor(date.min()))
    dates = (first, int(np.floor(date.max())) + 2)
    change = _change_at_nodes(lon, lat, dates, years or 0.0, epoch_year)
    out = np.zeros(frame.size)
    for k, whole in enumerate(range(*dates)):
        weight = np.clip(1.0 - np.abs(date - whole), 0.0, 1.0)
        some = np.flatnonzero(weight)
        out[some] += weight[some] * _bilinear(
            change[:, :, k], frame.longitude[some] - lon[0], frame.latitude[some] - lat[0]
        )
    return out


def _bounds(values: FloatArray) -> tuple[int, int]:
    """Tens of degrees around some values, so that chunks of an archive share their nodes."""
    step = 10
    low, high = int(np.floor(values.min() / step)), int(np.floor(values.max() / step)) + 1
    return step * low, step * high + 2


@lru_cache(maxsize=256)
def _change_at_nodes(
    longitude: tuple[int, int],
    latitude: tuple[int, int],
    dates: tuple[int, int],
    years: float,
    epoch_year: float | None,
) -> FloatArray:
    """Declination of an earlier epoch minus that of the date at whole degrees and years, rad."""
    axes = [np.arange(*bounds, dtype=np.float64) for bounds in (longitude, latitude, dates)]
    lon, lat, now = np.meshgrid(*axes, indexing="ij")
    old = now - years if epoch_year is None else np.full(now.shape, epoch_year)
    return _change(np.clip(lat, -90.0, 90.0), lon, now, old)


def _change(
    latitude: FloatArray, longitude: FloatArray, now: FloatArray, old: FloatArray
) -> FloatArray:
    """Declination of one decimal year minus that of another, rad."""
    height = np.full(latitude.shape, HEIGHT)
    then, there = (
        geomagnetic_field(latitude, longitude, height, seconds).declination
        for seconds in ((np.clip(year, FIRST, LAST) - 1970.0) * YEAR for year in (old, now))
    )
    return wrap_signed(then - there)


def _bilinear(values: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Values between nodes one apart, at distances from the first."""
    i, j = x.astype(np.int64), y.astype(np.int64)
    x, y = x - i, y - j
    return np.asarray(
        (1.0 - x) * ((1.0 - y) * values[i, j] + y * values[i, j + 1])
        + x * ((1.0 - y) * values[i + 1, j] + y * values[i + 1, j + 1])
    )


def _thinned(frame: Frame) -> Frame:
    return frame.take(slice(None, None, max(1, frame.size // MOST)))


def secular_patterns(frame: Frame) -> FloatArray:
    """Return the pattern of old tables, (2, n) rad per year, and what bends it as they get older.

    The first is ten years' change over ten, the second the mean yearly change of forty years less
    the first. Secular variation itself changes: of a table forty years old the first alone leaves
    a sixth.
    """
    near = declination_change(frame, years=10.0) / 10.0
    return np.stack([near, declination_change(frame, years=40.0) / 40.0 - near])


def project(frame: Frame, epoch_year: float) -> FloatArray:
    """Return the coefficients of `secular_patterns` that best match a table of an epoch, (2,).

    Parameters
    ----------
    epoch_year : float
        Decimal year.
    """
    few = _thinned(frame)
    return _matched(known(secular_patterns(few)), few, epoch_year)


def _matched(patterns: FloatArray, few: Frame, epoch_year: float) -> FloatArray:
    """Least-squares coefficients of some patterns (k, n) of a table of an epoch."""
    change = known(declination_change(few, epoch_year=epoch_year))
    return np.asarray(np.linalg.lstsq(patterns.T, change, rcond=1e-6)[0])


def year_matching(frame: Frame, coefficients: FloatArray) -> float:
    """Return the epoch whose table is nearest to coefficients of `secular_patterns`.

    Parameters
    ----------
    coefficients : (2,) float
        Where the second is 0, the first stands for all of the pattern.
    """
    few = _thinned(frame)
    own = slice(None, 2 if coefficients[1] else 1)
    patterns = known(secular_patterns(few))[own]
    now = mean_year(frame)
    # tables of sixty years back, and twenty ahead, where a fit's scatter may put one: every 2.5
    # years
    back = np.linspace(now + 20.0, now - 60.0, 33).clip(FIRST, LAST)
    apart = np.stack([_matched(patterns, few, float(year)) for year in back]) - coefficients[own]
    steps = np.linspace(0.0, 1.0, 41)[:, None, None]  # between two years tables change evenly
    between = (1.0 - steps) * apart[:-1] + steps * apart[1:]
    off = ((between @ patterns) ** 2).sum(axis=-1)
    step, first = np.unravel_index(int(np.argmin(off)), off.shape)
    return float(back[first] + steps[step, 0, 0] * (back[first + 1] - back[first]))
