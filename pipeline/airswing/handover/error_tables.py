"""Tables of wind errors: obserr.txt for OBSPROC and WRFDA (WRF 4.7.1), CSV for JEDI.

obserr.txt has tables of seven values a line, four lines a type of report, at 26 pressures and two
place holders; for wind one table each of components (UV), speed (SPD) and direction (DIR). A folder
gets a further table for each phase of flight. Only the types the archive's aircraft have are
changed, by the base errors of `wind_errors`, interpolated between the middles of the layers.

JEDI's files are those of UFO's DataExtractor: a line of names ``Group/variable``, a line of types,
then rows, ``_`` for a missing value; station ``_`` is for stations without rows. A file has one
payload column, so each wind component has a file. ObsFunction DrawObsErrorFromFile reads variances
from the group ``ErrorVariance``. Files of ioda-converters pad aircraft identifiers to eight
characters: a shorter one has its rows twice, unpadded and padded.
"""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any

import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.flags import published
from airswing.handover.selection import (
    PLATFORMS,
    Request,
    identifiers,
    platforms,
    product_of_run,
    refuse_existing,
    selected_rows,
)
from airswing.handover.wind_errors import WindErrors, base_variance, bounded, known_errors
from airswing.products.whole_files import write_text

# --- obserr.txt --------------------------------------------------------------------------------

LEVELS = (10, 20, 30, 40, 50, *range(100, 1101, 50))  # hPa of the values of a wind table
FILE_NAME = "obserr.txt"
GROSS_CHECK = 5.0  # errors beyond which WRFDA rejects a component (``max_error_uv``)
LARGEST_ANGLE = 90.0  # degrees; a direction error of that size means an unknown direction
_SECTION = re.compile(r"\b(\w+)\s+SENSOR ERRORS")
_ROW = re.compile(r"((?:\s*-?\d+\.\d*){7})(\s*)(.*)", re.DOTALL)
_A_LINE, _LINES = 7, 4  # numbers in a line, lines of a type of report
Tables = dict[str, dict[int, float]]


def write_obs_errors(request: Request) -> dict[str, Any]:
    """Write the error table, and one for each phase of flight where the path is a folder."""
    base = request.settings.base or files("airswing.handover") / "data" / FILE_NAME
    try:
        # Any byte passes unchanged through latin-1; such tables hold names of authors.
        text = base.read_bytes().decode("latin-1")
    except OSError as err:
        raise InputError("cannot be read", file=base, found=err.strerror) from err
    codes = set(platforms(request).tolist())
    tamdar = PLATFORMS.index("TAMDAR")
    types = ["TAMDARS"] * (tamdar in codes) + ["AIREPS"] * bool(codes - {tamdar})
    table = known_errors(request)
    targets = {"all": request.path}
    if request.folder:
        measured = table["observation_error"].notnull().any("layer").to_numpy()
        names = map(str, table["flight_phase"].to_numpy()[measured])
        targets = {name: request.path / f"obserr_{name}.txt" for name in ("all", *names)}
        targets["all"] = request.path / FILE_NAME
    refuse_existing(request, *targets.values())
    written: list[dict[str, Any]] = []
    for phase, target in targets.items():
        tables = wind_tables(table, phase)
        write_text(target, changed_table(text, tables, types))
        levels = {str(level): round(value, 2) for level, value in tables["UV"].items()}
        written.append({"path": str(target), "flight_phase": phase, "errors": levels})
    error = float(table["fleet_observation_error"])
    number = table["observation_count"].sel(flight_phase="all")
    square = table["disagreement_rms"].sel(flight_phase="all") ** 2
    spread = float(np.sqrt((square.fillna(0.0) * number).sum() / number.sum()))
    notes = [
        f"error of a component {error:.2f} m/s as {request.winds}; WRFDA's gross check rejects "
        f"components more than {GROSS_CHECK:g} errors, {GROSS_CHECK * error:.1f} m/s, from its "
        f"first guess: {GROSS_CHECK * error / spread:.1f} times the rms disagreement with the "
        f"reference here ({spread:.1f} m/s). Where that is under 3, raise max_error_uv in the "
        "namelist",
        "speed and direction errors count only with wind_sd_tamdar or wind_sd_airep",
    ]
    return {"files": written, "types": types, "notes": notes}


def wind_tables(table: xr.Dataset, phase: str) -> Tables:
    """Errors at the pressures (hPa) of a wind table, by section.

    ``UV`` and ``SPD`` (m/s) are the error of a component, ``DIR`` (degrees) its angle at the median
    wind speed of the layer.
    """
    middle = 0.005 * (table["layer_bottom_pressure"] + table["layer_top_pressure"]).to_numpy()[::-1]
    error = np.sqrt(bounded(base_variance(table, phase), 0.0))[::-1]
    speed = table["median_wind_speed"].to_numpy()[::-1]
    there = np.isfinite(speed)
    # A layer without reports has the nearest layer's speed.
    speed = np.interp(middle, middle[there], speed[there]) if there.any() else np.zeros(speed.size)
    angle = np.minimum(np.degrees(np.arctan2(error, speed)), LARGEST_ANGLE)
    columns = {"UV": error, "SPD": error, "DIR": angle}
    return {
        section: dict(zip(LEVELS, np.interp(LEVELS, middle, column).tolist(), strict=True))
        for section, column in columns.items()
    }


