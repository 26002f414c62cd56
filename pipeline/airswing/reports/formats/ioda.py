"""IODA observation files (NetCDF) of aircraft, as JEDI reads them.

Assumes groups ``MetaData`` and ``ObsValue`` over the dimension ``Location`` (``nlocs`` in old
files), or variables named ``variable@Group``. Winds are ``windEastward, windNorthward`` (m/s,
before 2022 ``eastward_wind, northward_wind``), the temperature ``airTemperature`` (K), the level
``pressure`` (Pa), else ``height`` (m; taken as pressure altitude, as aircraft report it). Times are
numbers with CF units or ISO 8601 text. The aircraft is the tail number, else the identifier, else
the station. A value of ``PreQC`` or ``QualityMarker`` above 3 fails the wind (PREPBUFR: 0 to 3
usable).

Source: JCSDA, JEDI documentation, "Naming conventions" (2022) and the older ioda-converters.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import WIND_QC
from airswing.reports.audit import Audit
from airswing.reports.columns import Mapped
from airswing.reports.formats import ReportFormat, constant_tail, register
from airswing.reports.formats.madis import NETCDF, Variable, open_netcdf, strings
from airswing.reports.values import from_epoch, parse_times

_TAILS = (
    *("aircraftTailNumber", "aircraftIdentifier", "aircraftRegistrationNumber"),
    *("stationIdentification", "station_id"),
)
_NUMBERS = {
    "pressure": ("pressure", "air_pressure"),
    "pressure_altitude": ("height", "altitude", "aircraftAltitude"),
    "latitude": ("latitude",),
    "longitude": ("longitude",),
    "eastward_wind": ("windEastward", "eastward_wind"),
    "northward_wind": ("windNorthward", "northward_wind"),
    "air_temperature": ("airTemperature", "air_temperature"),
}
_META = ("pressure", "pressure_altitude", "latitude", "longitude")
_LARGEST_GOOD = 3.0


def _read_ioda(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    with open_netcdf(path) as file:

        def first(group: str, names: tuple[str, ...]) -> Variable | None:
            inside = file.groups[group].variables if group in file.groups else {}
            every = {f"{name}@{group}": variable for name, variable in inside.items()}
            every |= file.variables
            return next((every[key] for n in names if (key := f"{n}@{group}") in every), None)

        times = first("MetaData", ("dateTime", "datetime", "time"))
        found = {
            ours: first("MetaData" if ours in _META else "ObsValue", names)
            for ours, names in _NUMBERS.items()
        }
        absent = [name for name in ("latitude", "longitude") if found[name] is None]
        absent += [] if times is not None else ["dateTime"]
        if found["pressure"] is None and found["pressure_altitude"] is None:
            absent.append("pressure")
        if absent or times is None:
            raise InputError(
                "is an IODA file without a variable that is needed in MetaData",
                file=path,
                field=", ".join(absent),
                found=", ".join(_names(file)[:30]),
            )
        if found["eastward_wind"] is None and found["air_temperature"] is None:
            raise InputError(
                "is an IODA file without winds or temperatures in ObsValue",
                file=path,
                found=", ".join(_names(file)[:30]),
                remedy="Name a file of aircraft observations",
            )
        raw: dict[str, object] = {
            ours: _number(variable) for ours, variable in found.items() if variable is not None
        }
        raw["time"], raw["time_blank"] = _times(times)
        tail, flight = first("MetaData", _TAILS), first("MetaData", ("aircraftFlightNumber",))
        named = tail if tail is not None else flight
        if constant := constant_tail(mapping):
            raw["tail"] = constant
        elif named is not None:
            raw["tail"] = strings(named)
        else:
            raw["tail"] = path.name.split(".")[0]
            audit.remark(f"{path.name} does not name the aircraft: its reports are taken as of one")
        if flight is not None:
            raw["flight"] = strings(flight)
        for group in ("PreQC", "QualityMarker"):
            if (codes := first(group, _NUMBERS["eastward_wind"])) is not None:
                fails = _number(codes) > _LARGEST_GOOD
                raw["wind_qc"] = np.where(fails, WIND_QC["fail"], WIND_QC["missing"])
        yield pd.DataFrame(raw)


def _names(file: netCDF4.Dataset) -> list[str]:
    inside = (f"{group}/{name}" for group in file.groups for name in file[group].variables)
    return [*file.variables, *inside]


def _number(variable: Variable) -> NDArray[np.float64]:
    values = np.asarray(variable[:], dtype=np.float64).reshape(-1)
    fill = getattr(variable, "_FillValue", None)
    absent = ~(np.abs(values) < 1e30)
    return np.where(absent | (values == fill if fill is not None else False), np.nan, values)


def _times(variable: Variable) -> tuple[NDArray[np.datetime64], NDArray[np.bool_]]:
    if variable.dtype is str or np.dtype(variable.dtype).kind in "SU":
        return parse_times(pd.Series(strings(variable), dtype=object))
    values = _number(variable)
    unit, _, epoch = getattr(variable, "units", "seconds since 1970-01-01").partition(" since ")
    length = {"seconds": 1.0, "minutes": 60.0, "hours": 3600.0, "days": 86400.0}[unit.strip()]
    start = pd.Timestamp(epoch.strip())
    start = start.tz_convert(None) if start.tzinfo else start
    return from_epoch(values * length + start.timestamp()), np.isnan(values)


def _recognises(start: bytes) -> bool:
    return start.startswith(NETCDF) and (b"MetaData" in start or b"ObsValue" in start)


register(ReportFormat("ioda", _recognises, _read_ioda))
