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
REPORTS_A_CHUNK = 32_768
"""Few enough that one aircraft's part of a month is read without much of the others'."""
PRODUCTS = (
    "headings",
    "fits",
    "corrected",
    "error_profiles",
    "observation_errors",
    "innovation_statistics",
    "gap",
    "postprocessed",
)
"""NetCDF products of a run, as :func:`open_results` names them."""
_MAKE = "Run the stage that makes it, or `airswing run`"
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
        Every variable must be in the vocabulary; dask-backed variables stay lazy.
    """
    changed: dict[object, xr.Variable] = {}
    for name, variable in ds.variables.items():
        if name in ds.coords:
            continue
        dtype, step = lookup(str(name), variable.dims).dtype, STORED_STEP.get(str(name), 0.0)
        if step:
            # a power of two: scaling loses nothing
            values = np.rint(variable.data * (1.0 / step)) * step
            if name in DIRECTIONS:
                values = values % 360.0  # what rounds up to a whole turn is north
            attrs = {**variable.attrs, "stored_step": step}
            changed[name] = xr.Variable(variable.dims, values.astype(dtype), attrs)
        elif dtype.startswith("f") and variable.dtype != dtype:
            changed[name] = variable.astype(dtype)
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


def open_product(path: str | Path) -> xr.Dataset:
    """Open a product, or a folder of its months as one Dataset, lazily.

    Parameters
    ----------
    path : str or path
        A file such as ``results/fits.nc``, or a folder of months such as ``results/headings``.

    Returns
    -------
    Dataset
        A product of every report is dask-backed in chunks of whole aircraft, ordered by aircraft
        and time, with ``row_size`` reports of each. Nothing is kept in memory of what is read.

    Raises
    ------
    InputError
        If the product is absent, damaged or not one of airswing.
    """
    path = Path(path).expanduser()
    files = sorted(path.glob("*.nc")) if path.is_dir() else [path]
    if not files:
        raise InputError("no month of a product in the folder", file=path, remedy=_MAKE)
    opened = [_opened(file) for file in files]
    ragged = ["report" in ds.dims and "row_size" in ds for ds in opened]
    if not path.is_dir() and not ragged[0]:
        return opened[0]
    if not all(ragged):
        raise InputError("not a folder of products by month", file=path, remedy=_MAKE)
    try:
        return joined_months(opened)
    except ValueError as err:
        raise InputError(str(err), file=path, remedy=_MAKE) from err


def read_product(path: str | Path, *, lazy: bool = False) -> xr.Dataset:
    """Read a product that :func:`write_product` wrote, or a folder of its months as one.

    Parameters
    ----------
    path : str or path
        As for :func:`open_product`.
    lazy : bool, default False
        As :func:`open_product`; else everything is read and the files are closed.

    Raises
    ------
    InputError
        If the product is absent, damaged or not one of airswing.
    """
    ds = open_product(path)
    if lazy:
        return ds
    path = Path(path)
    try:
        with ds:
            return ds.load()
    except DAMAGE as err:
        raise InputError(
            "not a product airswing can read", file=path, found=err, remedy="Make it again"
        ) from err


def open_results(folder: str | Path) -> xr.DataTree:
    """Open all NetCDF products of a run lazily.

    Parameters
    ----------
    folder : str or path
        Output folder of ``airswing run``.

    Returns
    -------
    DataTree
        One node a product that is there: ``headings``, ``fits``, ``corrected``,
        ``error_profiles``, ``observation_errors``, ``innovation_statistics``, ``gap``,
        ``postprocessed``.

    Raises
    ------
    InputError
        If the folder has none, or one of them is damaged.
    """
    folder = Path(folder).expanduser()
    paths = {name: product_path(folder, name) for name in PRODUCTS}
    found = {name: open_product(path) for name, path in paths.items() if path.exists()}
    if not found:
        raise InputError("no product in the folder", file=folder, remedy=_MAKE)
    return xr.DataTree.from_dict(found)


def product_path(folder: Path, name: str) -> Path:
    """Path of a product of a run: the folder of its months, else the file.

    Parameters
    ----------
    folder : Path
        Output folder of the run.
    name : str
        Of the product without a suffix, as ``headings``.
    """
    months = Path(folder) / name
    return months if months.is_dir() else months.with_suffix(".nc")


def _opened(path: Path) -> xr.Dataset:
    """One file, opened lazily and checked."""
    if not path.exists():
        raise InputError("no such product", file=path, remedy=_MAKE)
    limit_chunk_cache()
    try:
        require_whole(path)
        require_openable(path)
        ds = xr.open_dataset(path, engine="netcdf4", decode_timedelta=False, cache=False)
        # Every product has one; a file of the same name may be another program's.
        wrong = "" if "uuid" not in ds.attrs else _damage(ds)
    except DAMAGE as err:
        raise InputError(
            "not a product airswing can read", file=path, found=err, remedy="Make it again"
        ) from err
    if "uuid" not in ds.attrs:
        ds.close()
        raise InputError(
            "not a product of airswing",
            file=path,
            found=ds.attrs.get("title"),
            remedy="Move it away and run the stage that makes it",
        )
    if wrong:
        ds.close()
        raise InputError("a damaged product", file=path, field=wrong, remedy="Make it again")
    return ds


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
