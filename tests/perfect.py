"""Archives whose model wind is the true wind: the whole chain must recover the deviations.

Independent of the package: projections by PROJ strings, convergence by finite differences,
declination from ppigrf, GRIB by ecCodes. The wind is linear in grid index, ln p and time, so that
interpolation adds no error; the remaining error is that of the ground velocity from fixes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

import airswing  # noqa: F401  (pyproj before eccodes)

# isort: split
import eccodes
import numpy as np
import pandas as pd
import ppigrf
import pyproj

from tests.reference.builders import build, grid_keys

START = datetime(2009, 2, 27)
LEVELS = (600, 500, 400, 300)
STEPS = tuple(range(0, 51, 3))
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
    def rotated(self) -> bool:
        return self.crs is not None and "ob_tran" in self.crs

    def _plane(self) -> pyproj.Transformer:
        sphere = "+proj=longlat +R=6371229 +no_defs"
        earth = sphere if self.rotated else pyproj.CRS(self.crs).geodetic_crs
        return pyproj.Transformer.from_crs(earth, pyproj.CRS(self.crs), always_xy=True)

    def plane(self, lon: Any, lat: Any) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates in the units of ``step``, from the first grid point."""
        lon, lat = np.asarray(lon, float), np.asarray(lat, float)
        if self.crs is None:
            return (lon - self.first[0]) % 360.0, lat - self.first[1]
        turn = self._plane()
        x, y = (np.asarray(one) for one in turn.transform(lon, lat))
        x0, y0 = self.first if self.rotated else turn.transform(*self.first)
        return ((x - x0 + 180) % 360 - 180 if self.rotated else x - x0), y - y0

    def index(self, lon: Any, lat: Any) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.plane(lon, lat)
        return x / self.step[0], y / self.step[1]

    def position(self, i: Any, j: Any) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.asarray(i) * self.step[0], np.asarray(j) * self.step[1]
        if self.crs is None:
            return self.first[0] + x, self.first[1] + y
        turn = self._plane()
        x0, y0 = self.first if self.rotated else turn.transform(*self.first)
        return turn.transform(x + x0, y + y0, direction="INVERSE")

    def to_earth(self, u: Any, v: Any, lon: Any, lat: Any) -> tuple[np.ndarray, np.ndarray]:
        """True east and north components of a wind along the message's axes."""
        if self.crs is None or not self.along_grid:
            return u, v
        (x, y), (x2, y2) = self.plane(lon, lat), self.plane(lon, np.asarray(lat) + 1e-5)
        stretch = np.cos(np.radians(y + self.first[1])) if self.rotated else 1.0
        angle = np.arctan2((x2 - x) * stretch, y2 - y)  # of north in the plane, clockwise from +y
        return u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)

    def wind(self, i: Any, j: Any, lnp: Any, hours: Any) -> tuple[np.ndarray, np.ndarray]:
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


def write_model(
    place: Place,
    folder: Path,
    *,
    layout: str = "pairs",
    levels: Sequence[int] = LEVELS,
    pascals: bool = False,
    steps: Sequence[int] = STEPS,
    lead: int = 0,
) -> None:
    """Write one file a valid time. ``layout``: pairs, blocks, apart (u and v files) or multi."""
    folder.mkdir(parents=True, exist_ok=True)
    i, j = np.meshgrid(np.arange(place.size[0]), np.arange(place.size[1]))
    for step in steps:
        base = START + timedelta(hours=step - lead)
        when = int(base.strftime("%Y%m%d")), base.hour * 100
        options: Any = {"edition": place.edition, "when": when, "step": lead, "bits": 20}
        pairs = []
        for level in levels:
            both = place.wind(i, j, np.log(level * 100.0), step)
            if pascals:
                options["extra"] = {"typeOfLevel": "isobaricInPa", "level": level * 100}
            pairs.append(
                [
                    build(place.keys, part.ravel(), parameter=name, level=level, **options)
                    for name, part in zip("uv", both, strict=True)
                ]
            )
        us, vs = (b"".join(column) for column in zip(*pairs, strict=True))
        if layout == "multi":
            with open(folder / f"m{step:03d}.grib2", "wb") as sink:
                for pair in pairs:
                    _write_multi(pair, sink)
        elif layout == "apart":
            (folder / f"u{step:03d}.grb").write_bytes(us)
            (folder / f"v{step:03d}.grb").write_bytes(vs)
        elif layout == "blocks":
            (folder / f"b{step:03d}.grb").write_bytes(vs + us)
        else:
            (folder / f"p{step:03d}.grb").write_bytes(b"".join(b"".join(p) for p in pairs))


def _write_multi(pair: Sequence[bytes], sink: BinaryIO) -> None:
    """Both messages as one, the second from its section 4 on."""
    handles = [eccodes.codes_new_from_message(one) for one in pair]
    multi = eccodes.codes_grib_multi_new()
    eccodes.codes_grib_multi_append(handles[0], 0, multi)
    eccodes.codes_grib_multi_append(handles[1], 4, multi)
    eccodes.codes_grib_multi_write(multi, sink)
    eccodes.codes_grib_multi_release(multi)
    for handle in handles:
        eccodes.codes_release(handle)


