"""Writes the archive and label of a drawn case: scales effects, shares winds, measures the truth.

A strength is the root mean square of the change in reported minus model wind where the effect acts,
measured on a short archive of the same world without coding, and taken as proportional to the
effect's parameters. The true closure is measured on the reports written and on the twin archive of
the same seed without the effect. GRIB files are written once per world and state of the models. The
generator shares no code with `airswing.gap.effects`.

Errors of a real sensor (Garmin G1000, 1 Hz; headings and tracks magnetic): along each record ground
velocity = airspeed x heading vector + wind, with a wind piecewise linear in time (knots every 5
minutes) and linear in height, a heading in error by a constant, one and two cycles, an airspeed in
error by a factor. The residual of that fit, minus the mean of each heading, replaces the
generator's instrument noise. Errors of a real model: `airswing.synthetic.real_winds`.

Units: radians, m/s; degrees, kt in the records, kt for disagreement.
"""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic import real_winds
from airswing.synthetic.archive import (
    EDITIONS,
    Scenario,
    add_winds,
    simulate,
    simulate_arrays,
    write_reports,
)
from airswing.synthetic.atmosphere import Array, stream
from airswing.synthetic.fields import GriddedReference, sample_reference, write_reference
from airswing.synthetic.instrument import UNIT_FAULTS, coded, compute_wind
from airswing.synthetic.observe import Coding
from airswing.synthetic.outside_effects import WORTH_KT, is_fit, outside_truth
from airswing.synthetic.sealed.cases import Case
from airswing.synthetic.sealed.draws import START, Drawn, World, scaled
from airswing.synthetic.sealed.labels import Injected, Label
from airswing.units import KNOT

Effects = Sequence[Injected]
REFERENCES = ("ruc", "rtfdaa")
_CALIBRATION_DAYS = 5  # a strength is a mean over flights: a few days give it
# Components by which a diagnosis states an irregular error of the heading.
_ACROSS = ("across_heading", "heading_angle", "cross", "scatter")
# Rounding is not part of the strength of an effect.
_EXACT = Coding(direction_deg=0.001, speed_kt=0.001, position_arcmin=0.001)
_COARSE: dict[str, Any] = {"columns": 32, "rows": 25, "spacing_km": 57.0, "interval_hours": 2}
# Fields accurate enough to measure a strength.
_THIN_FIELDS: dict[str, Any] = {
    "columns": 16,
    "rows": 12,
    "spacing_km": 120.0,
    "interval_hours": 3,
    "levels": (1000, 900, 800, 700, 600, 500, 400, 350),
}


def generator_options(world: World) -> dict[str, Any]:
    """Options of `simulate_arrays` and `write_archive` for a world."""
    return {
        **(_COARSE if world.coarse else {}),
        "days": world.days,
        "aircraft": world.aircraft,
        "seed": world.seed,
        "world": "hard" if world.kind == "hard" else "default",
        "start": START,
    }


def innovation(frame: pd.DataFrame) -> Array:
    """Reported minus pooled model wind, (n, 2) m/s; NaN outside the fields."""
    parts = [
        frame[name] - sum(frame[f"{name}_{reference}"] for reference in REFERENCES) / 2.0
        for name in ("u", "v")
    ]
    return np.stack([np.asarray(column, float) for column in parts], axis=-1)


def twin_closure(archive: pd.DataFrame, twin: pd.DataFrame) -> dict[str, float]:
    """Mean vector disagreement (kt) of an archive and of its twin, on the reports both use."""
    frames = archive.set_index("made"), twin.set_index("made").loc[archive["made"]]
    used = np.ones(len(archive), bool)
    for frame in frames:
        used &= (frame["temperature_qc"] == "pass").to_numpy(bool)
        used &= np.isfinite(innovation(frame)).all(axis=1)
    before, after = (float(np.hypot(*innovation(frame)[used].T).mean() / KNOT) for frame in frames)
    return {"before": before, "after": after}


def strength_of(drawn: Drawn, world: World) -> float:
    """Strength (m/s) of an effect without a ladder, measured on a few days of the world."""
    short = replace(world, days=min(world.days, _CALIBRATION_DAYS))
    bare = _calibration(short)
    # Without its period; a swap is measured by the deviations it exchanges.
    always: list[Injected] = [{**effect, "period": None} for effect in drawn.effects]
    changed = _calibrating(short, [e for e in always if "pair" not in e["parameters"]])
    change = innovation(changed) - innovation(bare)
    acting = np.isfinite(change).all(axis=1)
    if drawn.tails is not None:
        acting &= np.isin(bare["tail"].to_numpy(str), np.array(drawn.tails))
    if drawn.draw.acts is not None:
        acting &= drawn.draw.acts(bare, drawn.effects[0]["parameters"])
    size = float(np.sqrt((change[acting] ** 2).sum(axis=1).mean())) if acting.any() else 0.0
    if drawn.draw.grows:
        period = drawn.effects[0]["period"]
        begins = START
        if period is not None and period[0] is not None:
            begins = datetime.fromisoformat(period[0])
        size *= (world.days - (begins - START).total_seconds() / 86400.0) / short.days
    return 2.0 * size if drawn.draw.scope == "pair" else size