def changed_table(text: str, tables: Tables, types: list[str]) -> str:
    """Text of an obserr.txt in which the errors of some types of report are replaced."""
    lines = text.splitlines(keepends=True)
    section, changed = "", set()
    for place, line in enumerate(lines):
        row = _ROW.match(line)
        if row is None:
            continue
        named = _SECTION.search(row[3])
        section = named[1] if named else section
        words = row[3].split()
        if section in tables and words and words[0] in types:
            # The type is named on the first of its four lines.
            for number, old in enumerate(lines[place : place + _LINES]):
                match = _ROW.match(old)
                if match is None:
                    raise InputError(
                        "a type of report has fewer than four lines",
                        field="--base",
                        found=old.strip(),
                    )
                values = re.findall(r"\s*-?\d+\.\d*", match[1])
                for k, level in enumerate(LEVELS[_A_LINE * number : _A_LINE * (number + 1)]):
                    if level in tables[section]:
                        values[k] = f"{tables[section][level]:6.2f}"
                lines[place + number] = "".join([*values, match[2], match[3]])
            changed.add((section, words[0]))
    missing = [f"{name} {kind}" for name in tables for kind in types if (name, kind) not in changed]
    if missing:
        raise InputError(
            "not a table of observation errors as OBSPROC reads it",
            field="--base",
            found=f"no rows of {', '.join(missing)}",
            remedy="Give a var/obsproc/obserr.txt of WRF, or none",
        )
    return "".join(lines)


# --- JEDI --------------------------------------------------------------------------------------

STATION = "MetaData/stationIdentification"
PRESSURE = "MetaData/pressure"
COMPONENTS = ("windEastward", "windNorthward")
COEFFICIENTS = "deviation_coefficients.csv"
EVERY_STATION = "_"
PADDED = 8  # characters of an aircraft identifier in files of ioda-converters


def write_jedi(request: Request) -> dict[str, Any]:
    """Write the tables into a folder."""
    if request.path.is_file():
        raise InputError(
            "is a file, and there are several tables",
            file=request.path,
            remedy="Name a folder with -o",
        )
    targets = {name: request.path / f"wind_error_{name}.csv" for name in COMPONENTS}
    coefficients = request.path / COEFFICIENTS
    refuse_existing(request, *targets.values(), coefficients)
    written = dict(zip(request.aircraft, identifiers(request), strict=True))
    rows = _error_rows(request, written)
    tables = {
        target: [f"{STATION},{PRESSURE},ErrorVariance/{name}", "string,float,float", *rows]
        for name, target in targets.items()
    }
    with product_of_run(request, "fits", why="it holds the coefficients") as fits:
        reference = str(request.corrected.attrs.get("correction_reference", ""))
        tables[coefficients] = _coefficient_rows(fits.load(), reference, written)
    for target, table in tables.items():
        write_text(target, "\n".join(table) + "\n")
    files = [{"path": str(target), "rows": len(table) - 2} for target, table in tables.items()]
    notes = [
        "errors are read by DrawObsErrorFromFile: interpolation of stationIdentification exact, of "
        "pressure linear, extrapolation mode nearest",
        f"{COEFFICIENTS} is for those who correct before the assimilation: heading error = A + "
        "B sin m + C cos m + D sin 2m + E cos 2m (degrees, m the indicated magnetic heading), B "
        "and C at horizontalField (nT); JEDI itself does not read it",
    ]
    return {"files": files, "notes": notes}


def _error_rows(request: Request, written: dict[str, str]) -> list[str]:
    """Rows of station, pressure (Pa) and error variance, those of all other stations first."""
    table = known_errors(request)
    base = base_variance(table, "all")[::-1]
    pressure = 0.5 * (table["layer_bottom_pressure"] + table["layer_top_pressure"]).to_numpy()[::-1]
    errors = WindErrors(request, selected_rows(request).rows, table)
    excess = dict(zip(written, errors.aircraft_excess.tolist(), strict=True))
    stations = {EVERY_STATION: 0.0}
    for name in sorted(written):
        if np.isfinite(excess[name]):
            stations |= dict.fromkeys([written[name], written[name].ljust(PADDED)], excess[name])
    return [
        f"{station},{at:.0f},{variance:.4f}"
        for station, more in stations.items()
        for at, variance in zip(pressure, bounded(base, more), strict=True)
    ]


def _coefficient_rows(fits: xr.Dataset, reference: str, written: dict[str, str]) -> list[str]:
    names = [str(name) for name in fits["reference"].to_numpy()]
    fit = fits.sel(reference=reference if reference in names else names[0])
    fit = fit.isel(aircraft=np.flatnonzero(published(fit["status"])))
    table = fit["deviation"].transpose("aircraft", "coefficient").to_pandas()
    table = table.assign(
        airspeedScale=fit["airspeed_scale"].to_numpy(),
        horizontalField=fit["mean_horizontal_field"].to_numpy(),
    )
    header = [STATION, *(f"DeviationCoefficientValue/{name}" for name in table)]
    rows = [",".join(header), ",".join(["string", *["float"] * table.shape[1]])]
    for name, *values in table.itertuples():
        texts = [f"{value:.6g}" if np.isfinite(value) else EVERY_STATION for value in values]
        rows.append(",".join([written.get(name, name), *texts]))
    return rows
