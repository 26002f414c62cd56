"""Model files as lazy Datasets (NetCDF, WRF, Zarr, GRIB through cfgrib), and values at points.

Leads remain numbers with their units. GRIB that the header scanner does not know is read by cfgrib
in a worker process (`airswing.guarded`), which may end: its values are then missing, or the file
cannot be opened. Each variable is opened separately; the coefficients of native levels come from
the messages' pv section.

Values are read chunk by chunk along time, member and level for several model times at once; of
rows and columns the box around all points is read. So no chunk is decompressed twice for one batch.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import dask.array as da
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.guarded import WorkerEndedError, guarded
from airswing.products.damaged_netcdf import require_sound
from airswing.reference.files import Reader, SourceFile, local_path
from airswing.reference.grib.grid_sections import MAX_POINTS
from airswing.reference.grib.headers import LENGTHS, GarbageError, single_fields, whole_messages
from airswing.reference.gridded.wrf import is_wrf
from airswing.reference.grids import Floats
from airswing.reference.state import grib_statistic
from airswing.reference.winds import GIVEN, PRESSURE, ModelTime, Request, StoredField, limits

ENGINES = ("auto", "grib", "cfgrib", "netcdf", "zarr", "wrf")
NOTES, GRID, SKIPPED = "airswing_notes", "airswing_grid", "airswing_skipped"
"""Encodings of a Dataset: choices made when it was opened; the grid section of its messages;
unreadable content."""
#: Feature types of CF, chapter 9: discrete samples, not fields.
_OBSERVATIONS = ("point", "timeseries", "trajectory", "profile")
_LOGGERS = ("metpy", "cfgrib", "cfgrib.dataset", "cfgrib.messages")
_KEPT_OPEN = 16  # files at most; each has a handle and its chunks
_NATIVE = ("hybrid", "hybridLayer", "generalVertical", "generalVerticalLayer")
#: Variables that are winds or may give one its pressure, by kind of level, in ecCodes' names.
_NEEDED: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("isobaricInhPa", "isobaricInPa"), ("u", "v")),
    **dict.fromkeys(_NATIVE, ("u", "v", "pres", "lnsp")),
    "surface": ("sp", "lnsp"),
}
_WITHOUT_ROWS = ("reduced_gg", "reduced_ll", "sh", "unstructured_grid", "healpix")
_KEYS = ("gridType", "shortName", "typeOfLevel", "numberOfPoints")
_Piece = tuple[dict[str, Any], Floats]
"""Index of one field along each dimension but that of alternatives, and the array of its values."""


def opened(file: SourceFile, engine: str) -> list[xr.Dataset]:
    """Datasets of a file, one or of GRIB one a variable; those opened last are kept."""
    return list(_opened(file, engine))


@lru_cache(maxsize=_KEPT_OPEN)
def _opened(file: SourceFile, engine: str) -> tuple[xr.Dataset, ...]:
    with quiet():
        try:
            if engine == "cfgrib":
                return tuple(_cfgrib_datasets(file))
            if engine == "zarr":
                options: dict[str, Any] = {"chunks": None, "decode_timedelta": False}
                return (xr.open_dataset(file.path, engine="zarr", cache=False, **options),)
            return (_netcdf(file.path, engine),)
        except InputError:
            raise
        except Exception as error:  # backends raise many kinds
            raise InputError(
                f"cannot be opened as {engine}",
                file=file.path,
                found=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                remedy="It is damaged, still being written, or of another kind (engine: names the "
                "kind); Zarr at an address needs fsspec and the package of the protocol",
            ) from error


def _netcdf(path: str, engine: str) -> xr.Dataset:
    import netCDF4

    local = local_path(path)
    require_sound(Path(local))

    options: dict[str, Any] = {"engine": "netcdf4", "decode_timedelta": False, "cache": False}
    root = xr.open_dataset(local, decode_times=False, **options)
    if engine == "wrf" and not is_wrf(root):
        raise InputError("is not a file of WRF", file=path, remedy="Give engine: netcdf")
    units = {key: str(variable.attrs.get("units")) for key, variable in root.variables.items()}
    julian = [key for key in units if re.match(r"days since -471[23]\b", units[key])]
    for key in julian:  # cftime and others count years before Christ in several ways
        root[key].attrs = {"units": "julian day"}
    if engine != "wrf":
        root = xr.decode_cf(root, mask_and_scale=False, decode_timedelta=False)
    with netCDF4.Dataset(local) as file:
        groups = _groups(file)
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
    if groups:
        raise InputError(
            "all variables are in groups of the NetCDF file",
            file=path,
            found=", ".join(groups),
            remedy=f"Open one with xarray.open_dataset(path, group={groups[0]!r}) and give the "
            "Dataset",
        )
    return root


def _groups(group: Any) -> list[str]:
    return [path for child in group.groups.values() for path in (str(child.path), *_groups(child))]


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress warnings and logs of libraries; airswing reports unusable variables itself."""
    logs = [logging.getLogger(name) for name in _LOGGERS]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)


