"""Which dimension of a variable is what, by MetPy's CF parsing.

Assumptions and validity
------------------------
* MetPy (`parse_cf`) tells the vertical, the horizontal and the time axis by `standard_name`,
  `axis`, `_CoordinateAxisType`, `positive`, units and, last, by name; a name in the
  configuration goes before. The rest are an ensemble (CF `realization`), ECMWF's `expver`, or
  have one entry.
* Horizontal coordinates are one-dimensional, or latitudes and longitudes of every point.
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
from airswing.reference.gridded.cf.naming import Naming

_MEMBER = re.compile(r"(number|members?|realization|ens\d*|ensemble\w*|perturbation\w*)$", re.I)
_EITHER = "expver"  # ECMWF's dimension of final and preliminary data: each time is in one of them
_PROJECTED = re.compile(r"(projection_)?[xy](_coordinate|c)?$", re.I)


class Axes(NamedTuple):
    """Dimensions of a variable."""

    y: xr.DataArray  # coordinates, one-dimensional or both two-dimensional
    x: xr.DataArray
    vertical: xr.DataArray | None  # coordinate of the levels, None without
    outer: tuple[str, ...]  # dimensions of time and member, in order
    member: str  # the ensemble's and the alternatives' dimension, empty without
    either: str
    crs: dict[str, object] | None  # attributes of the grid mapping, None where there is none

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
        """Dimension of the levels; empty without."""
        return str(self.vertical.dims[0]) if self.vertical is not None else ""


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """MetPy says by its logger and by warnings what is said here in our own words."""
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
    """Tell the dimensions of a variable.

    Raises
    ------
    InputError
        Without horizontal coordinates, with two candidates for one, or with a dimension that
        means nothing known.
    """
    import metpy.xarray  # noqa: F401  (registers the accessor)

    with _silent():
        parsed = _alone(ds, name).metpy.parse_cf()[name]
        found = {axis: _metpy_axis(parsed, axis) for axis in ("vertical", "time", "y", "x")}
        places = {axis: _metpy_axis(parsed, axis) for axis in ("latitude", "longitude")}
    y, x = _horizontal(ds, parsed, found, places, naming, file)
    # what is left is told one by one: levels before members, since only levels may be without any
    # mark
    left = [str(d) for d in parsed.dims if d not in (*y.dims, *x.dims)]
    vertical = _vertical(ds, parsed, found["vertical"], found["time"], left, naming, file)
    if vertical is not None:
        left.remove(str(vertical.dims[0]))
    member = next((d for d in left if _is_member(ds, d)), "")
    either = next((d for d in left if d == _EITHER), "")
    crs = getattr(parsed.coords.get("metpy_crs"), "item", lambda: None)()
    # MetPy makes a plain longitude and latitude mapping up where a file has none
    mapped = parsed.attrs.get("grid_mapping") in ds.variables
    return Axes(
        y,
        x,
        vertical,
        tuple(d for d in left if d != either),
        member,
        either,
        dict(crs.to_dict()) if crs is not None and mapped else None,
    )


def _alone(ds: xr.Dataset, name: str) -> xr.Dataset:
    """A variable with its coordinates and its grid mapping, wherever xarray has put them."""
    one = ds.reset_coords(name) if name in ds.coords and name not in ds.dims else ds
    mapping = one[name].attrs.get("grid_mapping", one[name].encoding.get("grid_mapping"))
    if mapping is None:
        return one[[name]]
    written = str(mapping).split(":")[0].strip()  # the extended form names coordinates, too
    kept = one[[name, *([written] if written in one.variables else [])]]
    kept[name] = one[name].assign_attrs(grid_mapping=written)
    return kept


def _metpy_axis(parsed: xr.DataArray, axis: str) -> xr.DataArray | None:
    try:
        found: xr.DataArray = getattr(parsed.metpy, axis)
    except AttributeError:
        return None
    return found


def coordinate(ds: xr.Dataset, name: str, key: str, file: str) -> xr.DataArray:
    """A coordinate that the configuration names.

    Raises
    ------
    InputError
        Where there is none of that name.
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
    places: dict[str, xr.DataArray | None],
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
    # by axis first: a projected grid has y and x beside the latitudes and longitudes of its points
    if y is None or x is None or y.ndim != 1 or x.ndim != 1:
        y = named[0] if named[0] is not None else places["latitude"]
        x = named[1] if named[1] is not None else places["longitude"]
    if y is None or x is None:
        y, x = _without_attributes(parsed)
    if y is None or x is None:
        raise InputError(
            "no horizontal coordinates",
            file=file,
            field=str(parsed.name),
            found=f"dimensions {', '.join(map(str, parsed.dims))}",
            remedy="Say latitude: and longitude: (or y: and x:) in the configuration; where there "
            "are several candidates, say which",
        )
    if y.ndim > 2 and y.ndim == x.ndim:  # of a moving grid: told apart by the caller
        y, x = (one.isel({d: 0 for d in one.dims[:-2]}) for one in (y, x))
    return y, x


def _without_attributes(
    parsed: xr.DataArray,
) -> tuple[xr.DataArray | None, xr.DataArray | None]:
    """Coordinates that only their names and places tell: the last two dimensions, y before x."""
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
    """Coordinate of the levels: named, by MetPy, or the one that nothing else explains."""
    if naming.level:
        named = coordinate(ds, naming.level, "level", file)
        if named.ndim == 1 and named.dims[0] in left:
            return named
        return None
    if found is not None and found.ndim == 1 and found.dims[0] in left:
        return found
    times = set() if time is None else {str(d) for d in time.dims}
    unexplained = [
        d
        for d in left
        if d not in times
        and d != _EITHER
        and not _is_member(ds, d)
        and not _is_time(ds.get(d))
        and parsed.sizes[d] > 1
    ]
    if len(unexplained) > 1:
        raise InputError(
            "which dimension holds the levels cannot be told",
            file=file,
            field=str(parsed.name),
            found=", ".join(unexplained),
            remedy="Say it in the configuration as level: NAME",
        )
    return ds[unexplained[0]] if unexplained else None


def _is_member(ds: xr.Dataset, dim: str) -> bool:
    attrs = ds[dim].attrs if dim in ds.variables else {}
    return attrs.get("standard_name") == "realization" or bool(_MEMBER.match(dim))


def _is_time(coordinate: xr.DataArray | xr.Variable | None) -> bool:
    """Whether a coordinate holds times or leads."""
    if coordinate is None:
        return False
    if coordinate.dtype.kind in "mM":
        return True
    if coordinate.dtype == object and coordinate.size:
        first: object = np.asarray(coordinate.values).ravel()[0]
        return hasattr(first, "calendar")
    named = str(coordinate.attrs.get("standard_name", ""))
    return named in ("time", "forecast_reference_time", "forecast_period")


def members_of(ds: xr.Dataset, dim: str, size: int) -> NDArray[np.int64]:
    """Numbers of an ensemble's members: as written, else counted from 0."""
    values = np.asarray(ds[dim].values) if dim in ds.variables else np.arange(size)
    if values.dtype.kind not in "iuf":
        values = np.arange(size)
    return values.astype(np.int64)
