"""Model winds appended to any table of times, places and levels: ``airswing collocate TRACK``.

Winds are relative to true north (earth-relative), interpolated in time, in the horizontal and in
ln p as for aircraft reports; rows outside the model get no wind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.physics.triangle import direction_in_degrees
from airswing.products.whole_files import atomic, require_parquet
from airswing.reference.catalogue import Catalogue, build_catalogue
from airswing.reference.collocate import collocate
from airswing.reports.columns import conversion, numbers, parse_times, split_name
from airswing.reports.formats import damage_named, opened
from airswing.reports.formats.tabular import header_of
from airswing.units import KNOT

_PLACE = ("time", "latitude", "longitude", "pressure")
TABLES = (".csv", ".parquet")
_ADDED = (
    *("eastward_wind_m_s", "northward_wind_m_s", "wind_direction_deg", "wind_speed_kt"),
    "lead_time_h",
)


def append_winds(
    table: pd.DataFrame,
    references: Mapping[str, str | Path | Sequence[str] | xr.Dataset | Catalogue],
    *,
    columns: Mapping[str, str] | None = None,
    max_time_gap: float = 10800.0,
    lead: str = "any",
) -> pd.DataFrame:
    """Append earth-relative model winds to a table of times, places and levels.

    Parameters
    ----------
    table : DataFrame
        With ``time`` (UTC: datetime, ISO 8601 text, or seconds since 1970), ``latitude`` and
        ``longitude`` (degrees; ``lat`` and ``lon`` too), and ``pressure`` or ``pressure_altitude``
        with its unit at the end of the name (``pressure_hPa``, ``pressure_altitude_ft``); the
        altitude is used in rows without a pressure.
    references : mapping of str to path, list of paths, Dataset or Catalogue
        Model files (a glob each), Datasets with CF winds or catalogues, by name.
    columns : mapping of str to str, optional
        From other names of these columns to these names.
    max_time_gap : float, default 10800
        Longest time between two model times around a row, s.
    lead : str, default "any"
        Which forecasts are used: ``any``, ``analysis``, or a comparison such as ``>= 1 h``.

    Returns
    -------
    DataFrame
        The table with, for each reference, ``NAME_eastward_wind_m_s``, ``NAME_northward_wind_m_s``,
        ``NAME_wind_direction_deg`` (from), ``NAME_wind_speed_kt`` and ``NAME_lead_time_h``; NaN
        where the model has no value, and no direction for calm.

    Raises
    ------
    InputError
        A column is missing or cannot be read, or there is no model wind.

    Examples
    --------
    >>> track = pd.DataFrame(
    ...     {"time": ["2009-09-20T12:30"], "lat": [42.0], "lon": [-88.0], "pressure_hPa": [400.0]}
    ... )
    >>> winds = airswing.append_winds(track, {"ruc": "data_samples/ruc/*.grb"})
    >>> bool(winds["ruc_wind_speed_kt"].notna().all())
    True
    """
    places = _places(table, columns or {})
    models = {
        name: ref if isinstance(ref, Catalogue) else build_catalogue(ref, name=name, lead=lead)
        for name, ref in references.items()
    }
    winds = collocate(places, models, max_time_gap=max_time_gap).compute()
    extended = table.copy()
    for name in references:
        at_model = winds.sel(reference=name)
        u, v = (at_model[f"reference_{way}ward_wind"].to_numpy() for way in ("east", "north"))
        speed = np.hypot(u, v)
        direction = np.where(speed > 0.0, direction_in_degrees(u, v), np.nan)
        values = (u, v, direction, speed / KNOT, at_model["lead_time"].to_numpy())
        for column, values_of_column in zip(_ADDED, values, strict=True):
            extended[f"{name}_{column}"] = values_of_column
    return extended


def collocate_track(
    track: Path,
    references: Sequence[str],
    output: Path,
    *,
    columns: Sequence[str] = (),
    say: Callable[[str], None] = lambda text: None,
) -> Path:
    """Append model winds to a CSV or Parquet file, as :func:`append_winds`.

    References are ``NAME=GLOB`` each, columns ``COLUMN=NAME``; `say` takes one line for each
    reference: the rows that have a wind, and the times of the model.
    """
    files = _pairs(references, "--reference", "ruc=ruc/*.grb")
    if not files:
        raise InputError(
            "a track needs --reference NAME=GLOB, the files of a model",
            file=track,
            remedy='Such as --reference "ruc=ruc/*.grb"',
        )
    meanings = _pairs(columns, "--columns", "fl=pressure_altitude_ft")
    for path in (track, output):
        if path.suffix.lower() not in TABLES:
            raise InputError("a track is a .csv or .parquet file", file=path)
        if path.suffix.lower() == ".parquet":
            require_parquet(path)
    if not track.exists():
        remedy = "Check the path, which starts at the current directory"
        raise InputError("no such file", file=track, remedy=remedy)
    with damage_named(track, "a table"), opened(track) as file:
        if track.suffix.lower() == ".csv":
            names, separator, lines = header_of(track)
            options: Any = {"names": names, "sep": separator, "skiprows": lines}
            # as text, so that identifiers keep leading zeros
            table = pd.read_csv(file, dtype=str, keep_default_na=False, index_col=False, **options)
        else:
            table = pd.read_parquet(file)
    models = {}
    for name, pattern in files.items():
        try:
            models[name] = build_catalogue(pattern, name=name)
        except InputError as error:  # it names a key of a configuration
            raise error.located(field=f"--reference {name}") from error.__cause__
    extended = append_winds(table, models, columns=meanings)
    for name, model in models.items():
        number = int(extended[f"{name}_wind_speed_kt"].notna().sum())
        first, last = (np.datetime_as_string(model.times[i], unit="m") for i in (0, -1))
        say(
            f"{number:,} of {len(extended):,} rows have a wind of {name}; the model covers "
            f"{first}Z to {last}Z"
        )
    with atomic(output) as temporary:
        if output.suffix.lower() == ".csv":
            # The columns of the track are written as they are.
            added = [f"{name}_{column}" for name in models for column in _ADDED]
            extended[added] = extended[added].map("{:.3f}".format, na_action="ignore")
            extended.to_csv(temporary, index=False)
        else:
            extended.to_parquet(temporary, index=False)
    return output


def _pairs(entries: Sequence[str], option: str, example: str) -> dict[str, str]:
    pairs = {}
    for entry in entries:
        name, _, value = (side.strip() for side in entry.partition("="))
        if not (name and value):
            raise InputError(
                "must be A=B", field=option, found=entry, remedy=f'Such as {option} "{example}"'
            )
        pairs[name] = value
    return pairs


def _places(table: pd.DataFrame, columns: Mapping[str, str]) -> xr.Dataset:
    if absent := [name for name in columns if name not in table.columns]:
        there = ", ".join(map(str, table.columns))
        remedy = "Give one of its columns"
        raise InputError(
            "the table has no such column", field=absent[0], found=there, remedy=remedy
        )
    places: dict[str, NDArray[Any]] = {}
    for name in map(str, table.columns):
        meant = columns.get(name, name).strip()
        meant = {"lat": "latitude", "lon": "longitude"}.get(meant.lower(), meant)
        if meant.lower() == "time":
            places["time"], blank = parse_times(table[name])
            unreadable = np.isnat(places["time"]) & ~blank
            if unreadable.any():
                first = table[name].iloc[int(np.argmax(unreadable))]
                remedy = "Times are ISO 8601 (UTC) or seconds since 1970"
                raise InputError("a time cannot be read", field=name, found=first, remedy=remedy)
        elif (column := split_name(meant)) and column[0].variable in (*_PLACE, "pressure_altitude"):
            quantity, unit = column
            places[quantity.variable] = numbers(table[name], *conversion(unit, quantity.si_unit))
    if "pressure_altitude" in places:
        from_altitude = pressure_from_altitude(places["pressure_altitude"])
        pressure = places.get("pressure", from_altitude)
        places["pressure"] = np.where(np.isnan(pressure), from_altitude, pressure)
    for name in _PLACE:
        if name not in places:
            raise InputError(
                "the table has no column for it",
                field={"pressure": "pressure_hPa or pressure_altitude_ft"}.get(name, name),
                found=", ".join(map(str, table.columns)),
                remedy="Rename the column, or give its name by --columns COLUMN=NAME (in Python: "
                "columns={...})",
            )
    return xr.Dataset({name: ("report", places[name]) for name in _PLACE})