@functools.lru_cache(maxsize=1)
def _calibration(short: World) -> pd.DataFrame:
    return _calibrating(short, [])


def _calibrating(short: World, effects: Effects) -> pd.DataFrame:
    options: dict[str, Any] = {**generator_options(short), **_THIN_FIELDS, "coding": _EXACT}
    return simulate_arrays(effects=effects, **options)


@functools.lru_cache(maxsize=2)
def _fields(world: World, on_models: str) -> dict[str, GriddedReference]:
    return simulate(Scenario(effects=json.loads(on_models), **generator_options(world)))[1]


def _on_models(effects: Effects) -> str:
    return json.dumps([dict(e) for e in effects if e["name"].startswith("reference_")])


def simulated(world: World, effects: Effects, **options: Any) -> pd.DataFrame:
    """Reports of a world with the winds of its models, which are built once for all its cases."""
    options |= generator_options(world) | {"references": ()}
    frame = simulate_arrays(effects=effects, **options)
    add_winds(frame, _fields(world, _on_models(effects)))
    return frame


_WIND_KNOT_SECONDS = 300.0  # slower changes are the wind's, faster ones the sensor's
_HEADING_BINS = 36
_MODEL_FOLDER = "wrf_ruc13_g212"


@dataclass(frozen=True)
class SensorRecord:
    """Residual errors of one real flight, each (n,)."""

    magnetic: Array  # indicated magnetic heading, radians
    heading_error: Array  # minus the mean of each heading, radians
    airspeed_error: Array  # minus the mean of each heading, m/s


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
    # The part of the wind that no smooth wind and no deviation explains.
    knots = np.arange(seconds[0], seconds[-1] + _WIND_KNOT_SECONDS, _WIND_KNOT_SECONDS)
    hats = np.stack([np.interp(seconds, knots, row) for row in np.eye(knots.size)])
    altitude = values["AltMSL"][good]
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
    residual = (target - design @ solution).reshape(-1, 2).T
    turned, longer = -(residual * right).sum(0) / airspeed, -(residual * ahead).sum(0)
    return SensorRecord(heading, _irregular(heading, turned), _irregular(heading, longer))


def _irregular(heading: Array, error: Array) -> Array:
    # reports draw their moments by heading: a lasting deviation of the unit would return in every
    # report of that heading, and a diagnosis that names it would be right
    bins = _heading_bin(heading)
    count = np.bincount(bins, minlength=_HEADING_BINS)
    mean = np.bincount(bins, error, _HEADING_BINS) / np.maximum(count, 1)
    return np.asarray(error - mean[bins])


def _heading_bin(heading: Array) -> NDArray[np.int64]:
    turn = np.mod(heading, 2 * np.pi) / (2 * np.pi)
    return np.asarray(turn * _HEADING_BINS, np.int64) % _HEADING_BINS


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
    """An archive of noiseless instruments with errors of real records, assigned to the aircraft."""
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
    ground = out["ground_u"].to_numpy(float), out["ground_v"].to_numpy(float)
    heading = out["heading"].to_numpy(float) + turned
    airspeed = out["airspeed"].to_numpy(float) + longer
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
) -> dict[str, float]:
    """Write a case on a real forecast run and measure its true closure."""
    grib = real / "grib" / _MODEL_FOLDER
    if not grib.is_dir():
        raise InputError("no real model run", file=grib)
    run, _, start = real_winds.read_run(grib)
    disagreement = {}
    for name, active in (("after", []), ("before", list(effects))):
        real_winds.write_archive(
            folder,
            grib,
            aircraft=world.aircraft,
            seed=world.seed,
            effects=active,
            output=str((folder / "results").resolve()),
        )
        disagreement[name] = _read_disagreement(folder / "reports", run, np.datetime64(start, "s"))
    shutil.rmtree(folder / "truth")
    return disagreement


def _read_disagreement(folder: Path, run: GriddedReference, start: np.datetime64) -> float:
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
    distance = np.hypot(-speed * np.sin(angle) - wind[0], -speed * np.cos(angle) - wind[1])
    return float(np.nanmean(distance) / KNOT)


