"""Archives whose model wind is the true wind: the whole chain must recover the deviations.

Independent of the package: projections by PROJ strings, convergence by finite differences,
declination from ppigrf, GRIB by ecCodes. The wind is linear in grid index, ln p and time, so that
interpolation adds no error; the remaining error is that of the ground velocity from fixes.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from typing import Any

import airswing  # noqa: F401  (pyproj before eccodes)

# isort: split
import eccodes
import numpy as np
import pandas as pd
import ppigrf
import pyproj

from tests.reference.builders import PARALLELS, build, grid_keys

START = datetime(2009, 2, 27)
LEVELS = (600, 500, 400, 300)
DEVIATIONS = {"S1": (1.5, 4.0, -2.0), "S2": (-2.0, -3.0, 3.5), "S3": (0.5, 0.0, 6.0)}
"""A, B, C in degrees of the three aircraft."""
KNOT = 1852 / 3600
GEOD = pyproj.Geod(ellps="WGS84")


@dataclass(frozen=True)
class Place:
    """A model grid: its keys of ecCodes, and its projection."""

    name: str
    keys: dict[str, Any]
    size: tuple[int, int]
    step: tuple[float, float]
    first: tuple[float, float]  # longitude, latitude of the first point
    crs: str | None = None
    edition: int = 2
    periodic: bool = False
    along_grid: bool = True

    @property
    def rotated(self):
        return self.crs is not None and "ob_tran" in self.crs

    @cached_property
    def _projection(self):
        sphere = "+proj=longlat +R=6371229 +no_defs"
        earth = sphere if self.rotated else pyproj.CRS(self.crs).geodetic_crs
        return pyproj.Transformer.from_crs(earth, pyproj.CRS(self.crs), always_xy=True)

    @cached_property
    def _origin(self):
        geographic = self.crs is None or self.rotated
        return self.first if geographic else self._projection.transform(*self.first)

    def plane(self, lon, lat):
        """Coordinates in the units of ``step``, from the first grid point."""
        lon, lat = np.asarray(lon, float), np.asarray(lat, float)
        if self.crs is None:
            return (lon - self.first[0]) % 360.0, lat - self.first[1]
        x, y = np.array(self._projection.transform(lon, lat))
        x, y = x - self._origin[0], y - self._origin[1]
        return ((x + 180) % 360 - 180 if self.rotated else x), y

    def index(self, lon, lat):
        x, y = self.plane(lon, lat)
        return x / self.step[0], y / self.step[1]

    def position(self, i, j):
        x = self._origin[0] + np.asarray(i) * self.step[0]
        y = self._origin[1] + np.asarray(j) * self.step[1]
        return (x, y) if self.crs is None else self._projection.transform(x, y, direction="INVERSE")

    def to_earth(self, u, v, lon, lat):
        """True east and north components of a wind along the message's axes."""
        if self.crs is None or not self.along_grid:
            return u, v
        (x, y), (x2, y2) = self.plane(lon, lat), self.plane(lon, np.asarray(lat) + 1e-5)
        stretch = np.cos(np.radians(y + self.first[1])) if self.rotated else 1.0
        angle = np.arctan2((x2 - x) * stretch, y2 - y)  # of north in the plane, clockwise from +y
        return u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)

    def wind(self, i, j, lnp, hours):
        """Components as in the messages."""
        x, y = np.asarray(i) / self.size[0] - 0.5, np.asarray(j) / self.size[1] - 0.5
        if self.periodic:  # linear between grid points, and the last joins the first
            knots = np.arange(self.size[0] + 1)
            wave = 0.3 * np.sin(2 * np.pi * knots / self.size[0] * 3)
            x = np.interp(np.asarray(i) % self.size[0], knots, wave)
        z, t = np.asarray(lnp) - np.log(45000.0), np.asarray(hours) / 48 - 0.5
        u = 14 + 16 * x - 9 * y - 8 * z + 6 * t + 5 * x * y
        v = -6 + 11 * x + 14 * y + 5 * z - 8 * t
        return u, v


