"""Real data with an effect added: errors of a real flux valve, and of a real forecast.

Sensor (Garmin G1000, 1 Hz; headings and tracks magnetic): along each record ground velocity =
airspeed x heading vector + wind, with a wind piecewise linear in time (knots every 5 minutes) and
linear in height, a heading in error by a constant, one and two cycles, an airspeed in error by a
factor. The residual of that fit, less the mean of each heading, replaces the generator's instrument
noise: each report takes that of a moment when the real aircraft was on about the same magnetic
heading. Model: `airswing.synthetic.real_winds`. Units: radians, m/s; degrees, kt in the records.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic import real_winds
from airswing.synthetic.atmosphere import Array, stream
from airswing.synthetic.fields import GriddedReference, sample_reference
from airswing.synthetic.instrument import coded, compute_wind
from airswing.synthetic.sealed.draws import World
from airswing.synthetic.sealed.labels import TwinClosure
from airswing.units import KNOT

_WIND_KNOT_SECONDS = 300.0  # slower changes are the wind's, faster ones the sensor's
_HEADING_BINS = 36
_MODEL_FOLDER = "wrf_ruc13_g212"


@dataclass(frozen=True)
class SensorRecord:
    """Residual errors of one real flight, each (n,)."""

    magnetic: Array  # indicated magnetic heading, radians
    heading_error: Array  # less the mean of each heading, radians
    airspeed_error: Array  # less the mean of each heading, m/s


def sensor_record(table: pd.DataFrame) -> SensorRecord:
    """Irregular errors of the sensors in one record of the Garmin's columns, one row a second."""
    names = ("HDG", "TRK", "TAS", "GndSpd", "AltMSL", "Roll")
    values = {name: table[name].to_numpy(float) for name in names}
    good = np.all([np.isfinite(column) for column in values.values()], axis=0)
    good &= (values["TAS"] > 60.0) & (values["GndSpd"] > 50.0) & (np.abs(values["Roll"]) < 12.0)
    if good.sum() < 600:
        raise InputError("too little level flight in a record", found=f"{int(good.sum())} s")
    seconds = np.arange(good.size, dtype=float)[good]
    heading, track = np.radians(values["HDG"][good]), np.radians(values["TRK"][good])
    airspeed, ground = values["TAS"][good] * KNOT, values["GndSpd"][good] * KNOT
    ahead = np.stack([np.sin(heading), np.cos(heading)])
    right = np.stack([np.cos(heading), -np.sin(heading)])
    wind = ground * np.stack([np.sin(track), np.cos(track)]) - airspeed * ahead
    left = _left_over(seconds, values["AltMSL"][good], heading, airspeed, wind, ahead, right)
    turned, longer = -(left * right).sum(0) / airspeed, -(left * ahead).sum(0)
    return SensorRecord(heading, _irregular(heading, turned), _irregular(heading, longer))


def _irregular(heading: Array, error: Array) -> Array:
    """Error less the mean of each heading.

    Reports draw their moments by heading: a lasting deviation of the unit would return in every
    report of that heading, and a diagnosis that names it would be right.
    """
    bins = _heading_bin(heading)
    count = np.bincount(bins, minlength=_HEADING_BINS)
    mean = np.bincount(bins, error, _HEADING_BINS) / np.maximum(count, 1)
    return np.asarray(error - mean[bins])


def _heading_bin(heading: Array) -> NDArray[np.int64]:
    turn = np.mod(heading, 2 * np.pi) / (2 * np.pi)
    return np.asarray(turn * _HEADING_BINS, np.int64) % _HEADING_BINS


def _left_over(
    seconds: Array,
    altitude: Array,
    heading: Array,
    airspeed: Array,
    wind: Array,
    ahead: Array,
    right: Array,
) -> Array:
    """Part (2, n) of the computed wind that no smooth wind or deviation explains."""
    knots = np.arange(seconds[0], seconds[-1] + _WIND_KNOT_SECONDS, _WIND_KNOT_SECONDS)
    hats = np.stack([np.interp(seconds, knots, row) for row in np.eye(knots.size)])
    smooth = np.concatenate([hats[hats.sum(1) > 0], [(altitude - altitude.mean()) / 1000.0]])
    cycles = [np.ones_like(heading)]
    cycles += [wave(k * heading) for k in (1, 2) for wave in (np.sin, np.cos)]
    blank = np.zeros_like(smooth)
    columns = [np.stack([smooth, blank], 1), np.stack([blank, smooth], 1)]
    columns += [(-airspeed * right)[None] * np.stack(cycles)[:, None]]
    columns += [(airspeed * ahead)[None]]
    design = np.concatenate(columns).transpose(2, 1, 0).reshape(-1, sum(map(len, columns)))
    target = wind.T.ravel()
    solution = np.linalg.lstsq(design, target, rcond=1e-9)[0]
    return np.asarray((target - design @ solution).reshape(-1, 2).T)


