"""NetCDF products: written whole or not at all, read as they were described.

A product is written under a temporary name beside its target and renamed when complete
(:mod:`airswing.products.whole_files`), so that a reader never sees half a file and an interruption
leaves the earlier product intact.
"""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Hashable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple, TypedDict

import netCDF4
import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.products.classic_netcdf import require_whole
from airswing.products.monthly import joined_months
from airswing.products.openable import require_openable, written_here
from airswing.products.whole_files import atomic, plain
from airswing.version import __version__
from airswing.vocabulary import describe, lookup

INSTITUTION = "airswing"
REFERENCES = (
    "Jacobs et al. (2010), TAMDAR update: magnetic deviation correction, AMS; "
    "Jacobs, Mulally & Anderson (2014), J. Atmos. Oceanic Technol. 31(8), 1733-1747"
)
_TIME_ATTRIBUTES = {
    "units": "milliseconds since 1970-01-01",
    "calendar": "standard",
    "_FillValue": np.iinfo(np.int64).min,
}
DAMAGE = (
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What the libraries raise on a file whose octets contradict each other."""
# Octets a variable; the library's own 16 MiB are hundreds of megabytes a product.
_CHUNK_CACHE = 2**20
REPORTS_A_CHUNK = 65_536
"""Few enough that one aircraft of ten million reports is read in well under a second."""
STORED_STEP = {
    "reference_eastward_wind": 2.0**-10,
    "reference_northward_wind": 2.0**-10,
    "ground_speed": 2.0**-10,
    "ground_eastward_velocity": 2.0**-10,
    "ground_northward_velocity": 2.0**-10,
    "ground_velocity_error": 2.0**-10,
    "airspeed": 2.0**-10,
    "airspeed_error": 2.0**-10,
    "climb_rate": 2.0**-10,
    "longitudinal_acceleration": 2.0**-14,
    "track": 2.0**-10,
    "turn": 2.0**-10,
    "bank": 2.0**-10,
    "heading": 2.0**-10,
    "heading_standard_error": 2.0**-6,
    "magnetic_heading": 2.0**-10,
    "heading_error": 2.0**-10,
    "heading_error_standard_error": 2.0**-10,
    "declination": 2.0**-10,
    "dip": 2.0**-10,
    "horizontal_field": 2.0**-4,
    "reference_eastward_wind_tendency": 2.0**-24,
    "reference_northward_wind_tendency": 2.0**-24,
    "reference_eastward_wind_lnp_derivative": 2.0**-8,
    "reference_northward_wind_lnp_derivative": 2.0**-8,
    "reference_eastward_wind_x_derivative": 2.0**-27,
    "reference_northward_wind_x_derivative": 2.0**-27,
    "reference_eastward_wind_y_derivative": 2.0**-27,
    "reference_northward_wind_y_derivative": 2.0**-27,
    "grid_convergence": 2.0**-10,
}
"""Step that derived variables of every report are rounded to before they are written, in their
unit: about a thousandth of a degree or of a metre a second, far below what they are known to. The
bits so left zero halve the file. What was reported is written as it came."""

# Those of them that run from 0 to, but not including, 360 degrees.
DIRECTIONS = ("heading", "magnetic_heading", "track")


def write_product(
    ds: xr.Dataset,
    path: Path,
    *,
    title: str,
    config_json: str = "",
    sources: Sequence[str] = (),
    source_uuids: Sequence[str] = (),
) -> Path:
    """Write a Dataset as a described, compressed NetCDF-4 product, atomically.

    Parameters
    ----------
    ds : Dataset
        Every variable must be in the vocabulary.
    config_json : str, optional
        The configuration the product was made with, as JSON.
    sources : sequence of str, optional
        What went in, one phrase each.
    source_uuids : sequence of str, optional
        Identifiers of the products this one was made from.

    Returns
    -------
    Path
        The path written.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = Path(path)
    ds = describe(ds)
    ds.attrs = {
        **{key: attribute_value(value) for key, value in ds.attrs.items()},
        **provenance(title, config_json=config_json, sources=sources, source_uuids=source_uuids),
    }
    with atomic(path) as temporary:
        ready = with_plain_times(ds.drop_encoding())
        ready.to_netcdf(temporary, engine="netcdf4", encoding=_encodings(ready))
    written_here(path)
    return path


def as_stored(ds: xr.Dataset) -> xr.Dataset:
    """Give every variable the precision it is written with: its type, and `STORED_STEP`.

    What follows from a Dataset in memory is then the same as what follows from its product.

    Parameters
    ----------
    ds : Dataset
        Every variable must be in the vocabulary.
    """
    changed: dict[object, object] = {}
    for name, variable in ds.variables.items():
        if name in ds.coords:
            continue
        dtype, values = lookup(str(name), variable.dims).dtype, variable.to_numpy()
        step, attrs = STORED_STEP.get(str(name), 0.0), variable.attrs
        if step:
            stored = values * (1.0 / step)  # a power of two: nothing is lost
            np.rint(stored, out=stored)
            stored *= step
            if name in DIRECTIONS:
                stored %= 360.0  # what rounds up to a whole turn is north
            changed[name] = (
                variable.dims,
                stored.astype(dtype, copy=False),
                {**attrs, "stored_step": step},
            )
        elif dtype.startswith("f") and variable.dtype != dtype:
            changed[name] = variable.dims, values.astype(dtype), attrs
    return ds.assign(changed)


def provenance(
    title: str,
    *,
    config_json: str = "",
    sources: Sequence[str] = (),
    source_uuids: Sequence[str] = (),
) -> dict[str, str]:
    """Global attributes that say what a product is and where it came from."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "Conventions": "CF-1.11",
        "title": title,
        "institution": INSTITUTION,
        "source": "; ".join(sources) or "aircraft reports and model winds",
        "history": f"{now} airswing {__version__}",
        "references": REFERENCES,
        "airswing_config": config_json,
        "airswing_version": __version__,
        "uuid": str(uuid.uuid4()),
        "source_uuids": " ".join(source_uuids),
    }


def read_product(path: Path, *, lazy: bool = False) -> xr.Dataset:
    """Read a product that :func:`write_product` wrote, or a folder of its months as one.

    Parameters
    ----------
    lazy : bool, default False
        Read a variable, or the part of it asked for, each time it is looked at, and keep nothing
        (see :mod:`airswing.products.ragged`); else read everything and close the file.

    Raises
    ------
    InputError
        If the product is absent or not a NetCDF file.
    """
    path = Path(path)
    if path.is_dir():
        return _read_months(path, lazy=lazy)
    if not path.exists():
        raise InputError(
            "no such product", file=path, remedy="Run the stage that makes it, or `airswing run`"
        )
    limit_chunk_cache()
    try:
        require_whole(path)
        require_openable(path)
        ds = xr.open_dataset(path, engine="netcdf4", decode_timedelta=False, cache=False)
        if not lazy:
            with ds:
                ds.load()
    except DAMAGE as err:
        raise InputError(
            "not a product airswing can read", file=path, found=err, remedy="Make it again"
        ) from err
    # Every product has one; a file of the same name may be another program's.
    if "uuid" not in ds.attrs:
        ds.close()
        raise InputError(
            "not a product of airswing",
            file=path,
            found=ds.attrs.get("title"),
            remedy="Move it away and run the stage that makes it",
        )
    wrong = _damage(ds)
    if wrong:
        ds.close()
        raise InputError("a damaged product", file=path, field=wrong, remedy="Make it again")
    return ds


def _read_months(folder: Path, *, lazy: bool) -> xr.Dataset:
    """A folder of months as one Dataset by aircraft, see :mod:`airswing.products.monthly`."""
    months = [read_product(path, lazy=True) for path in sorted(folder.glob("*.nc"))]
    if not months or any("report" not in month.dims for month in months):
        raise InputError(
            "not a folder of products by month", file=folder, remedy="Run `airswing update`"
        )
    try:
        joined = joined_months(months)
    except ValueError as err:
        raise InputError(
            str(err), file=folder, remedy="Run `airswing update`, which makes them alike"
        ) from err
    return joined if lazy else joined.load()


def _damage(ds: xr.Dataset) -> str:
    """Name of what is not as airswing writes it; empty where all is."""
    for told in ("title", "uuid", "history", "airswing_version"):
        if not isinstance(ds.attrs.get(told), str):
            return told
    for name, variable in ds.variables.items():
        try:
            entry = lookup(str(name), variable.dims)
        except (KeyError, ValueError):
            return str(name)
        numbers = variable.dtype.kind in "iufb"
        if numbers != (entry.dtype[:1] in "iufb") and variable.dtype.kind != "M":
            return str(name)
    if "row_size" in ds.variables and "report" in ds.sizes:
        sizes = ds["row_size"].to_numpy()
        if (sizes < 0).any() or int(sizes.sum()) != ds.sizes["report"]:
            return "row_size"
    return ""


def limit_chunk_cache() -> None:
    """Let the NetCDF library keep a few chunks of each variable of the files opened from now on.

    By default it keeps 16 MiB of every variable it reads or writes, hundreds of MB a product.
    """
    netCDF4.set_chunk_cache(size=_CHUNK_CACHE)


def attribute_value(value: object) -> object:
    """NetCDF attributes hold no mappings: those become JSON."""
    return json.dumps(plain(value)) if isinstance(value, (Mapping, list, bool)) else value


def with_plain_times(ds: xr.Dataset) -> xr.Dataset:
    """Turn times into milliseconds: xarray cannot encode a variable whose times are all missing."""
    times = [name for name in ds.variables if np.issubdtype(ds[name].dtype, np.datetime64)]
    missing = np.iinfo(np.int64).min
    for name in times:
        values = ds[name].to_numpy().astype("datetime64[ms]")
        counts = np.where(np.isnat(values), missing, values.astype(np.int64))
        ds[name] = (ds[name].dims, counts, ds[name].attrs | _TIME_ATTRIBUTES)
    return ds


def is_text(variable: xr.DataArray) -> bool:
    """Whether a variable holds names: stored as rows of characters, as CF has them.

    Strings of no fixed length would be read the same, but the HDF5 library crashes, or reports a
    broken file, when a file with such a variable is opened twice in one process (netcdf-c issue
    2510, HDF5 issue 5359, still so in HDF5 2.2.0).
    """
    return lookup(str(variable.name), variable.dims).dtype == "str" or variable.dtype.kind in "OUT"


class Packing(TypedDict, total=False):
    """How chunks are packed: keywords of ``netCDF4.Dataset.createVariable``."""

    zlib: bool
    complevel: Literal[1]
    shuffle: bool
    chunksizes: tuple[int, ...]


class Storage(NamedTuple):
    """How a variable stands in its file."""

    dtype: str
    packing: Packing
    fill: np.generic | None  # where no value is; None where the type has none of its own


def _encodings(ds: xr.Dataset) -> dict[Hashable, dict[str, object]]:
    return {name: _encoding(storage_of(ds[name])) for name in ds.variables}


def _encoding(stored: Storage) -> dict[str, object]:
    """Keywords of ``to_netcdf``."""
    encoding: dict[str, object] = {"dtype": stored.dtype, **stored.packing}
    return encoding if stored.fill is None else encoding | {"_FillValue": stored.fill}


def storage_of(variable: xr.DataArray, sizes: Mapping[Hashable, int] | None = None) -> Storage:
    """How a variable is stored.

    ``sizes`` are those of its dimensions in the file, where it is written in parts.
    """
    sizes = variable.sizes if sizes is None else sizes
    entry = lookup(str(variable.name), variable.dims)
    if is_text(variable):
        return Storage("S1", {}, None)
    time = entry.dtype.startswith("datetime64")
    packing: Packing = {}
    if sizes and math.prod(sizes.values()) > 1:
        packing = {"zlib": True, "complevel": 1, "shuffle": True}
        if "report" in sizes:
            packing["chunksizes"] = tuple(
                min(size, REPORTS_A_CHUNK) if name == "report" else 1
                for name, size in sizes.items()
            )
    fill = np.dtype(entry.dtype).type(np.nan) if entry.dtype.startswith("f") else None
    return Storage("i8" if time else entry.dtype, packing, fill)
