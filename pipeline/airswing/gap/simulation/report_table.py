"""Tables of simulated reports: written for an archive, or read from another simulation.

*Writing.* Positions, times, levels, temperatures and flags are those of the archive; the wind (and
airspeed and heading, where the archive reports them) is simulated, and blank where it was.

*Reading.* A report of another simulation is of the same aircraft at the same time (within 60 s:
times truncated to the minute match) and position (within three minutes of arc). If fewer than half
of the reports, or fewer than 200, have a match, the simulation is of other paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from airswing.errors import InputError
from airswing.flags import ICING, PHASE, QC, ROLL
from airswing.gap.archive.frame import Frame
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.effects import ActiveEffect
from airswing.gap.noise import NoiseModel
from airswing.gap.simulation.forward import Coding, simulate
from airswing.physics.triangle import wind_from_direction, wrap_degrees
from airswing.products.whole_files import atomic, require_parquet
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

_FLAGS: dict[str, dict[int, str]] = {
    "roll_flag": {ROLL["good"]: "G", ROLL["bad"]: "B", ROLL["not_available"]: "N"},
    "temperature_qc": {QC["pass"]: "pass", QC["fail"]: "fail"},
    "wind_qc": {QC["pass"]: "pass", QC["fail"]: "fail"},
    "phase": {code: name for name, code in PHASE.items() if name != "unknown"},
    "icing": {ICING["off"]: "0", ICING["on"]: "1"},
}


def simulate_reports(
    headings: xr.Dataset,
    *,
    reference: str | Sequence[str],
    effects: Sequence[ActiveEffect] = (),
    noise: NoiseModel | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Simulate the reports of an archive, with winds in the steps of each aircraft's coding.

    Parameters
    ----------
    headings : xarray.Dataset
        Headings of the archive with the reference wind (and its derivatives, for effects that
        need them).
    reference : str or sequence of str
        The reference, or the members of a pool, whose wind the aircraft fly through.
    effects : sequence of ActiveEffect
        Effects with aircraft, period and parameters.
    noise : NoiseModel, optional
        Error of the reference.
    seed : int
        Seed of noise and random effects.

    Returns
    -------
    pandas.DataFrame
        One row per report of the archive, canonical columns.

    Raises
    ------
    InputError
        As `simulate` and `Frame.from_headings`.

    Examples
    --------
    >>> table = airswing.simulate_reports(headings, reference="ruc", seed=1)
    >>> table["tail"].nunique()
    6
    """
    frame = Frame.from_headings(headings, reference=reference, excluded=(), phases=tuple(PHASE))
    sent = simulate(frame, effects=effects, noise=noise, coding=Coding.of_archive(frame), seed=seed)
    blank = np.full(headings.sizes["report"], np.nan)

    def column(name: str) -> Floats:
        if name not in headings:
            return blank
        return np.asarray(headings[name].values, dtype=np.float64)

    def merged(values: ArrayLike, simulated: Floats) -> Floats:
        out = np.array(values, dtype=np.float64)
        out[sent.report] = simulated
        return out

    speed, direction = wind_from_direction(sent.u_rep, sent.v_rep)
    degrees = np.where(speed > 0.0, np.degrees(direction), 0.0)
    table: dict[str, object] = {
        "tail": np.repeat(headings["aircraft"].values.astype(object), headings["row_size"].values),
        "time": headings["time"].values.astype("datetime64[ms]"),
        "latitude": merged(column("latitude"), sent.latitude).round(6),
        "longitude": merged(column("longitude"), wrap_degrees(sent.longitude)).round(6),
    }
    if "pressure_altitude" in headings:
        table["pressure_altitude_ft"] = (column("pressure_altitude") / FOOT).round(1)
    else:
        table["pressure_hPa"] = (column("pressure") / 100.0).round(3)
    table["wind_direction_deg"] = merged(blank, degrees.round(6) % 360.0)
    table["wind_speed_kt"] = merged(blank, (speed / KNOT).round(6))
    temperature = column("air_temperature")
    if np.isfinite(temperature).any():
        table["temperature_degC"] = (temperature - ZERO_CELSIUS).round(2)
    for name, codes in _FLAGS.items():
        if name in headings:
            values = pd.Series(np.asarray(headings[name].values)).map(codes)
            if values.notna().any():
                table[name] = values.fillna("").to_numpy(dtype=object)
    if "flight" in headings:
        table["flight"] = headings["flight"].values.astype(str).astype(object)
    for name, canonical, simulated in (
        ("reported_airspeed", "true_airspeed_kt", sent.airspeed / KNOT),
        ("reported_heading", "heading_deg", np.degrees(sent.heading).round(3) % 360.0),
    ):
        reported = np.isfinite(column(name))
        if reported.any():
            table[canonical] = np.where(reported, merged(blank, simulated.round(3)), np.nan)
    return pd.DataFrame(table)


