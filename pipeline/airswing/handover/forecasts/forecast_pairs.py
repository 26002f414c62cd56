"""Pairs of forecast and observation from tables, on the axes the filter runs along.

Assumes one line a station, start and lead (or valid time), with the forecast and what was observed
at its valid time. Lines that cannot be used are counted by reason, not a cause to stop. Units are
the table's; the variable's name and unit come from the configuration, a column, or the table's
comments.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.handover.forecasts.correcting import DIMS, TIME
from airswing.handover.forecasts.station_table import (
    column,
    numbers,
    optional_column,
    read_table,
    times,
)

STATION = ("station", "location", "id", "site")
START = ("start", "forecast_reference_time", "reference_time", "init", "date")
LEAD = ("lead", "lead_h", "leadtime", "lead_time")
VALID = ("time", "valid_time", "valid")
PLACES = {
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon"),
    "altitude": ("altitude", "elev", "elevation"),
}
# Short names of variables; any other name is kept.
KNOWN = {
    "t": "air_temperature",
    "t2m": "air_temperature",
    "2t": "air_temperature",
    "temperature": "air_temperature",
    "u": "eastward_wind",
    "10u": "eastward_wind",
    "u10": "eastward_wind",
    "v": "northward_wind",
    "10v": "northward_wind",
    "v10": "northward_wind",
    "ff": "wind_speed",
    "ws": "wind_speed",
}
_KEYS = ["variable", "station", TIME, "lead"]


def pairs_from_tables(
    files: Sequence[Path],
    *,
    columns: Mapping[str, str] | None = None,
    variable: str | None = None,
    units: str | None = None,
) -> xr.Dataset:
    """Read tables of forecast and observation.

    Parameters
    ----------
    columns : mapping of str to str, optional
        Their names to ours: ``station, start, lead (h), time (valid), variable, forecast,
        observation, latitude, longitude``; usual names are known.
    variable, units : str, optional
        Of tables that do not say.

    Returns
    -------
    Dataset
        As :func:`airswing.handover.forecasts.correcting.correct_forecasts` takes it, with
        ``lines_left_out`` (by reason) in its attributes.

    Raises
    ------
    InputError
        If a file is no such table, or nothing in them can be used.
    """
    left_out: Counter[str] = Counter()
    parts = [_part(Path(file), columns or {}, variable, units, left_out) for file in files]
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
    found = on_axes(table)
    found.attrs["lines_left_out"] = {reason: n for reason, n in left_out.items() if n}
    return found


def _part(
    file: Path,
    columns: Mapping[str, str],
    variable: str | None,
    units: str | None,
    left_out: Counter[str],
) -> pd.DataFrame:
    raw, told = read_table(file, columns)
    left_out["another number of columns"] += int(raw.attrs["lines_skipped"])
    start, lead = _starts_and_leads(raw, file)
    own = optional_column(raw, ("variable", "parameter"))
    named = variable or told.get("variable") or "forecast"
    names = pd.Series(named, index=raw.index) if own is None else own
    unit = optional_column(raw, ("units", "unit"))
    table = pd.DataFrame(
        {
            "station": column(raw, STATION, file=file),
            TIME: start,
            "lead": lead,
            "variable": names.map(
                lambda name: KNOWN.get(str(name).strip().lower(), str(name).strip())
            ),
            "units": unit if unit is not None else units or _plain_units(told.get("units", "")),
            "forecast": numbers(column(raw, ("forecast", "fcst", "fc"), file=file)),
            "observation": numbers(column(raw, ("observation", "obs", "observed"), file=file)),
        }
    )
    for name, known in PLACES.items():
        place = optional_column(raw, known)
        table[name] = np.nan if place is None else numbers(place)
    timeless = table[TIME].isna() | ~np.isfinite(table["lead"]) | (table["lead"] < 0.0)
    nameless = table["station"].map(lambda text: str(text).strip() == "")
    left_out["no start or lead that can be read"] += int(timeless.sum())
    left_out["no station"] += int((nameless & ~timeless).sum())
    usable: pd.DataFrame = table[~(timeless | nameless)]
    return usable


def _starts_and_leads(
    raw: pd.DataFrame, file: Path
) -> tuple[NDArray[np.datetime64], NDArray[np.float64]]:
    """Start and lead (h), of which one may be told by the valid time."""
    start = optional_column(raw, START)
    lead = optional_column(raw, LEAD)
    if start is not None and lead is not None:
        return times(start), numbers(lead)
    at = times(column(raw, VALID, file=file))
    if start is not None:
        begun = times(start)
        hours = (at - begun) / np.timedelta64(1, "h")
        return begun, np.where(np.isnat(at) | np.isnat(begun), np.nan, hours)
    ahead = numbers(column(raw, LEAD, file=file))
    steps = np.nan_to_num(ahead * 3.6e12).astype("timedelta64[ns]")
    return np.where(np.isfinite(ahead), at - steps, np.datetime64("NaT")), ahead


def _plain_units(text: str) -> str:
    """Units as CF has them, from what Verif writes for plots (``$^oC$``)."""
    plain = text.replace("$", "").replace("^o", "deg").replace("{", "").replace("}", "").strip()
    return {"degC": "degC", "C": "degC", "celsius": "degC", "m/s": "m s-1"}.get(plain, plain)


def on_axes(table: pd.DataFrame) -> xr.Dataset:
    """Lay lines of forecasts on the axes of `DIMS`.

    The table has ``variable, station, forecast_reference_time, lead, units, forecast,
    observation`` and the places of stations where known.
    """
    codes, axes = zip(*(pd.factorize(table[key], sort=True) for key in _KEYS), strict=True)
    shape = tuple(len(axis) for axis in axes)
    flat = np.ravel_multi_index(codes, shape)
    laid = {}
    for name in ("forecast", "observation"):
        values = np.full(int(np.prod(shape)), np.nan)
        values[flat] = table[name].to_numpy(dtype=np.float64)
        laid[name] = (DIMS, values.reshape(shape))
    coords = {key: (key, np.asarray(axis)) for key, axis in zip(_KEYS, axes, strict=True)}
    for key in ("variable", "station"):
        coords[key] = (key, np.array([str(value) for value in axes[_KEYS.index(key)]]))
    coords[TIME] = (TIME, pd.DatetimeIndex(axes[2]).to_numpy(dtype="datetime64[ns]"))
    found = xr.Dataset(laid, coords=coords)
    first = table.groupby("variable", sort=True)["units"].first().fillna("").astype(str)
    found["variable_units"] = ("variable", np.array(first.to_list()))
    places = table.groupby("station", sort=True)[list(PLACES)].first()
    for name in PLACES:
        if places[name].notna().any():
            found[name] = ("station", places[name].to_numpy(dtype=np.float64))
    return found
