"""Simulated reports as an archive that airswing reads again: canonical columns, CSV or Parquet.

Assumptions: positions, times, levels, temperatures and flags are the archive's; the wind (and the
airspeed and heading, where the archive reports them) is simulated. A report without a reference
wind, a ground vector or a wind of its own keeps its place in the archive with a blank wind, so that
ground vectors come out as they were.

Units are those of the canonical columns (knots, feet, degrees, Celsius).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.errors import InputError
from airswing.flags import ICING, PHASE, ROLL, TEMPERATURE_QC
from airswing.gap.archive.frame import Frame
from airswing.gap.effects import ActiveEffect
from airswing.gap.simulation.forward import Coding, NoiseLike, simulate
from airswing.physics.triangle import wind_from_direction, wrap_degrees
from airswing.products.whole_files import atomic
from airswing.units import FOOT, KNOT, ZERO_CELSIUS

_FLAGS: dict[str, dict[int, str]] = {
    "roll_flag": {ROLL["good"]: "G", ROLL["bad"]: "B", ROLL["not_available"]: "N"},
    "temperature_qc": {TEMPERATURE_QC["pass"]: "pass", TEMPERATURE_QC["fail"]: "fail"},
    "wind_qc": {TEMPERATURE_QC["pass"]: "pass", TEMPERATURE_QC["fail"]: "fail"},
    "phase": {code: name for name, code in PHASE.items() if name != "unknown"},
    "icing": {ICING["off"]: "0", ICING["on"]: "1"},
}


def simulate_reports(
    headings: xr.Dataset,
    *,
    reference: str | Sequence[str],
    effects: Sequence[ActiveEffect] = (),
    noise: NoiseLike | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Simulate the reports of an archive, winds coded in the steps each aircraft shows in it.

    Parameters
    ----------
    headings : xarray.Dataset
        Headings of the archive with the reference wind (and its derivatives, for effects that
        need them).
    reference : str or sequence of str
        The reference, or the members of a pool, whose wind the aircraft fly through.
    effects : sequence of ActiveEffect
        What is wrong, on whom and when.
    noise : NoiseLike, optional
        Error of the reference.
    seed : int
        Of noise and random effects.

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
    coding = Coding.of_archive(frame)
    sent = simulate(frame, effects=effects, noise=noise, coding=coding, seed=seed)
    table: dict[str, object] = {
        "tail": np.repeat(
            np.asarray(headings["aircraft"].values, dtype=object), headings["row_size"].values
        ),
        "time": headings["time"].values.astype("datetime64[ms]"),
        "latitude": _with(headings["latitude"].values, sent.report, sent.latitude).round(6),
        "longitude": _with(
            headings["longitude"].values, sent.report, wrap_degrees(sent.longitude)
        ).round(6),
        **_level(headings),
        **_wind(headings.sizes["report"], sent),
    }
    if "air_temperature" in headings and headings["air_temperature"].notnull().any():
        celsius = np.asarray(headings["air_temperature"].values, dtype=np.float64) - ZERO_CELSIUS
        table["temperature_degC"] = celsius.round(2)
    for name, codes in _FLAGS.items():
        if name in headings:
            values = pd.Series(np.asarray(headings[name].values)).map(codes)
            if values.notna().any():
                table[name] = values.fillna("").to_numpy(dtype=object)
    if "flight" in headings:
        table["flight"] = headings["flight"].values.astype(str).astype(object)
    table |= _reported_air(headings, sent)
    return pd.DataFrame(table)


def report_path(path: Path | str) -> Path:
    """Path of a file of reports, whose suffix says how it is written.

    Raises
    ------
    InputError
        A suffix other than ``.csv`` and ``.parquet``.
    """
    path = Path(path)
    if path.suffix not in {".csv", ".parquet"}:
        raise InputError(
            "reports are written as .csv or .parquet", file=path, found=path.suffix or "no suffix"
        )
    return path


def write_reports(table: pd.DataFrame, path: Path | str) -> Path:
    """Write a report table by the suffix of the file, atomically.

    Parameters
    ----------
    table : pandas.DataFrame
        Canonical columns.
    path : path-like
        ``.csv`` or ``.parquet``.

    Raises
    ------
    InputError
        Another suffix, a missing extra, or a folder that cannot be written to.
    """
    path = report_path(path)
    with atomic(path) as temporary:
        if path.suffix == ".csv":
            text = table.assign(time=_iso(table["time"]))
            text.to_csv(temporary, index=False, lineterminator="\n")
            return path
        try:
            table.to_parquet(temporary, index=False)
        except ImportError as err:
            raise InputError(
                "Parquet needs the extra 'parquet'", file=path, remedy="install airswing[parquet]"
            ) from err
    return path


def _with(
    values: ArrayLike, index: NDArray[np.int64], new: NDArray[np.float64]
) -> NDArray[np.float64]:
    out = np.asarray(values, dtype=np.float64).copy()
    out[index] = new
    return out


def _level(headings: xr.Dataset) -> dict[str, object]:
    if "pressure_altitude" in headings:
        feet = np.asarray(headings["pressure_altitude"].values, dtype=np.float64) / FOOT
        return {"pressure_altitude_ft": feet.round(1)}
    hectopascal = np.asarray(headings["pressure"].values, dtype=np.float64) / 100.0
    return {"pressure_hPa": hectopascal.round(3)}


def _wind(size: int, sent: Frame) -> dict[str, object]:
    speed, direction = wind_from_direction(sent.u_rep, sent.v_rep)
    degrees = np.where(speed > 0.0, np.degrees(direction), 0.0)
    blank = np.full(size, np.nan)
    return {
        "wind_direction_deg": _with(blank, sent.report, degrees.round(6) % 360.0),
        "wind_speed_kt": _with(blank, sent.report, (speed / KNOT).round(6)),
    }


def _reported_air(headings: xr.Dataset, sent: Frame) -> dict[str, object]:
    """Airspeed and heading the unit would have sent, where the archive holds them."""
    out: dict[str, object] = {}
    for name, column, values in (
        ("reported_airspeed", "true_airspeed_kt", sent.airspeed / KNOT),
        ("reported_heading", "heading_deg", np.degrees(sent.heading).round(3) % 360.0),
    ):
        if name in headings and headings[name].notnull().any():
            there = np.isfinite(np.asarray(headings[name].values, dtype=np.float64))
            simulated = _with(np.full(there.size, np.nan), sent.report, values.round(3))
            out[column] = np.where(there, simulated, np.nan)
    return out


def _iso(time: pd.Series[pd.Timestamp]) -> list[str]:
    stamps = np.asarray(time.values, dtype="datetime64[ms]")
    whole = not np.any(stamps.astype(np.int64) % 1000)
    text = np.datetime_as_string(stamps.astype("datetime64[s]") if whole else stamps)
    return [f"{stamp}Z" for stamp in text]
