"""NetCDF products: described by the vocabulary, CF-1.11 and ACDD, written whole or not at all.

Products of every report are contiguous ragged arrays of trajectories (CF-1.11, sections 9.3.3 and
H.4.3): the reports of one aircraft follow each other, and ``row_size`` counts them.

Damaged files are refused before their library reads them. The NetCDF library does not check the
header of a classic file: a wrong count of records gives absent records as zeros. The HDF5 library
may hang, or end the process, on a damaged file; such files are opened in a worker process first, if
this process has not written them. Classic files (CDF-1, 2 and 5) are laid out as in the NetCDF
Classic Format Specification (Unidata, 2024).
"""

from __future__ import annotations

import contextlib
import json
import math
import uuid
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import dask
import netCDF4
import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.guarded import WorkerEndedError, guarded
from airswing.products.ragged import joined_months
from airswing.products.whole_files import atomic, plain
from airswing.version import __version__
from airswing.vocabulary import describe, lookup

REFERENCES = (
    "Jacobs et al. (2010), TAMDAR update: magnetic deviation correction, AMS; "
    "Jacobs, Mulally & Anderson (2014), J. Atmos. Oceanic Technol. 31(8), 1733-1747"
)
# Defaults that the section `metadata` of the configuration replaces (ACDD 1.3).
_ACDD = {"institution": "not stated", "creator_name": "not stated", "license": "not stated"}
_TIME_UNITS = {"units": "milliseconds since 1970-01-01", "calendar": "standard"}
# Coordinates of a report, as its data variables name them.
_COORDINATES = ("time", "latitude", "longitude", "pressure_altitude")
# Bytes for each variable; the library's default of 16 MiB adds up to hundreds of megabytes.
_CHUNK_CACHE = 2**20
# Reports in a chunk: few, so that one aircraft is read without much of the others.
_REPORTS_A_CHUNK = 32_768
PRODUCTS = (
    *("headings", "fits", "corrected", "error_profiles", "observation_errors"),
    *("innovation_statistics", "gap", "postprocessed"),
)
_MAKE = "Run the stage that makes it, or `airswing run`"
# Rounded variables in the range from 0 to, but not including, 360 degrees.
_DIRECTIONS = ("heading", "magnetic_heading", "track")


