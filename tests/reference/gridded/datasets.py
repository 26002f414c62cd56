"""Datasets that look like those people have, and winds at points worked out another way."""

from functools import cache

import numpy as np
import xarray as xr
from pyproj import CRS, Proj

from tests.ragged import ragged

START = np.datetime64("2022-11-11T00:00", "ns")
HOUR = np.timedelta64(3600, "s").astype("m8[ns]")
LEVELS = np.array([200.0, 300.0, 500.0, 700.0, 850.0, 1000.0])  # hPa
MAPPINGS = {
    "lambert": {
        "grid_mapping_name": "lambert_conformal_conic",
        "standard_parallel": [30.0, 60.0],
        "longitude_of_central_meridian": -97.5,
        "latitude_of_projection_origin": 38.5,
        "earth_radius": 6371229.0,
        "false_easting": 100000.0,
    },
    "tangent": {
        "grid_mapping_name": "lambert_conformal_conic",
        "standard_parallel": 25.0,
        "longitude_of_central_meridian": -95.0,
        "latitude_of_projection_origin": 25.0,
        "earth_radius": 6371200.0,
    },
    "polar": {
        "grid_mapping_name": "polar_stereographic",
        "standard_parallel": 60.0,
        "straight_vertical_longitude_from_pole": -105.0,
        "latitude_of_projection_origin": 90.0,
        "earth_radius": 6371229.0,
    },
    "mercator": {
        "grid_mapping_name": "mercator",
        "standard_parallel": 20.0,
        "longitude_of_projection_origin": -100.0,
        "earth_radius": 6371229.0,
    },
    "rotated": {
        "grid_mapping_name": "rotated_latitude_longitude",
        "grid_north_pole_latitude": 39.25,
        "grid_north_pole_longitude": -162.0,
        "north_pole_grid_longitude": 0.0,
    },
}


def fields(shape, seed=3):
    """Rough winds: a wrong neighbour shows."""
    rng = np.random.default_rng(seed)
    u, v = rng.normal(10.0, 15.0, (2, *shape))
    return u.astype("f4"), v.astype("f4")


@cache  # PROJ looks an unnamed datum up among all for each: a tenth of a second
def crs_of(kind):
    return CRS.from_cf(MAPPINGS[kind])


def axes_of(kind):
    """x and y (m, or degrees of a rotated frame) of a grid over North America."""
    if kind == "rotated":
        return np.arange(-12.0, 12.01, 0.75), np.arange(-9.0, 9.01, 0.75)
    proj = Proj(crs_of(kind))
    x, y = proj(-97.5 if kind != "polar" else -105.0, 40.0)
    steps = np.arange(-15, 16) * 60000.0
    return x + steps, y + steps


def projected(kind, *, units="m"):
    """Winds along a projected grid on pressure levels, as CF has them."""
    x, y = axes_of(kind)
    u, v = fields((2, LEVELS.size, y.size, x.size))
    dims = ("time", "plev", "y", "x")
    standard = "projection_x_coordinate", "projection_y_coordinate"
    if kind == "rotated":
        standard, units = ("grid_longitude", "grid_latitude"), "degrees"
    scale = {"m": 1.0, "km": 1e-3, "degrees": 1.0}[units]
    wind = {"units": "m s-1", "grid_mapping": "crs"}
    return xr.Dataset(
        {
            "ua": (dims, u, wind | {"standard_name": "x_wind", "long_name": "Zonal wind"}),
            "va": (dims, v, wind | {"standard_name": "y_wind", "long_name": "Meridional wind"}),
            "crs": ((), 0, MAPPINGS[kind]),
        },
        coords={
            "time": START + HOUR * np.arange(2),
            "plev": ("plev", LEVELS * 100.0, {"units": "Pa", "standard_name": "air_pressure"}),
            "y": ("y", y * scale, {"units": units, "standard_name": standard[1]}),
            "x": ("x", x * scale, {"units": units, "standard_name": standard[0]}),
        },
    )


def latlon(*, latitude, longitude, hours=2, seed=3):
    """ERA5 as the Climate Data Store gave it until 2024."""
    u, v = fields((hours, LEVELS.size, latitude.size, longitude.size), seed)
    dims = ("time", "level", "latitude", "longitude")
    wind = {"units": "m s**-1"}
    return xr.Dataset(
        {
            "u": (dims, u, wind | {"standard_name": "eastward_wind"}),
            "v": (dims, v, wind | {"standard_name": "northward_wind"}),
        },
        coords={
            "time": START + HOUR * np.arange(hours),
            "level": ("level", LEVELS.astype("i4"), {"units": "millibars"}),
            "latitude": ("latitude", latitude.astype("f4"), {"units": "degrees_north"}),
            "longitude": ("longitude", longitude.astype("f4"), {"units": "degrees_east"}),
        },
    )


def points(lat, lon, pressure, *, after=0.0, start=START):
    """Reports, `after` hours after a first time."""
    columns = np.broadcast_arrays(lat, lon, pressure, np.atleast_1d(after))
    names = ("latitude", "longitude", "pressure", "after")
    values = {name: column.astype(float) for name, column in zip(names, columns, strict=True)}
    after = np.round(values.pop("after") * 3600e9).astype("timedelta64[ns]")
    return ragged(values | {"time": start.astype("M8[ns]") + after})


def by_hand(u, v, levels, fi, fj, pressure):
    """Report by report: ln p in each of four columns, then across them; fields (level, y, x).

    `levels` (Pa) by level, or by level, y and x; columns wrap round.
    """
    result = np.full((2, fi.size), np.nan)
    for n, (i, j, p) in enumerate(zip(fi, fj, pressure, strict=True)):
        i0, j0 = int(np.floor(i)), min(int(np.floor(j)), u.shape[1] - 2)
        total = np.zeros(2)
        for dj, di in ((0, 0), (0, 1), (1, 0), (1, 1)):
            weight = (1 - abs(i - i0 - di)) * (1 - abs(j - j0 - dj))
            if weight < 1e-12:
                continue
            row, column = j0 + dj, (i0 + di) % u.shape[2]
            p_here = levels if levels.ndim == 1 else levels[:, row, column]
            order, outside = np.argsort(p_here), {"left": np.nan, "right": np.nan}
            for c, component in enumerate((u, v)):
                values = component[order, row, column]
                total[c] += weight * np.interp(np.log(p), np.log(p_here[order]), values, **outside)
        result[:, n] = total
    return result[0], result[1]


def turned(u, v, angle):
    """Components along a grid whose north lies an angle (rad) clockwise of true north."""
    return u * np.cos(angle) + v * np.sin(angle), -u * np.sin(angle) + v * np.cos(angle)


def winds(collocated, reference=0):
    """u and v of a collocation."""
    collocated = collocated.compute()
    return (
        collocated["reference_eastward_wind"].values[reference],
        collocated["reference_northward_wind"].values[reference],
    )
