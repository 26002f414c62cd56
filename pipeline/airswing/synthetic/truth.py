"""Truth of a sample fleet: its deviations, drawn, evaluated and written.

A deviation curve is evaluated from the vector instrument at the mean field of the reports, without
the parts that depend on time, icing, acceleration or bank. Units: degrees, nT, m/s.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.synthetic.atmosphere import stream
from airswing.synthetic.instrument import (
    UNIT_FAULTS,
    EarthField,
    Fault,
    Setting,
    Unit,
    apply_unit_faults,
    deviation_curve,
)
from airswing.synthetic.observe import Correction

Effect = dict[str, object]
LITTLE = (0.05, 0.15)
"""Range of the strength of a background effect, m/s root mean square where it acts."""
_STEADY = ("compass_offset", "hard_iron", "soft_iron", "tas_scale", "tas_offset", "three_cycle")
# Parameter of each background effect, and the change of wind (m/s root mean square where it acts)
# of one unit of it on the archive's network; a drift's rate times the days of the archive.
_PER_UNIT = {
    "compass_offset": ("offset_deg", 2.0),
    "hard_iron": ("amplitude_deg", 1.3),
    "soft_iron": ("amplitude_deg", 1.43),
    "tas_scale": ("scale_percent", 1.15),
    "compass_drift": ("rate_deg_per_day", 1.17),
    "heater_current": ("offset_deg", 2.0),
    "acceleration_error": ("amplitude_deg", 0.0174),
    "turn_error": ("amplitude_deg", 0.5),
    "time_lag": ("offset_s", 0.021),
    "altitude_offset": ("offset_ft", 0.00114),
    "heading_by_temperature": ("amplitude_deg", 1.9),
    "three_cycle": ("amplitude_deg", 1.41),
}


def fleet_deviations(tails: Sequence[str], seed: int) -> list[Effect]:
    """Ordinary compass errors of a fleet.

    Offsets of about 0.8 degrees; one cycle of 0.6 to 2.6 degrees, 3 to 6 on every fourth aircraft;
    two cycles on every fifth; airspeed scale of 0.3 %.
    """
    rng = stream(seed, "deviations")
    effects: list[Effect] = []

    def add(name: str, tail: str, **parameters: float) -> None:
        rounded = {key: round(float(value), 3) for key, value in parameters.items()}
        effects.append({"name": name, "tails": [tail], "parameters": rounded})

    for index, tail in enumerate(tails):
        size = rng.uniform(3.0, 6.0) if index % 4 == 1 else rng.uniform(0.6, 2.6)
        add("compass_offset", tail, offset_deg=rng.normal(0, 0.8))
        add("hard_iron", tail, amplitude_deg=size, phase_deg=rng.uniform(-180, 180))
        add("tas_scale", tail, scale_percent=rng.normal(0, 0.3))
        twice, phase = rng.uniform(1.0, 2.0), rng.uniform(-180, 180)
        if index % 5 == 2:  # few have a second cycle: the fit must not assume it
            add("soft_iron", tail, amplitude_deg=twice, phase_deg=phase)
    return effects


def small_effects(tails: Sequence[str], seed: int, *, days: float = 45.0) -> list[Effect]:
    """A little (`LITTLE`) of every effect for every aircraft, and one per cent of gross errors."""
    rng = stream(seed, "background")
    effects: list[Effect] = []
    for tail in tails:
        for name, (parameter, strength) in _PER_UNIT.items():
            size = rng.uniform(*LITTLE) / strength
            sign = 1.0 if name == "time_lag" else rng.choice([-1.0, 1.0])
            values = {parameter: float(sign * size / (days if name == "compass_drift" else 1.0))}
            if name in ("hard_iron", "soft_iron", "three_cycle"):
                values["phase_deg"] = float(rng.uniform(-180, 180))
            effects.append({"name": name, "tails": [tail], "parameters": values})
    effects.append({"name": "outliers", "tails": None, "parameters": {"fraction": 0.01}})
    return effects


def unit_of(
    index: int,
    faults: Sequence[Fault],
    tails: Sequence[str],
    horizontal: float,
    down: float,
    *,
    usual_field: float | None = None,
) -> Unit:
    """Steady errors of one aircraft's unit, arrays of length 1, in the field around it (nT)."""
    zero = np.zeros(1)
    level = dict.fromkeys(
        ("hours", "latitude", "longitude", "magnetic", "declination", "acceleration", "bank"), zero
    )
    setting = Setting(
        tail=np.array([index]),
        horizontal=zero + horizontal,
        down=zero + down,
        temperature=zero + 260.0,
        icing=np.zeros(1, bool),
        phase=np.full(1, 2),
        box=(0.0, 1.0, 0.0, 1.0),
        **level,
    )
    if usual_field is not None:
        setting.usual_field = usual_field
    apply_unit_faults(setting, [fault for fault in faults if fault.name in _STEADY], tails)
    return setting.unit


