"""Winds of a GRIB file through cfgrib, for grids and levels that the header scanner does not know.

cfgrib and ecCodes run in a worker process (`airswing.guarded`), which may end: its values are then
missing, or the file cannot be opened; neither ends the run. Values are read field by field when
they are needed.

Assumptions and validity
------------------------
* u, v, and the pressure, the surface pressure or its logarithm on native levels, each opened by
  itself. The coefficients of the levels come from the messages' pv section. Fields that are no
  state of the atmosphere (`airswing.reference.state`) are left out.
* Grids of rows and columns only; reduced Gaussian grids, unstructured grids and spherical harmonics
  are refused.
"""

from __future__ import annotations

import os
from collections import Counter
from functools import lru_cache
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.guarded import WorkerEndedError, guarded
from airswing.reference.files import SourceFile, local_path
from airswing.reference.grib.grid_sections import MAX_POINTS, read_grid
from airswing.reference.grib.headers import GarbageError, Window, single_fields, whole_messages
from airswing.reference.grids import AxesGrid, UnplaceableGridError
from airswing.reference.state import grib_statistic

GRID, SKIPPED = "airswing_grid", "airswing_skipped"
"""Encodings of a Dataset: the grid as its grid section has it; what could not be read."""
_ISOBARIC = ("isobaricInhPa", "isobaricInPa")
_NATIVE = ("hybrid", "hybridLayer", "generalVertical", "generalVerticalLayer")
_WITHOUT_ROWS = ("reduced_gg", "reduced_ll", "sh", "unstructured_grid", "healpix")
_KEYS = ("gridType", "shortName", "typeOfLevel", "numberOfPoints", "Nx", "Ny", "md5GridSection")


def cfgrib_datasets(file: SourceFile) -> list[xr.Dataset]:
    """Datasets of one variable each, with values that are read in a worker process.

    Raises
    ------
    InputError
        If the file holds u and v on no grid of rows and columns, or cannot be opened.
    """
    path = local_path(file.path)
    try:
        parts, skipped, odd = guarded(_described, str(path))
    except WorkerEndedError as error:
        raise InputError("cannot be opened as cfgrib", file=file.path, found=error) from error
    if not parts and odd:
        raise InputError(
            "winds on no grid of rows and columns",
            file=file.path,
            found=", ".join(odd),
            remedy="Ask the archive for a regular grid, or interpolate to one (cdo remapbil)",
        )
    if not parts and skipped:
        raise InputError(
            "cannot be opened as cfgrib",
            file=file.path,
            found="; ".join(f"{n:,} {what}: {why}" for (what, why), n in skipped.items()),
        )
    found = []
    for number, (part, name, dims, shape, attrs, section) in enumerate(parts):
        outer = len(shape) - 2
        chunks = tuple((1,) * n if axis < outer else (n,) for axis, n in enumerate(shape))
        values = da.map_blocks(  # type: ignore[no-untyped-call]
            _block,
            file.path,
            number,
            dtype=np.float64,
            chunks=chunks,
            meta=np.empty((0,) * len(shape)),
        )
        ds = part.assign({name: (dims, values, attrs)})
        ds.encoding[GRID] = section
        found.append(ds)
    if found:
        found[0].encoding[SKIPPED] = skipped
    return found


def grid_of(ds: xr.Dataset) -> AxesGrid | None:
    """Grid of a Dataset by its grid section; None if rows and columns describe it."""
    edition, section = ds.encoding.get(GRID, (0, b""))
    if not section:
        return None
    try:
        grid = read_grid(edition, section)
    except UnplaceableGridError:
        return None
    plain = not grid.by_column and not grid.alternate
    return grid if plain and grid.frame.kind != "longitude_latitude" else None


def _block(path: str, number: int, block_info: Any = None) -> NDArray[np.float64]:
    """One field of a variable; NaN if the worker ends."""
    location = block_info[None]
    outer = tuple(start for start, _ in location["array-location"][:-2])
    local = local_path(path)
    try:
        return guarded(_field, str(local), number, outer).reshape(location["chunk-shape"])
    except (WorkerEndedError, ValueError) as error:
        raise ValueError(f"not decodable: {error}") from None