DAMAGE = (
    *(ArithmeticError, AttributeError, LookupError, OSError),
    *(RuntimeError, TypeError, ValueError),
)
"""Exceptions that the libraries raise on a damaged file."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SOUND: set[tuple[str, int, int]] = set()
# Bytes of a value by the type's code in the header, and tags of the header's three lists.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_DIMENSION, _VARIABLE, _ATTRIBUTE = 10, 11, 12
_MOST = 10_000_000  # entries of a list or values of an attribute, more than any file has
_PADDING = 3  # bytes: the last variable may lack its padding to a multiple of four
# Number of records where the writer did not state it.
_STREAMING = (0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF)


def write_product(
    ds: xr.Dataset,
    path: str | Path,
    *,
    title: str,
    config_json: str = "",
    sources: Sequence[str] = (),
    source_uuids: Sequence[str] = (),
) -> Path:
    """Write a Dataset as a described, compressed NetCDF-4 product, whole or not at all.

    Parameters
    ----------
    ds : Dataset
        Every variable must be in the vocabulary; dask-backed variables are computed.
    path : str or path
    title : str
    config_json : str, optional
        The configuration the product was made with, as JSON; its section ``metadata`` is written
        as global attributes.
    sources, source_uuids : sequence of str, optional
        Descriptions of the input data; identifiers of the products this one was made from.

    Returns
    -------
    Path
        The path written.

    Raises
    ------
    InputError
        If the file cannot be written.
    KeyError
        If a variable is not in the vocabulary.

    Examples
    --------
    >>> one = airswing.aircraft_reports(corrected, "N401")
    >>> airswing.write_product(one, folder / "N401.nc", title="Corrected winds of N401").name
    'N401.nc'
    """
    path = Path(path)
    ds = describe(ds).drop_encoding()
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    stated = json.loads(config_json or "{}").get("metadata") or {}
    source = "; ".join(sources) or "aircraft reports and model winds"
    ds.attrs = {
        **{
            # NetCDF attributes hold no mappings
            key: json.dumps(plain(value)) if isinstance(value, (Mapping, list, bool)) else value
            for key, value in ds.attrs.items()
        },
        "Conventions": "CF-1.11, ACDD-1.3",
        "title": title,
        "summary": f"{title}. Made by airswing {__version__} from {source}",
        **_ACDD,
        **{name: value for name, value in stated.items() if value},
        "source": source,
        "history": f"{now} airswing {__version__}",
        "date_created": now,
        "references": REFERENCES,
        "airswing_config": config_json,
        "airswing_version": __version__,
        "uuid": str(uuid.uuid4()),
        "source_uuids": " ".join(source_uuids),
    }
    if _is_ragged(ds):
        _mark_trajectories(ds)
    # The library encodes no variable of which every time is missing (NaT).
    times = {name: v for name, v in ds.variables.items() if v.dtype.kind == "M"}
    for name, v in times.items():
        ds[name] = v.dims, v.data.astype("M8[ms]").astype(np.int64), v.attrs | _TIME_UNITS
    netCDF4.set_chunk_cache(size=_CHUNK_CACHE)
    # xarray's lock of the file cannot be sent to the processes of dask's local scheduler.
    processes = dask.config.get("scheduler", None) in ("processes", "multiprocessing")
    here = dask.config.set(scheduler="threads") if processes else contextlib.nullcontext()
    with atomic(path) as temporary, here:
        encoding = {name: _encoding(ds[name]) for name in ds.variables}
        ds.to_netcdf(temporary, engine="netcdf4", encoding=encoding)
    written_here(path)
    return path


def _is_ragged(ds: xr.Dataset) -> bool:
    return "report" in ds.dims and "row_size" in ds


def _mark_trajectories(ds: xr.Dataset) -> None:
    """Attributes of a ragged array of trajectories, and of the time and space it covers."""
    ds.attrs["featureType"] = "trajectory"
    ds["row_size"].attrs["sample_dimension"] = "report"
    ds["aircraft"].attrs["cf_role"] = "trajectory_id"
    there = [name for name in _COORDINATES if name in ds]
    for name, variable in ds.variables.items():
        if "report" in variable.dims and name not in there:
            variable.attrs["coordinates"] = " ".join(there)
    if ds.sizes["report"] and set(_COORDINATES[:3]) <= set(there):
        time = ds["time"].to_numpy()
        ds.attrs["time_coverage_start"] = f"{np.nanmin(time).astype('M8[s]')}Z"
        ds.attrs["time_coverage_end"] = f"{np.nanmax(time).astype('M8[s]')}Z"
        for name, short in (("latitude", "lat"), ("longitude", "lon")):
            values = ds[name].to_numpy()
            ds.attrs[f"geospatial_{short}_min"] = float(np.nanmin(values))
            ds.attrs[f"geospatial_{short}_max"] = float(np.nanmax(values))


def as_stored(ds: xr.Dataset) -> xr.Dataset:
    """Give every variable the precision it is written with: its type and step in the vocabulary.

    A stage then gives the same result from a Dataset in memory as from its product. Dask-backed
    variables stay lazy.
    """
    changed: dict[object, xr.Variable] = {}
    for name in ds.data_vars:
        variable = ds.variables[name]
        entry = lookup(str(name), variable.dims)
        if entry.step:
            # a power of two: scaling loses nothing
            values = np.rint(variable.data * (1.0 / entry.step)) * entry.step
            if name in _DIRECTIONS:
                values = values % 360.0  # a value rounded up to 360 is north
            attrs = {**variable.attrs, "stored_step": entry.step}
            variable = xr.Variable(variable.dims, values, attrs)
        if entry.dtype.startswith("f"):
            changed[name] = variable.astype(entry.dtype, copy=False)
    return ds.assign(changed)


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
        and time, with ``row_size`` reports of each. Values that are read are not kept in memory.

    Raises
    ------
    InputError
        If the product is absent, damaged or not one of airswing.

    Examples
    --------
    >>> headings = airswing.open_product(folder / "headings")
    >>> headings["heading_error"].dims
    ('reference', 'report')
    """
    path = Path(path).expanduser()
    files = sorted(path.glob("*.nc")) if path.is_dir() else [path]
    if not files:
        raise InputError("no month of a product in the folder", file=path, remedy=_MAKE)
    months = [_opened(file) for file in files]
    if not all(map(_is_ragged, months)):
        if not path.is_dir():
            return months[0]
        raise InputError("not a folder of products by month", file=path, remedy=_MAKE)
    try:
        return joined_months(months)
    except ValueError as err:
        raise InputError(str(err), file=path, remedy=_MAKE) from err


