"""NetCDF products: described by the vocabulary, CF-1.11 and ACDD, written whole or not at all.

Products of every report are contiguous ragged arrays of trajectories (CF-1.11, sections 9.3.3 and
H.4.3): the reports of one aircraft follow each other, and ``row_size`` counts them.
"""

from __future__ import annotations

import contextlib
import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import dask
import netCDF4
import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.products.damaged_netcdf import DAMAGE, require_sound, written_here
from airswing.products.ragged import joined_months
from airswing.products.whole_files import atomic, json_types
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
    >>> reports = airswing.aircraft_reports(corrected, "N401")
    >>> airswing.write_product(reports, folder / "N401.nc", title="Corrected winds of N401").name
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
            key: json.dumps(json_types(v)) if isinstance(v, (Mapping, list, bool)) else v
            for key, v in ds.attrs.items()
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
    scheduler = dask.config.set(scheduler="threads") if processes else contextlib.nullcontext()
    with atomic(path) as temporary, scheduler:
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
            if name in ("heading", "magnetic_heading", "track"):
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
    products = {name: open_product(path) for name, path in paths.items() if path.exists()}
    if not products:
        raise InputError("no product in the folder", file=folder, remedy=_MAKE)
    return xr.DataTree.from_dict(products)


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
