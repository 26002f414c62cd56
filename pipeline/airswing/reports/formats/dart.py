"""DART observation sequences (``obs_seq``, ASCII) of aircraft.

Locations are ``loc3d``: longitude and latitude in radians, the vertical coordinate as pressure (Pa,
kind 2) or height (m, kind 3; taken as pressure altitude). Times are seconds and days since
1601-01-01. A quality code above 3 fails the wind. A sequence does not name the aircraft: all
reports of a type count as one. Source: NCAR/DART, guide, "Detailed structure of an obs_seq file".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.errors import InputError
from airswing.flags import WIND_QC
from airswing.reports.audit import Audit
from airswing.reports.columns import Mapped
from airswing.reports.formats import ReportFormat, constant_tail, content_of

_TYPE = re.compile(r"(ACARS|AIRCRAFT|AMDAR|TAMDAR)_(U_WIND_COMPONENT|V_WIND_COMPONENT|TEMPERATURE)")
_VARIABLES = {
    "U_WIND_COMPONENT": "eastward_wind",
    "V_WIND_COMPONENT": "northward_wind",
    "TEMPERATURE": "air_temperature",
}
_PRESSURE, _HEIGHT = 2, 3
_LARGEST_GOOD = 3.0
_MISSING = -888888.0
_PLACE = ["tail", "days", "seconds", "longitude", "latitude", "vertical", "coordinate"]


def _read_sequence(path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    lines = content_of(path).decode("ascii", "replace").splitlines()
    first = _find(lines, r"obs_(type|kind)_definitions")
    types = dict(line.split()[:2] for line in lines[first + 2 : first + 2 + int(lines[first + 1])])
    counts = _find(lines, r"num_copies.*")
    copies, checks = (int(value) for value in re.findall(r":\s*(\d+)", lines[counts])[:2])
    total = int(re.findall(r"\d+", lines[_find(lines, r"num_obs.*")])[0])
    starts = [n for n in range(counts, len(lines)) if re.match(r"\s*OBS\s+\d+\s*$", lines[n])]
    if len(starts) != total:
        raise ValueError(f"{total:,} observations by its header, {len(starts):,} in the file")
    records = []
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        block = "\n".join(lines[start + 1 : stop]).rstrip().split("\n")
        location, kind = _find(block, "loc3d"), _find(block, "kind|type")
        name = _TYPE.fullmatch(types[block[kind + 1].strip()])
        longitude, latitude, vertical, coordinate = block[location + 1].split()[:4]
        value = float(block[0])
        if name is None or value == _MISSING or int(coordinate) not in (_PRESSURE, _HEIGHT):
            continue
        # Time and error variance are the last lines, after those specific to a type.
        seconds, days = block[-2].split()[:2]
        failed = any(float(code) > _LARGEST_GOOD for code in block[copies : copies + checks])
        place = (float(longitude), float(latitude), float(vertical), int(coordinate))
        records.append(
            (name[1], int(days), int(seconds), *place, _VARIABLES[name[2]], value, failed)
        )
    audit.drop("other_type", len(starts) - len(records), unread=True)
    if not records:
        raise InputError("holds no winds or temperatures of aircraft")
    audit.remark(
        "DART observation sequences do not name the aircraft: all reports of a type are taken as "
        "one aircraft, and compasses cannot be fitted"
    )
    table = pd.DataFrame.from_records(records, columns=[*_PLACE, "variable", "value", "failed"])
    wide = table.pivot_table(index=_PLACE, columns="variable", values="value", aggfunc="first")
    wide = wide.reindex(columns=list(_VARIABLES.values()))
    fails = table.groupby(_PLACE)["failed"].max().reindex(wide.index).to_numpy(dtype=bool)
    raw = wide.reset_index()
    since_1601 = raw["days"].to_numpy("m8[D]") + raw["seconds"].to_numpy("m8[s]")
    yield raw.drop(columns=["days", "seconds", "vertical", "coordinate"]).assign(
        tail=constant_tail(mapping) or raw["tail"],
        time=(np.datetime64("1601-01-01", "s") + since_1601).astype("datetime64[ns]"),
        latitude=np.degrees(raw["latitude"]),
        longitude=np.degrees(raw["longitude"]),
        pressure=raw["vertical"].where(raw["coordinate"] == _PRESSURE),
        pressure_altitude=raw["vertical"].where(raw["coordinate"] == _HEIGHT),
        wind_qc=np.where(fails, WIND_QC["fail"], WIND_QC["missing"]),
    )


def _find(lines: list[str], pattern: str) -> int:
    """Number of the first line of a pattern; a ValueError where there is none."""
    for number, line in enumerate(lines):
        if re.fullmatch(pattern, line.strip()):
            return number
    raise ValueError(f"no line {pattern!r}")


FORMATS = (
    ReportFormat(
        "dart",
        lambda start: start.lstrip().startswith(b"obs_sequence"),
        _read_sequence,
        title="a DART observation sequence (binary ones are converted by obs_sequence_tool)",
    ),
)