@dataclass
class Archivist:
    """Writes the archives of a check and keeps the parts they share."""

    root: Path  # folder of the check; archives go to ``cases``, fields to ``winds``
    real: Path | None = None  # folder with real data for rung 5
    _bare: tuple[World, pd.DataFrame] | None = field(default=None, init=False)

    def write(self, case: Case) -> Label:
        """Write the archive of one case and return its label."""
        for item in case.drawn:
            if item.draw.fault is not None:
                UNIT_FAULTS.setdefault(item.name, item.draw.fault)
        outside = None
        if case.kind == "outside":
            item, outside = self._fit_draw(case)
            drawn = [item]
        else:
            drawn = [
                self._strengthened(item, size, case.world)
                for item, size in zip(case.drawn, case.sizes, strict=True)
            ]
        effects = [effect for item in drawn for effect in item.effects]
        folder = self.root / "cases" / case.name
        if case.world.kind == "model":
            assert self.real is not None
            closure = write_model_case(folder, self.real, effects, case.world)
        else:
            closure = self._write_sample(folder, case.world, effects)
        sizes = list(case.sizes) if outside is None else [outside["size_m_s"]]
        return {
            "name": case.name,
            "rung": case.rung,
            "kind": case.kind,
            "variant": case.variant,
            "world": case.world.kind,
            "size": max(sizes, default=0.0),
            "sizes": sizes,
            "focus": [item.name for item in drawn],
            "names": list(dict.fromkeys(name for item in drawn for name in item.names)),
            "effects": effects,
            "without": list(case.without),
            # The tails of a real record are heavy: a diagnosis that names them is right.
            "background": ["outliers"] if case.world.kind in ("hard", "sensor") else [],
            # The record turns the heading of every aircraft: an effect across it is not false.
            "background_components": list(_ACROSS) if case.world.kind == "sensor" else [],
            "closure": closure,
            "outside": outside,
        }

    def _fit_draw(self, case: Case) -> tuple[Drawn, dict[str, Any]]:
        """First suitable draw of an outside effect, and its truth.

        For a case with ``worth``, the first suitable one that closes `WORTH_KT`, or that with the
        largest closure. If none is suitable (rare), the one that named effects explain least.
        """
        bare = self._without(case.world)
        wind = innovation(bare)
        fit, every = [], []
        for item in (*case.drawn, *case.instead):
            truth = outside_truth(bare, wind, item.effects[0], seed=case.world.seed)
            every.append((item, truth))
            if is_fit(truth):
                fit.append((item, truth))
                if not case.worth or truth["closes_kt"] >= WORTH_KT:
                    return fit[-1]
        if fit:
            return max(fit, key=lambda pair: pair[1]["closes_kt"])
        return min(every, key=lambda pair: pair[1]["named_share"])

    def _strengthened(self, drawn: Drawn, size: float, world: World) -> Drawn:
        if drawn.draw.ladder:
            return drawn
        ordinary = replace(world, kind="default", days=max(world.days, _CALIBRATION_DAYS))
        return scaled(drawn, size / max(strength_of(drawn, ordinary), 1e-6))

    def _write_sample(self, folder: Path, world: World, effects: Effects) -> dict[str, float]:
        frame = self._simulated(world, effects)
        bare = frame if not effects else self._without(world)
        write_reports(folder / "reports", frame)
        winds = self._winds_of(world, effects)
        config = yaml.safe_load((winds / "config.yaml").read_text(encoding="utf-8"))
        config["reports"]["files"] = str((folder / "reports" / "*.csv").resolve())
        config["output"] = str((folder / "results").resolve())
        (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
        return twin_closure(frame, bare)

    def _simulated(self, world: World, effects: Effects) -> pd.DataFrame:
        if world.kind != "sensor":
            return simulated(world, effects)
        assert self.real is not None
        silent = Coding(heading_noise=0.0, airspeed_noise=0.0)
        frame = simulated(world, effects, coding=silent)
        return with_real_sensor(frame, real_sensor(self.real / "heading"), seed=world.seed)

    def _without(self, world: World) -> pd.DataFrame:
        if self._bare is None or self._bare[0] != world:
            self._bare = world, self._simulated(world, [])
        return self._bare[1]

    def _winds_of(self, world: World, effects: Effects) -> Path:
        on_models = _on_models(effects)
        key = json.dumps([*astuple(world), on_models])
        folder = self.root / "winds" / hashlib.sha256(key.encode()).hexdigest()[:10]
        if (folder / "config.yaml").exists():
            return folder
        where, references = str(folder.resolve()), {}
        for name, stored in _fields(world, on_models).items():
            edition, suffix = EDITIONS[name]
            write_reference(
                folder / name, stored, start=START, edition=edition, lead_hours=1, times_per_file=6
            )
            references[name] = {"files": f"{where}/{name}/*.{suffix}"}
        config = {
            "reports": {"files": ""},
            "references": references,
            "pool": {"+".join(references): list(references)},
            "output": "",
        }
        (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
        return folder
