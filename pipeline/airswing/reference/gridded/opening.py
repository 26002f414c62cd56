"""Files to lazy Datasets: NetCDF, WRF, Zarr, and GRIB through cfgrib.

Assumptions and validity
------------------------
* Packed integers are unpacked and fill values made NaN by xarray as parts are read; whole fields
  are never kept. Leads stay numbers with their units.
* Winds in a group of a NetCDF file are read if one group alone holds winds.
* Datasets that are opened are kept for this process, a few at a time.
"""

from __future__ import annotations

import contextlib
import logging
import re
import warnings
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import xarray as xr

from airswing.errors import InputError
from airswing.model_formats import model_formats
from airswing.products.damaged_netcdf import require_sound
from airswing.reference.files import SourceFile, identify, is_url, kind_of, local_path
from airswing.reference.gridded.naming import Naming, components
from airswing.reference.gridded.wrf import is_wrf

ENGINES = ("auto", "grib", "cfgrib", "netcdf", "zarr", "wrf")
#: Feature types of CF, chapter 9: discrete samples, not fields.
_OBSERVATIONS = ("point", "timeseries", "trajectory", "profile")
_KEPT_OPEN = 16  # files at most; each has a handle and its chunks
NOTES = "airswing_notes"
"""Encoding of a Dataset: what was chosen when it was opened."""


def engine_of(path: str) -> str:
    """Engine that opens a file: ``grib``, ``zarr``, ``wrf``, ``netcdf`` or a further kind.

    Raises
    ------
    InputError
        If it is none of them, or cannot be read.
    """
    try:
        kind = kind_of(path)
    except OSError as error:
        raise InputError("cannot be opened", file=path, found=error.strerror) from error
    if not kind:
        raise InputError(
            "neither GRIB nor NetCDF nor a Zarr store",
            file=path,
            remedy="Model winds come as GRIB, NetCDF, Zarr or wrfout",
        )
    if kind != "netcdf":
        return kind
    return "wrf" if is_wrf(opened(identify(path), "netcdf")[0]) else "netcdf"


def opened(file: SourceFile, engine: str) -> list[xr.Dataset]:
    """Datasets of a file, from this process's store of open ones: one, or of GRIB one a variable.

    Raises
    ------
    InputError
        If it cannot be opened.
    """
    return list(_opened(file, engine))


@lru_cache(maxsize=_KEPT_OPEN)
def _opened(file: SourceFile, engine: str) -> tuple[xr.Dataset, ...]:
    with _quiet():
        try:
            if engine == "cfgrib":
                from airswing.reference.gridded.cfgrib_files import cfgrib_datasets

                return tuple(cfgrib_datasets(file))
            if engine in model_formats():
                return tuple(model_formats()[engine].open(local_path(file.path)))
            if engine == "zarr":
                return (
                    xr.open_dataset(
                        file.path, engine="zarr", chunks=None, decode_timedelta=False, cache=False
                    ),
                )
            return (_netcdf(file.path, engine),)
        except InputError:
            raise
        except Exception as error:  # each backend raises its own
            missing = isinstance(error, ImportError) and is_url(file.path)
            raise InputError(
                f"cannot be opened as {engine}",
                file=file.path,
                found=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                remedy="Install fsspec and the package of the protocol (s3fs, gcsfs, aiohttp)"
                if missing
                else "The file is damaged, still being written, or of another kind: engine: "
                "names the kind",
            ) from error


def _netcdf(path: str, engine: str) -> xr.Dataset:
    local = local_path(path)
    require_sound(Path(local))

    def read(group: str | None) -> xr.Dataset:
        options: dict[str, Any] = {"group": group, "engine": "netcdf4"}
        options |= {"decode_timedelta": False, "cache": False}
        plain = xr.open_dataset(local, decode_times=False, **options)
        if engine == "wrf":
            if not is_wrf(plain):
                raise InputError("is no file of WRF", file=path, remedy="Give engine: netcdf")
            return plain
        julian = [key for key, one in plain.variables.items() if _is_julian(one.attrs.get("units"))]
        if not julian:
            return xr.open_dataset(local, **options)
        for key in julian:  # cftime and others count years before Christ in several ways
            plain[key].attrs = {"units": "julian day"}
        return xr.decode_cf(plain, mask_and_scale=False, decode_timedelta=False)

    root, groups = read(None), _groups(local)
    root.encoding["airswing_copy"] = local
    kind = str(root.attrs.get("featureType", ""))
    if "/ObsValue" in groups or kind.lower().startswith(_OBSERVATIONS):
        raise InputError(
            "holds observations " + (f"(featureType {kind})" if kind else "(IODA)"),
            file=path,
            remedy="Give it under reports; model winds are fields on a grid",
        )
    if engine == "wrf" or root.data_vars:
        return root
    groups = [g for g in groups if components(read(g), Naming())]
    if len(groups) > 1:
        raise InputError(
            "winds in several groups of a NetCDF file",
            file=path,
            found=", ".join(groups),
            remedy=f"Open one with xarray.open_dataset(path, group={groups[0]!r}) and give the "
            "Dataset",
        )
    if not groups:
        return root
    found = read(groups[0])
    found.encoding["airswing_copy"] = local
    outer = root.drop_vars([name for name in root.variables if name in found.variables])
    found = found.assign_coords({str(k): v for k, v in outer.coords.items()})
    found.encoding[NOTES] = [f"winds of the group {groups[0]}"]
    return found


def _is_julian(units: object) -> bool:
    return bool(re.match(r"days since -471[23]\b", str(units)))


def _groups(path: str) -> list[str]:
    """Paths of all groups of a NetCDF file."""
    import netCDF4

    with netCDF4.Dataset(path) as file:
        found, left = list[str](), list(file.groups.values())
        while left:
            group = left.pop(0)
            found.append(str(group.path))
            left += list(group.groups.values())
    return found


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Backends warn and log about variables that are not needed."""
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
