"""Sample archives: reports and model winds of a fleet whose compasses are known.

Assumptions: what `airswing.synthetic.world.true_atmosphere`, `fleet`, `instrument`, `faults` and
`observe` state. The truth is written beside the archive, never into it. Everything follows from one
seed; an effect switched on changes nothing else, so two archives with and without it are paired.

Units in the files: the canonical columns'. `simulate_arrays` gives SI, radians and degrees as its
docstring says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic.aircraft.airborne_fleet import Flown, fly, report_steps
from airswing.synthetic.aircraft.faults import Fault, parse_faults, reference_changes
from airswing.synthetic.aircraft.network import NETWORKS, timetable
from airswing.synthetic.aircraft.observe import Coding, Correction, Units, observe
from airswing.synthetic.aircraft.truth import (
    corrections,
    fleet_deviations,
    save_truth,
    small_effects,
    truth_record,
)
from airswing.synthetic.world.earthfield import EarthField
from airswing.synthetic.world.gridded_fields import (
    GriddedReference,
    build_references,
    plane,
    sample_reference,
)
from airswing.synthetic.world.lambert import GRIB2_RADIUS, LambertGrid, centred_grid
from airswing.synthetic.world.true_atmosphere import World, WorldParameters

__all__ = ["Options", "Scenario", "simulate_arrays", "write_archive"]

Array = NDArray[np.float64]
Effects = Sequence[Mapping[str, object]]

LEVELS = (1000, 950, 900, 850, 800, 750, 700, 650, 600, 550, 500, 450, 400, 350)  # hPa
# Both editions, so that every made run reads both.
_EDITION = {"ruc": 1, "rtfdaa": 2, "rr": 2}
_GRID_RELATIVE = {"ruc": True, "rtfdaa": True, "rr": False}


@dataclass(frozen=True)
class Scenario:
    """Everything an archive follows from."""

    # days, aircraft, seed: length, fleet size, seed
    days: int = 45
    aircraft: int = 14
    seed: int = 1
    effects: Effects = ()  # see `airswing.synthetic.aircraft.faults`
    # ``default``, or ``hard``: longer-reaching error with heavy tails, bias, 1 % outliers and a
    # little of every effect on every aircraft
    world: str = "default"
    network: str = "great_lakes"  # key of `airswing.synthetic.aircraft.network.NETWORKS`
    start: datetime = datetime(2009, 3, 1)  # first day, UTC
    # of ``ruc`` (GRIB1), ``rtfdaa`` and ``rr`` (GRIB2)
    references: tuple[str, ...] = ("ruc", "rtfdaa")
    # columns, rows: grid points
    columns: int = 45
    rows: int = 35
    spacing_km: float = 40.635  # grid length
    levels: tuple[int, ...] = LEVELS  # hPa, decreasing
    # interval_hours, lead_hours: between fields; length of the forecasts
    interval_hours: int = 1
    lead_hours: int = 1
    legs_per_day: float = 4.0  # flights of one aircraft a day
    shuttles: int = 0  # how many of the aircraft fly on a single route
    # climb_seconds, cruise_seconds: between reports; multiples of 10 s
    climb_seconds: float = 60.0
    cruise_seconds: float = 120.0
    coding: Coding = field(default_factory=Coding)  # what the units can express, and their noise
    # (day number, tails): from that day these aircraft apply their 8-point table
    field_test: tuple[int, tuple[str, ...]] | None = None
    packing: Mapping[str, str] = field(default_factory=dict)  # eccodes packing type by reference

    @property
    def tails(self) -> list[str]:
        """Names of the aircraft: N401, N402, ..."""
        return [f"N{401 + index}" for index in range(self.aircraft)]

    @property
    def sizes(self) -> WorldParameters:
        """Sizes of winds and errors."""
        return WorldParameters.hard() if self.world == "hard" else WorldParameters()

    def grid(self, radius: float) -> LambertGrid:
        """Return the model grid on a sphere of this radius."""
        centre = NETWORKS[self.network].centre
        return centred_grid(
            *centre,
            columns=self.columns,
            rows=self.rows,
            spacing=float(round(1000 * self.spacing_km)),
            radius=radius,
        )


class Options(TypedDict, total=False):
    """Fields of `Scenario` but its effects."""

    days: int
    aircraft: int
    seed: int
    world: str
    network: str
    start: datetime
    references: tuple[str, ...]
    columns: int
    rows: int
    spacing_km: float
    levels: tuple[int, ...]
    interval_hours: int
    lead_hours: int
    legs_per_day: float
    shuttles: int
    climb_seconds: float
    cruise_seconds: float
    coding: Coding
    field_test: tuple[int, tuple[str, ...]] | None
    packing: Mapping[str, str]


@dataclass(frozen=True)
class _Simulated:
    """One archive in memory."""

    reports: pd.DataFrame
    references: dict[str, GriddedReference]
    faults: list[Fault]
    field: EarthField
    correction: Correction | None


def _fly(scenario: Scenario, world: World) -> Flown:
    """Return the scenario's flights through the large-scale wind."""
    table = timetable(
        NETWORKS[scenario.network],
        aircraft=scenario.aircraft,
        days=scenario.days,
        seed=scenario.seed,
        legs_per_day=scenario.legs_per_day,
        shuttles=scenario.shuttles,
    )

    def wind(latitude: Array, longitude: Array, altitude: Array, hours: Array) -> Array:
        x, y = plane(latitude, longitude)
        zeta = np.log(pressure_from_altitude(altitude) / 1e5)
        return world.large_scale_at(x, y, zeta, hours)

    return fly(table, wind, seed=scenario.seed)


