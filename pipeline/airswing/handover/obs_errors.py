"""obserr.txt: wind errors of aircraft reports as OBSPROC gives them to WRFDA.

Layout of var/obsproc/obserr.txt of WRF 4.7.1: tables of seven values a line, four lines a type of
report, at 26 pressures from 10 to 1100 hPa and two place holders; for wind one table each of the
components (UV), of speed (SPD) and of direction (DIR). OBSPROC interpolates in pressure and gives
every report of a type the same profile: there is no error by report, leg or aircraft in this file
(ob.ascii holds that), so a folder gets one table more for each phase of flight, for those who run
OBSPROC once for each. WRFDA looks at SPD and DIR only with ``wind_sd_tamdar`` or ``wind_sd_airep``.

Written are the rows of the types the archive's aircraft have (TAMDARS; AIREPS for AMDAR, ACARS and
AIREP), at the pressures the measured errors cover; all else stays as it is in the table begun from.
Values carry two decimals in the six columns of the original: the reader takes the point as it
stands.
"""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airswing.errors import InputError
from airswing.handover.records.platforms import PLATFORMS, platforms
from airswing.handover.records.registry import (
    Account,
    ExportFormat,
    FileAccount,
    Request,
    register,
)
from airswing.handover.records.run_products import errors_beside, none_known, refuse_existing

if TYPE_CHECKING:
    import xarray as xr


LEVELS = (10, 20, 30, 40, 50, *range(100, 1101, 50))
"""hPa of the values of a wind table; two place holders follow."""
FILE_NAME = "obserr.txt"
GROSS_CHECK = 5.0  # Errors beyond which WRFDA rejects a component (``max_error_uv``)
_SECTION = re.compile(r"\b(\w+)\s+SENSOR ERRORS")
_ROW = re.compile(r"((?:\s*-?\d+\.\d*){7})(\s*)(.*)", re.DOTALL)
# Numbers in a line and lines of a type of report, as WRFDA reads them.
_A_LINE, _LINES = 7, 4
_LARGEST = 90.0  # Degrees: a direction that is not known any better is not known


def write(request: Request) -> Account:
    """Write the error table, and one for each phase of flight where it is a folder."""
    from airswing.products.whole_files import write_text

    base = _base(request)
    types = _report_types(request)
    own = errors_beside(request).sel(state=request.winds)
    targets = {
        phase: request.path / name if request.folder else request.path
        for phase, name in _names(own, folder=request.folder).items()
    }
    refuse_existing(request, *targets.values())
    written: list[FileAccount] = []
    for phase, target in targets.items():
        tables = _wind_tables(own, phase)
        write_text(target, _changed_table(base, tables, types))
        levels = {str(level): round(value, 2) for level, value in tables["UV"].items()}
        written.append({"path": str(target), "flight_phase": phase, "errors": levels})
    return {"files": written, "types": types, "notes": _notes(own, request.winds)}


def _base(request: Request) -> str:
    """The table to begin from: one that was given, or WRF's own."""
    given = request.settings.base
    if given is None:
        return (files("airswing.handover") / "data" / FILE_NAME).read_text(encoding="ascii")
    try:
        # Any octets come through latin-1 as they were; names of authors stand in such
        # tables.
        return Path(given).read_bytes().decode("latin-1")
    except OSError as err:
        raise InputError("cannot be read", file=given, found=err.strerror) from err


def _report_types(request: Request) -> list[str]:
    """Types of report in OBSPROC's table that the archive's aircraft are."""
    found = set(platforms(request.corrected, request.settings).tolist())
    tamdar = PLATFORMS.index("TAMDAR")
    return [*(["TAMDARS"] if tamdar in found else []), *(["AIREPS"] if found - {tamdar} else [])]


def _names(own: xr.Dataset, *, folder: bool) -> dict[str, str]:
    """File of each phase of flight whose errors are known."""
    known = own["observation_error"].notnull().any("layer")
    if not bool(known.sel(flight_phase="all")):
        raise none_known(own)
    phases = [str(name) for name in own["flight_phase"].to_numpy()[known.to_numpy()]]
    names = {phase: f"obserr_{phase}.txt" for phase in phases if phase != "all"}
    return {"all": FILE_NAME, **(names if folder else {})}


