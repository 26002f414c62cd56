"""CSV tables for JEDI: errors by aircraft and pressure, and the coefficients of the corrections.

Layout of the files UFO's DataExtractor reads (ufo, src/ufo/utils/dataextractor): a line of names
``Group/variable``, a line of types, then rows of as many columns, ``_`` for a value that is
missing; a row whose station is ``_`` is what stations without rows of their own get. The payload is
one column, so there is a file for each wind component. ObsFunction DrawObsErrorFromFile reads
variances (its default ``dispersion measure``) from the group ``ErrorVariance``; stations are
matched ``exact``, pressure is ``nearest`` or ``linear``, and ``extrapolation mode`` has to be
``nearest``: by default a pressure outside the table stops the run. JEDI of before 2022 wrote
``variable@Group`` and other names of variables.

A correction of a compass cannot be drawn as an observation bias, since the error turns with the
heading: for those who correct upstream there is a table of the coefficients (degrees, by indicated
magnetic heading), in the same layout but with several columns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import published
from airswing.handover.records.platforms import identifiers
from airswing.handover.records.registry import (
    Account,
    ExportFormat,
    FileAccount,
    Request,
    register,
)
from airswing.handover.records.run_products import (
    errors_beside,
    none_known,
    product_beside,
    refuse_existing,
)

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
STATION = "MetaData/stationIdentification"
PRESSURE = "MetaData/pressure"
COMPONENTS = ("windEastward", "windNorthward")
COEFFICIENTS = "deviation_coefficients.csv"
EVERY_STATION = "_"
# Of a layer's variance: what is at least left to an aircraft better than the rest.
LEAST_SHARE = 0.25


def write(request: Request) -> Account:
    """Write the tables into a folder."""
    from airswing.products.whole_files import write_text

    if request.path.is_file():
        raise InputError(
            "is a file, and there are several tables",
            file=request.path,
            remedy="Name a folder with -o",
        )
    tails = map(str, request.corrected["aircraft"].to_numpy())
    called = dict(zip(tails, identifiers(request.corrected, request.settings), strict=True))
    targets = {name: request.path / f"wind_error_{name}.csv" for name in COMPONENTS}
    coefficients = request.path / COEFFICIENTS
    refuse_existing(request, *targets.values(), coefficients)
    rows = _error_rows(errors_beside(request), request.winds, called)
    with product_beside(request, "fits.nc", why="it holds the coefficients") as product:
        fits = product.load()
    files: list[FileAccount] = []
    for component, target in targets.items():
        head = [f"{STATION},{PRESSURE},ErrorVariance/{component}", "string,float,float"]
        write_text(target, "\n".join([*head, *rows]) + "\n")
        files.append({"path": str(target), "rows": len(rows)})
    reference = str(request.corrected.attrs.get("correction_reference", ""))
    table = _coefficient_rows(fits, reference, called)
    write_text(coefficients, "\n".join(table) + "\n")
    files.append({"path": str(coefficients), "rows": len(table) - 2})
    return {"files": files, "notes": _notes()}


def _error_rows(errors: xr.Dataset, winds: str, called: Mapping[str, str]) -> list[str]:
    """Rows of station, pressure and error variance from ``observation_errors.nc``.

    Those of all other stations first, then the archive's; pressures increasing.
    """
    own = errors.sel(state=winds)
    layer = own["observation_error_filled"].sel(flight_phase="all").to_numpy() ** 2
    fleet = float(own["fleet_observation_error"]) ** 2
    if not np.isfinite(fleet):
        raise none_known(errors)
    pressure = 0.5 * (own["layer_bottom_pressure"] + own["layer_top_pressure"]).to_numpy()
    order = np.argsort(pressure)
    aircraft = own["aircraft_observation_error"].to_numpy() ** 2
    rows = _station(EVERY_STATION, layer[order], pressure[order])
    for place in np.argsort(names := [str(name) for name in own["aircraft"].to_numpy()]):
        if np.isfinite(aircraft[place]):
            # The profile of the fleet, moved by what this aircraft's variance differs:
            # no aircraft has reports enough for a profile of its own.
            variance = np.maximum(layer + aircraft[place] - fleet, LEAST_SHARE * layer)
            rows += _station(
                called.get(names[place], names[place]), variance[order], pressure[order]
            )
    return rows


def _station(name: str, variance: Floats, pressure: Floats) -> list[str]:
    return [f"{name},{at:.0f},{one:.4f}" for at, one in zip(pressure, variance, strict=True)]


def _coefficient_rows(fits: xr.Dataset, reference: str, called: Mapping[str, str]) -> list[str]:
    """Lines of the table of coefficients: names, types, and a row for every trusted fit.

    ``reference`` is the fit the correction was made with; the first where it is not told.
    """
    names = [str(name) for name in fits["reference"].to_numpy()]
    own = fits.sel(reference=reference if reference in names else names[0])
    columns = [str(name) for name in own["coefficient"].to_numpy()]
    head = ",".join(
        [
            STATION,
            *(f"DeviationCoefficientValue/{name}" for name in columns),
            "DeviationCoefficientValue/airspeedScale",
            "DeviationCoefficientValue/horizontalField",
        ]
    )
    rows = [head, ",".join(["string", *["float"] * (len(columns) + 2)])]
    good = published(own["status"])
    table = own["deviation"].transpose("aircraft", "coefficient").to_numpy()
    more = [own[name].to_numpy() for name in ("airspeed_scale", "mean_horizontal_field")]
    for place, name in enumerate(map(str, own["aircraft"].to_numpy())):
        if good[place]:
            values = [*table[place], more[0][place], more[1][place]]
            rows.append(",".join([called.get(name, name), *(_number(value) for value in values)]))
    return rows


def _number(value: float) -> str:
    return f"{value:.6g}" if np.isfinite(value) else EVERY_STATION


def _notes() -> list[str]:
    return [
        "errors are read by DrawObsErrorFromFile: interpolation of stationIdentification exact, of "
        "pressure linear, extrapolation mode nearest",
        f"{COEFFICIENTS} is for those who correct upstream: heading error = A + B sin m + C cos m "
        "+ D sin 2m + E cos 2m (degrees, m the indicated magnetic heading), B and C at "
        "horizontalField (nT); JEDI itself does not read it",
    ]


register(ExportFormat("jedi", "errors by aircraft and pressure for JEDI (CSV)", write))