def write_model(place, folder, *, layout="pairs", levels=LEVELS, pascals=False, lead=0):
    """Write one file a valid time. ``layout``: pairs, blocks, apart (u and v files) or multi."""
    folder.mkdir(parents=True, exist_ok=True)
    i, j = np.meshgrid(np.arange(place.size[0]), np.arange(place.size[1]))
    for step in range(0, 51, 3):
        base = START + timedelta(hours=step - lead)
        when = int(base.strftime("%Y%m%d")), base.hour * 100
        options = {"edition": place.edition, "when": when, "step": lead, "bits": 20}
        us, vs = [], []
        for level in levels:
            if pascals:
                options["extra"] = {"typeOfLevel": "isobaricInPa", "level": level * 100}
            winds = place.wind(i, j, np.log(level * 100.0), step)
            for name, wind, messages in zip("uv", winds, (us, vs), strict=True):
                message = build(place.keys, wind.ravel(), parameter=name, level=level, **options)
                messages.append(message)
        pairs = list(zip(us, vs, strict=True))
        files = {
            "apart": {"u": us, "v": vs},
            "blocks": {"b": vs + us},
            "pairs": {"p": [message for pair in pairs for message in pair]},
            "multi": {"m": [_multi(pair) for pair in pairs]},
        }
        for letter, messages in files[layout].items():
            (folder / f"{letter}{step:03d}.grb").write_bytes(b"".join(messages))


def _multi(pair):
    """Both messages as one, the second from its section 4 on."""
    handles = [eccodes.codes_new_from_message(message) for message in pair]
    multi = eccodes.codes_grib_multi_new()
    for handle, section in zip(handles, (0, 4), strict=True):
        eccodes.codes_grib_multi_append(handle, section, multi)
        eccodes.codes_release(handle)
    with tempfile.TemporaryFile() as sink:
        eccodes.codes_grib_multi_write(multi, sink)
        eccodes.codes_grib_multi_release(multi)
        sink.seek(0)
        return sink.read()


def pressure_of(feet):
    """ICAO troposphere, Pa."""
    return 101325.0 * (1 - 0.0065 * feet * 0.3048 / 288.15) ** 5.255876


def fly(place, *, flights=26, reports=12, seconds=180):
    """Reports of aircraft with `DEVIATIONS` that fly straight through the model's wind.

    B and C are those at the mean horizontal field of the aircraft's reports, since the deviation by
    iron is inversely proportional to the field.
    """
    rng = np.random.default_rng(1)
    shape = len(DEVIATIONS), flights, 1
    every = np.zeros((len(DEVIATIONS), flights, reports))
    i, j = (rng.uniform(0.35, 0.65, shape) * (n - 1) for n in place.size)
    if place.periodic:
        i = rng.uniform(-2, 2, shape)
    azimuth, speed = rng.uniform(0, 360, shape), rng.uniform(110, 150, shape)
    feet = rng.uniform(15500, 28500, shape).round(-1) + every
    begin = (np.arange(flights)[:, None] + rng.uniform(0, 0.5, shape)) * 47 * 3600 / flights
    elapsed = begin.round() + seconds * np.arange(reports)
    ahead = speed * seconds * np.arange(reports)
    start = (np.asarray(column) + every for column in place.position(i, j))
    lon, lat, back = (np.asarray(column) for column in GEOD.fwd(*start, azimuth + every, ahead))
    wind = place.wind(*place.index(lon, lat), np.log(pressure_of(feet)), elapsed / 3600)
    track, (u, v) = np.radians(back + 180.0), place.to_earth(*wind, lon, lat)
    ground = speed * np.sin(track), speed * np.cos(track)
    airspeed, true = (f(ground[0] - u, ground[1] - v) for f in (np.hypot, np.arctan2))
    # In two days the geomagnetic field turns by under 0.001 degrees.
    east, north, _ = (column[0] for column in ppigrf.igrf(lon, lat, feet * 0.3048e-3, START))
    declination, horizontal = np.arctan2(east, north), np.hypot(east, north)
    a, b, c = np.array(list(DEVIATIONS.values())).T[..., None, None]
    gain, shown = horizontal.mean(axis=(1, 2), keepdims=True) / horizontal, true
    for _ in range(60):
        m = shown - declination
        shown = true + np.radians(a + gain * (b * np.sin(m) + c * np.cos(m)))
    u, v = ground[0] - airspeed * np.sin(shown), ground[1] - airspeed * np.cos(shown)
    columns = {
        "latitude": lat,
        "longitude": lon,
        "pressure_altitude_ft": feet,
        "wind_direction_deg": np.degrees(np.arctan2(-u, -v)) % 360,
        "wind_speed_kt": np.hypot(u, v) / KNOT,
    }
    names = [f"{tail}-{flight}" for tail in DEVIATIONS for flight in range(flights)]
    return pd.DataFrame(
        {
            "tail": np.repeat(list(DEVIATIONS), flights * reports),
            "time": START + pd.to_timedelta(elapsed.ravel(), unit="s"),
            **{name: values.ravel() for name, values in columns.items()},
            "phase": "cruise",
            "flight": np.repeat(names, reports),
        }
    )