def _cfgrib_datasets(file: SourceFile) -> list[xr.Dataset]:
    """Datasets of one variable each, with values that are read in a worker process."""
    path = local_path(file.path)
    try:
        described, skipped, odd = guarded(_described, str(path))
    except WorkerEndedError as error:
        raise InputError("cannot be opened as cfgrib", file=file.path, found=error) from error
    if not described and odd:
        raise InputError(
            "winds not on a grid of rows and columns",
            file=file.path,
            found=", ".join(odd),
            remedy="Ask the archive for a regular grid, or interpolate to one (cdo remapbil)",
        )
    if not described and skipped:
        why = "; ".join(f"{n:,} {kind}: {why}" for (kind, why), n in skipped.items())
        raise InputError("cannot be opened as cfgrib", file=file.path, found=why)
    datasets = []
    for number, (coordinates, name, dims, shape, attrs, section) in enumerate(described):
        options: Any = {"dtype": np.float64, "meta": np.empty((0,) * len(shape))}
        options["chunks"] = (*((1,) * n for n in shape[:-2]), *((n,) for n in shape[-2:]))
        values = da.map_blocks(_block, file.path, number, **options)  # type: ignore[no-untyped-call]
        ds = coordinates.assign({name: (dims, values, attrs)})
        ds.encoding[GRID] = section
        datasets.append(ds)
    if datasets:
        datasets[0].encoding[SKIPPED] = skipped
    return datasets


def _block(path: str, number: int, block_info: Any = None) -> NDArray[np.float64]:
    """One field of a variable; NaN if the worker ends."""
    location = block_info[None]
    outer = tuple(start for start, _ in location["array-location"][:-2])
    local = local_path(path)
    try:
        return guarded(_field, str(local), number, outer).reshape(location["chunk-shape"])
    except (WorkerEndedError, ValueError) as error:
        raise ValueError(f"not decodable: {error}") from None


def _described(path: str) -> tuple[list[tuple[Any, ...]], Counter[tuple[str, str]], list[str]]:
    """Coordinates and attributes of the variables of a file; in a worker process."""
    datasets, skipped, odd = _variables(path, os.stat(path).st_mtime_ns)
    parts = []
    for ds, section in datasets:
        ((name, array),) = ds.data_vars.items()
        variable = str(name), tuple(map(str, array.dims)), array.shape, dict(array.attrs)
        parts.append((ds.drop_vars(str(name)).load(), *variable, section))
    return parts, skipped, odd


def _field(path: str, number: int, outer: tuple[int, ...]) -> NDArray[np.float64]:
    ds, _ = _variables(path, os.stat(path).st_mtime_ns)[0][number]
    return np.asarray(next(iter(ds.data_vars.values()))[outer].values, dtype=np.float64)


@lru_cache(maxsize=4)
def _variables(
    path: str, mtime_ns: int
) -> tuple[list[tuple[xr.Dataset, tuple[int, bytes]]], Counter[tuple[str, str]], list[str]]:
    """Variables of a file by cfgrib, with edition and grid section; skipped content; bad grids."""
    import eccodes
    from cfgrib.messages import Message

    skipped: Counter[tuple[str, str]] = Counter()
    # by grid type, variable, kind of level, edition and grid section
    kinds: dict[tuple[str, str, str, int, bytes], dict[int, Any]] = {}
    for get, start, edition, length in whole_messages(path, skipped):
        try:
            for single, sections in single_fields(get(start, length), edition):
                message = Message(eccodes.codes_new_from_message(single))
                grid, name, level, count = (message.get(key) for key in _KEYS)
                if name not in _NEEDED.get(level, ()):
                    continue
                if reason := grib_statistic(edition, sections):
                    if name in ("u", "v"):
                        skipped["wind", reason] += 1
                    continue
                if not 0 < int(count or 0) <= MAX_POINTS:
                    raise ValueError
                section = sections.get(2 if edition == 1 else 3, b"")
                fields = kinds.setdefault((grid, name, level, edition, section), {})
                fields[len(fields)] = message
        except (GarbageError, LookupError, ValueError, TypeError, eccodes.CodesInternalError):
            skipped["message", LENGTHS] += 1
    native = any(level in _NATIVE for _, _, level, _, _ in kinds)
    datasets, odd = [], set[str]()
    for (grid, name, _, edition, section), fields in kinds.items():
        if not native and name not in ("u", "v"):
            continue
        if grid in _WITHOUT_ROWS:
            odd.add(grid)
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
        datasets.append((ds, (edition, section)))
    return datasets, skipped, sorted(odd)


