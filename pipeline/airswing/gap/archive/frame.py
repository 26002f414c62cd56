"""Reports of an archive against one reference, as plain arrays.

Heading and airspeed are the INDICATED values: direction and length of the air vector ``V_A = V_G -
W_reported`` used by the unit. No report is left out for the size of its residual (this would
attenuate every effect). Variables absent from the headings product are NaN (or the code for
unknown). Constants of the whole archive are kept in every subset, so that columns computed by parts
agree with columns computed at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.innovations import member_mean
from airswing.flags import PHASE, ROLL, SCREENING
from airswing.gap.archive.acceleration import acceleration_at_reports
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.physics.bank import bank_at_reports
from airswing.physics.triangle import wrap_degrees
from airswing.products.ragged import blocks, joined, some_reports
from airswing.units import DAY, Picked

Columns = dict[str, NDArray[Any]]  # arrays of integers and of floats

#: Flights of a day in an archive of which a part is used: three for each of the coefficients of the
#: large-scale wind of a day (`airswing.gap.design`), which would otherwise hold their noise.
DENSE = 40
AIRCRAFT_FIELDS = tuple(
    f"{name}_resolution" for name in ("position", "time", "wind_speed", "wind_direction")
)
"""Fields of a frame with one value per aircraft."""
# field of the frame -> variable of the headings product
_SAME = (
    "latitude longitude pressure airspeed climb_rate heading magnetic_heading declination dip bank"
)
_NAMES = {name: name for name in f"{_SAME} horizontal_field lead_time grid_convergence".split()} | {
    "heading_error": "heading_standard_error",
    "acceleration": "longitudinal_acceleration",
    "temperature": "air_temperature",
}
for _u, _side in (("u", "eastward"), ("v", "northward")):
    _NAMES[f"{_u}_rep"] = f"{_side}_wind"
    _NAMES[f"{_u}_ref"] = f"reference_{_side}_wind"
    _NAMES[f"ground_{_u}"] = f"ground_{_side}_velocity"
    _NAMES[f"d{_u}dt"] = f"reference_{_side}_wind_tendency"
    for _axis in ("lnp", "x", "y"):
        _NAMES[f"d{_u}d{_axis}"] = f"reference_{_side}_wind_{_axis}_derivative"
    for _when in ("before", "after"):
        _NAMES[f"{_u}_{_when}"] = f"reference_{_side}_wind_hour_{_when}"
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
    tails, aircraft : tuple of str, (n,) int
        Names of the aircraft; ``aircraft`` indexes them.
    epoch, reference_field : float
        First time (s since 1970) and median horizontal field (nT) of the whole archive.
    report, flight : (n,) int
        Position of each row in the Dataset it came from; flight number, unique over the archive.
    time, latitude, longitude, pressure : (n,) float
        s since 1970, degrees, Pa (from the reported pressure altitude).
    u_rep, v_rep, u_ref, v_ref : (n,) float
        Reported and reference wind, eastward and northward, m s-1.
    heading, magnetic_heading, heading_error : (n,) float
        Indicated heading from true and from magnetic north, and its standard error, rad.
    airspeed, ground_u, ground_v, climb_rate : (n,) float
        Indicated true airspeed, ground velocity, rate of climb, m s-1.
    declination, dip, horizontal_field : (n,) float
        rad, rad (positive downward), nT.
    acceleration, bank : (n,) float
        Longitudinal acceleration, m s-2 (`airswing.gap.archive.acceleration`); rad, right wing down
        positive (`airswing.physics.bank`).
    temperature, lead_time : (n,) float
        K, h.
    phase, icing : (n,) int
        Codes of `airswing.flags`; icing -1 where not reported.
    dudt, dvdt, dudlnp, dvdlnp, dudx, dvdx, dudy, dvdy : (n,) float
        Derivatives of the reference wind: m s-2, m s-1 by ln p, s-1 eastward and northward.
    u_before, v_before, u_after, v_after : (n,) float
        Reference wind an hour before and an hour after the report, m s-1; NaN where unknown.
    grid_convergence : (n,) float
        Rotation from grid-relative to earth-relative wind, rad:
        ``u = cos u_g + sin v_g``, ``v = -sin u_g + cos v_g``.
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
    report: Integers
    aircraft: Integers
    flight: Integers
    time: Floats
    latitude: Floats
    longitude: Floats
    pressure: Floats
    u_rep: Floats
    v_rep: Floats
    u_ref: Floats
    v_ref: Floats
    heading: Floats
    magnetic_heading: Floats
    airspeed: Floats
    ground_u: Floats
    ground_v: Floats
    heading_error: Floats
    declination: Floats
    dip: Floats
    horizontal_field: Floats
    acceleration: Floats
    bank: Floats
    climb_rate: Floats
    temperature: Floats
    phase: Integers
    icing: Integers
    dudt: Floats
    dvdt: Floats
    dudlnp: Floats
    dvdlnp: Floats
    dudx: Floats
    dvdx: Floats
    dudy: Floats
    dvdy: Floats
    u_before: Floats
    v_before: Floats
    u_after: Floats
    v_after: Floats
    grid_convergence: Floats
    lead_time: Floats
    position_resolution: Floats
    time_resolution: Floats
    wind_speed_resolution: Floats
    wind_direction_resolution: Floats

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
    def residual(self) -> Floats:
        """Reported minus reference wind, (n, 2), m s-1."""
        return np.stack([self.u_rep - self.u_ref, self.v_rep - self.v_ref], axis=-1)

    def take(self, index: Picked) -> Frame:
        """Select reports by index, slice or mask; constants of archive and aircraft are kept."""
        return replace(self, **{name: getattr(self, name)[index] for name in REPORT_FIELDS})

    def aircraft_mask(self, tails: str | Sequence[str]) -> Booleans:
        """Mark the reports of the named aircraft, (n,); InputError for an unknown one."""
        wanted = [tails] if isinstance(tails, str) else list(tails)
        for tail in wanted:
            if tail not in self.tails:
                some = ", ".join(self.tails[:8]) + " ..." * (len(self.tails) > 8)
                raise InputError("unknown aircraft", found=tail, remedy=f"the archive holds {some}")
        return np.isin(self.aircraft, [self.tails.index(tail) for tail in wanted])

    @classmethod
    def from_headings(
        cls,
        ds: xr.Dataset,
        *,
        reference: str | Sequence[str],
        phases: Sequence[str] = ("ascent", "cruise", "descent"),
        excluded: Sequence[str] = ("temperature_qc", "wind_qc", "ground_speed"),
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
            Names of screening bits whose reports are left out; by default those of bad quality
            and those without a heading.

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
        tails, values, screening = _read_columns(ds, reference)
        codes = [PHASE[name] for name in phases]
        keep = np.isin(values["phase"], [*codes, PHASE["unknown"]] if "cruise" in phases else codes)
        keep &= (screening & sum(SCREENING[name] for name in excluded)) == 0
        for name in ("u_rep", "v_rep", "u_ref", "v_ref", "ground_u", "ground_v"):
            keep &= np.isfinite(values[name])
        keep &= np.isfinite(values["heading"]) & np.isfinite(values["airspeed"])
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
        field = values["horizontal_field"][np.isfinite(values["horizontal_field"])]
        return cls(
            tails=tails,
            epoch=float(values["time"].min()),  # drifts are counted from the first report in use
            # 20000 nT, usual in middle latitudes, for an archive without magnetic data
            reference_field=float(np.median(field)) if field.size else 20000.0,
            **values,
        )


_CONSTANTS = {"tails", "epoch", "reference_field", *AIRCRAFT_FIELDS}
REPORT_FIELDS = tuple(f.name for f in fields(Frame) if f.name not in _CONSTANTS)
"""Names of the fields with one value per report."""


def _read_columns(
    ds: xr.Dataset, reference: str | Sequence[str]
) -> tuple[tuple[str, ...], Columns, Integers]:
    names = [str(name) for name in np.atleast_1d(ds["reference"].values)]
    wanted = [reference] if isinstance(reference, str) else list(reference)
    if len(wanted) == 1 and wanted[0] not in names:
        wanted = wanted[0].split("+")
    for name in wanted:
        if name not in names:
            raise InputError("unknown reference", found=name, remedy=f"one of {', '.join(names)}")
    members = [names.index(name) for name in wanted]
    ds = ds[[name for name in _VARIABLES if name in ds]].compute()  # one pass over a lazy graph
    tails = tuple(str(name) for name in ds["aircraft"].values)
    values: Columns = {
        "report": np.arange(ds.sizes["report"], dtype=np.int64),
        "aircraft": np.repeat(np.arange(len(tails)), np.asarray(ds["row_size"].values)),
        "time": ds["time"].values.astype("datetime64[ns]").astype(np.int64) / 1e9,
    }
    blank = np.full(ds.sizes["report"], np.nan)
    codes = {
        name: np.asarray(ds[name] if name in ds else np.full_like(blank, missing), np.int64)
        for name, missing in _CODES.items()
    }
    values |= {name: codes[name] for name in ("flight", "phase", "icing")}
    for field, name in _NAMES.items():
        column = blank
        if name in ds and "reference" in ds[name].dims:
            column = member_mean(ds[name].isel(reference=members).astype(np.float64)).to_numpy()
        elif name in ds:
            column = np.asarray(ds[name].values, dtype=np.float64)
        values[field] = np.radians(column) if field in _ANGLES else column
    longitude = values["longitude"]
    # continuous within 180 degrees of the direction of their mean as unit vectors
    meridian = float(np.degrees(np.angle(np.nansum(np.exp(1j * np.radians(longitude))))))
    east = longitude - meridian
    values["longitude"] = np.where(np.abs(east) > 180.0, meridian + wrap_degrees(east), longitude)
    place = {name: values[name] for name in ("latitude", "longitude")}
    motion = values["bank"], codes["roll_flag"], values["flight"], values["time"]
    values["bank"] = bank_at_reports(*motion, **place)
    for name in AIRCRAFT_FIELDS:
        unknown = np.full(len(tails), np.nan)
        values[name] = np.asarray(ds[name].values, np.float64) if name in ds else unknown
    return tails, values, codes["screening"]


def end_of_day(seconds: Floats) -> float:
    """Second of the day about which, within three hours, fewest reports are made."""
    hour = np.bincount((np.mod(seconds, DAY) // 3600).astype(np.int64), minlength=24)
    three = np.convolve(np.r_[hour, hour[:2]], np.ones(3), "valid")
    return (float(np.argmin(three)) + 1.5) * 3600.0


def sampled(headings: xr.Dataset, most: int = 150_000) -> xr.Dataset:
    """Draw whole flights of ragged headings, about ``most`` reports; all if there are no more.

    A report takes 5.7 kB of whitened columns in the memory of a diagnosis. Days are left out evenly
    where fewer than `DENSE` flights of each would remain. Flights are drawn by a multiplicative
    hash of their number (Knuth, The Art of Computer Programming, 6.4), independent of the order of
    reading.
    """
    total = headings.sizes["report"]
    if total <= most or "flight" not in headings:
        return headings
    begun = [_departures(block) for block in blocks(headings, ["flight", "time"])]
    starts = np.concatenate([seconds[begins] for seconds, begins in begun])
    ends, share = end_of_day(starts), most / total
    flights = starts.size * share / np.unique((starts - ends) // DAY).size  # of a day
    days = max(share, min(1.0, flights / DENSE))
    parts = []
    for block, (departure, _) in zip(blocks(headings, _VARIABLES), begun, strict=True):
        day = (departure - ends) // DAY
        used = np.floor((day + 1) * days) > np.floor(day * days)
        hashed = np.asarray(block["flight"].to_numpy(), np.int64) * 2654435761 % 2**32
        parts.append(some_reports(block, used & (hashed < share / days * 2**32)))
    return joined(parts)


def _departures(block: xr.Dataset) -> tuple[Floats, Booleans]:
    """Time of the first report of each report's flight, s since 1970; which reports are first."""
    # the reports of a flight are consecutive
    flight = block["flight"].to_numpy()
    begins = np.r_[True, flight[1:] != flight[:-1]][: flight.size]
    seconds = block["time"].to_numpy().astype("datetime64[s]").astype(np.float64)
    return seconds[np.flatnonzero(begins)][np.cumsum(begins) - 1], begins