def _simulate(scenario: Scenario) -> _Simulated:
    """Fly, observe and build the references."""
    world = World(scenario.sizes, scenario.seed, 24.0 * scenario.days)
    effects = list(scenario.effects)
    if scenario.world == "hard":
        effects += small_effects(scenario.tails, scenario.seed, days=float(scenario.days))
    faults = parse_faults(effects, start=scenario.start, tails=scenario.tails)
    flown = _fly(scenario, world)
    flight, step = report_steps(
        flown, climb_seconds=scenario.climb_seconds, cruise_seconds=scenario.cruise_seconds
    )
    inside = flown.latitude[step, flight], flown.longitude[step, flight]
    box = (inside[0].min(), inside[0].max(), inside[1].min(), inside[1].max())
    earth = EarthField(scenario.start, float(scenario.days), box)
    correction = None
    if scenario.field_test is not None:
        day, chosen = scenario.field_test
        correction = corrections(faults, earth, scenario.tails, chosen, 24.0 * day)

    def wind(_: object, lat: Array, lon: Array, pressure: Array, hours: Array) -> Array:
        return world.at_points(*plane(lat, lon), np.log(pressure / 1e5), hours)

    reports = observe(
        flown,
        flight,
        step,
        wind=wind,
        seed=scenario.seed,
        field=earth,
        units=Units(scenario.tails, faults, scenario.coding, correction),
    )
    last = float(np.ceil(reports["hours"].max())) + scenario.interval_hours
    first = np.floor(reports["hours"].min() / scenario.interval_hours) * scenario.interval_hours
    hours = np.arange(first, last + 1e-6, scenario.interval_hours)
    references: dict[str, GriddedReference] = {}
    changes = reference_changes(faults, scenario.references)
    for edition in sorted({_EDITION[name] for name in scenario.references}):
        names = tuple(name for name in scenario.references if _EDITION[name] == edition)
        grid = scenario.grid(GRIB2_RADIUS) if edition == 2 else scenario.grid(6367470.0)
        references.update(
            build_references(
                world,
                grid,
                names=names,
                grid_relative=_GRID_RELATIVE,
                levels=np.array(scenario.levels, float),
                hours=hours,
                changes=changes,
            )
        )
    return _Simulated(reports, references, faults, earth, correction)


