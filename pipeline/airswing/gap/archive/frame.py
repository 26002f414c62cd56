"""Reports of an archive against one reference, as plain arrays in SI units and radians.

Assumptions and validity: SI units and radians everywhere except ``latitude`` and ``longitude``
(degrees) and ``horizontal_field`` (nT). Heading and airspeed are the INDICATED values, that is
direction and length of the air vector ``V_A = V_G - W_reported`` used by the unit. A frame
contains the reports with known reported wind, reference wind and ground vector; no report is left
out for the size of its residual (this would attenuate every effect).

Names of variables are those of the headings product (docs/formats.md); the wind of a pool is the
mean of its available members. Variables absent from the product are NaN (or the code for unknown).
Constants of the whole archive (its first time, its median horizontal field) are kept in every
subset, so that columns computed by parts agree with columns computed at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.disagreement import member_mean
from airswing.flags import PHASE, ROLL, SCREENING
from airswing.gap.archive.acceleration import acceleration_at_reports
from airswing.physics.bank import bank_at_reports
from airswing.physics.great_circle import central_angle
from airswing.physics.triangle import wrap_degrees
from airswing.units import DAY, EARTH_RADIUS, Picked

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Columns = dict[str, NDArray[Any]]  # arrays of integers and of floats

DEFAULT_HORIZONTAL_FIELD = 20000.0
"""Horizontal field of an archive without magnetic data, nT."""
EXCLUDED = ("temperature_qc", "wind_qc", "ground_speed")
"""Screening rules whose reports are left out: bad by a quality flag, or heading undefined."""
AIRCRAFT_FIELDS = (
    "position_resolution",
    "time_resolution",
    "wind_speed_resolution",
    "wind_direction_resolution",
)
"""Fields of a frame with one value per aircraft."""
_ESSENTIAL = ("u_rep", "v_rep", "u_ref", "v_ref", "ground_u", "ground_v", "heading", "airspeed")
# field of the frame -> variable of the headings product
_NAMES = {
    **{name: name for name in ("latitude", "longitude", "pressure", "airspeed", "climb_rate")},
    **{name: name for name in ("heading", "magnetic_heading", "declination", "dip", "bank")},
    **{name: name for name in ("horizontal_field", "lead_time", "grid_convergence")},
    "u_rep": "eastward_wind",
    "v_rep": "northward_wind",
    "u_ref": "reference_eastward_wind",
    "v_ref": "reference_northward_wind",
    "ground_u": "ground_eastward_velocity",
    "ground_v": "ground_northward_velocity",
    "heading_error": "heading_standard_error",
    "acceleration": "longitudinal_acceleration",
    "temperature": "air_temperature",
}
_DERIVATIVES = {"t": "tendency", "lnp": "lnp_derivative", "x": "x_derivative", "y": "y_derivative"}
for _axis, _suffix in _DERIVATIVES.items():
    _NAMES[f"dud{_axis}"] = f"reference_eastward_wind_{_suffix}"
    _NAMES[f"dvd{_axis}"] = f"reference_northward_wind_{_suffix}"
for _when in ("before", "after"):
    _NAMES[f"u_{_when}"] = f"reference_eastward_wind_hour_{_when}"
    _NAMES[f"v_{_when}"] = f"reference_northward_wind_hour_{_when}"
# fields that are angles, degrees in the product
_ANGLES = {"heading", "magnetic_heading", "heading_error", "declination", "dip", "bank"}
_ANGLES.add("grid_convergence")
_CODES = {"flight": 0, "phase": PHASE["unknown"], "icing": -1, "screening": 0}
_CODES["roll_flag"] = ROLL["missing"]
_VARIABLES = ("row_size", "time", *_CODES, *_NAMES.values(), *AIRCRAFT_FIELDS)


@dataclass(frozen=True)
class Frame:
    """Reports of an archive against one reference, as plain arrays over ``n`` reports.

    Attributes
    ----------
    tails : tuple of str
        Names of the aircraft; ``aircraft`` (n,) indexes them.
    epoch : float
        First time of the whole archive, s since 1970.
    reference_field : float
        Median horizontal field H of the whole archive, nT; amplitudes of cycles refer to it.
    report : (n,) int
        Position of each row in the Dataset it came from.
    flight : (n,) int
        Flight number, unique over the archive.
    time : (n,) float
        s since 1970.
    latitude, longitude : (n,) float
        Degrees.
    pressure : (n,) float
        Pa, from the reported pressure altitude.
    u_rep, v_rep, u_ref, v_ref : (n,) float
        Reported and reference wind, eastward and northward, m s-1.
    heading, magnetic_heading : (n,) float
        Indicated heading, rad from true north and from magnetic north.
    airspeed : (n,) float
        Indicated true airspeed, m s-1.
    ground_u, ground_v : (n,) float
        Ground velocity, m s-1.
    heading_error : (n,) float
        Standard error of the indicated heading, rad.
    declination, dip : (n,) float
        rad, dip positive downward.
    horizontal_field : (n,) float
        nT.
    acceleration : (n,) float
        Longitudinal acceleration, m s-2; see `airswing.gap.archive.acceleration`.
    bank : (n,) float
        rad, right wing down positive; see `airswing.physics.bank`.
    climb_rate : (n,) float
        m s-1.
    temperature : (n,) float
        K; NaN where not reported.
    phase, icing : (n,) int
        Codes of `airswing.flags`; icing -1 where not reported.
    dudt, dvdt : (n,) float
        Tendency of the reference wind, m s-2.
    dudlnp, dvdlnp : (n,) float
        Derivative of the reference wind by ln p, m s-1.
    dudx, dvdx, dudy, dvdy : (n,) float
        Derivatives of the reference wind eastward and northward, s-1.
    u_before, v_before, u_after, v_after : (n,) float
        Reference wind an hour before and an hour after the report, m s-1; NaN where unknown.
    grid_convergence : (n,) float
        Rotation from grid-relative to earth-relative wind, rad:
        ``u = cos u_g + sin v_g``, ``v = -sin u_g + cos v_g``.
    lead_time : (n,) float
        h.
    position_resolution, time_resolution : (aircraft,) float
        Steps of coded positions and times, degree, s; NaN where unknown.
    wind_speed_resolution, wind_direction_resolution : (aircraft,) float
        Steps of coded winds, m s-1, degree; NaN where unknown.

    Examples
    --------
    >>> frame = airswing.Frame.from_headings(headings, reference=["ruc"])
    >>> frame.residual.shape == (frame.size, 2)
    True
    """

    tails: tuple[str, ...]
    epoch: float
    reference_field: float
    report: IntArray
    aircraft: IntArray
    flight: IntArray
    time: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    pressure: FloatArray
    u_rep: FloatArray
    v_rep: FloatArray
    u_ref: FloatArray
    v_ref: FloatArray
    heading: FloatArray
    magnetic_heading: FloatArray
    airspeed: FloatArray
    ground_u: FloatArray
    ground_v: FloatArray
    heading_error: FloatArray
    declination: FloatArray
    dip: FloatArray
    horizontal_field: FloatArray
    acceleration: FloatArray
    bank: FloatArray
    climb_rate: FloatArray
    temperature: FloatArray
    phase: IntArray
    icing: IntArray
    dudt: FloatArray
    dvdt: FloatArray
    dudlnp: FloatArray
    dvdlnp: FloatArray
    dudx: FloatArray
    dvdx: FloatArray
    dudy: FloatArray
    dvdy: FloatArray
    u_before: FloatArray
    v_before: FloatArray
    u_after: FloatArray
    v_after: FloatArray
    grid_convergence: FloatArray
    lead_time: FloatArray
    position_resolution: FloatArray
    time_resolution: FloatArray
    wind_speed_resolution: FloatArray
    wind_direction_resolution: FloatArray

    def __repr__(self) -> str:
        flights = np.unique(self.flight).size
        text = f"{self.size:,} reports, {flights:,} flights, {len(self.tails)} aircraft"
        if self.size:
            ends = np.array([self.time.min(), self.time.max()]).astype("datetime64[s]")
            text += f", {' to '.join(np.datetime_as_string(ends, 'm'))}"
        return f"<Frame: {text}>"

    @property
    def size(self) -> int:
        """Number of reports."""
        return int(self.time.size)

    @property
    def day(self) -> IntArray:
        """Whole days since 1970, (n,)."""
        return np.floor_divide(self.time, DAY).astype(np.int64)

    @property
    def residual(self) -> FloatArray:
        """Reported minus reference wind, (n, 2), m s-1."""
        return np.stack([self.u_rep - self.u_ref, self.v_rep - self.v_ref], axis=-1)

    def take(self, index: Picked) -> Frame:
        """Select reports by integer index, slice or boolean mask, in the given order.

        Parameters
        ----------
        index : array or slice
            Index of a 1-D array.

        Returns
        -------
        Frame
            Constants of the archive and of the aircraft are kept.
        """
        return replace(self, **{name: getattr(self, name)[index] for name in REPORT_FIELDS})

    def aircraft_mask(self, tails: str | Sequence[str]) -> NDArray[np.bool_]:
        """Mark the reports of the named aircraft.

        Parameters
        ----------
        tails : str or sequence of str
            Names of aircraft.

        Returns
        -------
        (n,) bool

        Raises
        ------
        InputError
            An aircraft is not in the archive.
        """
        wanted = [tails] if isinstance(tails, str) else list(tails)
        for tail in wanted:
            if tail not in self.tails:
                raise InputError(
                    "unknown aircraft",
                    found=tail,
                    remedy=f"the archive holds {', '.join(self.tails[:8])}"
                    + (" ..." if len(self.tails) > 8 else ""),
                )
        return np.isin(self.aircraft, [self.tails.index(tail) for tail in wanted])

    def step_distance(self) -> FloatArray:
        """Compute the great-circle distance from the previous row.

        Rows must be in order of aircraft, flight and time (as from `from_headings`).

        Returns
        -------
        (n,) float
            m; NaN at the first report of a flight.
        """
        lat, lon = np.radians(self.latitude), np.radians(self.longitude)
        out = np.full(self.size, np.nan)
        out[1:] = EARTH_RADIUS * central_angle(lat[:-1], lon[:-1], lat[1:], lon[1:])
        out[1:][self.flight[1:] != self.flight[:-1]] = np.nan
        return out

    @classmethod
    def from_headings(
        cls,
        ds: xr.Dataset,
        *,
        reference: str | Sequence[str],
        phases: Sequence[str] = ("ascent", "cruise", "descent"),
        excluded: Sequence[str] = EXCLUDED,
        epoch: float | None = None,
        reference_field: float | None = None,
        meridian: float | None = None,
    ) -> Frame:
        """Build a frame from a headings Dataset.

        Parameters
        ----------
        ds : xarray.Dataset
            The headings product (dimensions ``report``, ``reference``, ``aircraft``); degrees. A
            lazy Dataset is computed in one pass.
        reference : str or sequence of str
            One reference, or the members of a pool (their mean is used where they exist).
        phases : sequence of str
            Phases of flight to keep; reports of unknown phase are kept with ``cruise``.
        excluded : sequence of str
            Names of screening bits whose reports are left out.
        epoch, reference_field : float, optional
            Constants of the whole archive (s since 1970, nT), required when `ds` is a part of it;
            by default computed from `ds`.
        meridian : float, optional
            Middle longitude of the whole archive, degrees. Longitudes are continuous within 180
            degrees of it, also across the antimeridian. By default that of `ds`.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            The reference or a phase is unknown, or no report is left.
        """
        for name in phases:
            if name not in PHASE:
                raise InputError("unknown phase", found=name, remedy=f"one of {', '.join(PHASE)}")
        tails, values, screening = _read_columns(ds, reference, meridian)
        codes = [PHASE[name] for name in phases]
        keep = np.isin(values["phase"], [*codes, PHASE["unknown"]] if "cruise" in phases else codes)
        keep &= (screening & sum(SCREENING[name] for name in excluded)) == 0
        for name in _ESSENTIAL:
            keep &= np.isfinite(values[name])
        if not keep.any():
            raise InputError(
                "no report has a wind, a ground vector and a reference wind at once",
                field="reports",
                found=f"{keep.size} reports read",
                remedy="check that reports and references overlap in time, space and level",
            )
        for name in REPORT_FIELDS:
            values[name] = values[name][keep]
        # computed from the kept reports only, since it depends on neighbours
        motion = ("acceleration", "pressure", "phase", "flight", "time", "latitude", "longitude")
        values["acceleration"] = acceleration_at_reports(*(values[name] for name in motion))
        if epoch is None:  # drifts are counted from the first report in use
            epoch = float(values["time"].min())
        if reference_field is None:
            field = values["horizontal_field"][np.isfinite(values["horizontal_field"])]
            reference_field = float(np.median(field)) if field.size else DEFAULT_HORIZONTAL_FIELD
        return cls(
            tails=tails, epoch=float(epoch), reference_field=float(reference_field), **values
        )


REPORT_FIELDS: tuple[str, ...] = tuple(
    f.name
    for f in fields(Frame)
    if f.name not in {"tails", "epoch", "reference_field", *AIRCRAFT_FIELDS}
)
"""Names of the fields with one value per report."""


def _read_columns(
    ds: xr.Dataset, reference: str | Sequence[str], meridian: float | None
) -> tuple[tuple[str, ...], Columns, IntArray]:
    """Return names of aircraft, fields of a frame, and screening bits (report,)."""
    members = _members(ds, reference)
    ds = ds[[name for name in _VARIABLES if name in ds]].compute()  # one pass over a lazy graph
    tails = tuple(str(name) for name in ds["aircraft"].values)
    values: Columns = {
        "report": np.arange(ds.sizes["report"], dtype=np.int64),
        "aircraft": np.repeat(np.arange(len(tails)), np.asarray(ds["row_size"].values)),
        "time": ds["time"].values.astype("datetime64[ns]").astype(np.int64) / 1e9,
    }
    codes = {
        name: np.asarray(ds[name].values, np.int64)
        if name in ds
        else np.full(ds.sizes["report"], missing, np.int64)
        for name, missing in _CODES.items()
    }
    values |= {name: codes[name] for name in ("flight", "phase", "icing")}
    for field, name in _NAMES.items():
        column = np.full(ds.sizes["report"], np.nan)
        if name in ds and "reference" in ds[name].dims:
            column = member_mean(ds[name].isel(reference=members).astype(np.float64)).to_numpy()
        elif name in ds:
            column = np.asarray(ds[name].values, dtype=np.float64)
        values[field] = np.radians(column) if field in _ANGLES else column
    longitude = values["longitude"]
    if meridian is None:  # direction of the mean of the longitudes as unit vectors
        angle_sum = np.nansum(np.exp(1j * np.radians(longitude)))
        meridian = float(np.degrees(np.angle(angle_sum)))
    east = longitude - meridian
    values["longitude"] = np.where(np.abs(east) > 180.0, meridian + wrap_degrees(east), longitude)
    values["bank"] = bank_at_reports(
        values["bank"],
        codes["roll_flag"],
        values["flight"],
        values["time"],
        latitude=values["latitude"],
        longitude=values["longitude"],
    )
    for name in AIRCRAFT_FIELDS:
        unknown = np.full(len(tails), np.nan)
        values[name] = np.asarray(ds[name].values, np.float64) if name in ds else unknown
    return tails, values, codes["screening"]


def _members(ds: xr.Dataset, reference: str | Sequence[str]) -> list[int]:
    known = [str(name) for name in np.atleast_1d(ds["reference"].values)]
    wanted = [reference] if isinstance(reference, str) else list(reference)
    if len(wanted) == 1 and wanted[0] not in known and "+" in wanted[0]:
        wanted = wanted[0].split("+")
    for name in wanted:
        if name not in known:
            raise InputError("unknown reference", found=name, remedy=f"one of {', '.join(known)}")
    return [known.index(name) for name in wanted]