def write_reports(table, path, **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    ready = table.copy()
    if "time" in ready and ready["time"].dtype.kind == "M":
        ready["time"] = ready["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    ready.to_csv(path, index=False, **options)
    return path


def _degrees(name, first, size, step, **more):
    last = first[0] + step[0] * (size[0] - 1), first[1] + step[1] * (size[1] - 1)
    keys = grid_keys("regular_ll", size, first, last, uvRelativeToGrid=0)
    return Place(name, keys, size, step, first, along_grid=False, **more)


def _turned(name, kind, crs, size, first, step, *, last=None, edition=2, **keys):
    """Grid of equal steps along which the components of the wind point."""
    keys = grid_keys(kind, size, first, last, **keys, uvRelativeToGrid=1)
    radius = {1: 6367470, 2: 6371229}[edition]
    crs = f"+proj={crs} +R={radius} +no_defs"
    return Place(name, keys, size, (step, step), first, crs, edition)


RUC = "lcc +lat_1=25 +lat_2=25 +lat_0=25 +lon_0=265"
STEPS = dict.fromkeys(("DxInMetres", "DyInMetres"), 162546)
POLE = {"latitudeOfSouthernPoleInDegrees": -40.0, "longitudeOfSouthernPoleInDegrees": 10.0}
TURNED = "ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p=40.0 +lon_0=10.0"
FIJI = dict.fromkeys(("DiInMetres", "DjInMetres"), 110000) | {"LaDInDegrees": -20.0}
FIJI |= {"shapeOfTheEarth": 6, "last": (195.0, -8.0)}
PLACES = {
    place.name: place
    for place in (
        _turned(
            *("ruc_grib1", "lambert", RUC, (37, 28), (233.862, 16.281), 162546),
            **(STEPS | PARALLELS | {"edition": 1}),
        ),
        _degrees("alaska_minus180", (-200.0, 50.0), (41, 23), (1.0, 1.0)),
        _degrees("greenwich_global", (0.0, 30.0), (180, 31), (2.0, 1.0), periodic=True),
        _turned(
            *("europe_rotated", "rotated_ll", TURNED, (31, 27), (-15.0, -13.0), 1.0),
            **(POLE | {"angleOfRotationInDegrees": 0.0, "last": (15.0, 13.0)}),
        ),
        _turned(
            *("fiji_mercator_across_180", "mercator", "merc +lat_ts=20 +lon_0=180"),
            *((29, 25), (165.0, -32.0), 110000),
            **FIJI,
        ),
    )
}
