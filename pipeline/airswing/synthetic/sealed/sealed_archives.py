"""From a drawn case to an archive on disk and a label: strengths set, winds shared, truth measured.

Assumptions
-----------
* A strength is the root mean square of the change in reported minus reference wind over the reports
  where the effect acts, measured on a short archive of the same world without coding. It is taken
  as proportional to the effect's parameters.
* The true closure is measured on the very reports written: the mean vector disagreement with the
  effect, and in the twin archive of the same seed without it (for the hard world, without the
  effect but with the background everything has), over the reports that both archives use.
* Of the draws of an outside effect the first is taken that acts on enough reports, is large enough
  and of which what has a name explains less than `MOST_NAMED`.
* GRIB files are written once per world and state of the references; cases point to them.

Validity: the generator of `airswing.synthetic`, which shares no code with `airswing.gap.effects`.

Units: m/s, kt for disagreement.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from airswing.synthetic.aircraft.faults import UNIT_FAULTS
from airswing.synthetic.aircraft.observe import Coding
from airswing.synthetic.aircraft.outside_effects import KNOT
from airswing.synthetic.sample import sample_archive as archive
from airswing.synthetic.sample.sample_archive import (
    Options,
    Scenario,
    simulate_arrays,
    write_reports,
)
from airswing.synthetic.sealed.cases import START, Case, World
from airswing.synthetic.sealed.draws import Drawn, scaled
from airswing.synthetic.sealed.labels import Injected, Label, OutsideTruth, TwinClosure
from airswing.synthetic.sealed.outside_truth import WORTH_KT, is_fit, outside_truth
from airswing.synthetic.world.gribwriter import write_reference
from airswing.synthetic.world.gridded_fields import GriddedReference, sample_reference

__all__ = ["Archivist", "strength_of", "twin_closure"]

Array = NDArray[np.float64]
Effects = Sequence[Injected]
# Edition and suffix of the references' GRIB files.
_EDITIONS = {"ruc": (1, "grb"), "rtfdaa": (2, "grb2")}
REFERENCES = tuple(_EDITIONS)
# Strength is a mean over flights: a few days of them tell it.
_CALIBRATION_DAYS = 5
# Components by which a diagnosis tells an irregular error of the heading.
_ACROSS = ("across_heading", "heading_angle", "cross", "scatter")
# Rounding is no part of an effect's strength.
_EXACT = Coding(direction_deg=0.001, speed_kt=0.001, position_arcmin=0.001)
_COARSE_FIELDS: Options = {
    "columns": 32,
    "rows": 25,
    "spacing_km": 57.0,
    "interval_hours": 2,
}
# Options that make the references next to nothing, where only the reports are wanted.
_NO_FIELDS: Options = {
    "columns": 3,
    "rows": 3,
    "spacing_km": 600.0,
    "levels": (1000, 350),
    "interval_hours": 6,
}
# Options that make the references good enough to measure a strength against.
_THIN_FIELDS: Options = {
    "columns": 16,
    "rows": 12,
    "spacing_km": 120.0,
    "interval_hours": 3,
    "levels": (1000, 900, 800, 700, 600, 500, 400, 350),
}


def generator_options(world: World) -> Options:
    """Return what `simulate_arrays` and `write_archive` are told about a world."""
    fields: Options = _COARSE_FIELDS if world.coarse else {}
    return {
        **fields,
        "days": world.days,
        "aircraft": world.aircraft,
        "seed": world.seed,
        "world": "hard" if world.kind == "hard" else "default",
        "start": START,
    }


def innovation(frame: pd.DataFrame) -> Array:
    """Return reported minus pooled reference wind, (n, 2) m/s; NaN outside the fields."""
    out = [
        frame[name] - sum(frame[f"{name}_{reference}"] for reference in REFERENCES) / 2.0
        for name in ("u", "v")
    ]
    return np.stack([np.asarray(part, float) for part in out], axis=-1)


def usable(frame: pd.DataFrame) -> NDArray[np.bool_]:
    """Return which reports (n,) a diagnosis uses."""
    passed = (frame["temperature_qc"] == "pass").to_numpy(bool)
    return np.asarray(np.isfinite(innovation(frame)).all(axis=1) & passed)


def twin_closure(made: pd.DataFrame, twin: pd.DataFrame) -> TwinClosure:
    """Return the mean vector disagreement of an archive and of its twin, on the same reports.

    Parameters
    ----------
    made, twin : pandas.DataFrame
        Reports with the references' winds; ``made`` numbers the reports in both.

    Returns
    -------
    dict
        ``before`` (of the archive) and ``after`` (of the twin), kt.
    """
    own, bare = made.set_index("made"), twin.set_index("made").loc[made["made"]]
    both = usable(own) & usable(bare)
    before, after = (
        float(np.hypot(*innovation(frame)[both].T).mean() / KNOT) for frame in (own, bare)
    )
    return {"before": before, "after": after}


def acting(frame: pd.DataFrame, drawn: Drawn) -> NDArray[np.bool_]:
    """Return the reports (n,) on which an effect acts by its nature, whatever its period."""
    here = np.ones(len(frame), bool)
    if drawn.tails is not None:
        here &= np.isin(frame["tail"].to_numpy(str), np.array(drawn.tails))
    if drawn.how.acts is not None:
        here &= drawn.how.acts(frame, drawn.effects[0]["parameters"])
    return here


def strength_of(drawn: Drawn, world: World) -> float:
    """Return the strength of an effect as it stands, m/s root mean square where it acts.

    Parameters
    ----------
    drawn : Drawn
        Not one with a ladder.
    world : World
        Its seed and fleet are used, for a few days.
    """
    short = replace(world, days=min(world.days, _CALIBRATION_DAYS))
    bare = _calibration(short)
    changed = _calibrating(short, [_always(e) for e in drawn.effects])
    change = innovation(changed) - innovation(bare)
    here = acting(bare, drawn) & np.isfinite(change).all(axis=1)
    size = float(np.sqrt((change[here] ** 2).sum(axis=1).mean())) if here.any() else 0.0
    if drawn.how.grows:
        size *= _in_force(drawn, world) / short.days
    return 2.0 * size if drawn.how.whose == "pair" else size


def _in_force(drawn: Drawn, world: World) -> float:
    """Return the days from which an effect begins to the end of the archive."""
    period = drawn.effects[0]["period"]
    begins = START
    if period is not None and period[0] is not None:
        begins = datetime.fromisoformat(period[0])
    return world.days - (begins - START).total_seconds() / 86400.0


@functools.lru_cache(maxsize=1)
def _calibration(short: World) -> pd.DataFrame:
    """Return the short archive without effect that strengths are measured against."""
    return _calibrating(short, [])


def _calibrating(short: World, effects: Effects) -> pd.DataFrame:
    options: Options = {**generator_options(short), **_THIN_FIELDS, "coding": _EXACT}
    return simulate_arrays(effects=effects, derivatives=False, **options)


def _always(effect: Injected) -> Injected:
    """Return the effect without its period; a swap is measured by the deviations it exchanges."""
    if "pair" in effect["parameters"]:
        return {
            "name": "compass_offset",
            "tails": effect["tails"],
            "parameters": {},
            "period": None,
        }
    return {**effect, "period": None}


@functools.lru_cache(maxsize=2)
def _fields(world: World, of_reference: str) -> dict[str, GriddedReference]:
    """Return the gridded references of a world under some effects on them (JSON)."""
    scenario = Scenario(effects=json.loads(of_reference), **generator_options(world))
    return archive._simulate(scenario).references


def _on_references(effects: Effects) -> str:
    return json.dumps([dict(e) for e in effects if e["name"].startswith("reference_")])


def simulated(world: World, effects: Effects, *, coding: Coding | None = None) -> pd.DataFrame:
    """Return the reports of a world with the winds of its references.

    The same as `airswing.synthetic.sample.sample_archive.simulate_arrays`, but the fields are built
    once for all cases of a world.

    Parameters
    ----------
    world : World
        Seed, size, kind.
    effects : sequence of mapping
        See `airswing.synthetic.aircraft.faults`.
    coding : Coding, optional
        The generator's by default.
    """
    options: Options = {**generator_options(world), **_NO_FIELDS, "coding": coding or Coding()}
    frame = simulate_arrays(effects=effects, derivatives=False, **options)
    for name, stored in _fields(world, _on_references(effects)).items():
        wind = sample_reference(
            stored,
            frame["latitude"].to_numpy(),
            frame["longitude"].to_numpy(),
            frame["pressure"].to_numpy() / 100.0,
            frame["hours"].to_numpy(),
        )
        frame[f"u_{name}"], frame[f"v_{name}"] = wind["u"], wind["v"]
    return frame


@dataclass
class Archivist:
    """Writes the archives of a check and keeps what they share."""

    root: Path  # folder of the check; archives go to ``cases``, fields to ``winds``
    real: Path | None = None  # folder with real data for rung 5
    _bare: tuple[World, pd.DataFrame] | None = field(default=None, init=False)

    def write(self, case: Case) -> Label:
        """Write one case's archive and return its label.

        Returns
        -------
        dict
            ``name, rung, kind, variant, size, sizes, focus, names, effects, without, closure``,
            what the world has in the background, and of an outside effect ``outside``: component,
            shape, variables, the share that has a name, and what each variable carries.
        """
        for part in case.drawn:
            if part.how.fault is not None:
                UNIT_FAULTS.setdefault(part.name, part.how.fault)
        if case.kind == "outside":
            drawn, outside = self._fit_draw(case)
        else:
            outside = None
            drawn = tuple(
                self._strengthened(part, size, case.world)
                for part, size in zip(case.drawn, case.sizes, strict=True)
            )
        effects = [effect for part in drawn for effect in part.effects]
        folder = self.root / "cases" / case.name
        if case.world.kind == "model":
            from airswing.synthetic.sealed.injection import write_model_case

            closure = write_model_case(folder, self._real(), effects, case.world)
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
            "focus": [part.name for part in drawn],
            "names": list(dict.fromkeys(name for part in drawn for name in part.names)),
            "effects": effects,
            "without": list(case.without),
            # A real record's tails are as heavy as they are: who names them is right.
            "background": ["outliers"] if case.world.kind in ("hard", "sensor") else [],
            # the record turns the heading of every aircraft: one across it or scatter is not false
            "background_components": list(_ACROSS) if case.world.kind == "sensor" else [],
            "closure": closure,
            "outside": outside,
        }

    def _fit_draw(self, case: Case) -> tuple[tuple[Drawn, ...], OutsideTruth]:
        """Return the first draw of an outside effect that is fit, and what is true of it.

        Of a case that shall be worth closing, the first that is fit and closes `WORTH_KT`, or that
        closes most. Where none is fit (rare), the one furthest from having a name is taken.
        """
        bare = self._without(case.world)
        wind = innovation(bare)
        fit, others = [], []
        for part in (*case.drawn, *case.instead):
            told = outside_truth(bare, wind, part.effects[0], seed=case.world.seed)
            if is_fit(told):
                fit.append(((part,), told))
                if not case.worth or told["closes_kt"] >= WORTH_KT:
                    return fit[-1]
            others.append(((part,), told))
        if fit:
            return max(fit, key=lambda one: one[1]["closes_kt"])
        return min(others, key=lambda one: one[1]["named_share"])

    def _real(self) -> Path:
        if self.real is None:
            raise ValueError("a case on real data needs the folder of real data")
        return self.real

    def _strengthened(self, drawn: Drawn, size: float, world: World) -> Drawn:
        if drawn.how.ladder:
            return drawn
        ordinary = replace(world, kind="default", days=max(world.days, _CALIBRATION_DAYS))
        return scaled(drawn, size / max(strength_of(drawn, ordinary), 1e-6))

    def _write_sample(self, folder: Path, world: World, effects: Effects) -> TwinClosure:
        """Write reports and configuration; return the disagreement with and without effects."""
        made = self._simulated(world, effects)
        bare = made if not effects else self._without(world)
        write_reports(folder / "reports", made)
        winds = self._winds_of(world, effects)
        config = yaml.safe_load((winds / "config.yaml").read_text(encoding="utf-8"))
        config["reports"]["files"] = str((folder / "reports" / "*.csv").resolve())
        config["output"] = str((folder / "results").resolve())
        (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False), "utf-8")
        return twin_closure(made, bare)

    def _simulated(self, world: World, effects: Effects) -> pd.DataFrame:
        if world.kind != "sensor":
            return simulated(world, effects)
        from airswing.synthetic.sealed.injection import real_sensor, with_real_sensor

        silent = Coding(heading_noise=0.0, airspeed_noise=0.0)
        frame = simulated(world, effects, coding=silent)
        return with_real_sensor(frame, real_sensor(self._real() / "heading"), seed=world.seed)

    def _without(self, world: World) -> pd.DataFrame:
        if self._bare is None or self._bare[0] != world:
            self._bare = world, self._simulated(world, [])
        return self._bare[1]

    def _winds_of(self, world: World, effects: Effects) -> Path:
        """Return the folder with the fields of a world under the effects on its references."""
        of_reference = _on_references(effects)
        key = json.dumps([*astuple(world), of_reference])
        folder = self.root / "winds" / hashlib.sha256(key.encode()).hexdigest()[:10]
        if (folder / "config.yaml").exists():
            return folder
        where, references = str(folder.resolve()), {}
        for name, stored in _fields(world, of_reference).items():
            edition, suffix = _EDITIONS[name]
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
