"""Near-surface forecasts at stations from GRIB, paired with observations.

Instantaneous fields of temperature at 2 m and wind at 10 m. Interpolation is bilinear in the grid's
index space, winds are rotated to true east and north; nothing is extrapolated. The difference
between the heights of the model's ground and the station is not corrected: it contributes to the
estimated bias. A forecast is paired with the observation nearest in time within a gap. SI units.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.handover.forecasts.correcting import TIME
from airswing.handover.forecasts.forecast_pairs import (
    PLACES,
    STATION,
    VALID,
    column,
    numbers,
    on_axes,
    places,
    read_table,
    times,
)
from airswing.physics.triangle import wind_components
from airswing.reference.grib.grid_sections import read_grid
from airswing.reference.grib.headers import LENGTHS, GarbageError, single_fields, whole_messages
from airswing.reference.grib.values import (
    KeyValue,
    UnreadableMessageError,
    decode_guarded,
    read_keys,
)
from airswing.reference.grids import Grid, UnplaceableGridError
from airswing.reference.state import grib_statistic
from airswing.reference.winds import bilinear, corners, rotated
from airswing.reports.columns import LIMITS, conversion, split_name

Floats = NDArray[np.float64]
Skipped = Counter[tuple[str, str]]
_Field = tuple[str, int, float, Grid, Floats]
"""Variable, start (ns since 1970), lead (h), grid, and values at the stations along the grid."""
_RANGE = {
    name: LIMITS[name]
    for name in ("air_temperature", "wind_speed", "eastward_wind", "northward_wind")
}
UNITS = {name: "K" if name == "air_temperature" else "m s-1" for name in _RANGE}
# Short name and height of a field, and its variable; winds are along the grid at first.
_WANTED: dict[tuple[object, object], str] = {
    ("2t", 2): "air_temperature",
    ("10u", 10): "eastward_wind",
    ("10v", 10): "northward_wind",
}
# Category and number of temperature, u and v in discipline 0 of GRIB2.
_NUMBERS = {(0, 0), (2, 2), (2, 3)}
_HEADER = ["shortName", "level", "stepType", "dataDate", "dataTime", "validityDate", "validityTime"]


def pairs_at_stations(
    forecasts: Sequence[Path],
    observations: Sequence[Path],
    *,
    columns: Mapping[str, str] | None = None,
    max_time_gap: float = 1800.0,
) -> xr.Dataset:
    """Pair forecasts from GRIB with observations at stations, for `correct_forecasts`.

    The tables' columns are named as in docs/postprocessing.md, after ``columns``; an observation is
    within ``max_time_gap`` (s) of the valid time.
    """
    left_out: Counter[str] = Counter()
    parts = [_observations(Path(file), columns or {}, left_out) for file in observations]
    observed = pd.concat(parts, ignore_index=True)
    if observed.empty:
        raise InputError(
            "no observation can be used",
            file=observations[0],
            found="; ".join(f"{reason} ({n})" for reason, n in left_out.items() if n)
            or "no line with a value",
        )
    stations = observed.groupby("station", sort=True)[list(PLACES)].first().reset_index()
    table, skipped = forecasts_at_stations(forecasts, stations)
    left_out.update(skipped)
    outside = table.groupby("station")["forecast"].apply(lambda values: values.isna().all())
    off = [str(name) for name in outside.index[outside]]
    if off:
        left_out[f"stations without a forecast: {', '.join(off[:8])}"] += len(off)
    names = [name for name in UNITS if name in observed]
    values = observed.melt(["station", "time"], names, "variable", "observation")
    usable = table[table["forecast"].notna() & table["variable"].isin(names)]
    paired = pd.merge_asof(
        usable.assign(time=_valid(usable)).sort_values("time"),
        values.dropna(subset="observation").sort_values("time"),
        on="time",
        by=["station", "variable"],
        direction="nearest",
        tolerance=pd.Timedelta(seconds=max_time_gap),
    )
    if not paired["observation"].notna().any():
        raise InputError(
            "no observation matches a forecast",
            file=observations[0],
            field="postprocess.stations.files",
            found=f"forecasts valid {_valid(table).min()} to {_valid(table).max()}, observations "
            f"{observed['time'].min()} to {observed['time'].max()}",
            remedy="Check the stations' places and times (UTC)",
        )
    paired = paired.merge(stations, on="station", how="left")
    paired["units"] = paired["variable"].map(UNITS)
    pairs = on_axes(paired)
    pairs.attrs["lines_left_out"] = {reason: n for reason, n in left_out.items() if n}
    return pairs


def _valid(table: pd.DataFrame) -> pd.Series:
    return table[TIME] + pd.to_timedelta((table["lead"] * 3.6e12).round(), unit="ns")


def _observations(file: Path, columns: Mapping[str, str], left_out: Counter[str]) -> pd.DataFrame:
    """One table: station, time, place, variables in SI units."""
    raw, _ = read_table(file, columns)
    left_out["observation lines with another number of columns"] += int(raw.attrs["lines_skipped"])
    for name in ("latitude", "longitude"):
        column(raw, PLACES[name], file=file)
    table = pd.DataFrame(
        {
            "station": column(raw, STATION, file=file).astype(str),
            "time": times(column(raw, VALID, file=file)),
            **places(raw),
        }
    )
    wanted = (*_RANGE, "wind_direction")
    for name in map(str, raw.columns):
        parsed = split_name(name.removeprefix("air_"))
        if parsed is not None and parsed[0].variable in wanted:
            factor, offset = conversion(parsed[1], parsed[0].si_unit)
            table[parsed[0].variable] = numbers(raw[name], raw.index) * factor + offset
    if not {*wanted} & {*table}:
        raise InputError(
            "no column with an observation",
            file=file,
            found="columns " + ", ".join(map(str, raw.columns)),
            remedy="Name them under columns, such as air_temperature_degC, wind_speed_kt, "
            "wind_direction_deg, eastward_wind_m_s, northward_wind_m_s",
        )
    if {"wind_speed", "wind_direction"} <= set(table):
        components = wind_components(table["wind_speed"], np.radians(table["wind_direction"]))
        table["eastward_wind"], table["northward_wind"] = components
    elif {"eastward_wind", "northward_wind"} <= set(table):
        table["wind_speed"] = np.hypot(table["eastward_wind"], table["northward_wind"])
    for name, (least, most) in _RANGE.items():
        if name in table:
            absurd = table[name].notna() & ~table[name].between(least, most)
            left_out[f"{name} out of range"] += int(absurd.sum())
            table.loc[absurd, name] = np.nan
    good = table["time"].notna() & table["latitude"].between(-90, 90)
    good &= table["longitude"].between(-180, 360)
    left_out["observations without a time or place that can be read"] += int((~good).sum())
    return table[good]


def forecasts_at_stations(
    files: Sequence[Path], stations: pd.DataFrame
) -> tuple[pd.DataFrame, dict[str, int]]:
    """Read the forecasts of GRIB files at stations (``station, latitude, longitude``).

    Returns a table of ``variable`` (`UNITS`), ``station, forecast_reference_time, lead`` (h),
    ``forecast``, and counts of fields left out by reason. InputError if no file holds such a field.
    """
    skipped: Skipped = Counter()
    latitude, longitude = (stations[name].to_numpy(float) for name in ("latitude", "longitude"))
    fields: dict[tuple[int, float], dict[str, tuple[Grid, Floats]]] = {}
    for file in files:
        for name, start, lead, grid, values in _fields_of(str(file), latitude, longitude, skipped):
            fields.setdefault((start, lead), {})[name] = grid, values
    parts = [
        pd.DataFrame(
            {
                "variable": name,
                "station": stations["station"].astype(str).to_numpy(),
                TIME: np.datetime64(start, "ns"),
                "lead": lead,
                "forecast": values,
            }
        )
        for (start, lead), by_name in sorted(fields.items())
        for name, values in _variables(by_name, latitude, longitude).items()
    ]
    if not parts:
        raise InputError(
            "no temperature at 2 m and no wind at 10 m in the forecasts",
            file=files[0],
            field="postprocess.forecasts.files",
            found="; ".join(sorted({why for _, why in skipped})) or f"{len(files)} files",
        )
    table = pd.concat(parts, ignore_index=True)
    return table, {f"{kind}: {why}": n for (kind, why), n in skipped.items()}


def _variables(
    fields: Mapping[str, tuple[Grid, Floats]], latitude: Floats, longitude: Floats
) -> dict[str, Floats]:
    variables = {name: fields[name][1] for name in fields if name == "air_temperature"}
    if "eastward_wind" in fields and "northward_wind" in fields:
        (grid, u), (grid_v, v) = fields["eastward_wind"], fields["northward_wind"]
        if grid == grid_v:
            along = grid.wind_along_grid
            angle = grid.convergence(latitude, longitude) if along else np.zeros_like(latitude)
            variables["eastward_wind"], variables["northward_wind"] = rotated(u, v, angle)
            variables["wind_speed"] = np.hypot(u, v)
    return variables


def _fields_of(
    path: str, latitude: Floats, longitude: Floats, skipped: Skipped
) -> Iterator[_Field]:
    try:
        for get, start, edition, length in whole_messages(path, skipped):
            try:
                for single, sections in single_fields(get(start, length), edition):
                    try:
                        field = _at_stations(single, edition, sections, latitude, longitude)
                    except UnplaceableGridError as err:
                        skipped["grid", str(err)] += 1
                    except (UnreadableMessageError, ValueError, ArithmeticError) as err:
                        skipped["message", str(err)] += 1
                    else:
                        if field is not None:
                            yield field
            except (GarbageError, IndexError):
                skipped["message", LENGTHS] += 1
    except OSError as err:
        skipped["file", f"cannot be opened ({err.strerror})"] += 1


def _at_stations(
    message: bytes, edition: int, sections: Mapping[int, bytes], latitude: Floats, longitude: Floats
) -> _Field | None:
    """One field at the stations; None where it is another variable."""
    if edition == 1:
        # Byte 10 of section 1: 105 is a height above ground (GRIB1 table 3).
        product, section = sections[1], sections.get(2)
        if section is None or product[9] != 105:
            return None
    else:
        product, section = sections[4], sections[3]
        # Bytes 10, 11 and 23 of section 4: category, number, and 103 for a height above ground
        # (GRIB2 code table 4.5).
        if (product[9], product[10]) not in _NUMBERS or product[22] != 103:
            return None
    keys = read_keys(message, _HEADER)
    name = _WANTED.get((str(keys.get("shortName")), keys.get("level")))
    if name is None or keys.get("stepType") != "instant":
        return None
    reason = grib_statistic(edition, sections)
    if reason:
        raise UnreadableMessageError(reason)
    start, valid = (_stamp(keys, kind) for kind in ("data", "validity"))
    grid = read_grid(edition, section)
    values = decode_guarded([(message, grid.size, None)])[0]
    if isinstance(values, str):
        raise UnreadableMessageError(values)
    least, most = _RANGE[name]
    if not ((values >= least) & (values <= most) | np.isnan(values)).all():
        raise UnreadableMessageError(f"impossible values of {name}")
    at = np.full(latitude.size, np.nan)
    fi, fj = grid.fractional_index(latitude, longitude)
    inside = np.flatnonzero(np.isfinite(fi) & np.isfinite(fj))
    if inside.size:
        cell = corners(grid, fi[inside], fj[inside])
        at[inside] = bilinear(values[cell.points], cell.x, cell.y)
    lead = (valid - start) / np.timedelta64(1, "h")
    return name, int(start.astype(np.int64)), float(lead), grid, at


def _stamp(keys: Mapping[str, KeyValue], kind: str) -> np.datetime64:
    """A time of the header, within the years that int64 counts in ns (to 2262)."""
    date, clock = keys.get(kind + "Date"), keys.get(kind + "Time")
    if not (isinstance(date, int) and isinstance(clock, int) and 19000101 <= date < 22000101):
        raise UnreadableMessageError("damaged: impossible reference time")
    stamp = f"{date // 10000:04d}-{date // 100 % 100:02d}-{date % 100:02d}"
    return np.datetime64(f"{stamp}T{clock // 100:02d}:{clock % 100:02d}", "ns")