Part = tuple[
    xr.Dataset, str, tuple[str, ...], tuple[int, ...], dict[str, object], tuple[int, bytes]
]


def _described(path: str) -> tuple[list[Part], Counter[tuple[str, str]], list[str]]:
    """Coordinates and attributes of the variables of a file; in a worker process."""
    status = os.stat(path)
    datasets, skipped, odd = _variables(path, status.st_size, status.st_mtime_ns)
    parts = []
    for ds, section in datasets:
        name = str(next(iter(ds.data_vars)))
        one = ds[name]
        dims = tuple(map(str, one.dims))
        parts.append((ds.drop_vars(name).load(), name, dims, one.shape, dict(one.attrs), section))
    return parts, skipped, odd


def _field(path: str, number: int, outer: tuple[int, ...]) -> NDArray[np.float64]:
    """Values of one field; in a worker process."""
    status = os.stat(path)
    ds, _ = _variables(path, status.st_size, status.st_mtime_ns)[0][number]
    one = next(iter(ds.data_vars.values()))
    return np.asarray(one[outer].values, dtype=np.float64)


@lru_cache(maxsize=4)
def _variables(
    path: str, size: int, mtime_ns: int
) -> tuple[list[tuple[xr.Dataset, tuple[int, bytes]]], Counter[tuple[str, str]], list[str]]:
    """Variables of a file by cfgrib, with edition and grid section, what is skipped, odd grids."""
    from cfgrib.messages import Message

    skipped: Counter[tuple[str, str]] = Counter()
    kinds: dict[tuple[object, ...], dict[int, Any]] = {}
    sections_of: dict[tuple[object, ...], tuple[int, bytes]] = {}
    import eccodes

    descriptor = os.open(path, os.O_RDONLY)
    try:
        for start, edition, length in whole_messages(Window(descriptor), skipped):
            message = os.pread(descriptor, length, start)
            try:
                for single, sections in single_fields(message, edition):
                    reason = grib_statistic(edition, sections)
                    one = Message(eccodes.codes_new_from_message(single))
                    keys = {key: one.get(key) for key in _KEYS}
                    if not _may_matter(keys):
                        continue
                    if reason:
                        if keys["shortName"] in ("u", "v"):
                            skipped["wind", reason] += 1
                        continue
                    if not 0 < int(keys["numberOfPoints"] or 0) <= MAX_POINTS:
                        raise ValueError
                    section = sections.get(2 if edition == 1 else 3, b"")
                    kind = (*(keys[key] for key in _KEYS[:3]), section)
                    fields = kinds.setdefault(kind, {})
                    fields[len(fields)] = one
                    sections_of[kind] = edition, section
            except (GarbageError, LookupError, ValueError, TypeError, eccodes.CodesInternalError):
                skipped["message", "garbage: section lengths do not add up"] += 1
    finally:
        os.close(descriptor)
    native = any(kind[2] in _NATIVE for kind in kinds)
    found, odd = [], set[str]()
    for kind, fields in kinds.items():
        if not native and kind[1] not in ("u", "v"):
            continue
        if kind[0] in _WITHOUT_ROWS:
            odd.add(str(kind[0]))
            continue
        try:
            ds = xr.open_dataset(
                fields,  # type: ignore[arg-type]  # cfgrib takes mappings of fields
                engine="cfgrib",
                decode_timedelta=False,
                cache=False,
                backend_kwargs={"errors": "raise", "read_keys": ["pv", "uvRelativeToGrid"]},
            )
        except Exception as error:  # cfgrib and xarray raise many kinds
            reason = f"cannot be opened: {type(error).__name__}: {' '.join(str(error).split())}"
            skipped["message", reason[:200]] += len(fields)
            continue
        found.append((ds, sections_of[kind]))
    return found, skipped, sorted(odd)


def _may_matter(keys: dict[str, object]) -> bool:
    """Whether a field is a wind or may give one its pressure."""
    name, level = keys["shortName"], keys["typeOfLevel"]
    if level in _ISOBARIC + _NATIVE and name in ("u", "v"):
        return True
    if level in _NATIVE:
        return name in ("pres", "lnsp")
    return level == "surface" and name in ("sp", "lnsp")