def simulate_arrays(
    *, effects: Effects = (), derivatives: bool = True, **options: Unpack[Options]
) -> pd.DataFrame:
    """Return an archive as one table, reference winds included, without writing a file.

    The reference winds are what an exact reader of the files would find: the same packed grids,
    bilinear, linear in ln p and in time, rotated to true east and north.

    Parameters
    ----------
    effects : sequence of mapping
        See `airswing.synthetic.aircraft.faults`.
    derivatives : bool
        Also return the reference's gradients.
    **options
        Further fields of `Scenario`: ``days, aircraft, seed, world, ...``.

    Returns
    -------
    pandas.DataFrame
        Sorted by tail and time. As reported: ``tail, time`` (datetime64), ``latitude, longitude``
        (degrees), ``altitude`` (m), ``pressure`` (Pa), ``direction`` (degrees), ``speed`` (kt),
        ``u, v`` (m/s), ``celsius, phase, icing, roll_flag, flight``. As indicated (radians, m/s):
        ``heading`` (true), ``airspeed``. Exact (radians, SI): ``true_u, true_v, true_heading,
        true_airspeed, ground_u, ground_v, bank, acceleration, declination, horizontal`` (nT),
        ``dip, temperature`` (K). For each reference NAME: ``u_NAME, v_NAME`` (m/s) and, with
        derivatives, ``dudt_NAME`` (m s-2), ``dudlnp_NAME``, ``dudx_NAME``, ``dudy_NAME`` (s-1) and
        likewise for v; ``convergence`` (radians), the angle from grid to earth.
    """
    scenario = Scenario(effects=effects, **options)
    made = _simulate(scenario)
    frame = finished(made.reports, scenario.start)
    for name, stored in made.references.items():
        wind = sample_reference(
            stored,
            frame["latitude"].to_numpy(),
            frame["longitude"].to_numpy(),
            frame["pressure"].to_numpy() / 100.0,
            frame["hours"].to_numpy(),
        )
        kept = wind if derivatives else {key: wind[key] for key in ("u", "v")}
        for key, values in kept.items():
            frame[f"{key}_{name}"] = values
    grid = next(iter(made.references.values())).grid
    frame["convergence"] = grid.convergence(frame["longitude"].to_numpy())
    return frame


def finished(reports: pd.DataFrame, start: datetime) -> pd.DataFrame:
    """Return the reports sorted by tail and time, with absolute times and pressure.

    Parameters
    ----------
    reports : pandas.DataFrame
        From `airswing.synthetic.aircraft.observe.observe`.
    start : datetime
        Hour zero, UTC.

    Returns
    -------
    pandas.DataFrame
        With ``time`` (datetime64) and ``pressure`` (Pa).
    """
    frame = reports.sort_values(["tail", "hours", "flight"], kind="stable", ignore_index=True)
    whole = np.round(frame["hours"].to_numpy() * 3600.0).astype("timedelta64[s]")
    frame["time"] = (np.datetime64(start, "s") + whole).astype("datetime64[ns]")
    frame["pressure"] = pressure_from_altitude(frame["altitude"].to_numpy())
    return frame


_PHASES = np.array(["", "ascent", "cruise", "descent"])


def write_reports(
    directory: Path,
    frame: pd.DataFrame,
    *,
    phases: Sequence[str] = ("ascent", "cruise", "descent"),
) -> None:
    """Write one CSV per aircraft in canonical columns.

    Parameters
    ----------
    directory : Path
        Folder, made where missing.
    frame : pandas.DataFrame
        From `finished`.
    phases : sequence of str
        Phases of flight to write.
    """
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
    table = table[table["phase"].isin(list(phases))]
    for tail, part in table.groupby("tail", sort=True):
        part.to_csv(directory / f"{tail}.csv", index=False)