def read_product(path: str | Path) -> xr.Dataset:
    """Read a product, or a folder of its months as one, into memory.

    Parameters
    ----------
    path : str or path
        As for :func:`open_product`.

    Returns
    -------
    Dataset
        In memory; the files are closed.

    Examples
    --------
    >>> fits = airswing.read_product(folder / "fits.nc")
    >>> fits["deviation"].dims
    ('reference', 'aircraft', 'coefficient')
    """
    with _damage_named(path), open_product(path) as ds:
        return ds.load()


def open_results(folder: str | Path) -> xr.DataTree:
    """Open all NetCDF products of a run lazily.

    Parameters
    ----------
    folder : str or path
        Output folder of ``airswing run``.

    Returns
    -------
    DataTree
        One node for each existing product: ``headings``, ``fits``, ``corrected``,
        ``error_profiles``, ``observation_errors``, ``innovation_statistics``, ``gap``,
        ``postprocessed``.

    Raises
    ------
    InputError
        If the folder has none, or one of them is damaged.

    Examples
    --------
    >>> tree = airswing.open_results(folder)
    >>> "fits" in tree.children
    True
    """
    folder = Path(folder).expanduser()
    paths = {name: product_path(folder, name) for name in PRODUCTS}
    found = {name: open_product(path) for name, path in paths.items() if path.exists()}
    if not found:
        raise InputError("no product in the folder", file=folder, remedy=_MAKE)
    return xr.DataTree.from_dict(found)


def product_path(folder: Path, name: str) -> Path:
    """Path of a product (such as ``headings``) of a run: the folder of its months, or the file."""
    months, file = Path(folder) / name, Path(folder) / f"{name}.nc"
    # other folders, such as that of the gap's page, are no products
    by_month = name in ("headings", "corrected") and (months.is_dir() or not file.exists())
    return months if by_month else file


@contextlib.contextmanager
def _damage_named(path: str | Path) -> Iterator[None]:
    """Convert exceptions of the libraries on a damaged file to an InputError."""
    try:
        yield
    except DAMAGE as err:
        raise InputError(
            "not a product airswing can read", file=path, found=err, remedy="Make it again"
        ) from err


def _opened(path: Path) -> xr.Dataset:
    """Open one file lazily and check it; CF coordinates of reports stay data variables."""
    if not path.exists():
        raise InputError("no such product", file=path, remedy=_MAKE)
    netCDF4.set_chunk_cache(size=_CHUNK_CACHE)
    with _damage_named(path):
        require_sound(path)
        ds = xr.open_dataset(
            path, engine="netcdf4", decode_timedelta=False, decode_coords=False, cache=False
        )
        # Every product has a uuid; a file of the same name may come from another program.
        if "uuid" not in ds.attrs:
            raise InputError(
                "not a product of airswing",
                file=path,
                found=ds.attrs.get("title"),
                remedy="Move it away and run the stage that makes it",
            )
        if entry := _damaged_entry(ds):
            raise InputError("a damaged product", file=path, field=entry, remedy="Make it again")
    for variable in ds.variables.values():
        variable.attrs.pop("coordinates", None)
    return ds


def _damaged_entry(ds: xr.Dataset) -> str:
    """Name of an attribute or variable that airswing does not write in this form; empty if none."""
    for key in ("title", "uuid", "history", "airswing_version"):
        if not isinstance(ds.attrs.get(key), str):
            return key
    for name, variable in ds.variables.items():
        try:
            numbers = lookup(str(name), variable.dims).dtype[:1] in "iufb"
        except (KeyError, ValueError):
            return str(name)
        if numbers != (variable.dtype.kind in "iufb") and variable.dtype.kind != "M":
            return str(name)
    if _is_ragged(ds):
        sizes = ds["row_size"].to_numpy()
        if (sizes < 0).any() or int(sizes.sum()) != ds.sizes["report"]:
            return "row_size"
    return ""


def _encoding(variable: xr.DataArray) -> dict[str, object]:
    """Encoding of a variable.

    Names are stored as characters. With strings of variable length the HDF5 library crashes, or
    reports a broken file, when the file is opened twice in one process (netcdf-c issue 2510, HDF5
    issue 5359, present in HDF5 2.2.0).
    """
    entry = lookup(str(variable.name), variable.dims)
    if entry.dtype == "str" or variable.dtype.kind in "OUT":
        return {"dtype": "S1"}
    encoding: dict[str, object] = {"dtype": entry.dtype}
    if entry.dtype.startswith("datetime64"):
        encoding = {"dtype": "i8", "_FillValue": np.iinfo(np.int64).min}
    elif entry.dtype.startswith("f"):
        encoding["_FillValue"] = np.dtype(entry.dtype).type(np.nan)
    if variable.dims == (variable.name,):
        # coordinate variables have a value everywhere (CF-1.11, section 2.5.1)
        encoding["_FillValue"] = None
    if variable.size > 1:
        encoding |= {"zlib": True, "complevel": 1, "shuffle": True}
        if "report" in variable.dims:
            encoding["chunksizes"] = tuple(
                min(size, _REPORTS_A_CHUNK) if name == "report" else 1
                for name, size in variable.sizes.items()
            )
    return encoding


