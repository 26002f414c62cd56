"""Magnetic variation of the unit out of date or scaled.

IGRF, 1900 to 2030; other epochs are replaced by its ends. The declination of both epochs is
computed at whole degrees and years with linear interpolation (within 1 % away from the magnetic
poles), so that the value of a report does not depend on the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Floats
from airswing.gap.effects.base import (
    Estimate,
    HeadingEffect,
    Parameter,
    Parameters,
    Stated,
    number,
    standard_error,
)
from airswing.physics.geomagnetism import geomagnetic_field
from airswing.physics.triangle import wrap_signed
from airswing.synthetic.sealed.draws import Draw, sign
from airswing.units import DAY

YEAR = 365.25 * DAY
FIRST, LAST = 1900.01, 2029.99
"""Range of IGRF-14, decimal years; the field is constant beyond its last epoch."""


def _table(rng: np.random.Generator) -> dict[str, object]:
    # a table that is scaled or out of date
    if rng.uniform() < 0.5:
        return {"factor": float(rng.choice([0.0, 0.5, 1.5])), "mean_deg": sign(rng)}
    return {"epoch_year": float(rng.integers(1960, 1996)), "mean_deg": sign(rng)}


class DeclinationError(HeadingEffect):
    """Declination of an old epoch, or a wrong multiple of the correct one.

    Three candidates: `years` out of date (secular variation over ten years), the same with the
    curvature `bend` of older tables, and `factor` minus one times the declination. ``mean_deg`` is
    the resulting mean error; if given alone it scales the secular pattern.
    """

    name = "declination_error"
    title = "wrong magnetic variation"
    draw = Draw(_table, ("mean_deg",), scope="fleet")
    distinguished_by = {
        "compass_offset": "flights over a larger region, where the declination varies"
    }
    physics = (
        "The unit turns magnetic into true heading by a stored table of the magnetic variation. "
        "An old table is wrong by the secular variation since, a pattern over the region that is "
        "the same for every aircraft."
    )
    source = "IGRF-14, Alken et al. 2021, Earth Planets Space 73:49; RTCA DO-236C (MAGVAR tables)."
    parameters = (
        Parameter("epoch_year", "year", 10.0, "epoch of the table in use", None),
        Parameter("factor", "1", 0.3, "declination in use over the correct one", None),
        Parameter("mean_deg", "degree", 1.0, "mean heading error that results", None),
    )
    scope = "fleet"
    needs = ("heading", "declination")
    confused_with = ("compass_offset: of the whole fleet, where the region is small",)
    column_scales = np.array([10.0, 0.3, 10.0])  # years, 1, years
    alternatives = ((0,), (1,), (0, 2))

    def basis(self, frame: Frame) -> Floats:
        # rad per year out of date, per unit of factor and per year of bend
        secular, bend = _secular_patterns(frame)
        return np.stack([secular, frame.declination, bend])

    def error(self, frame: Frame, values: Parameters) -> Floats:
        if values["epoch_year"] is None:
            return super().error(frame, values)
        return np.nan_to_num(declination_change(frame, epoch_year=number(values["epoch_year"])))

    def to_parameters(self, coefficients: Floats, covariance: Floats, frame: Frame) -> Estimate:
        # of the age or the factor, whichever is larger
        aged, factor = np.array([coefficients[0], coefficients[2]]), float(coefficients[1])
        old = abs(aged[0] / self.column_scales[0]) >= abs(factor / self.column_scales[1])
        used = [0, 2] if old else [1]
        per_unit = np.nan_to_num(self.basis(frame)[used]).mean(axis=1)
        mean_error = float(np.sqrt(per_unit @ covariance[np.ix_(used, used)] @ per_unit))
        values: Stated = {"epoch_year": None, "factor": None}
        values["mean_deg"] = float(np.degrees(coefficients[used] @ per_unit))
        errors = {"mean_deg": float(np.degrees(mean_error))}
        if old:
            values["epoch_year"] = _year_of_coefficients(frame, aged)
            return values, errors | {"epoch_year": standard_error(covariance, 0)}
        values["factor"] = 1.0 + factor
        return values, errors | {"factor": standard_error(covariance, 1)}

    def from_parameters(self, values: Mapping[str, object], frame: Frame) -> Floats:
        # an epoch has an error of its own, which no coefficients give exactly
        full = self.complete(values)
        if full["factor"] is not None:
            return np.array([0.0, number(full["factor"]) - 1.0, 0.0])
        mean = float(np.mean(np.nan_to_num(self.basis(frame)[0])))
        wanted = np.radians(number(full["mean_deg"] or 0.0))
        return np.array([wanted / mean if mean != 0.0 else 0.0, 0.0, 0.0])


def declination_change(
    frame: Frame, *, years: float | None = None, epoch_year: float | None = None
) -> Floats:
    """Declination of an earlier epoch minus that of the date of each report, (n,) rad.

    The epoch is some ``years`` before the date, or a decimal ``epoch_year`` for all.
    """
    date = 1970.0 + frame.time / YEAR
    lon, lat = _bounds(frame.longitude), _bounds(frame.latitude)
    dates = (int(np.floor(date.min())), int(np.floor(date.max())) + 2)
    change = _change_at_nodes(lon, lat, dates, years or 0.0, epoch_year)
    nodes = [np.arange(*bounds) for bounds in (lon, lat, dates)]
    places = frame.longitude, frame.latitude, date
    return np.asarray(RegularGridInterpolator(nodes, change)(np.stack(places, -1)))


def _bounds(values: Floats) -> tuple[int, int]:
    # in tens of degrees, so that parts of an archive share their nodes
    low, high = (int(np.floor(end / 10)) for end in (values.min(), values.max()))
    return 10 * low, 10 * (high + 1) + 2


@lru_cache(maxsize=256)
def _change_at_nodes(
    longitude: tuple[int, int],
    latitude: tuple[int, int],
    dates: tuple[int, int],
    years: float,
    epoch_year: float | None,
) -> Floats:
    axes = [np.arange(*bounds, dtype=np.float64) for bounds in (longitude, latitude, dates)]
    lon, lat, now = np.meshgrid(*axes, indexing="ij")
    # at 5000 m: secular variation hardly depends on the height
    lat, height = np.clip(lat, -90.0, 90.0), np.full(lat.shape, 5000.0)
    epoch = now - years if epoch_year is None else np.full(now.shape, epoch_year)
    seconds = [(np.clip(year, FIRST, LAST) - 1970.0) * YEAR for year in (epoch, now)]
    then, today = (geomagnetic_field(lat, lon, height, at).declination for at in seconds)
    return wrap_signed(then - today)


def _secular_patterns(frame: Frame) -> Floats:
    """Secular variation over ten years, and that over forty minus it, (2, n) rad per year."""
    # without the second a sixth of the error of a table that is forty years old remains
    recent = declination_change(frame, years=10.0) / 10.0
    return np.stack([recent, declination_change(frame, years=40.0) / 40.0 - recent])


def _year_of_coefficients(frame: Frame, coefficients: Floats) -> float:
    # the epoch whose table is nearest to coefficients of the secular patterns
    # five hundred reports, of which an epoch is found in a second
    subset = frame.take(slice(None, None, max(1, frame.size // 500)))
    # if the second is 0, the first is that of the pattern without curvature
    used = slice(None, 2 if coefficients[1] else 1)
    patterns = np.nan_to_num(_secular_patterns(subset))[used]
    now = 1970.0 + float(np.mean(frame.time)) / YEAR
    # every 2.5 years from twenty years ahead (by the error of a fit) to sixty years back
    years = np.linspace(now + 20.0, now - 60.0, 33).clip(FIRST, LAST)
    changes = [declination_change(subset, epoch_year=float(year)) for year in years]
    fitted = np.linalg.lstsq(patterns.T, np.nan_to_num(changes).T, rcond=1e-6)[0].T
    difference = fitted - coefficients[used]
    steps = np.linspace(0.0, 1.0, 41)[:, None, None]  # linear between two years
    between = (1.0 - steps) * difference[:-1] + steps * difference[1:]
    misfit = ((between @ patterns) ** 2).sum(axis=-1)
    step, first = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
    return float(years[first] + steps[step, 0, 0] * (years[first + 1] - years[first]))


EFFECT = DeclinationError()