def _config(directory: str, scenario: Scenario, made: _Simulated, output: str) -> dict[str, object]:
    """Return the configuration of an archive."""
    suffix = {1: "grb", 2: "grb2"}
    config: dict[str, object] = {
        "reports": {"files": f"{directory}/reports/*.csv"},
        "references": {
            name: {"files": f"{directory}/{name}/*.{suffix[_EDITION[name]]}"}
            for name in made.references
        },
    }
    if len(made.references) > 1:
        config["pool"] = {"+".join(made.references): list(made.references)}
    if scenario.interval_hours > 1:
        config["collocation"] = {"max_time_gap": f"{scenario.interval_hours} h"}
    if scenario.field_test is not None:
        day, chosen = scenario.field_test
        config["field_test"] = {
            "start": str((scenario.start + timedelta(days=day)).date()),
            "before_start": str(scenario.start.date()),
            "corrected": list(chosen),
            "controls": [tail for tail in scenario.tails if tail not in chosen],
        }
    config["output"] = output
    return config


def write_archive(
    directory: str | Path,
    *,
    effects: Effects | None = None,
    phases: Sequence[str] = ("ascent", "cruise", "descent"),
    times_per_file: int = 1,
    truth: str | Path | None = None,
    output: str | None = None,
    thinned: Mapping[str, float] | None = None,
    **options: Unpack[Options],
) -> Path:
    """Write an archive: reports, GRIB, a configuration, and the truth beside them.

    Parameters
    ----------
    directory : path
        Folder, made where missing.
    effects : sequence of mapping, optional
        What is wrong with the units and references (`airswing.synthetic.aircraft.faults`). None
        draws a compass deviation for every aircraft; an empty list means perfect units.
    phases : sequence of str
        Phases of flight to write.
    times_per_file : int
        Valid times in one GRIB file.
    truth : path, optional
        Folder of ``truth.json``; ``directory/truth`` by default.
    output : str, optional
        The configuration's output folder; ``results`` beside the archive's parts by default.
    thinned : mapping, optional
        Tail to the share of its flights that is kept.
    **options
        Further fields of `Scenario`: ``days``, ``aircraft``, ``seed`` ...

    Returns
    -------
    Path
        The configuration, ready for ``airswing run``.
    """
    from airswing.synthetic.world.gribwriter import write_reference

    root = Path(directory)
    root.mkdir(parents=True, exist_ok=True)  # where it cannot be, nothing is flown first
    scenario = Scenario(**options)
    if effects is None:
        effects = fleet_deviations(scenario.tails, scenario.seed)
    scenario = replace(scenario, effects=effects)
    made = _simulate(scenario)
    frame = finished(made.reports, scenario.start)
    for tail, share in (thinned or {}).items():
        own = frame["flight"][frame["tail"] == tail].unique()
        kept = own[: max(1, int(share * own.size))]
        frame = frame[(frame["tail"] != tail) | frame["flight"].isin(kept)]
    write_reports(root / "reports", frame, phases=phases)
    for name, stored in made.references.items():
        write_reference(
            root / name,
            stored,
            start=scenario.start,
            edition=_EDITION[name],
            lead_hours=scenario.lead_hours,
            packing=scenario.packing.get(name, "grid_simple"),
            times_per_file=times_per_file,
        )
    where = str(root.resolve())
    config = _config(where, scenario, made, output or f"{where}/results")
    target = root / "config.yaml"
    target.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    save_truth(
        Path(truth) if truth is not None else root / "truth",
        truth_record(
            frame,
            made.faults,
            scenario.tails,
            effects,
            usual_field=float(made.reports["horizontal"].median()),
        ),
        seed=scenario.seed,
        start=scenario.start,
        corrected=scenario.field_test and list(scenario.field_test[1]),
    )
    return target
