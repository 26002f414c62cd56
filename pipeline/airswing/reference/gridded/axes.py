"""Dimensions of a variable: horizontal, vertical, time, ensemble; by MetPy's CF parsing.

Assumptions and validity
------------------------
* MetPy (`parse_cf`) recognises the vertical, horizontal and time axes by `standard_name`, `axis`,
  `_CoordinateAxisType`, `positive`, units and, last, by name; a name in the configuration takes
  precedence. The rest are an ensemble (CF `realization`), ECMWF's `expver`, or have one entry.
* Horizontal coordinates are one-dimensional along two dimensions, or latitudes and longitudes of
  every point. Unstructured grids (one dimension of cells) are refused.
"""

from __future__ import annotations

import contextlib
import logging
import re
import warnings
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference.gridded.naming import Naming

LEAD_NAME = re.compile(
    r"(step|lead(_?time)?|prediction_timedelta|forecast_(period|hour|time)|fhr|time_offset)\w*$",
    re.I,
)
_MEMBER = re.compile(r"(number|members?|realization|ens\d*|ensemble\w*|perturbation\w*)$", re.I)
_EITHER = "expver"  # ECMWF's dimension of final and preliminary data: each time is in one of them
_PROJECTED = re.compile(r"(projection_)?[xy](_coordinate|c)?$", re.I)
_LEVEL = re.compile(r"(p?lev(el)?s?|pressure(_levels?)?|isobaric\w*|plevs?)$", re.I)
_CELLS = re.compile(r"(n_?cells?\w*|cells?|ncol|ncells_\d+|nodes?|faces?|nMesh\w*|values)$", re.I)


class Axes(NamedTuple):
    """Dimensions of a variable."""

    y: xr.DataArray  # coordinates, one-dimensional or both two-dimensional
    x: xr.DataArray
    vertical: xr.DataArray | None  # coordinate of the levels
    outer: tuple[str, ...]  # dimensions of time and member, in order
    member: str  # the ensemble's and the alternatives' dimension, empty if there is none
    either: str
    crs: dict[str, object] | None  # attributes of the grid mapping

    @property
    def y_dim(self) -> str:
        """Dimension along y."""
        return str(self.y.dims[0])

    @property
    def x_dim(self) -> str:
        """Dimension along x."""
        return str(self.x.dims[-1])

    @property
    def level_dim(self) -> str:
        """Dimension of the levels; empty if there is none."""
        return str(self.vertical.dims[0]) if self.vertical is not None else ""


def unstructured(file: str, dimension: str) -> InputError:
    """The error for winds on an unstructured grid."""
    return InputError(
        "winds on an unstructured grid (one dimension of cells)",
        file=file,
        field=dimension,
        remedy="Interpolate to latitude and longitude first, for instance with cdo remapbil",
    )


def cell_dimension(ds: xr.Dataset) -> str:
    """Dimension of the cells of an unstructured grid, empty if there is none."""
    for name in map(str, ds.dims):
        if _CELLS.match(name) and ds.sizes[name] > 1:
            return name
    return ""


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """MetPy logs and warns about what our own messages say."""
    log = logging.getLogger("metpy")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(before)


def axes_of(ds: xr.Dataset, name: str, naming: Naming, file: str) -> Axes:
    """Dimensions of a variable.

    Raises
    ------
    InputError
        Without horizontal coordinates, with two candidates for one, with an unknown dimension, or
        on an unstructured grid.
    """
    import metpy.xarray  # noqa: F401  (registers the accessor)

    with _silent():
        parsed = _alone(ds, name).metpy.parse_cf()[name]
        found = {
            axis: getattr(parsed.metpy, axis, None)
            for axis in ("vertical", "time", "y", "x", "latitude", "longitude")
        }
    y, x = _horizontal(ds, parsed, found, naming, file)
    # levels before members, since only levels may be without any mark
    left = [str(d) for d in parsed.dims if d not in (*y.dims, *x.dims)]
    vertical = _vertical(ds, parsed, found["vertical"], found["time"], left, naming, file)
    if vertical is not None:
        left.remove(str(vertical.dims[0]))
    crs = getattr(parsed.coords.get("metpy_crs"), "item", lambda: None)()
    # MetPy assumes a longitude and latitude mapping if a file has none
    mapped = parsed.attrs.get("grid_mapping") in ds.variables
    either = _EITHER if _EITHER in left else ""
    return Axes(
        y,
        x,
        vertical,
        tuple(d for d in left if d != either),
        next((d for d in left if _is_member(ds, d)), ""),
        either,
        dict(crs.to_dict()) if crs is not None and mapped else None,
    )


def _alone(ds: xr.Dataset, name: str) -> xr.Dataset:
    """A variable with its coordinates and its grid mapping, wherever xarray has put them."""
    one = ds.reset_coords(name) if name in ds.coords and name not in ds.dims else ds
    mapping = one[name].attrs.get("grid_mapping", one[name].encoding.get("grid_mapping"))
    if mapping is None:
        return one[[name]]
    written = str(mapping).split(":")[0].strip()  # the extended form names coordinates too
    kept = one[[name, *([written] if written in one.variables else [])]]
    kept[name] = one[name].assign_attrs(grid_mapping=written)
    return kept


