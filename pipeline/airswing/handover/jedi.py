"""CSV tables for JEDI: wind errors by aircraft and pressure, and the coefficients of corrections.

Files of UFO's DataExtractor: a line of names ``Group/variable``, a line of types, then rows, ``_``
for a missing value; station ``_`` is for stations without rows. A file has one payload column, so
each wind component has a file. ObsFunction DrawObsErrorFromFile reads variances from the group
``ErrorVariance``. Files of ioda-converters pad aircraft identifiers to eight characters: a shorter
one has its rows twice, as it is and padded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from airswing.errors import InputError
from airswing.flags import published
from airswing.handover.request import Request, product_of_run, refuse_existing
from airswing.handover.selection import identifiers, selected_rows
from airswing.handover.wind_errors import WindErrors, base_variance, bounded, known_errors
from airswing.products.whole_files import write_text

if TYPE_CHECKING:
    import xarray as xr

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
    names = request.aircraft
    written = dict(zip(names, identifiers(request), strict=True))
    rows = _error_rows(request, written)
    with product_of_run(request, "fits", why="it holds the coefficients") as fits:
        reference = str(request.corrected.attrs.get("correction_reference", ""))
        table = _coefficient_rows(fits.load(), reference, written)
    files: list[dict[str, Any]] = []
    for component, target in targets.items():
        top = [f"{STATION},{PRESSURE},ErrorVariance/{component}", "string,float,float"]
        write_text(target, "\n".join([*top, *rows]) + "\n")
        files.append({"path": str(target), "rows": len(rows)})
    write_text(coefficients, "\n".join(table) + "\n")
    files.append({"path": str(coefficients), "rows": len(table) - 2})
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
    known = known_errors(request, required=True)
    assert known is not None
    base = base_variance(known, "all")[::-1]
    pressure = 0.5 * (known["layer_bottom_pressure"] + known["layer_top_pressure"]).to_numpy()[::-1]
    errors = WindErrors(request, selected_rows(request).rows, known)
    rows = _station(EVERY_STATION, pressure, bounded(base, 0.0))
    excess = dict(zip(written, errors.aircraft_excess, strict=True))
    for name in sorted(written):
        if np.isfinite(excess[name]):
            variance = bounded(base, excess[name])
            for station in dict.fromkeys([written[name], written[name].ljust(PADDED)]):
                rows += _station(station, pressure, variance)
    return rows


def _station(name: str, pressure: np.ndarray, variance: np.ndarray) -> list[str]:
    return [f"{name},{at:.0f},{one:.4f}" for at, one in zip(pressure, variance, strict=True)]


def _coefficient_rows(fits: xr.Dataset, reference: str, written: dict[str, str]) -> list[str]:
    """Table of coefficients: names, types, and a row for each published fit of a reference."""
    names = [str(name) for name in fits["reference"].to_numpy()]
    fit = fits.sel(reference=reference if reference in names else names[0])
    columns = [str(name) for name in fit["coefficient"].to_numpy()]
    payload = [*columns, "airspeedScale", "horizontalField"]
    header = [STATION, *(f"DeviationCoefficientValue/{name}" for name in payload)]
    rows = [",".join(header), ",".join(["string", *["float"] * len(payload)])]
    deviation = fit["deviation"].transpose("aircraft", "coefficient").to_numpy()
    more = [fit[name].to_numpy() for name in ("airspeed_scale", "mean_horizontal_field")]
    for place in np.flatnonzero(published(fit["status"])):
        name = str(fit["aircraft"].to_numpy()[place])
        values = [*deviation[place], *(column[place] for column in more)]
        texts = [f"{value:.6g}" if np.isfinite(value) else EVERY_STATION for value in values]
        rows.append(",".join([written.get(name, name), *texts]))
    return rows