class DatasetReader(Reader):
    """Values of the fields of model times at grid points.

    Datasets given in Python have the path that their catalogue has.
    """

    def __init__(self, datasets: Mapping[str, xr.Dataset]) -> None:
        super().__init__()
        self.datasets = datasets

    def close(self) -> None:
        """Forget the Datasets."""
        self._opened.clear()

    def answer(self, models: Sequence[ModelTime], asked: Sequence[Request]) -> list[list[Floats]]:
        """Values of all requests of some model times; NaN if a field cannot be read."""
        # by file, number of its Dataset, variable and chunk
        pieces: dict[tuple[SourceFile, int, StoredField, int], list[_Piece]] = defaultdict(list)
        seen: dict[object, Floats] = {}
        answers: list[list[tuple[np.void, StoredField, Floats]]] = []
        engine = models[0].engine if models else ""
        for model, wanted in zip(models, asked, strict=True):
            mine = []
            for row, points in wanted:
                stored, file = model.stored[int(row["offset"])], model.files[int(row["file"])]
                # one surface pressure serves every level
                key = (file, *(int(row[c]) for c in ("subindex", "offset", "index")), id(points))
                if key not in seen:
                    seen[key] = np.zeros(points.shape)
                    rows = np.divmod(points, model.grids[min(int(row["kind"]), PRESSURE)].ni)
                    at = stored.places(row["index"]) | dict(
                        zip((stored.y, stored.x), rows, strict=True)
                    )
                    chunk = int(stored.chunk_numbers(row["index"]))
                    pieces[file, int(row["subindex"]), stored, chunk].append((at, seen[key]))
                mine.append((row, stored, seen[key]))
            answers.append(mine)
        for (file, number, stored, _), together in pieces.items():
            if engine == GIVEN:
                datasets = [self.datasets[file.path]]
            else:
                datasets = self.open(file, lambda source: opened(source, engine))
            if datasets is None:
                for _, target in together:
                    target[...] = np.nan
                continue
            for name in stored.names:
                try:
                    _add(datasets[number].variables[name], stored, together)
                    self.decoded += 1
                except Exception as error:  # backends raise many kinds
                    reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
                    self.problems[file.path, f"{name}: cannot be read: {reason}"] = None
                    for _, target in together:
                        target[...] = np.nan
        return [[_in_si(*entry) for entry in mine] for mine in answers]


def _add(variable: xr.Variable, stored: StoredField, pieces: list[_Piece]) -> None:
    staggered = {"x": stored.x, "y": stored.y}.get(stored.stagger)
    box = {d: slice(0, size) for d, size in zip(stored.dims, stored.shape, strict=True)}
    for dim in pieces[0][0]:
        places = [at[dim] for at, _ in pieces]
        low, high = min(int(np.min(p)) for p in places), max(int(np.max(p)) for p in places)
        box[dim] = slice(low, high + 1 + (dim == staggered))
    block = variable[tuple(box[d] for d in stored.dims)]
    lazy = block.chunks is not None
    values = np.asarray(block.data.compute(scheduler="synchronous") if lazy else block.values)

    def taken(at: dict[str, Any], more: int) -> Floats:
        """Values at the points, or at the next ones along the staggered axis."""
        place = {d: n - box[d].start + more * (d == staggered) for d, n in at.items()}
        index = tuple(place.get(d, 0) for d in stored.dims if d != stored.either)
        if not stored.either:
            return np.asarray(values[index], dtype=np.float64)
        # each time is in one of the alternatives: the first that is not missing counts
        alternatives = np.moveaxis(values, stored.dims.index(stored.either), 0)
        first, *rest = (np.asarray(field[index], dtype=np.float64) for field in alternatives)
        for alternative in rest:
            first = np.where(np.isnan(first), alternative, first)
        return first

    for at, target in pieces:
        result = taken(at, 0)
        if staggered:  # points lie between: the mean of the two neighbours
            result = 0.5 * result + 0.5 * taken(at, 1)
        target[...] += result


def _in_si(row: np.void, stored: StoredField, values: Floats) -> Floats:
    """Values in SI units; a pressure by the formula of its level."""
    if stored.scale != 1.0:
        values = values * stored.scale
    if stored.exponential:
        with np.errstate(over="ignore"):
            values = np.exp(values)
    if row["kind"] >= PRESSURE:
        values = row["a"] + row["b"] * values
    low, high = limits(int(row["kind"]))
    # fill values without an attribute would be interpolated
    with np.errstate(invalid="ignore"):
        return np.where((values >= low) & (values <= high), values, np.nan)