def coordinate(ds: xr.Dataset, name: str, key: str, file: str) -> xr.DataArray:
    """A coordinate that the configuration names.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in ds.variables and name not in ds.dims:
        raise InputError(
            "no such variable",
            file=file,
            field=f"{key}: {name}",
            found="variables " + ", ".join(map(str, ds.variables)),
        )
    return ds[name]


def _horizontal(
    ds: xr.Dataset,
    parsed: xr.DataArray,
    found: dict[str, xr.DataArray | None],
    naming: Naming,
    file: str,
) -> tuple[xr.DataArray, xr.DataArray]:
    """Coordinates along y and x."""
    named = [
        coordinate(ds, str(name), key, file) if name else None
        for name, key in (
            (naming.y or naming.latitude, "y"),
            (naming.x or naming.longitude, "x"),
        )
    ]
    y = named[0] if named[0] is not None else found["y"]
    x = named[1] if named[1] is not None else found["x"]
    # by axis first: a projected grid has y and x and also latitudes and longitudes of points
    if y is None or x is None or y.ndim != 1 or x.ndim != 1:
        y = named[0] if named[0] is not None else found["latitude"]
        x = named[1] if named[1] is not None else found["longitude"]
    cells = next((str(d) for d in parsed.dims if _CELLS.match(str(d))), "")
    if cells or (y is not None and x is not None and y.ndim == 1 and y.dims == x.dims):
        raise unstructured(file, cells or str(parsed.dims[-1]))
    if y is None or x is None:
        y, x = _without_attributes(parsed)
    if y is None or x is None:
        raise InputError(
            "no horizontal coordinates",
            file=file,
            field=str(parsed.name),
            found=f"dimensions {', '.join(map(str, parsed.dims))}",
            remedy="Give latitude: and longitude: (or y: and x:) in the configuration; if there "
            "are several candidates, name one",
        )
    if y.ndim > 2 and y.ndim == x.ndim:  # of a moving grid
        y, x = (one.isel({d: 0 for d in one.dims[:-2]}) for one in (y, x))
    return y, x


def _without_attributes(parsed: xr.DataArray) -> tuple[xr.DataArray | None, xr.DataArray | None]:
    """Coordinates known by name and place only: the last two dimensions, y before x."""
    if parsed.ndim < 2:
        return None, None
    y, x = (str(d) for d in parsed.dims[-2:])
    if not (_PROJECTED.match(y) and _PROJECTED.match(x) and {y, x} <= set(parsed.coords)):
        return None, None
    return parsed.coords[y], parsed.coords[x]


def _vertical(
    ds: xr.Dataset,
    parsed: xr.DataArray,
    found: xr.DataArray | None,
    time: xr.DataArray | None,
    left: list[str],
    naming: Naming,
    file: str,
) -> xr.DataArray | None:
    """Coordinate of the levels: configured, by MetPy, or the one that nothing else explains."""
    if naming.level:
        named = coordinate(ds, naming.level, "level", file)
        return named if named.ndim == 1 and named.dims[0] in left else None
    if found is not None and found.ndim == 1 and found.dims[0] in left:
        return found
    times = set() if time is None else {str(d) for d in time.dims}
    unexplained = [
        d
        for d in left
        if d not in times
        and d != _EITHER
        and not _is_member(ds, d)
        and not _is_time(d, ds.get(d))
        and parsed.sizes[d] > 1
    ]
    levels = [d for d in unexplained if _LEVEL.match(d)]
    if len(levels) == 1:
        unexplained = levels
    if len(unexplained) > 1:
        raise InputError(
            "several dimensions may hold the levels",
            file=file,
            field=str(parsed.name),
            found=", ".join(unexplained),
            remedy="Name it in the configuration as level: NAME",
        )
    return ds[unexplained[0]] if unexplained else None


def _is_member(ds: xr.Dataset, dim: str) -> bool:
    attrs = ds[dim].attrs if dim in ds.variables else {}
    return attrs.get("standard_name") == "realization" or bool(_MEMBER.match(dim))


def _is_time(name: str, values: xr.DataArray | xr.Variable | None) -> bool:
    """Whether a coordinate holds times or leads."""
    if LEAD_NAME.match(name):
        return True
    if values is None:
        return False
    if values.dtype.kind in "mM" or str(values.attrs.get("units", "")).startswith("day as "):
        return True
    if values.dtype == object and values.size:
        first: object = np.asarray(values.values).ravel()[0]
        return hasattr(first, "calendar")
    named = str(values.attrs.get("standard_name", ""))
    return named in ("time", "forecast_reference_time", "forecast_period")


def members_of(ds: xr.Dataset, dim: str, size: int) -> NDArray[np.int64]:
    """Numbers of an ensemble's members: as written, else counted from 0."""
    values = np.asarray(ds[dim].values) if dim in ds.variables else np.arange(size)
    return (values if values.dtype.kind in "iuf" else np.arange(size)).astype(np.int64)