def pressure_of(feet: np.ndarray) -> np.ndarray:
    """ICAO troposphere, Pa."""
    return 101325.0 * (1 - 0.0065 * feet * 0.3048 / 288.15) ** 5.255876


def fly(
    place: Place,
    *,
    deviations: dict[str, tuple[float, float, float]] = DEVIATIONS,
    flights: int = 26,
    reports: int = 12,
    seconds: int = 180,
    seed: int = 1,
) -> pd.DataFrame:
    """Reports of aircraft with known deviation that fly straight through the model's wind.

    B and C are those at the mean horizontal field of the aircraft's reports, since the deviation by
    iron is inversely proportional to the field.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for tail, deviation in deviations.items():
        flown = [
            _leg(place, rng, flight, flights=flights, reports=reports, seconds=seconds)
            for flight in range(flights)
        ]
        _put_field(flown)
        mean = np.mean([leg["horizontal"] for leg in flown])
        for flight, leg in enumerate(flown):
            u_reported, v_reported = _reported_wind(leg, deviation, mean)
            for k in range(reports):
                rows.append(
                    {
                        "tail": tail,
                        "time": leg["begin"] + timedelta(seconds=seconds * k),
                        "latitude": leg["lat"][k],
                        "longitude": leg["lon"][k],
                        "pressure_altitude_ft": leg["feet"][k],
                        "wind_direction_deg": np.degrees(np.arctan2(-u_reported[k], -v_reported[k]))
                        % 360,
                        "wind_speed_kt": np.hypot(u_reported[k], v_reported[k]) / KNOT,
                        "phase": "cruise",
                        "flight": f"{tail}-{flight}",
                    }
                )
    return pd.DataFrame(rows)


def _leg(
    place: Place, rng: np.random.Generator, flight: int, *, flights: int, reports: int, seconds: int
) -> dict[str, Any]:
    """One straight flight: where it goes and its air vector."""
    i, j = (rng.uniform(0.35, 0.65) * (n - 1) for n in place.size)
    if place.periodic:
        i = rng.uniform(-2, 2)
    lon0, lat0 = (float(x) for x in place.position(i, j))
    azimuth, speed = rng.uniform(0, 360), rng.uniform(110, 150)
    begin = START + timedelta(seconds=round((flight + rng.uniform(0, 0.5)) * 47 * 3600 / flights))
    distance = speed * seconds * np.arange(reports)
    lon, lat, back = GEOD.fwd(
        np.full(reports, lon0), np.full(reports, lat0), np.full(reports, azimuth), distance
    )
    track = np.radians(np.asarray(back) + 180.0)
    feet = np.full(reports, rng.uniform(15500, 28500).__round__(-1))
    hours = (begin - START).total_seconds() / 3600 + seconds * np.arange(reports) / 3600
    wind = place.wind(*place.index(lon, lat), np.log(pressure_of(feet)), hours)
    u, v = place.to_earth(*wind, lon, lat)
    ground = speed * np.sin(track), speed * np.cos(track)
    return {
        "begin": begin,
        "lon": lon,
        "lat": lat,
        "feet": feet,
        "ground": ground,
        "air": (ground[0] - u, ground[1] - v),
    }


def _put_field(legs: list[dict[str, Any]]) -> None:
    """The geomagnetic field along all flights; in two days it turns by under 0.001 degrees."""
    # One call, since ppigrf reads its coefficients at every call.
    lon, lat, feet = (np.array([leg[name] for leg in legs]) for name in ("lon", "lat", "feet"))
    east, north, _ = ppigrf.igrf(lon, lat, feet * 0.3048e-3, START)
    for leg, e, n in zip(legs, east[0], north[0], strict=True):
        leg["declination"], leg["horizontal"] = np.arctan2(e, n), np.hypot(e, n)


def _reported_wind(
    leg: dict[str, Any], deviation: tuple[float, float, float], mean: float
) -> tuple[np.ndarray, np.ndarray]:
    """Wind that the unit computes with its deviated heading."""
    a, b, c = deviation
    airspeed, true_heading = np.hypot(*leg["air"]), np.arctan2(*leg["air"])
    gain, shown = mean / leg["horizontal"], true_heading.copy()
    for _ in range(60):
        m = shown - leg["declination"]
        shown = true_heading + np.radians(a + gain * (b * np.sin(m) + c * np.cos(m)))
    return (
        leg["ground"][0] - airspeed * np.sin(shown),
        leg["ground"][1] - airspeed * np.cos(shown),
    )


def write_reports(table: pd.DataFrame, path: Path, **options: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    ready = table.copy()
    if "time" in ready and ready["time"].dtype.kind == "M":
        ready["time"] = ready["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ")
    ready.to_csv(path, index=False, **options)
    return path


_SPHERE = {1: "+R=6367470 +no_defs", 2: "+R=6371229 +no_defs"}


def _degrees(
    name: str,
    first: tuple[float, float],
    size: tuple[int, int],
    step: tuple[float, float],
    **more: Any,
) -> Place:
    last = first[0] + step[0] * (size[0] - 1), first[1] + step[1] * (size[1] - 1)
    north = int(step[1] > 0)
    keys = grid_keys("regular_ll", size, first, last, jScansPositively=north, uvRelativeToGrid=0)
    return Place(name, keys, size, step, first, along_grid=False, **more)


def _lambert(
    name: str,
    first: tuple[float, float],
    lov: float,
    latins: tuple[float, float],
    *,
    size: tuple[int, int] = (33, 29),
    metres: int = 90000,
    edition: int = 2,
    along: bool = True,
) -> Place:
    keys = grid_keys(
        "lambert",
        size,
        first,
        LoVInDegrees=lov % 360,
        Latin1InDegrees=latins[0],
        Latin2InDegrees=latins[1],
        DxInMetres=metres,
        DyInMetres=metres,
        projectionCentreFlag=128 * (latins[0] < 0),
        uvRelativeToGrid=int(along),
    )
    if edition == 2:
        keys |= {"LaDInDegrees": latins[0], "shapeOfTheEarth": 6}
    crs = f"+proj=lcc +lat_1={latins[0]} +lat_2={latins[1]} +lat_0={latins[0]} +lon_0={lov} "
    step = (metres, metres)
    return Place(name, keys, size, step, first, crs + _SPHERE[edition], edition, along_grid=along)


def _polar(
    name: str, first: tuple[float, float], lov: float, *, south: bool = False, edition: int = 2
) -> Place:
    size, metres, sign = (31, 27), 100000, -1 if south else 1
    keys = grid_keys(
        "polar_stereographic",
        size,
        first,
        orientationOfTheGridInDegrees=lov % 360,
        DxInMetres=metres,
        DyInMetres=metres,
        projectionCentreFlag=128 * south,
        resolutionAndComponentFlags=8,
    )
    if edition == 2:
        keys |= {"LaDInDegrees": 60.0 * sign, "shapeOfTheEarth": 6}
    crs = f"+proj=stere +lat_0={90 * sign} +lat_ts={60 * sign} +lon_0={lov} {_SPHERE[edition]}"
    return Place(name, keys, size, (metres, metres), first, crs, edition)


def _mercator(
    name: str,
    first: tuple[float, float],
    last: tuple[float, float],
    true: float,
    *,
    edition: int = 2,
) -> Place:
    size, metres = (29, 25), 110000
    keys = grid_keys(
        "mercator",
        size,
        first,
        last,
        DiInMetres=metres,
        DjInMetres=metres,
        LaDInDegrees=true,
        uvRelativeToGrid=1,
    )
    if edition == 2:
        keys["shapeOfTheEarth"] = 6
    crs = f"+proj=merc +lat_ts={abs(true)} +lon_0={first[0] + 15.0} {_SPHERE[edition]}"
    return Place(name, keys, size, (metres, metres), first, crs, edition)


def _rotated(
    name: str, corner: tuple[float, float], pole: tuple[float, float], *, edition: int = 2
) -> Place:
    """Corner in rotated degrees; pole is the southern pole's (longitude, latitude)."""
    size, step = (31, 27), (1.0, 1.0)
    last = corner[0] + size[0] - 1, corner[1] + size[1] - 1
    keys = grid_keys(
        "rotated_ll",
        size,
        corner,
        last,
        latitudeOfSouthernPoleInDegrees=pole[1],
        longitudeOfSouthernPoleInDegrees=pole[0] % 360,
        angleOfRotationInDegrees=0.0,
        uvRelativeToGrid=1,
    )
    sphere = "+R=6371229 +no_defs"
    turned = f"+proj=ob_tran +o_proj=longlat +o_lon_p=0 +o_lat_p={-pole[1]} +lon_0={pole[0]} "
    return Place(name, keys, size, step, corner, turned + sphere, edition)


PLACES = {
    place.name: place
    for place in (
        _lambert(
            "ruc_grib1",
            (233.862, 16.281),
            265.0,
            (25.0, 25.0),
            metres=162546,
            edition=1,
            size=(37, 28),
        ),
        _lambert("ruc_grib2_earth_relative", (240.0, 22.5), 265.0, (25.0, 25.0), along=False),
        _lambert("australia_lambert_secant", (130.0, -45.0), 145.0, (-20.0, -45.0)),
        _lambert("alaska_lambert_across_180", (165.0, 42.0), 190.0, (50.0, 65.0)),
        _degrees("fiji_0_360", (165.0, -30.0), (31, 25), (1.0, 1.0)),
        _degrees("alaska_minus180", (-200.0, 50.0), (41, 23), (1.0, 1.0)),
        _degrees("greenwich_global", (0.0, 30.0), (180, 31), (2.0, 1.0), periodic=True),
        _rotated("europe_rotated", (-15.0, -13.0), (10.0, -40.0)),
        _polar("canada_polar", (235.0, 40.0), 255.0),
        _polar("southern_polar", (20.0, -60.0), 0.0, south=True),
        _mercator("fiji_mercator_across_180", (165.0, -32.0), (195.0, -8.0), -20.0),
    )
}