def report_path(path: Path | str) -> Path:
    """Check the suffix of a file of reports, ``.csv`` or ``.parquet``."""
    path = Path(path)
    if path.suffix not in {".csv", ".parquet"}:
        raise InputError(
            "reports are written as .csv or .parquet", file=path, found=path.suffix or "no suffix"
        )
    if path.suffix == ".parquet":
        require_parquet(path)
    return path


def write_reports(table: pd.DataFrame, path: Path | str) -> Path:
    """Write a table of reports atomically, in the format of the suffix.

    InputError for another suffix, a missing extra, or a folder that cannot be written to.
    """
    path = report_path(path)
    with atomic(path) as temporary:
        if path.suffix == ".csv":
            stamps = np.asarray(table["time"].values, dtype="datetime64[ms]")
            in_seconds = not np.any(stamps.astype(np.int64) % 1000)
            text = np.datetime_as_string(stamps, "s" if in_seconds else "ms")
            table = table.assign(time=[f"{stamp}Z" for stamp in text])
            table.to_csv(temporary, index=False, lineterminator="\n")
        else:
            table.to_parquet(temporary, index=False)
    return path


@dataclass(frozen=True)
class Matched:
    """Simulated winds at the reports of an archive."""

    # (n,): simulated wind, m s-1; NaN without a match
    u: Floats
    v: Floats
    simulated: int  # number of reports of the simulation

    @property
    def found(self) -> Booleans:
        """Whether each report has a match, (n,)."""
        return np.isfinite(self.u) & np.isfinite(self.v)

    @property
    def same_paths(self) -> bool:
        """Whether the simulation follows the paths of the archive."""
        return bool(self.found.sum() >= max(200, 0.5 * self.found.size))


def match_reports(frame: Frame, simulated: xr.Dataset) -> Matched:
    """Find the simulated report (from `read_reports`) of every report of an archive."""
    seconds = simulated["time"].values.astype("datetime64[ms]").astype(np.int64) / 1e3
    tails = np.repeat(simulated["aircraft"].values.astype(str), simulated["row_size"].values)
    owner = np.array(frame.tails)[frame.aircraft]
    real = pd.DataFrame({"tail": owner, "time": frame.time}).rename_axis("row").reset_index()
    table = pd.DataFrame({"tail": tails, "time": seconds}).rename_axis("nearest").reset_index()
    tables = real.sort_values("time"), table.sort_values("time")
    pairs = pd.merge_asof(*tables, on="time", by="tail", direction="nearest", tolerance=60).dropna()
    rows, nearest = (pairs[side].to_numpy(np.int64) for side in ("row", "nearest"))
    latitude, longitude = simulated["latitude"].values, simulated["longitude"].values
    north = latitude[nearest] - frame.latitude[rows]
    east = wrap_degrees(longitude[nearest] - frame.longitude[rows])
    same = np.hypot(north, east * np.cos(np.radians(frame.latitude[rows]))) <= 0.05
    u, v = np.full((2, frame.size), np.nan)
    u[rows[same]] = simulated["eastward_wind"].values[nearest[same]]
    v[rows[same]] = simulated["northward_wind"].values[nearest[same]]
    return Matched(u, v, int(seconds.size))


def with_simulated_wind(frame: Frame, matched: Matched) -> Frame:
    """Replace the reference wind by the simulated wind, at the reports with a match."""
    is_matched = matched.found
    if not is_matched.any():
        raise InputError("no simulated report is of an aircraft and time of the archive")
    frame = frame.take(np.flatnonzero(is_matched))
    return replace(frame, u_ref=matched.u[is_matched], v_ref=matched.v[is_matched])
