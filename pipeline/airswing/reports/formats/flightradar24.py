"""Tables of Flightradar24: positions of a flight (granular data) and the CSV of a playback.

Granular data
    ``snapshot_id`` (seconds since 1970), ``altitude`` (ft, barometric at 1013 hPa, 0 on the
    ground), ``heading``, ``latitude, longitude, speed`` (kt), perhaps ``flight_id``; the file is
    ``<yyyymmdd>_<flight_id>_positions.csv``.
Playback
    ``Timestamp, UTC, Callsign, Position, Altitude, Speed, Direction``, where Position is
    ``"latitude,longitude"``.

``heading`` and ``Direction`` are the track over ground and ``speed`` is the ground speed: there is
no compass heading, airspeed or wind in them. The reports serve for model winds along the track.
The aircraft is the flight: neither table names the airframe. Positions at altitude 0 are left out.

Source: trrrj (EUROCONTROL PRU), read_positions_fr24; Flightradar24, "KML and CSV export tools".
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.reports.audit import Audit
from airswing.reports.columns import Mapped
from airswing.reports.formats import (
    ReportFormat,
    compression_of,
    constant_tail,
    is_text,
    register,
)
from airswing.reports.values import parse_times
from airswing.units import FOOT, KNOT

_GRANULAR = ("snapshot_id", "altitude", "heading", "latitude", "longitude", "speed")
_PLAYBACK = ("Timestamp", "UTC", "Callsign", "Position", "Altitude", "Speed", "Direction")


def _read_track(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    table = pd.read_csv(path, dtype=str, keep_default_na=False, compression=compression_of(path))
    table.columns = table.columns.str.strip()
    flight = path.name.split(".")[0].removesuffix("_positions")
    if set(_PLAYBACK) <= set(table):
        place = table["Position"].str.split(",", n=1, expand=True).reindex(columns=[0, 1])
        track = pd.DataFrame(
            {
                "time": table["Timestamp"],
                "latitude": place[0],
                "longitude": place[1],
                "altitude": table["Altitude"],
                "speed": table["Speed"],
                "heading": table["Direction"],
                "flight": table["Callsign"],
            }
        )
    elif set(_GRANULAR) <= set(table):
        track = table.rename(columns={"snapshot_id": "time", "flight_id": "flight"})
        track["flight"] = track.get("flight", flight)
    else:
        raise InputError(
            "is no table of Flightradar24",
            file=path,
            found=", ".join(table.columns[:20]),
            remedy=f"Its columns are {', '.join(_GRANULAR)} or {', '.join(_PLAYBACK)}",
        )
    number = {
        name: pd.to_numeric(track[name], errors="coerce").to_numpy(dtype=np.float64)
        for name in ("latitude", "longitude", "altitude", "speed", "heading")
    }
    time, blank = parse_times(track["time"])
    flying = ~(number["altitude"] <= 0.0)
    audit.drop("on_ground_or_stale", int(np.count_nonzero(~flying)), unread=True)
    audit.remark(
        "tables of Flightradar24 hold the track over ground and the ground speed, but no heading, "
        "airspeed or wind: they serve for model winds along the track alone"
    )
    raw = pd.DataFrame(
        {
            "tail": constant_tail(mapping) or track["flight"],
            "flight": track["flight"],
            "time": time,
            "time_blank": blank,
            "latitude": number["latitude"],
            "longitude": number["longitude"],
            "pressure_altitude": number["altitude"] * FOOT,
            "ground_speed": number["speed"] * KNOT,
            "track": number["heading"],
        }
    )
    yield raw.loc[flying]


def _recognises(start: bytes) -> bool:
    header = start.split(b"\n")[0].decode(errors="replace")
    names = {name.strip(' "\r') for name in header.split(",")}
    return is_text(start) and (set(_GRANULAR) <= names or set(_PLAYBACK) <= names)


register(ReportFormat("flightradar24", _recognises, _read_track))
