"""Columns of a headings product as a frame's arrays: radians, in SI units.

Assumptions: the names of the product (docs/formats.md); a pool's wind is the mean of its members
where they exist. What is not in the product is NaN (or the code for unknown), so a product without
gradients or icing still makes a frame.

Validity: one pass over a lazy Dataset; its reports are sorted by aircraft and time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.disagreement import member_mean
from airswing.flags import PHASE, ROLL
from airswing.physics.bank import bank_at_reports
from airswing.physics.triangle import wrap_degrees

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Columns = dict[str, NDArray[Any]]  # whole numbers among floats, as the fields of a frame are

AIRCRAFT_FIELDS = (
    "position_resolution",
    "time_resolution",
    "wind_speed_resolution",
    "wind_direction_resolution",
)
"""Fields of a frame that have one value per aircraft."""

# field of the frame -> (variable of the Dataset, is an angle in degrees)
_PER_REPORT: dict[str, tuple[str, bool]] = {
    "latitude": ("latitude", False),
    "longitude": ("longitude", False),
    "pressure": ("pressure", False),
    "u_rep": ("eastward_wind", False),
    "v_rep": ("northward_wind", False),
    "heading": ("heading", True),
    "magnetic_heading": ("magnetic_heading", True),
    "airspeed": ("airspeed", False),
    "ground_u": ("ground_eastward_velocity", False),
    "ground_v": ("ground_northward_velocity", False),
    "heading_error": ("heading_standard_error", True),
    "declination": ("declination", True),
    "dip": ("dip", True),
    "horizontal_field": ("horizontal_field", False),
    "acceleration": ("longitudinal_acceleration", False),
    "bank": ("bank", True),
    "climb_rate": ("climb_rate", False),
    "temperature": ("air_temperature", False),
}
_PER_REFERENCE: dict[str, tuple[str, bool]] = {
    "u_ref": ("reference_eastward_wind", False),
    "v_ref": ("reference_northward_wind", False),
    "dudt": ("reference_eastward_wind_tendency", False),
    "dvdt": ("reference_northward_wind_tendency", False),
    "dudlnp": ("reference_eastward_wind_lnp_derivative", False),
    "dvdlnp": ("reference_northward_wind_lnp_derivative", False),
    "dudx": ("reference_eastward_wind_x_derivative", False),
    "dvdx": ("reference_northward_wind_x_derivative", False),
    "dudy": ("reference_eastward_wind_y_derivative", False),
    "dvdy": ("reference_northward_wind_y_derivative", False),
    "grid_convergence": ("grid_convergence", True),
    "lead_time": ("lead_time", False),
}
_VARIABLES = (
    "row_size",
    "time",
    "flight",
    "phase",
    "icing",
    "screening",
    "roll_flag",
    *(name for name, _ in (_PER_REPORT | _PER_REFERENCE).values()),
    *AIRCRAFT_FIELDS,
)


def middle_longitude(longitude: FloatArray) -> float:
    """Direction of the mean of longitudes as unit vectors, degrees; 0 where none is known."""
    angle = np.radians(longitude[np.isfinite(longitude)])
    return float(np.degrees(np.arctan2(np.sin(angle).sum(), np.cos(angle).sum())))


def headings_columns(
    ds: xr.Dataset, reference: str | Sequence[str], *, meridian: float | None = None
) -> tuple[tuple[str, ...], Columns, xr.Dataset]:
    """Read what a frame holds from a headings Dataset.

    Parameters
    ----------
    ds : xarray.Dataset
        Dimensions ``report``, ``reference``, ``aircraft``; angles in degrees.
    reference : str or sequence of str
        One reference, or the members of a pool.
    meridian : float, optional
        Middle of the archive, degrees: longitudes run on 180 degrees to either side of it, so that
        an archive across the antimeridian is of one piece. That of `ds` by default.

    Returns
    -------
    tails : tuple of str
    values : dict
        Field of the frame -> array, (report,) or, for :data:`AIRCRAFT_FIELDS`, (aircraft,).
    ds : xarray.Dataset
        The variables read, in memory.

    Raises
    ------
    InputError
        If the reference is unknown.
    """
    members = _members(ds, reference)
    ds = ds[[name for name in _VARIABLES if name in ds]].compute()  # one pass over a lazy graph
    size = ds.sizes["report"]
    tails = tuple(str(name) for name in ds["aircraft"].values)
    nanoseconds = ds["time"].values.astype("datetime64[ns]").astype(np.int64)
    values: Columns = {
        "report": np.arange(size, dtype=np.int64),
        "aircraft": np.repeat(np.arange(len(tails)), np.asarray(ds["row_size"].values)),
        "flight": _codes(ds, "flight", 0),
        "time": nanoseconds / 1e9,
        "phase": _codes(ds, "phase", PHASE["unknown"]),
        "icing": _codes(ds, "icing", -1),
    }
    for field, (name, angle) in _PER_REPORT.items():
        values[field] = _column(ds, name, angle=angle)
    for field, (name, angle) in _PER_REFERENCE.items():
        values[field] = _pooled(ds, name, members, angle=angle)
    middle = middle_longitude(values["longitude"]) if meridian is None else meridian
    east = values["longitude"] - middle
    values["longitude"] = np.where(
        np.abs(east) > 180.0, middle + wrap_degrees(east), values["longitude"]
    )
    values["bank"] = bank_at_reports(
        values["bank"],
        _codes(ds, "roll_flag", ROLL["missing"]),
        values["flight"],
        values["time"],
        latitude=values["latitude"],
        longitude=values["longitude"],
    )
    for name in AIRCRAFT_FIELDS:
        values[name] = (
            np.asarray(ds[name].values, dtype=np.float64)
            if name in ds
            else np.full(len(tails), np.nan)
        )
    return tails, values, ds


def _column(ds: xr.Dataset, name: str, *, angle: bool = False) -> FloatArray:
    if name not in ds:
        return np.full(ds.sizes["report"], np.nan)
    values = np.asarray(ds[name].values, dtype=np.float64)
    return np.radians(values) if angle else values


def _codes(ds: xr.Dataset, name: str, missing: int) -> IntArray:
    if name not in ds:
        return np.full(ds.sizes["report"], missing, dtype=np.int64)
    return np.asarray(ds[name].values, dtype=np.int64)


def _members(ds: xr.Dataset, reference: str | Sequence[str]) -> list[int]:
    known = [str(name) for name in np.atleast_1d(ds["reference"].values)]
    wanted = [reference] if isinstance(reference, str) else list(reference)
    if len(wanted) == 1 and wanted[0] not in known and "+" in wanted[0]:
        wanted = wanted[0].split("+")
    for name in wanted:
        if name not in known:
            raise InputError("unknown reference", found=name, remedy=f"one of {', '.join(known)}")
    return [known.index(name) for name in wanted]


def _pooled(ds: xr.Dataset, name: str, members: list[int], *, angle: bool) -> FloatArray:
    if name not in ds:
        return np.full(ds.sizes["report"], np.nan)
    data = ds[name]
    if "reference" not in data.dims:
        return _column(ds, name, angle=angle)
    mean = member_mean(data.isel(reference=members).astype(np.float64)).to_numpy()
    return np.radians(mean) if angle else mean