def corrections(
    faults: Sequence[Fault],
    earth: EarthField,
    tails: Sequence[str],
    corrected: Sequence[str],
    start: float,
) -> Correction:
    """Eight-point tables to 0.1 degree, as loaded after an earlier swing."""
    south, north, west, east = earth.box
    middle = [np.array([0.5 * (south + north)]), np.array([0.5 * (west + east)]), np.zeros(1)]
    _, horizontal, down = (float(value[0]) for value in earth.at(*middle))
    nodes = np.radians(np.arange(0.0, 360.0, 45.0))
    tables = {}
    for tail in corrected:
        index = list(tails).index(tail)
        curve = deviation_curve(horizontal, down, unit_of(index, faults, tails, horizontal, down))
        error = curve["A"] + curve["B"] * np.sin(nodes) + curve["C"] * np.cos(nodes)
        error += curve["D"] * np.sin(2 * nodes) + curve["E"] * np.cos(2 * nodes)
        tables[index] = np.round(error, 1)
    return Correction(tables, start)


def truth_record(
    frame: pd.DataFrame,
    faults: Sequence[Fault],
    tails: Sequence[str],
    effects: Sequence[Mapping[str, object]],
    *,
    usual_field: float | None = None,
) -> dict[str, object]:
    """Truth of an archive as plain numbers: ``aircraft`` by tail, ``effects``, ``known_faults``.

    ``usual_field`` (nT) is that at which hard iron is stated, by default the median of the reports.
    """
    aircraft: dict[str, object] = {}
    if usual_field is None:
        usual_field = float(frame["horizontal"].median())
    for index, tail in enumerate(tails):
        reports = frame[frame["tail"] == tail]
        cruise = reports[reports["phase"] == 2] if (reports["phase"] == 2).any() else reports
        if cruise.empty:
            continue
        horizontal = float(cruise["horizontal"].mean())
        down = float((cruise["horizontal"] * np.tan(cruise["dip"])).mean())
        unit = unit_of(index, faults, tails, horizontal, down, usual_field=usual_field)
        curve = deviation_curve(horizontal, down, unit)
        aircraft[tail] = {
            "deviation": {name: round(curve[name], 4) for name in "ABCDE"},
            "deviation_residual_rms": round(curve["residual_rms"], 4),
            "offset": round(curve["A"], 4),
            "amplitude": round(float(np.hypot(curve["B"], curve["C"])), 4),
            "phase": round(float(np.degrees(np.arctan2(curve["C"], curve["B"]))), 3),
            "airspeed_scale": round(float(unit.airspeed_factor[0]) - 1.0, 6),
            "airspeed_offset": round(float(unit.airspeed_offset[0]), 4),
            "mean_horizontal_field": round(horizontal, 1),
            "reports": len(reports),
            "cruise_reports": int((reports["phase"] == 2).sum()),
        }
    return {
        "aircraft": aircraft,
        "effects": [dict(effect) for effect in effects],
        "known_faults": sorted({fault.name for fault in faults if fault.name in UNIT_FAULTS}),
    }


def save_truth(
    folder: Path,
    record: Mapping[str, object],
    *,
    seed: int,
    start: datetime,
    corrected: Sequence[str] | None = None,
) -> None:
    """Write ``truth.json``; ``corrected`` are the aircraft that apply a table in the field test."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {**record, "seed": seed, "start": start.isoformat(), "corrected": corrected}
    (folder / "truth.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
