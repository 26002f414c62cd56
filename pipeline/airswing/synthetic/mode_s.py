"""Sample of ERA5 as NetCDF with aircraft that report their magnetic heading (Mode S).

Compass: psi_ind = psi + A + B sin m + C cos m. The model's wind is linear in place, ln p and time,
so that interpolation adds no error; the true wind adds an error of each flight and gusts. Reports
have the resolution of Mode-S registers 5,0 and 6,0 and the columns of `traffic`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from airswing.synthetic.atmosphere import Array
from airswing.synthetic.instrument import EarthField
from airswing.units import KNOT

START = np.datetime64("2017-01-11T00:00", "ns")
LEVELS = (500.0, 400.0, 300.0, 250.0, 200.0)
# Standard altitudes of the levels that are flown.
_ALTITUDE_FT = {300.0: 30065.0, 250.0: 33999.0}
# m; independent of the package's, so that a wrong radius there is detected.
EARTH = 6_371_000.0
STEP_S, REPORTS = 10, 150
WEST = -127.0  # edge of the region, degrees
# Degrees: resolution of heading and track in registers 6,0 and 5,0.
_ANGLE_STEP = 90.0 / 512.0
# Deviation A, B, C (degrees), and the true heading of aircraft that fly only one.
AIRCRAFT = {
    "a00001": (1.2, 2.0, -1.5, None),
    "a00002": (-0.8, -1.0, 2.5, None),
    "a00003": (0.4, 3.0, 0.5, None),
    "a00004": (2.1, 0.0, 0.0, 285.0),
    "a00005": (-1.4, 0.0, 0.0, 40.0),
    "a00006": (0.9, 0.0, 0.0, 110.0),
}


def _model_wind(latitude: Array, longitude: Array, pressure: Array, hour: Array) -> Array:
    height = np.log(500.0 / pressure)
    east = 18.0 + 1.1 * (latitude - 49.0) + 14.0 * height + 0.2 * hour
    north = -4.0 + 0.7 * (longitude + 121.0) - 5.0 * height - 0.1 * hour
    return np.stack(np.broadcast_arrays(east, north))


def write_mode_s(
    folder: str | Path, *, south: float = 45.0, flights: int = 20, seed: int = 1
) -> dict[str, tuple[float, float, float, float | None]]:
    """Write ``era5.nc`` and ``mode_s.csv``.

    Parameters
    ----------
    folder : path
        Made where missing.
    south : float
        Southern edge of a region of 8 by 12 degrees, from 127 degrees west.
    flights : int
        Flights of each aircraft.
    seed : int
        Seed of all random numbers.

    Returns
    -------
    dict
        The truth, `AIRCRAFT`.

    Examples
    --------
    >>> deviations = airswing.write_mode_s(folder / "mode_s", flights=2, seed=1)
    >>> len(deviations) > 0
    True
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    hours = 2 * flights + 2
    packing = {"dtype": "int16", "scale_factor": 0.002, "add_offset": 10.0, "_FillValue": -32767}
    packing |= {"zlib": True, "complevel": 1}
    _era5(south, hours).to_netcdf(place / "era5.nc", encoding={"u": packing, "v": packing})
    start = pd.Timestamp(START).to_pydatetime()
    field = EarthField(start, hours / 24.0, (south, south + 8.0, WEST, WEST + 12.0))
    tables = []
    for name, (*curve, only) in AIRCRAFT.items():
        for number in range(flights):
            heading = rng.uniform(0, 360) if only is None else only + rng.uniform(-8, 8)
            begin = 2.0 * number + rng.uniform(0, 1)
            tables.append(_flight(name, curve, heading, begin, field, rng, (south, WEST)))
    pd.concat(tables).to_csv(place / "mode_s.csv", index=False)
    return AIRCRAFT


def _era5(south: float, hours: int) -> xr.Dataset:
    axes = {
        "time": np.arange(hours, dtype=float),
        "level": np.array(LEVELS),
        "latitude": south + np.arange(8.0, -0.1, -0.5),
        "longitude": WEST + np.arange(0.0, 12.1, 0.5),
    }
    hour, level, lat, lon = np.meshgrid(*axes.values(), indexing="ij")
    winds = _model_wind(lat, lon, level, hour)
    attrs = [
        {"units": "m s**-1", "standard_name": f"{way}ward_wind", "long_name": f"{letter} component"}
        for way, letter in (("east", "U"), ("north", "V"))
    ]
    ds = xr.Dataset(
        {n: (tuple(axes), wind, a) for n, wind, a in zip("uv", winds, attrs, strict=True)},
        coords=axes,
    )
    ds["time"] = START + (axes["time"] * 3600).astype("timedelta64[s]")
    ds["level"].attrs = {"units": "millibars", "long_name": "pressure_level"}
    ds["latitude"].attrs = {"units": "degrees_north"}
    ds["longitude"].attrs = {"units": "degrees_east"}
    ds.attrs = {"Conventions": "CF-1.6"}
    return ds


def _flight(
    name: str,
    curve: list[float],
    heading: float,
    begin: float,
    field: EarthField,
    rng: np.random.Generator,
    corner: tuple[float, float],
) -> pd.DataFrame:
    airspeed = 225.0 + rng.normal(0, 4)
    level = list(_ALTITUDE_FT)[int(rng.integers(2))]
    error = rng.normal(0, 1.0, 2)
    lat, lon = corner[0] + 4.0 + rng.uniform(-0.7, 0.7), corner[1] + 6.0 + rng.uniform(-1, 1)
    psi = np.radians(heading)
    rows = []
    for k in range(REPORTS):
        hour = begin + k * STEP_S / 3600.0
        wind = _model_wind(*(np.array(x) for x in (lat, lon, level, hour))) + error
        wind = wind + rng.normal(0, 0.7, 2)
        ground = airspeed * np.array([np.sin(psi), np.cos(psi)]) + wind
        rows.append((hour, lat, lon, *ground))
        lat += np.degrees(ground[1] * STEP_S / EARTH)
        lon += np.degrees(ground[0] * STEP_S / EARTH / np.cos(np.radians(lat)))
    hours, lats, lons, east, north = np.array(rows).T
    magnetic = heading - np.degrees(field.at(lats, lons, hours)[0])
    a, b, c = curve
    indicated = magnetic
    for _ in range(50):  # indicated - deviation(indicated) = magnetic
        waves = b * np.sin(np.radians(indicated)) + c * np.cos(np.radians(indicated))
        indicated = magnetic + a + waves
    stamp = START + (hours * 3.6e12).astype("timedelta64[ns]")
    return pd.DataFrame(
        {
            "timestamp": pd.DatetimeIndex(stamp).round("100ms"),
            "icao24": name,
            "callsign": f"{name}-{int(begin)}",
            "latitude": np.round(lats, 5),
            "longitude": np.round(lons, 5),
            "altitude": _ALTITUDE_FT[level],
            "groundspeed": 2.0 * np.rint(np.hypot(east, north) / KNOT / 2.0),
            "track": _rounded(np.degrees(np.arctan2(east, north))),
            "heading": _rounded(indicated),
            "TAS": 2.0 * np.rint(airspeed / KNOT / 2.0),
        }
    )


def _rounded(angle: Array) -> Array:
    return np.asarray(np.mod(np.rint(angle / _ANGLE_STEP) * _ANGLE_STEP, 360.0))