def real_sensor(folder: Path) -> list[SensorRecord]:
    """Records of every flight (``*flight*.csv``) in a folder; InputError if there is none."""
    files = sorted(folder.glob("*flight*.csv"))
    if not files:
        raise InputError("no record of a real flux valve", file=folder)
    records = []
    for path in files:
        table = pd.read_csv(path, skipinitialspace=True, low_memory=False)
        table.columns = [str(name).strip().lstrip("#").strip() for name in table.columns]
        numbers = {name: pd.to_numeric(table[name], errors="coerce") for name in table}
        records.append(sensor_record(pd.DataFrame(numbers)))
    return records


def with_real_sensor(
    frame: pd.DataFrame, records: Sequence[SensorRecord], *, seed: int
) -> pd.DataFrame:
    """An archive of noiseless instruments with errors of real records, dealt to the aircraft."""
    out = frame.copy()
    magnetic = (out["heading"] - out["declination"]).to_numpy(float)
    turned, longer = np.zeros(len(out)), np.zeros(len(out))
    aircraft = out["aircraft"].to_numpy(int)
    flight = out["flight"].to_numpy(int)
    begin = stream(seed, "record position").integers(0, 1 << 20, int(flight.max()) + 1)
    for number, record in enumerate(records):
        rows = np.flatnonzero(aircraft % len(records) == number)
        moment = _moments(record, magnetic[rows], flight[rows], begin)
        turned[rows] = record.heading_error[moment]
        longer[rows] = record.airspeed_error[moment]
    air = out["heading"].to_numpy(float), out["airspeed"].to_numpy(float)
    ground = out["ground_u"].to_numpy(float), out["ground_v"].to_numpy(float)
    heading, airspeed = air[0] + turned, air[1] + longer
    u, v = compute_wind(*ground, airspeed, heading)
    direction, speed = coded(u, v, direction_step=np.ones(len(out)), speed_step=np.ones(len(out)))
    out["heading"], out["airspeed"] = heading, airspeed
    out["direction"], out["speed"] = direction, speed
    out["u"] = -speed * KNOT * np.sin(np.radians(direction))
    out["v"] = -speed * KNOT * np.cos(np.radians(direction))
    return out


def _moments(
    record: SensorRecord, magnetic: Array, flight: NDArray[np.int64], begin: NDArray[np.int64]
) -> NDArray[np.int64]:
    """A moment of the record for each report: same heading, advancing along the flight."""
    bins = _heading_bin(record.magnetic)
    order = np.argsort(bins, kind="stable")
    bins, wanted = bins[order], _heading_bin(magnetic)
    present = np.unique(bins)
    gap = np.abs(np.angle(np.exp(2j * np.pi * (wanted[:, None] - present) / _HEADING_BINS)))
    nearest = present[np.argmin(gap, axis=1)]
    first, last = np.searchsorted(bins, nearest), np.searchsorted(bins, nearest, "right")
    new = np.r_[True, flight[1:] != flight[:-1]]
    position = np.arange(flight.size)
    since = position - np.maximum.accumulate(np.where(new, position, 0))
    return np.asarray(order[first + (begin[flight] + since) % (last - first)], np.int64)


def write_model_case(
    folder: Path, real: Path, effects: Sequence[Mapping[str, object]], world: World
) -> TwinClosure:
    """Write a case on a real forecast run and measure its true closure."""
    grib = real / "grib" / _MODEL_FOLDER
    if not grib.is_dir():
        raise InputError("no real model run", file=grib)
    run, _, start = real_winds.read_run(grib)
    found = {}
    for name, active in (("after", []), ("before", list(effects))):
        real_winds.write_archive(
            folder,
            grib,
            aircraft=world.aircraft,
            seed=world.seed,
            effects=active,
            output=str((folder / "results").resolve()),
        )
        found[name] = _read_disagreement(folder / "reports", run, np.datetime64(start, "s"))
    shutil.rmtree(folder / "truth")
    return {"after": found["after"], "before": found["before"]}


def _read_disagreement(folder: Path, run: GriddedReference, start: np.datetime64) -> float:
    """Mean disagreement of written reports with a run's winds, kt."""
    table = pd.concat([pd.read_csv(path) for path in sorted(folder.glob("*.csv"))])
    table = table[table["temperature_qc"] == "pass"]
    times = pd.to_datetime(table["time"]).dt.tz_localize(None).to_numpy("datetime64[s]")
    hours = (times - start).astype(float) / 3600.0
    pressure = pressure_from_altitude(0.3048 * table["pressure_altitude_ft"].to_numpy(float))
    wind = sample_reference(
        run, table["latitude"].to_numpy(), table["longitude"].to_numpy(), pressure / 100.0, hours
    )
    angle = np.radians(table["wind_direction_deg"].to_numpy(float))
    speed = table["wind_speed_kt"].to_numpy(float) * KNOT
    apart = np.hypot(-speed * np.sin(angle) - wind[0], -speed * np.cos(angle) - wind[1])
    return float(np.nanmean(apart) / KNOT)
