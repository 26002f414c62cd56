"""Near-surface forecasts at stations, from GRIB: temperature at 2 m, wind at 10 m.

Assumes instantaneous fields at a height above ground, on the grids that
:mod:`airswing.reference.grids` places. Interpolation is that of the collocation: bilinear
in the grid's index space along the grid, winds turned to true east and north at the station;
nothing is extrapolated, and a missing corner that has weight gives no value. The difference between
the heights of the model's ground and the station is not corrected: the filter finds its effect as a
systematic error. SI units.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.handover.forecasts.correcting import TIME
from airswing.reference.grib.decoding import KeyValue, UnreadableMessageError
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import GarbageError, Window, single_fields, whole_messages
from airswing.reference.grib.values import decode_guarded, read_keys
from airswing.reference.grids import Grid, UnplaceableGridError
from airswing.reference.winds import bilinear, corners

Floats = NDArray[np.float64]
_WANTED = {("2t", 2): "air_temperature", ("10u", 10): "u", ("10v", 10): "v"}
# Category and number of temperature, u and v in discipline 0 of GRIB2.
_NUMBERS = {(0, 0), (2, 2), (2, 3)}
_HEADER = ["shortName", "level", "stepType", "dataDate", "dataTime", "validityDate", "validityTime"]
_POSSIBLE = {"air_temperature": (150.0, 350.0), "u": (-150.0, 150.0), "v": (-150.0, 150.0)}
UNITS = {
    "air_temperature": "K",
    "eastward_wind": "m s-1",
    "northward_wind": "m s-1",
    "wind_speed": "m s-1",
}


class _Field(NamedTuple):
    """One field at the stations, along its grid."""

    name: str
    start: int
    lead: float
    grid: Grid
    values: Floats


def forecasts_at_stations(
    files: Sequence[Path], stations: pd.DataFrame
) -> tuple[pd.DataFrame, dict[str, int]]:
    """Read the forecasts of every file at the stations.

    Parameters
    ----------
    files : sequence of Path
        GRIB, edition 1 or 2.
    stations : DataFrame
        ``station, latitude, longitude`` (degrees), one line a station.

    Returns
    -------
    DataFrame
        ``variable, station, forecast_reference_time, lead`` (h), ``forecast``; variables are
        ``air_temperature``, ``eastward_wind``, ``northward_wind`` and ``wind_speed``.
    dict of str to int
        What was left out, by reason.

    Raises
    ------
    InputError
        If no file holds such a field.
    """
    skipped: Counter[tuple[str, str]] = Counter()
    latitude, longitude = (stations[name].to_numpy(float) for name in ("latitude", "longitude"))
    found: dict[tuple[int, float, str], _Field] = {}
    for file in files:
        for field in _fields_of(str(file), latitude, longitude, skipped):
            found[field.start, field.lead, field.name] = field
    parts = [
        (name, start, lead, values)
        for start, lead in sorted({key[:2] for key in found})
        for name, values in _variables(found, start, lead, latitude, longitude).items()
    ]
    if not parts:
        raise InputError(
            "no temperature at 2 m and no wind at 10 m in the forecasts",
            file=files[0],
            field="postprocess.forecasts.files",
            found="; ".join(sorted({why for _, why in skipped})) or f"{len(files)} files",
        )
    size = stations.shape[0]
    table = pd.DataFrame(
        {
            "variable": np.repeat([name for name, *_ in parts], size),
            "station": pd.Series(np.tile(stations["station"].to_numpy(), len(parts))).astype(str),
            TIME: np.repeat(np.array([start for _, start, *_ in parts], "datetime64[ns]"), size),
            "lead": np.repeat([lead for *_, lead, _ in parts], size),
            "forecast": np.concatenate([values for *_, values in parts]),
        }
    )
    return table, {f"{what}: {why}": n for (what, why), n in skipped.items()}


def _variables(
    found: dict[tuple[int, float, str], _Field],
    start: int,
    lead: float,
    latitude: Floats,
    longitude: Floats,
) -> dict[str, Floats]:
    """Variables of one start and lead, true east and north."""
    temperature, u, v = (found.get((start, lead, name)) for name in _WANTED.values())
    variables = {} if temperature is None else {"air_temperature": temperature.values}
    if u is not None and v is not None and u.grid == v.grid:
        angle = np.zeros_like(latitude)
        if u.grid.wind_along_grid:
            angle = u.grid.convergence(latitude, longitude)
        cosine, sine = np.cos(angle), np.sin(angle)
        variables["eastward_wind"] = cosine * u.values + sine * v.values
        variables["northward_wind"] = -sine * u.values + cosine * v.values
        variables["wind_speed"] = np.hypot(u.values, v.values)
    return variables


def _fields_of(
    path: str, latitude: Floats, longitude: Floats, skipped: Counter[tuple[str, str]]
) -> Iterator[_Field]:
    """Fields of one file at the stations; what cannot be read is counted."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError as err:
        skipped["file", f"cannot be opened ({err.strerror})"] += 1
        return
    try:
        for start, edition, length in whole_messages(Window(descriptor), skipped):
            message = os.pread(descriptor, length, start)
            try:
                for single, sections in single_fields(message, edition):
                    if _may_be_wanted(sections, edition):
                        section = sections[2 if edition == 1 else 3]
                        yield from _field(single, edition, section, latitude, longitude, skipped)
            except (GarbageError, IndexError):
                skipped["message", "garbage: section lengths do not add up"] += 1
    finally:
        os.close(descriptor)


