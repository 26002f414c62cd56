"""Files to Datasets, lazily: NetCDF and wrfout, Zarr stores, and GRIB by cfgrib.

Assumptions and validity
------------------------
* Packed integers are unpacked and fill values made NaN by xarray as parts are read; whole
  fields are never kept. Leads stay numbers with their units.
* A Zarr store is a folder; it is the same as long as its metadata and its files' sizes and
  times are. Other files are the same as GRIB files are: by size and time.
* cfgrib opens u, v and what gives their pressure one by one: variables that do not share their
  levels stay apart. Its index is not written anywhere.
* Opened Datasets are kept for this process, a few at a time; nothing is read from them but what
  is asked for.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import warnings
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import xarray as xr

from airswing.errors import InputError
from airswing.model_formats import model_formats
from airswing.products.damaged_netcdf import require_sound
from airswing.products.fingerprint import ZARR_MARKS
from airswing.reference.geometry.model_time import SourceFile
from airswing.reference.gridded.cfgrib_parts import cfgrib_parts

ENGINES = ("auto", "grib", "cfgrib", "netcdf", "zarr", "wrf")
# Files at most; each holds a handle and its chunks.
_KEPT_OPEN = 16
# Octets of chunks that the NetCDF library keeps by variable; its own default is 16 to 64 MB.
_CHUNK_CACHE = 1 << 20
_MAGIC = ((b"CDF", "netcdf"), (b"\x89HDF", "netcdf"), (b"GRIB", "grib"))


def kind_of(path: str) -> str:
    """What a file is by its first octets, or a folder by its marks.

    ``netcdf``, ``zarr``, ``grib``, a further kind's name, or empty.
    """
    if os.path.isdir(path):
        return "zarr" if is_zarr(path) else ""
    with open(path, "rb") as file:
        start = file.read(1024)
    for further in model_formats().values():
        if further.tells(path, start):
            return further.name
    return next((kind for magic, kind in _MAGIC if start.startswith(magic)), "") or (
        "grib" if b"GRIB" in start else ""
    )


def is_zarr(path: str) -> bool:
    """Whether a folder is a Zarr store."""
    return any(os.path.isfile(os.path.join(path, mark)) for mark in ZARR_MARKS)


def identify_store(path: str) -> SourceFile:
    """Identity of a Zarr store: its metadata, and names, sizes and times of all its files."""
    full = os.path.abspath(path)
    mark = next(os.path.join(full, m) for m in ZARR_MARKS if os.path.isfile(os.path.join(full, m)))
    status = os.stat(mark)
    digest = hashlib.blake2b(digest_size=12)
    for folder, folders, names in os.walk(full):
        folders.sort()
        for name in sorted(names):
            file = os.path.join(folder, name)
            entry = os.stat(file)
            digest.update(repr((file[len(full) :], entry.st_size, entry.st_mtime_ns)).encode())
    return SourceFile(full, status.st_size, status.st_mtime_ns, digest.hexdigest())


def is_same(file: SourceFile) -> bool:
    """Whether a file still has the size and time it was catalogued with; `OSError` where gone."""
    path = file.path
    if os.path.isdir(path):
        path = next(
            (p for p in (os.path.join(path, m) for m in ZARR_MARKS) if os.path.isfile(p)), path
        )
    status = os.stat(path)
    return (status.st_size, status.st_mtime_ns) == (file.size, file.mtime_ns)


def opened(file: SourceFile, engine: str) -> list[xr.Dataset]:
    """Datasets of a file, from this process's store of open ones: one, or of GRIB one a variable.

    Raises
    ------
    InputError
        Where it cannot be opened.
    """
    return list(_opened(file, engine))


@lru_cache(maxsize=_KEPT_OPEN)
def _opened(file: SourceFile, engine: str) -> tuple[xr.Dataset, ...]:
    with _quiet():
        try:
            if engine == "cfgrib":
                return tuple(cfgrib_parts(file.path))
            if engine in model_formats():
                return tuple(model_formats()[engine].open(file.path))
            return (_open(file.path, engine),)
        except InputError:
            raise
        except Exception as error:  # each backend raises its own
            raise InputError(
                f"cannot be opened as {engine}",
                file=file.path,
                found=_short(error),
                remedy="The file is damaged, still being written, or of another kind; engine: says "
                "which",
            ) from error


def _open(path: str, engine: str) -> xr.Dataset:
    if engine != "zarr":
        with _little_cached():
            return _open_netcdf(path, engine)
    return xr.open_dataset(path, engine="zarr", chunks=None, decode_timedelta=False, cache=False)


def _open_netcdf(path: str, engine: str) -> xr.Dataset:
    require_sound(Path(path))
    return xr.open_dataset(
        path,
        engine="netcdf4",
        decode_times=False if engine == "wrf" else None,
        decode_timedelta=False,
        cache=False,
    )


@contextlib.contextmanager
def _little_cached() -> Iterator[None]:
    """Files opened within keep few chunks in memory: each is asked for once."""
    import netCDF4

    size, slots, preemption = netCDF4.get_chunk_cache()
    netCDF4.set_chunk_cache(_CHUNK_CACHE, slots, preemption)
    try:
        yield
    finally:
        netCDF4.set_chunk_cache(size, slots, preemption)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Backends warn and log about variables that are not asked for."""
    logs = [logging.getLogger(name) for name in ("cfgrib", "cfgrib.dataset", "cfgrib.messages")]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)


def _short(error: Exception) -> str:
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words[:300]}"
