"""Pairs of forecast and observation: from tables, and from a run's winds at flight levels.

Text tables have one line of names, divided by commas, semicolons, tabs or blanks; lines that begin
with ``#`` are comments, of which ``# variable: T`` and ``# units: K`` are used (Verif, Nipen et al.
2023, Bull. Amer. Meteor. Soc. 104). Lines that cannot be used are counted by reason. At flight
levels a place is a box of latitude and longitude in a layer of pressure; its pair of a day is the
mean model wind and the mean corrected wind of the reports in it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.innovations import LEVEL_EDGES_HPA, chunks, profile_cells
from airswing.flags import FREE_OF_DEVIATION
from airswing.handover.forecasts.correcting import TIME
from airswing.physics.triangle import wrap_degrees
from airswing.reports.columns import parse_times

Floats = NDArray[np.float64]
Times = NDArray[np.datetime64]
STATION = ("station", "location", "id", "site")
START = ("start", "forecast_reference_time", "reference_time", "init", "date")
LEAD = ("lead", "lead_h", "leadtime", "lead_time")
VALID = ("time", "valid_time", "valid")
PLACES = {
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon"),
    "altitude": ("altitude", "elev", "elevation"),
}
VARIABLES = {  # by short name; other names are kept
    **dict.fromkeys(("t", "t2m", "2t", "temperature"), "air_temperature"),
    **dict.fromkeys(("u", "10u", "u10"), "eastward_wind"),
    **dict.fromkeys(("v", "10v", "v10"), "northward_wind"),
    **dict.fromkeys(("ff", "ws"), "wind_speed"),
}
LEAD_HOURS = 24.0  # lead of pairs at flight levels: the bias of a day is known on the next
_VALUES = ("forecast", "observation")
_KEYS = ["variable", "station", TIME, "lead"]
_COMMENT = re.compile(r"#\s*(variable|units)\s*:\s*(.*?)\s*$", re.IGNORECASE)
# A time outside this range is a number misread as a date.
_FIRST, _LAST = np.datetime64("1900-01-01"), np.datetime64("2200-01-01")
_WINDS = ("eastward_wind", "northward_wind")


def read_table(path: Path, columns: Mapping[str, str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Read one table as text, and ``variable`` and ``units`` of its comments.

    ``columns`` are names in the table and names used here; other columns keep theirs, in lower
    case. ``attrs["lines_skipped"]`` counts broken lines.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as err:
        cause = getattr(err, "strerror", None) or "bytes that are not text"
        raise InputError("cannot be read as a table of text", file=path, found=cause) from err
    lines = [line.strip() for line in text.splitlines()]
    comments = {m[1].lower(): m[2] for line in lines if (m := _COMMENT.match(line))}
    body = [line for line in lines if line and not line.startswith("#")]
    if len(body) < 2:
        raise InputError("a table without lines", file=path, found=f"{len(body)} lines of text")
    mark = next((mark for mark in (",", ";", "\t") if mark in body[0]), None)
    split = [[cell.strip().strip('"') for cell in line.split(mark)] for line in body]
    names, rows = [name.lower() for name in split[0]], split[1:]
    complete = [row for row in rows if len(row) == len(names)]
    # A few invalid lines are skipped; if most are invalid, the file is not a table.
    if 2 * len(complete) < len(rows) or len(names) < 2:
        raise InputError(
            "not a table: most lines have another number of columns than the first",
            file=path,
            found=f"{len(names)} names, a line of {len(rows[0])} values",
        )
    mapped = {name.strip().strip('"').lower(): canonical for name, canonical in columns.items()}
    for name in mapped:
        if name not in names:
            raise InputError(
                "no such column", file=path, field=name, found="columns " + ", ".join(names)
            )
    table = pd.DataFrame(complete, columns=names, dtype=object).rename(columns=mapped)
    again = table.columns[table.columns.duplicated()]
    if len(again):
        raise InputError(
            "two columns of one name",
            file=path,
            field=str(again[0]),
            remedy="Leave one of them out, or name them under columns",
        )
    table.attrs["lines_skipped"] = len(rows) - len(complete)
    return table, comments


def _optional_column(table: pd.DataFrame, names: Sequence[str]) -> pd.Series | None:
    return next((table[name] for name in names if name in table), None)


def column(table: pd.DataFrame, names: Sequence[str], *, file: Path) -> pd.Series:
    """First existing column of several names; InputError, naming ``file``, if there is none."""
    values = _optional_column(table, names)
    if values is None:
        raise InputError(
            f"no column {' or '.join(names)}",
            file=file,
            found="columns " + ", ".join(map(str, table.columns)),
            remedy="Name it under columns, as `name in the table: known name`",
        )
    return values


def numbers(values: pd.Series | None, index: pd.Index) -> Floats:
    """Read numbers; NaN where -999 or over 1e30 (fill values), not a number, or no column."""
    if values is None:
        return np.full(len(index), np.nan)
    read = pd.to_numeric(values.str.strip(), errors="coerce").to_numpy(dtype=np.float64)
    return np.where((np.abs(read) < 1e30) & (read != -999.0), read, np.nan)


def times(values: pd.Series) -> Times:
    """Read times in UTC: ISO 8601, yyyymmdd[HH[MM[SS]]] or seconds since 1970; else NaT."""
    text = values.astype(str).str.strip().str.removesuffix(".0")
    # A date of eight digits gets an hour, or it would be seconds since 1970.
    text = text.str.replace(r"^((?:19|20)\d{6})$", r"\g<1>00", regex=True)
    parsed = parse_times(text)[0]
    return np.where((parsed >= _FIRST) & (parsed <= _LAST), parsed, np.datetime64("NaT", "ns"))


def places(table: pd.DataFrame) -> dict[str, Floats]:
    """Latitude, longitude and altitude of each line, NaN where there is no such column."""
    return {
        name: numbers(_optional_column(table, names), table.index) for name, names in PLACES.items()
    }


def pairs_from_tables(
    files: Sequence[Path],
    *,
    columns: Mapping[str, str] | None = None,
    variable: str | None = None,
    units: str | None = None,
) -> xr.Dataset:
    """Read tables of forecast and observation for `correct_forecasts`.

    ``columns`` are names in the tables and ``station, start, lead (h), time (valid), variable,
    forecast, observation, latitude, longitude``; usual names are known. ``variable`` and ``units``
    are for tables that do not give them. Attribute ``lines_left_out`` counts lines by reason.
    InputError if a file is not such a table, or nothing in them can be used.
    """
    left_out: Counter[str] = Counter()
    parts = [_read_lines(Path(file), columns or {}, variable, units, left_out) for file in files]
    table = pd.concat(parts, ignore_index=True)
    again = table.duplicated(_KEYS, keep="last")
    left_out["another line of the same station, start and lead"] += int(again.sum())
    table = table[~again]
    if table.empty or not (table["forecast"].notna() & table["observation"].notna()).any():
        why = "; ".join(f"{reason} ({n})" for reason, n in left_out.most_common(3) if n)
        raise InputError(
            "no pair of forecast and observation can be used",
            file=files[0],
            found=why or "no line with both",
        )
    pairs = on_axes(table)
    pairs.attrs["lines_left_out"] = {reason: n for reason, n in left_out.items() if n}
    return pairs


def _read_lines(
    file: Path,
    columns: Mapping[str, str],
    variable: str | None,
    units: str | None,
    left_out: Counter[str],
) -> pd.DataFrame:
    raw, comments = read_table(file, columns)
    left_out["another number of columns"] += int(raw.attrs["lines_skipped"])
    start, lead = _starts_and_leads(raw, file)
    names = _optional_column(raw, ("variable", "parameter"))
    if names is None:
        names = pd.Series(variable or comments.get("variable") or "forecast", index=raw.index)
    names = names.map(lambda name: str(name).strip())
    unit = _optional_column(raw, ("units", "unit"))
    table = pd.DataFrame(
        {
            "station": column(raw, STATION, file=file),
            TIME: start,
            "lead": lead,
            "variable": names.map(lambda name: VARIABLES.get(name.lower(), name)),
            "units": unit if unit is not None else units or _cf_units(comments.get("units", "")),
            "forecast": numbers(column(raw, ("forecast", "fcst", "fc"), file=file), raw.index),
            "observation": numbers(
                column(raw, ("observation", "obs", "observed"), file=file), raw.index
            ),
            **places(raw),
        }
    )
    timeless = table[TIME].isna() | ~np.isfinite(table["lead"]) | (table["lead"] < 0.0)
    nameless = table["station"].map(lambda text: str(text).strip() == "") & ~timeless
    left_out["no start or lead that can be read"] += int(timeless.sum())
    left_out["no station"] += int(nameless.sum())
    usable: pd.DataFrame = table[~(timeless | nameless)]
    return usable


def _starts_and_leads(raw: pd.DataFrame, file: Path) -> tuple[Times, Floats]:
    """Start and lead time (h), of which one may be given by the valid time."""
    start, lead = _optional_column(raw, START), _optional_column(raw, LEAD)
    if start is not None and lead is not None:
        return times(start), numbers(lead, raw.index)
    valid = times(column(raw, VALID, file=file))
    if start is not None:
        begun = times(start)
        return begun, (valid - begun) / np.timedelta64(1, "h")  # NaN where a time is missing
    ahead = numbers(column(raw, LEAD, file=file), raw.index)
    steps = np.nan_to_num(ahead * 3.6e12).astype("timedelta64[ns]")
    return np.where(np.isfinite(ahead), valid - steps, np.datetime64("NaT")), ahead


def _cf_units(text: str) -> str:
    """CF units from the plot labels of Verif (``$^oC$``)."""
    label = text.replace("$", "").replace("^o", "deg").replace("{", "").replace("}", "").strip()
    return {"C": "degC", "celsius": "degC", "m/s": "m s-1"}.get(label, label)


def on_axes(table: pd.DataFrame) -> xr.Dataset:
    """Put a table of `DIMS`, units, forecast, observation and places on the axes of `DIMS`."""
    ds = table.set_index(_KEYS)[[*_VALUES]].astype(np.float64).to_xarray()
    ds = ds.assign_coords(
        {name: ds[name].astype(str) for name in ("variable", "station")}
        | {TIME: ds[TIME].astype("M8[ns]")}
    )
    first = table.groupby("variable", sort=True)["units"].first().fillna("").astype(str)
    ds["variable_units"] = ("variable", np.array(first.to_list()))
    places = table.groupby("station", sort=True)[list(PLACES)].first()
    for name in PLACES:
        if places[name].notna().any():
            ds[name] = ("station", places[name].to_numpy(dtype=np.float64))
    return ds


def flight_level_pairs(
    headings: xr.Dataset, corrected: xr.Dataset, members: list[str], *, region: float, fewest: int
) -> xr.Dataset:
    """Pair the model's winds (mean of the members) with corrected winds, by box, layer and day.

    ``region`` is the side of a box, degrees; InputError where no box, layer and day has ``fewest``
    reports. A station of the result is a box in a layer, with the place of its middle.
    """
    parts = []
    needed = ["latitude", "longitude", "pressure", "phase", "screening"]
    for chunk in chunks(headings, {"": members}, needed, corrected):
        cell = profile_cells(chunk.block)
        columns: dict[Any, Any] = {
            "south": np.floor(chunk.column("latitude") / region),
            "west": np.floor(wrap_degrees(chunk.column("longitude")) / region),
            "layer": cell % (len(LEVEL_EDGES_HPA) - 1),
            TIME: chunk.day.astype("datetime64[D]").astype("datetime64[ns]"),
        }
        for name, model, wind in zip(_WINDS, chunk.model[""], chunk.corrected, strict=True):
            columns |= {("forecast", name): model, ("observation", name): wind}
        table = pd.DataFrame(columns)
        good = (cell >= 0) & table.notna().all(axis=1).to_numpy()
        good &= np.isin(chunk.applied, FREE_OF_DEVIATION)
        parts.append(table[good].assign(reports=1).groupby(["south", "west", "layer", TIME]).sum())
    summed = pd.concat(parts).groupby(level=[0, 1, 2, 3]).sum()
    retained = summed[summed["reports"] >= fewest]
    if retained.empty:
        raise InputError(
            f"no box of {region:g} degrees has {fewest} corrected winds in a layer on any day",
            field="postprocess.winds",
            found=f"at most {int(summed['reports'].max()) if len(summed) else 0}",
            remedy="Make region larger or fewest smaller",
        )
    means = retained.div(retained["reports"], axis=0).reset_index()
    edges = np.array(LEVEL_EDGES_HPA)
    middle = 0.5 * (edges[:-1] + edges[1:])[means["layer"].astype(int)]
    latitude, longitude = ((means[side] + 0.5) * region for side in ("south", "west"))
    names = [
        f"{p:04.0f}_hPa_{abs(y):.7g}{'S' if y < 0 else 'N'}_{abs(x):.7g}{'W' if x < 0 else 'E'}"
        for p, y, x in zip(middle, latitude, longitude, strict=True)
    ]
    lines = pd.DataFrame({"station": names, TIME: means[TIME], "latitude": latitude})
    lines = lines.assign(
        lead=LEAD_HOURS, units="m s-1", longitude=longitude, altitude=middle * 100.0
    )
    components = [
        lines.assign(variable=name, **{kind: means[kind, name] for kind in _VALUES})
        for name in _WINDS
    ]
    pairs = on_axes(pd.concat(components, ignore_index=True))
    few = int((summed["reports"] < fewest).sum())
    pairs.attrs["lines_left_out"] = {f"box, layer and day with under {fewest} winds": few}
    return pairs.rename(altitude="pressure")  # `on_axes` calls the level of a place altitude
