"""Plain-array view of an archive against one reference: what effects and statistics work on.

Assumptions and validity: SI units and radians everywhere except ``latitude``/``longitude``
(degrees) and ``horizontal_field`` (nT). The heading and the airspeed are the INDICATED ones, that
is direction and length of the air vector ``V_A = V_G - W_reported`` the unit worked with. A report
enters a frame when its reported wind, reference wind and ground vector are all known; nothing is
left out for the size of its residual (that would attenuate every effect).

Constants of the whole archive (its first time, its median horizontal field) travel with every
subset, so that columns built chunk by chunk agree with columns built at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PHASE, SCREENING
from airswing.gap.archive.acceleration import acceleration_at_reports
from airswing.gap.archive.headings_columns import AIRCRAFT_FIELDS, headings_columns
from airswing.physics.great_circle import central_angle
from airswing.units import DAY, EARTH_RADIUS, Picked

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

DEFAULT_HORIZONTAL_FIELD = 20000.0
"""Horizontal field (nT) stated where an archive gives none."""
EXCLUDED = ("temperature_qc", "wind_qc", "ground_speed")
"""Screening rules a frame honours: the report is bad by its own flags, or its heading undefined."""


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
        Median horizontal field of the whole archive, nT: the H at which cycles are stated.
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
        Its derivative by ln p, m s-1.
    dudx, dvdx, dudy, dvdy : (n,) float
        Its derivatives eastward and northward, s-1.
    grid_convergence : (n,) float
        Angle that turns grid-relative into earth-relative wind, rad:
        ``u = cos u_g + sin v_g``, ``v = -sin u_g + cos v_g``.
    lead_time : (n,) float
        h.
    position_resolution, time_resolution, wind_speed_resolution, wind_direction_resolution
        (aircraft,) float: degree, s, m s-1, degree; NaN where unknown.

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
    grid_convergence: FloatArray
    lead_time: FloatArray
    position_resolution: FloatArray
    time_resolution: FloatArray
    wind_speed_resolution: FloatArray
    wind_direction_resolution: FloatArray

    def __repr__(self) -> str:
        # Forty arrays printed would say nothing.
        flights = np.unique(self.flight).size
        counted = f"{self.size:,} reports, {flights:,} flights, {len(self.tails)} aircraft"
        if not self.size:
            return f"<Frame: {counted}>"
        ends = np.array([self.time.min(), self.time.max()]).astype("datetime64[s]")
        return f"<Frame: {counted}, {' to '.join(np.datetime_as_string(ends, 'm'))}>"

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
        """Take rows of the frame by integer index, slice or boolean mask, in the order given.

        Parameters
        ----------
        index : array or slice
            Anything that indexes a 1-D array.

        Returns
        -------
        Frame
            Constants of the archive and of the aircraft are kept.
        """
        return replace(self, **{name: getattr(self, name)[index] for name in REPORT_FIELDS})

    def aircraft_mask(self, tails: str | Sequence[str]) -> NDArray[np.bool_]:
        """Mark, (n,) bool, the reports that are of the aircraft named."""
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
        """Return the great-circle distance from the row before, (n,) m; NaN at a flight's start.

        Rows must be in order of aircraft, flight and time (as `from_headings` gives them).
        """
        lat, lon = np.radians(self.latitude), np.radians(self.longitude)
        out = np.full(self.size, np.nan)
        out[1:] = EARTH_RADIUS * central_angle(lat[:-1], lon[:-1], lat[1:], lon[1:])
        # the way from one flight's end to the next one's beginning was not flown
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
            The headings product (dimensions ``report``, ``reference``, ``aircraft``); degrees.
        reference : str or sequence of str
            One reference, or the members of a pool (their mean is used where they exist).
        phases : sequence of str
            Phases of flight kept; reports of unknown phase are kept with ``cruise``.
        excluded : sequence of str
            Names of screening bits whose reports are left out.
        epoch, reference_field, meridian : float, optional
            Constants of the whole archive (s since 1970, nT, middle longitude in degrees), to be
            given when `ds` is a part of it; by default taken from `ds`.

        Raises
        ------
        InputError
            The reference is unknown, or no report is left.
        """
        return _build(
            cls,
            ds,
            reference,
            phases,
            excluded,
            epoch=epoch,
            reference_field=reference_field,
            meridian=meridian,
        )


REPORT_FIELDS: tuple[str, ...] = tuple(
    f.name
    for f in fields(Frame)
    if f.name not in {"tails", "epoch", "reference_field", *AIRCRAFT_FIELDS}
)
"""Names of the fields that have one value per report."""

_ESSENTIAL = ("u_rep", "v_rep", "u_ref", "v_ref", "ground_u", "ground_v", "heading", "airspeed")


def _kept_phases(phases: Sequence[str]) -> list[int]:
    for name in phases:
        if name not in PHASE:
            raise InputError("unknown phase", found=name, remedy=f"one of {', '.join(PHASE)}")
    codes = [PHASE[name] for name in phases]
    return [*codes, PHASE["unknown"]] if "cruise" in phases else codes


def _build(
    cls: type[Frame],
    ds: xr.Dataset,
    reference: str | Sequence[str],
    phases: Sequence[str],
    excluded: Sequence[str],
    *,
    epoch: float | None,
    reference_field: float | None,
    meridian: float | None,
) -> Frame:
    tails, values, ds = headings_columns(ds, reference, meridian=meridian)
    keep = np.isin(values["phase"], _kept_phases(phases))
    for field in _ESSENTIAL:
        keep &= np.isfinite(values[field])
    if "screening" in ds:
        mask = sum(SCREENING[name] for name in excluded)
        keep &= (np.asarray(ds["screening"].values, dtype=np.int64) & mask) == 0
    if not keep.any():
        raise InputError(
            "no report has a wind, a ground vector and a reference wind at once",
            field="reports",
            found=f"{keep.size} reports read",
            remedy="check that reports and references overlap in time, space and level",
        )
    for name in REPORT_FIELDS:
        values[name] = values[name][keep]
    motion = ("acceleration", "pressure", "phase", "flight", "time", "latitude", "longitude")
    # of the reports kept: it looks at neighbours, and one left out is none
    values["acceleration"] = acceleration_at_reports(*(values[name] for name in motion))
    # after what is left out: drifts count from the first report that is used
    start = float(values["time"].min()) if epoch is None else float(epoch)
    if reference_field is None:
        field_values = values["horizontal_field"][np.isfinite(values["horizontal_field"])]
        reference_field = (
            float(np.median(field_values)) if field_values.size else DEFAULT_HORIZONTAL_FIELD
        )
    return cls(tails=tails, epoch=start, reference_field=float(reference_field), **values)