# --- damaged files ------------------------------------------------------------------------------


def require_sound(path: Path) -> None:
    """Refuse a damaged NetCDF file with the reason; files of other kinds pass."""
    with path.open("rb") as file:
        start = file.read(len(_HDF5))
        if start.startswith(b"CDF"):
            file.seek(0)
            try:
                needed, records = _extent(file)
            except ValueError as error:
                raise InputError(
                    "cannot be opened: damaged, its NetCDF header is inconsistent",
                    file=path,
                    found=error,
                ) from error
            if needed > path.stat().st_size + _PADDING:
                raise InputError(
                    f"cannot be opened: damaged, {needed:,} bytes by its header, of which "
                    f"{path.stat().st_size:,} are there",
                    file=path,
                    found=f"{records:,} records",
                )
    if start == _HDF5 and _identity(path) not in _SOUND:
        try:
            fault = guarded(_fault, str(path.absolute()))
        except WorkerEndedError:
            fault = "opening it ends the process, or never returns"
        if fault:
            raise InputError("cannot be opened: a damaged NetCDF file", file=path, found=fault)
        written_here(path)


def written_here(path: Path) -> None:
    """Record that this process has written or checked a file, which is then not checked again."""
    _SOUND.add(_identity(path))


def _identity(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.absolute()), status.st_size, status.st_mtime_ns


def _fault(path: str) -> str:
    """Open a NetCDF-4 file and read every description in it; message of the first error."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            groups = [file]
            for group in groups:
                groups += group.groups.values()
                for name in group.ncattrs():
                    group.getncattr(name)
                for variable in group.variables.values():
                    _ = (variable.shape, variable.dtype, variable.chunking(), variable.filters())
                    for name in variable.ncattrs():
                        variable.getncattr(name)
    except DAMAGE as error:
        return f"{type(error).__name__}: {error}"[:300]
    return ""


def _extent(file: BinaryIO) -> tuple[int, int]:
    """End of the variables of a classic file in bytes, and the number of records.

    A ValueError is raised where the header is inconsistent or ends early.
    """

    def number(length: int = 4) -> int:
        found = file.read(length)
        if len(found) < length:
            raise ValueError("it ends in its header")
        return int.from_bytes(found, "big")

    def length() -> int:
        found = number(wide)
        if found > _MOST:
            raise ValueError(f"a list of {found:,} entries")
        return found

    def skip(bytes_of_each: int = 1) -> None:  # names and values are padded to four bytes
        size = bytes_of_each * length()
        number(size + -size % 4)

    def entries(tag: int) -> range:
        kind, found = number(), length()
        if kind not in (0, tag) or (kind == 0 and found):
            raise ValueError("a list of an unexpected kind")
        return range(found)

    def value_size() -> int:
        kind = number()
        if kind not in _SIZES:
            raise ValueError(f"values of type {kind}")
        return _SIZES[kind]

    def attributes() -> None:
        for _ in entries(_ATTRIBUTE):
            skip()
            skip(value_size())

    version = number() & 0xFF
    if version not in (1, 2, 5):  # classic, 64-bit offset, CDF-5
        raise ValueError(f"format {version}")
    wide = 8 if version == 5 else 4
    records, sizes = number(wide), []
    for _ in entries(_DIMENSION):
        skip()
        sizes.append(number(wide))
    attributes()
    end, rows = 0, []
    for _ in entries(_VARIABLE):
        skip()
        dims = [number(wide) for _ in range(length())]
        attributes()
        each, _, begin = value_size(), number(wide), number(4 if version == 1 else 8)
        if any(dim >= len(sizes) for dim in dims):
            raise ValueError("a variable of an unknown dimension")
        shape = [sizes[dim] for dim in dims]
        if shape and shape[0] == 0:  # the record dimension
            rows.append((begin, each * math.prod(shape[1:])))
        else:
            end = max(end, begin + each * math.prod(shape))
    if rows and records and records not in _STREAMING:
        # A single variable of records has no padding between them.
        step = sum(size + -size % 4 * (len(rows) > 1) for _, size in rows)
        end = max(end, max(begin + size for begin, size in rows) + (records - 1) * step)
    return end, records