def _wind_tables(own: xr.Dataset, phase: str) -> dict[str, dict[int, float]]:
    """Errors at the pressures (hPa) of a wind table that measured layers cover, by section.

    ``UV`` and ``SPD`` (m/s) are the error of a component; ``DIR`` (degrees) is the angle it has at
    the layer's median speed.
    """
    error = own["observation_error"].sel(flight_phase=phase).to_numpy()
    bottom, top = (own[f"layer_{end}_pressure"].to_numpy() / 100.0 for end in ("bottom", "top"))
    speed = own["median_wind_speed"].to_numpy()
    known = np.isfinite(error) & (error > 0.0)
    middle = 0.5 * (bottom + top)
    angle = np.minimum(np.degrees(np.arctan2(error, np.nan_to_num(speed, nan=0.0))), _LARGEST)
    found: dict[str, dict[int, float]] = {"UV": {}, "SPD": {}, "DIR": {}}
    order = np.flatnonzero(known)[np.argsort(middle[known])]
    for level in LEVELS:
        if not ((bottom[order] >= level) & (top[order] <= level)).any():
            continue
        for section, values in (("UV", error), ("SPD", error), ("DIR", angle)):
            found[section][level] = float(np.interp(level, middle[order], values[order]))
    return found


def _changed_table(base: str, tables: dict[str, dict[int, float]], types: list[str]) -> str:
    """The table with the errors of some types of report changed; all else as it was.

    Raises
    ------
    InputError
        If a row is not there.
    """
    lines = base.splitlines(keepends=True)
    section, done = "", set()
    for place, line in enumerate(lines):
        row = _ROW.match(line)
        if row is None:
            continue
        named = _SECTION.search(row[3])
        section = named[1] if named else section
        words = row[3].split()
        if section in tables and words and words[0] in types:
            # The type stands on the first of its four lines.
            lines[place : place + _LINES] = _block(lines[place : place + _LINES], tables[section])
            done.add((section, words[0]))
    missing = [f"{one} {kind}" for one in tables for kind in types if (one, kind) not in done]
    if missing:
        raise InputError(
            "not a table of observation errors as OBSPROC reads it",
            field="--base",
            found=f"no rows of {', '.join(missing)}",
            remedy="Give a var/obsproc/obserr.txt of WRF, or none",
        )
    return "".join(lines)


def _block(lines: list[str], errors: dict[int, float]) -> list[str]:
    """The four lines of a type, with the errors at some levels."""
    changed = []
    for row, line in enumerate(lines):
        match = _ROW.match(line)
        if match is None:
            raise InputError(
                "a type of report has fewer than four lines", field="--base", found=line.strip()
            )
        values = re.findall(r"\s*-?\d+\.\d*", match[1])
        for place in range(_A_LINE):
            number = row * _A_LINE + place
            if number < len(LEVELS) and LEVELS[number] in errors:
                values[place] = f"{errors[LEVELS[number]]:6.2f}"
        changed.append("".join(values) + match[2] + match[3])
    return changed


def _notes(own: xr.Dataset, winds: str) -> list[str]:
    """What a small error does in WRFDA, in words."""
    error = float(own["fleet_observation_error"])
    number = own["observation_count"].sel(flight_phase="all")
    square = own["disagreement_rms"].sel(flight_phase="all") ** 2
    spread = float(np.sqrt((square.fillna(0.0) * number).sum() / number.sum()))
    return [
        f"error of a component {error:.2f} m/s as {winds}; WRFDA's gross check rejects components "
        f"more than {GROSS_CHECK:g} errors, {GROSS_CHECK * error:.1f} m/s, from its first guess: "
        f"{GROSS_CHECK * error / spread:.1f} times the rms disagreement with the reference here "
        f"({spread:.1f} m/s). Where that is under 3, raise max_error_uv in the namelist",
        "speed and direction errors count only with wind_sd_tamdar or wind_sd_airep",
    ]


register(ExportFormat("obs_errors", "wind errors for OBSPROC and WRFDA (obserr.txt)", write))
