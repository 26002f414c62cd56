"""From a drawn case to an archive on disk and a label: strengths set, winds shared, truth measured.

A strength is the root mean square of the change in reported minus model wind where the effect acts,
measured on a short archive of the same world without coding, and taken as proportional to the
effect's parameters. The true closure is measured on the reports written and on the twin archive of
the same seed without the effect. GRIB files are written once per world and state of the models. The
generator shares no code with `airswing.gap.effects`. Units: m/s, kt for disagreement.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from airswing.synthetic.archive import (
    EDITIONS,
    Scenario,
    add_winds,
    simulate,
    simulate_arrays,
    write_reports,
)
from airswing.synthetic.atmosphere import Array
from airswing.synthetic.fields import GriddedReference, write_reference
from airswing.synthetic.instrument import UNIT_FAULTS
from airswing.synthetic.observe import Coding
from airswing.synthetic.sealed.cases import Case
from airswing.synthetic.sealed.draws import START, Drawn, World, scaled
from airswing.synthetic.sealed.injection import real_sensor, with_real_sensor, write_model_case
from airswing.synthetic.sealed.labels import Injected, Label, OutsideTruth, TwinClosure
from airswing.synthetic.sealed.outside import WORTH_KT, is_fit, outside_truth
from airswing.units import KNOT

Effects = Sequence[Injected]
REFERENCES = ("ruc", "rtfdaa")
_CALIBRATION_DAYS = 5  # a strength is a mean over flights: a few days give it
# Components by which a diagnosis states an irregular error of the heading.
_ACROSS = ("across_heading", "heading_angle", "cross", "scatter")
# Rounding is no part of the strength of an effect.
_EXACT = Coding(direction_deg=0.001, speed_kt=0.001, position_arcmin=0.001)
_COARSE: dict[str, Any] = {"columns": 32, "rows": 25, "spacing_km": 57.0, "interval_hours": 2}
# Fields good enough to measure a strength.
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
    return np.stack([np.asarray(part, float) for part in parts], axis=-1)


def twin_closure(made: pd.DataFrame, twin: pd.DataFrame) -> TwinClosure:
    """Mean vector disagreement (kt) of an archive and of its twin, on the reports both use."""
    frames = made.set_index("made"), twin.set_index("made").loc[made["made"]]
    both = np.ones(len(made), bool)
    for frame in frames:
        both &= (frame["temperature_qc"] == "pass").to_numpy(bool)
        both &= np.isfinite(innovation(frame)).all(axis=1)
    before, after = (float(np.hypot(*innovation(frame)[both].T).mean() / KNOT) for frame in frames)
    return {"before": before, "after": after}


def strength_of(drawn: Drawn, world: World) -> float:
    """Strength (m/s) of an effect without a ladder, measured on a few days of the world."""
    short = replace(world, days=min(world.days, _CALIBRATION_DAYS))
    bare = _calibration(short)
    # Without its period; a swap is measured by the deviations it exchanges.
    always: list[Injected] = [{**effect, "period": None} for effect in drawn.effects]
    changed = _calibrating(short, [e for e in always if "pair" not in e["parameters"]])
    change = innovation(changed) - innovation(bare)
    here = np.isfinite(change).all(axis=1)
    if drawn.tails is not None:
        here &= np.isin(bare["tail"].to_numpy(str), np.array(drawn.tails))
    if drawn.how.acts is not None:
        here &= drawn.how.acts(bare, drawn.effects[0]["parameters"])
    size = float(np.sqrt((change[here] ** 2).sum(axis=1).mean())) if here.any() else 0.0
    if drawn.how.grows:
        period = drawn.effects[0]["period"]
        begins = START
        if period is not None and period[0] is not None:
            begins = datetime.fromisoformat(period[0])
        size *= (world.days - (begins - START).total_seconds() / 86400.0) / short.days
    return 2.0 * size if drawn.how.whose == "pair" else size


@functools.lru_cache(maxsize=1)
def _calibration(short: World) -> pd.DataFrame:
    """The short archive without effect."""
    return _calibrating(short, [])


def _calibrating(short: World, effects: Effects) -> pd.DataFrame:
    options: dict[str, Any] = {**generator_options(short), **_THIN_FIELDS, "coding": _EXACT}
    return simulate_arrays(effects=effects, **options)


@functools.lru_cache(maxsize=2)
def _fields(world: World, on_models: str) -> dict[str, GriddedReference]:
    """Gridded models of a world under some effects on them (JSON)."""
    return simulate(Scenario(effects=json.loads(on_models), **generator_options(world)))[1]


def _on_models(effects: Effects) -> str:
    return json.dumps([dict(e) for e in effects if e["name"].startswith("reference_")])


def simulated(world: World, effects: Effects, **options: Any) -> pd.DataFrame:
    """Reports of a world with the winds of its models, which are built once for all its cases."""
    options |= generator_options(world) | {"references": ()}
    frame = simulate_arrays(effects=effects, **options)
    add_winds(frame, _fields(world, _on_models(effects)))
    return frame


@dataclass
class Archivist:
    """Writes the archives of a check and keeps the parts they share."""

    root: Path  # folder of the check; archives go to ``cases``, fields to ``winds``
    real: Path | None = None  # folder with real data for rung 5
    _bare: tuple[World, pd.DataFrame] | None = field(default=None, init=False)

    def write(self, case: Case) -> Label:
        """Write the archive of one case and return its label."""
        for part in case.drawn:
            if part.how.fault is not None:
                UNIT_FAULTS.setdefault(part.name, part.how.fault)
        outside = None
        if case.kind == "outside":
            part, outside = self._fit_draw(case)
            drawn = [part]
        else:
            drawn = [
                self._strengthened(part, size, case.world)
                for part, size in zip(case.drawn, case.sizes, strict=True)
            ]
        effects = [effect for part in drawn for effect in part.effects]
        folder = self.root / "cases" / case.name
        if case.world.kind == "model":
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
            # The tails of a real record are heavy: a diagnosis that names them is right.
            "background": ["outliers"] if case.world.kind in ("hard", "sensor") else [],
            # The record turns the heading of every aircraft: an effect across it is not false.
            "background_components": list(_ACROSS) if case.world.kind == "sensor" else [],
            "closure": closure,
            "outside": outside,
        }

    def _fit_draw(self, case: Case) -> tuple[Drawn, OutsideTruth]:
        """First draw of an outside effect that is fit, and its truth.

        Of a case with ``worth``, the first that is fit and closes `WORTH_KT`, or the one with the
        largest closure. Where none is fit (rare), the one that named effects explain least.
        """
        bare = self._without(case.world)
        wind = innovation(bare)
        fit, every = [], []
        for part in (*case.drawn, *case.instead):
            truth = outside_truth(bare, wind, part.effects[0], seed=case.world.seed)
            every.append((part, truth))
            if is_fit(truth):
                fit.append((part, truth))
                if not case.worth or truth["closes_kt"] >= WORTH_KT:
                    return fit[-1]
        if fit:
            return max(fit, key=lambda one: one[1]["closes_kt"])
        return min(every, key=lambda one: one[1]["named_share"])

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
        silent = Coding(heading_noise=0.0, airspeed_noise=0.0)
        frame = simulated(world, effects, coding=silent)
        return with_real_sensor(frame, real_sensor(self._real() / "heading"), seed=world.seed)

    def _without(self, world: World) -> pd.DataFrame:
        if self._bare is None or self._bare[0] != world:
            self._bare = world, self._simulated(world, [])
        return self._bare[1]

    def _winds_of(self, world: World, effects: Effects) -> Path:
        """Folder with the fields of a world under the effects on its models."""
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