def _may_be_wanted(sections: dict[int, bytes], edition: int) -> bool:
    """Whether a field stands at a height above ground on a grid of its own."""
    if edition == 1:
        # Octet 10 of section 1: 105 is a height above ground (GRIB1 table 3).
        return 2 in sections and sections[1][9] == 105
    product = sections[4]
    # Octets 10, 11 and 23 of section 4: category, number, and 103 for a height above ground
    # (GRIB2 code table 4.5).
    return (product[9], product[10]) in _NUMBERS and product[22] == 103


def _field(
    message: bytes,
    edition: int,
    section: bytes,
    latitude: Floats,
    longitude: Floats,
    skipped: Counter[tuple[str, str]],
) -> Iterator[_Field]:
    """A field at the stations; what cannot be read is counted."""
    try:
        field = _at_stations(message, edition, section, latitude, longitude)
    except UnplaceableGridError as err:
        skipped["grid", str(err)] += 1
    except (UnreadableMessageError, ValueError, ArithmeticError) as err:
        skipped["message", str(err)] += 1
    else:
        if field is not None:
            yield field


def _at_stations(
    message: bytes, edition: int, section: bytes, latitude: Floats, longitude: Floats
) -> _Field | None:
    """One field at the stations; None where it is another variable or no value at a time."""
    keys = read_keys(message, _HEADER)
    name = _WANTED.get((str(keys.get("shortName")), _whole(keys, "level")))
    if name is None or keys.get("stepType") != "instant":
        return None
    start, valid = (_stamp(keys, kind) for kind in ("data", "validity"))
    grid = read_grid(edition, section)
    values = decode_guarded([(message, grid.size, None)])[0]
    if isinstance(values, str):
        raise UnreadableMessageError(values)
    least, most = _POSSIBLE[name]
    if not ((values >= least) & (values <= most) | np.isnan(values)).all():
        raise UnreadableMessageError(f"{name} that no atmosphere has")
    lead = (valid - start) / np.timedelta64(1, "h")
    at = _interpolated(grid, values, latitude, longitude)
    return _Field(name, int(start.astype(np.int64)), float(lead), grid, at)


def _whole(keys: Mapping[str, KeyValue], name: str) -> int:
    found = keys.get(name)
    return found if isinstance(found, int) else -1


def _stamp(keys: Mapping[str, KeyValue], kind: str) -> np.datetime64:
    """A time of the header within the years that ns can count."""
    date, clock = (_whole(keys, kind + part) for part in ("Date", "Time"))
    # ns since 1970 end in 2262
    if not 19000101 <= date < 22000101:
        raise UnreadableMessageError("damaged: impossible reference time")
    stamp = f"{date // 10000:04d}-{date // 100 % 100:02d}-{date % 100:02d}"
    return np.datetime64(f"{stamp}T{clock // 100:02d}:{clock % 100:02d}", "ns")


def _interpolated(grid: Grid, values: Floats, latitude: Floats, longitude: Floats) -> Floats:
    """Values at the stations, NaN outside the grid."""
    found = np.full(latitude.size, np.nan)
    fi, fj = grid.fractional_index(latitude, longitude)
    inside = np.flatnonzero(np.isfinite(fi) & np.isfinite(fj))
    if inside.size:
        cell = corners(grid, fi[inside], fj[inside])
        found[inside] = bilinear(values[cell.points], cell.x, cell.y)
    return found
