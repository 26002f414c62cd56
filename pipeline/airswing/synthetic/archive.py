"""Sample archives: reports and model winds of a fleet whose compasses are known.

All random numbers follow from one seed, and an effect changes nothing else, so that archives with
and without it are paired. The truth is written next to the archive, not into it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic.atmosphere import Array, World, WorldParameters
from airswing.synthetic.fields import (
    GRIB_RADIUS,
    GriddedReference,
    build_reference,
    centred_grid,
    plane,
    sample_reference,
    write_reference,
)
from airswing.synthetic.flights import NETWORKS, fly, report_steps, timetable
from airswing.synthetic.instrument import EarthField, Fault, parse_faults, reference_changes
from airswing.synthetic.observe import Coding, Units, observe
from airswing.synthetic.truth import (
    corrections,
    fleet_deviations,
    save_truth,
    small_effects,
    truth_record,
)

Effects = Sequence[Mapping[str, object]]
LEVELS = (1000, 950, 900, 850, 800, 750, 700, 650, 600, 550, 500, 450, 400, 350)
"""hPa."""
EDITIONS = {"ruc": (1, "grb"), "rtfdaa": (2, "grb2")}
"""GRIB edition and suffix of each model: both editions, so that every archive tests both."""
_PHASES = np.array(["", "ascent", "cruise", "descent"])


@dataclass(frozen=True)
class Scenario:
    """Parameters that determine an archive."""

    days: int = 45
    aircraft: int = 14
    seed: int = 1
    effects: Effects = ()  # see `airswing.synthetic.instrument`
    # "default", or "hard": longer-reaching errors with heavy tails, bias, 1 % outliers and a little
    # of every effect on every aircraft
    world: str = "default"
    network: str = "great_lakes"  # of `airswing.synthetic.flights.NETWORKS`
    start: datetime = datetime(2009, 3, 1)  # first day, UTC
    references: tuple[str, ...] = ("ruc", "rtfdaa")  # of `EDITIONS`
    columns: int = 45  # grid points
    rows: int = 35
    spacing_km: float = 40.635  # grid length
    levels: tuple[int, ...] = LEVELS  # hPa, decreasing
    interval_hours: int = 1  # between fields
    lead_hours: int = 1  # of the forecasts
    legs_per_day: float = 4.0  # flights of one aircraft a day
    shuttles: int = 0  # aircraft that fly on a single route
    climb_seconds: float = 60.0  # between reports; multiples of 10 s
    cruise_seconds: float = 120.0
    coding: Coding = field(default_factory=Coding)
    # (day number, tails): from that day these aircraft apply their 8-point table
    field_test: tuple[int, tuple[str, ...]] | None = None

    @property
    def tails(self) -> list[str]:
        """Names of the aircraft: N401, N402, ..."""
        return [f"N{401 + index}" for index in range(self.aircraft)]


def simulate(
    scenario: Scenario,
) -> tuple[pd.DataFrame, dict[str, GriddedReference], list[Fault]]:
    """Reports (see `finished`), models by name, and faults of an archive."""
    sizes = WorldParameters.hard() if scenario.world == "hard" else WorldParameters()
    world = World(sizes, scenario.seed, 24.0 * scenario.days)
    effects = list(scenario.effects)
    if scenario.world == "hard":
        effects += small_effects(scenario.tails, scenario.seed, days=float(scenario.days))
    faults = parse_faults(effects, start=scenario.start, tails=scenario.tails)
    table = timetable(
        NETWORKS[scenario.network],
        aircraft=scenario.aircraft,
        days=scenario.days,
        seed=scenario.seed,
        legs_per_day=scenario.legs_per_day,
        shuttles=scenario.shuttles,
    )

    def large_scale(latitude: Array, longitude: Array, altitude: Array, hours: Array) -> Array:
        zeta = np.log(pressure_from_altitude(altitude) / 1e5)
        return world.large_scale_at(*plane(latitude, longitude), zeta, hours)

    def wind(_: object, lat: Array, lon: Array, pressure: Array, hours: Array) -> Array:
        return world.at_points(*plane(lat, lon), np.log(pressure / 1e5), hours)

    flown = fly(table, large_scale, seed=scenario.seed)
    flight, step = report_steps(
        flown, climb_seconds=scenario.climb_seconds, cruise_seconds=scenario.cruise_seconds
    )
    latitude, longitude = flown.latitude[step, flight], flown.longitude[step, flight]
    box = (latitude.min(), latitude.max(), longitude.min(), longitude.max())
    earth = EarthField(scenario.start, float(scenario.days), box)
    correction = None
    if scenario.field_test is not None:
        day, corrected = scenario.field_test
        correction = corrections(faults, earth, scenario.tails, corrected, 24.0 * day)
    units = Units(scenario.tails, faults, scenario.coding, correction)
    reports = observe(flown, flight, step, wind=wind, seed=scenario.seed, field=earth, units=units)
    interval = scenario.interval_hours
    last = float(np.ceil(reports["hours"].max())) + interval
    first = np.floor(reports["hours"].min() / interval) * interval
    changes = reference_changes(faults, scenario.references)
    references = {}
    for name in sorted(scenario.references, key=EDITIONS.__getitem__):
        grid = centred_grid(
            *NETWORKS[scenario.network].centre,
            columns=scenario.columns,
            rows=scenario.rows,
            spacing=float(round(1000 * scenario.spacing_km)),
            radius=GRIB_RADIUS[EDITIONS[name][0]],
        )
        hours = np.arange(first, last + 1e-6, interval)
        levels = np.array(scenario.levels, float)
        references[name] = build_reference(world, grid, name, levels, hours, changes[name])
    return finished(reports, scenario.start), references, faults


def simulate_arrays(*, effects: Effects = (), **options: Any) -> pd.DataFrame:
    """An archive as one table with the models' winds, without writing a file.

    The models' winds equal an exact interpolation of the files: the same packed grids, bilinear,
    linear in ln p and in time, rotated to true east and north. ``options`` are further fields of
    `Scenario`. The table is sorted by tail and time. As reported: ``tail, time, latitude,
    longitude`` (degrees), ``altitude`` (m), ``pressure`` (Pa), ``direction`` (degrees), ``speed``
    (kt), ``u, v`` (m/s), ``celsius, phase, icing, roll_flag, flight``. As indicated (radians, m/s):
    ``heading`` (true), ``airspeed``. Exact (radians, SI): ``true_u, true_v, true_heading,
    true_airspeed, ground_u, ground_v, bank, acceleration, declination, horizontal`` (nT), ``dip,
    temperature`` (K). For each model NAME: ``u_NAME, v_NAME`` (m/s).
    """
    frame, references, _ = simulate(Scenario(effects=effects, **options))
    add_winds(frame, references)
    return frame


def add_winds(frame: pd.DataFrame, references: Mapping[str, GriddedReference]) -> None:
    """Add the winds of every model at the reports, in place."""
    places = [frame[name].to_numpy() for name in ("latitude", "longitude", "pressure", "hours")]
    places[2] = places[2] / 100.0
    for name, stored in references.items():
        frame[f"u_{name}"], frame[f"v_{name}"] = sample_reference(stored, *places)


def finished(reports: pd.DataFrame, start: datetime) -> pd.DataFrame:
    """Reports sorted by tail and time, with ``time`` (datetime64) and ``pressure`` (Pa)."""
    frame = reports.sort_values(["tail", "hours", "flight"], kind="stable", ignore_index=True)
    seconds = np.round(frame["hours"].to_numpy() * 3600.0).astype("timedelta64[s]")
    frame["time"] = (np.datetime64(start, "s") + seconds).astype("datetime64[ns]")
    frame["pressure"] = pressure_from_altitude(frame["altitude"].to_numpy())
    return frame


def write_reports(directory: Path, frame: pd.DataFrame) -> None:
    """Write one CSV an aircraft in canonical columns, from `finished` reports."""
    directory.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(
        {
            "tail": frame["tail"],
            "time": frame["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "latitude": frame["latitude"].map("{:.4f}".format),
            "longitude": frame["longitude"].map("{:.4f}".format),
            "pressure_altitude_ft": np.round(frame["altitude"] / 0.3048).astype(int),
            "wind_direction_deg": frame["direction"].map("{:g}".format),
            "wind_speed_kt": frame["speed"].map("{:g}".format),
            "temperature_degC": frame["celsius"].astype(int),
            "temperature_qc": frame["temperature_qc"],
            "roll_flag": frame["roll_flag"],
            "phase": _PHASES[frame["phase"].to_numpy()],
            "flight": frame["flight"].astype(str),
            "icing": frame["icing"],
        }
    )
    for tail, group in table.groupby("tail", sort=True):
        group.to_csv(directory / f"{tail}.csv", index=False)


def write_archive(
    directory: str | Path,
    *,
    effects: Effects | None = None,
    times_per_file: int = 1,
    truth: str | Path | None = None,
    output: str | None = None,
    thinned: Mapping[str, float] | None = None,
    **options: Any,
) -> Path:
    """Write an archive: reports, GRIB, a configuration, and the truth next to them.

    Parameters
    ----------
    directory : path
        Folder, created if missing.
    effects : sequence of mapping, optional
        Faults of units and models (`airswing.synthetic.instrument`). None draws a compass deviation
        for every aircraft; an empty list means perfect units.
    times_per_file : int, default 1
        Valid times in one GRIB file.
    truth : path, optional
        Folder of ``truth.json``; ``directory/truth`` by default.
    output : str, optional
        Output folder of the configuration; ``directory/results`` by default.
    thinned : mapping, optional
        Tail to the share of its flights that is kept.
    **options
        Further fields of `Scenario`: ``days``, ``aircraft``, ``seed`` ...

    Returns
    -------
    Path
        The configuration, ready for ``airswing run``.

    Examples
    --------
    >>> config = airswing.write_archive(folder / "sample", days=1, aircraft=1, seed=1)
    >>> config.name
    'config.yaml'
    """
    root = Path(directory)
    root.mkdir(parents=True, exist_ok=True)  # fails before any flight is simulated
    scenario = Scenario(**options)
    if effects is None:
        effects = fleet_deviations(scenario.tails, scenario.seed)
    scenario = replace(scenario, effects=effects)
    frame, references, faults = simulate(scenario)
    usual = float(frame["horizontal"].median())
    for tail, share in (thinned or {}).items():
        flights = frame["flight"][frame["tail"] == tail].unique()
        flown = flights[: max(1, int(share * flights.size))]
        frame = frame[(frame["tail"] != tail) | frame["flight"].isin(flown)]
    write_reports(root / "reports", frame)
    for name, stored in references.items():
        write_reference(
            root / name,
            stored,
            start=scenario.start,
            edition=EDITIONS[name][0],
            lead_hours=scenario.lead_hours,
            times_per_file=times_per_file,
        )
    where = str(root.resolve())
    config = _config(where, scenario, list(references), output or f"{where}/results")
    target = root / "config.yaml"
    target.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    save_truth(
        Path(truth) if truth is not None else root / "truth",
        truth_record(frame, faults, scenario.tails, effects, usual_field=usual),
        seed=scenario.seed,
        start=scenario.start,
        corrected=scenario.field_test and list(scenario.field_test[1]),
    )
    return target


def _config(folder: str, scenario: Scenario, names: list[str], output: str) -> dict[str, object]:
    config: dict[str, object] = {
        "reports": {"files": f"{folder}/reports/*.csv"},
        "references": {name: {"files": f"{folder}/{name}/*.{EDITIONS[name][1]}"} for name in names},
    }
    if len(names) > 1:
        config["pool"] = {"+".join(names): names}
    if scenario.interval_hours > 1:
        config["collocation"] = {"max_time_gap": f"{scenario.interval_hours} h"}
    if scenario.field_test is not None:
        day, corrected = scenario.field_test
        config["field_test"] = {
            "start": str((scenario.start + timedelta(days=day)).date()),
            "before_start": str(scenario.start.date()),
            "corrected": list(corrected),
            "controls": [tail for tail in scenario.tails if tail not in corrected],
        }
    return config | {"output": output}
