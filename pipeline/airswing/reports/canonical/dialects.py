"""Tables of programs in use, told by the names of their columns.

Assumes that a table with all the columns of a signature was written by that program: what its
columns mean is then known without a mapping. A mapping of the user's comes before it, column by
column. Headings of Mode-S register 6,0 are magnetic, tracks and ground speeds are those of ADS-B or
of register 5,0; the ``heading`` of OpenSky's state vectors is the track over ground.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from airswing.reports.canonical.columns import ColumnMapping


@dataclass(frozen=True)
class Dialect:
    """One program's names, mapped as `columns.parse_mapping` takes them."""

    name: str
    signature: frozenset[str]  # columns that are always there
    columns: Mapping[str, str | tuple[str, ...]]

    def columns_in(self, names: Iterable[str]) -> ColumnMapping:
        """The mapping of the columns that are there."""
        there = {name.strip() for name in names}
        found: dict[str, str | list[str]] = {}
        for key, target in self.columns.items():
            if isinstance(target, tuple):
                some = [one for one in target if one in there]
                if some:
                    found[key] = some
            elif key in there:
                found[key] = target
        return found


# Programs whose tables are understood as they stand.
DIALECTS = (
    Dialect(
        "decoded Mode-S (meteo-particle-model)",
        frozenset({"ts", "icao", "lat", "lon", "alt", "hdg"}),
        {
            "icao": "tail",
            "ts": "time",
            "lat": "latitude",
            "lon": "longitude",
            "alt": "pressure_altitude_ft",
            "hdg": "magnetic_heading_deg",
            "ias": "indicated_airspeed_kt",
            "ground_speed_kt": ("gs_adsb", "gs"),
            "track_deg": ("trk_adsb", "trk"),
            "tas": "true_airspeed_kt",
        },
    ),
    Dialect(
        "traffic",
        frozenset({"timestamp", "icao24", "latitude", "longitude", "altitude", "groundspeed"}),
        {
            "icao24": "tail",
            "timestamp": "time",
            "altitude": "pressure_altitude_ft",
            "groundspeed": "ground_speed_kt",
            "track": "track_deg",
            "heading": "magnetic_heading_deg",
            "IAS": "indicated_airspeed_kt",
            "TAS": "true_airspeed_kt",
            "Mach": "mach",
            "callsign": "flight",
        },
    ),
    Dialect(
        "OpenSky state vectors",
        frozenset({"time", "icao24", "lat", "lon", "velocity", "heading", "baroaltitude"}),
        {
            "icao24": "tail",
            "lat": "latitude",
            "lon": "longitude",
            "baroaltitude": "pressure_altitude_m",
            "velocity": "ground_speed_m_s",
            "heading": "track_deg",
            "callsign": "flight",
        },
    ),
)


def dialect_of(names: Iterable[str]) -> Dialect | None:
    """The program that wrote a table with these columns."""
    there = {name.strip() for name in names}
    return next((one for one in DIALECTS if one.signature <= there), None)
