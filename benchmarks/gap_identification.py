"""Score the diagnosis on drawn archives held in memory, by effect and size.

    python benchmarks/gap_identification.py --cases 60 --seed 1 --output results.jsonl

The archives come from `airswing.synthetic` (which shares no code with the effects' design columns);
no file is written and read back, so this measures the statistics alone. Every case is a line of
JSON: what was put in, its rms where it acts (from the paired archive without it), what was found.
The summary prints first names right, ambiguity sets, aircraft, parameters, dates, closure and false
claims, and with ``--score FILE`` only that.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

import airswing  # noqa: F401
from airswing.gap.archive.frame import Frame
from airswing.gap.diagnose import diagnose
from airswing.synthetic.sample.sample_archive import simulate_arrays

KNOT = 1852 / 3600
START = np.datetime64("2009-03-01")

#: Parameters that give about 1 m/s rms where the effect acts; scaled by the drawn size.
UNIT_SIZE: dict[str, dict[str, float]] = {
    "compass_offset": {"offset_deg": 0.51},
    "hard_iron": {"amplitude_deg": 0.72},
    "soft_iron": {"amplitude_deg": 0.72},
    "compass_step": {"offset_deg": 0.51},
    "compass_drift": {"rate_deg_per_day": 0.0196},
    "heater_current": {"offset_deg": 0.51},
    "acceleration_error": {"amplitude_deg": 6.0},
    "turn_error": {"amplitude_deg": 3.5},
    "declination_error": {"mean_deg": 0.5},
    "tas_scale": {"scale_percent": 0.9},
    "tas_offset": {"offset_m_s": 1.0},
    "reference_speed_bias": {"bias_percent": 5.0},
    "reference_time_offset": {"offset_h": 0.6},
    "reference_grid_relative": {"fraction": 0.8},
    "altitude_offset": {"offset_ft": 1000.0},
    "time_lag": {"offset_s": 70.0},
    "heading_by_temperature": {"amplitude_deg": 0.51},
    "heading_by_longitude": {"amplitude_deg": 1.0},
    "heading_by_hour": {"amplitude_deg": 0.72},
    "three_cycle": {"amplitude_deg": 0.72},
    "pitot_icing": {"scale_percent": 0.9},
    "tas_by_altitude": {"scale_percent": 1.1},
    "heading_by_crosswind": {"fraction": 0.12},
}
OUTSIDE = tuple(UNIT_SIZE)[16:]
FLEET = {
    "declination_error",
    "reference_speed_bias",
    "reference_time_offset",
    "reference_grid_relative",
}
MOMENTS = {"wind_coding", "position_coding", "outliers", "tail_swap"}


def climb_rate(altitude: np.ndarray, seconds: np.ndarray, flight: np.ndarray) -> np.ndarray:
    """Rate of climb, m/s, mean of the steps to both neighbours of the same flight."""
    same = np.r_[flight[1:] == flight[:-1], False]
    rate = np.r_[np.diff(altitude) / np.maximum(np.diff(seconds), 1), 0.0]
    after, before = np.where(same, rate, 0.0), np.r_[0.0, np.where(same, rate, 0.0)[:-1]]
    count = same.astype(float) + np.r_[False, same[:-1]]
    return (after + before) / np.maximum(count, 1)


def frame_of(table: Any, reference: str = "ruc", seed: int = 0) -> Frame:
    """Frame of the arrays of `simulate_arrays`, as a headings product would give it."""
    names = tuple(sorted(table["tail"].unique()))
    n, rng = len(table), np.random.default_rng(seed)

    def column(name: str) -> np.ndarray:
        return table[name].to_numpy(float)

    ground = np.stack([column("ground_u"), column("ground_v")], -1) + rng.normal(0, 0.5, (n, 2))
    air = ground - np.stack([column("u"), column("v")], -1)
    heading = np.arctan2(air[:, 0], air[:, 1])
    seconds = table["time"].to_numpy().astype("datetime64[ns]").astype(np.int64) / 1e9
    flight = np.unique(
        table["tail"].astype(str) + "_" + table["flight"].astype(str), return_inverse=True
    )[1]
    gradients = {
        f"{q}{x}": column(f"{q}{x}_{reference}")
        for q in ("du", "dv")
        for x in ("dt", "dlnp", "dx", "dy")
    }
    unknown = np.full(len(names), np.nan)
    frame = Frame(
        tails=names,
        epoch=float(seconds.min()),
        reference_field=float(np.median(column("horizontal"))),
        report=np.arange(n),
        aircraft=np.searchsorted(names, table["tail"].to_numpy(str)),
        flight=flight,
        time=seconds,
        latitude=column("latitude"),
        longitude=column("longitude"),
        pressure=column("pressure"),
        u_rep=column("u"),
        v_rep=column("v"),
        u_ref=column(f"u_{reference}"),
        v_ref=column(f"v_{reference}"),
        heading=heading,
        magnetic_heading=heading - column("declination"),
        airspeed=np.hypot(*air.T),
        ground_u=ground[:, 0],
        ground_v=ground[:, 1],
        ground_error=np.full(n, 0.5),
        declination=column("declination"),
        dip=column("dip"),
        horizontal_field=column("horizontal"),
        acceleration=column("acceleration"),
        bank=column("bank"),
        climb_rate=climb_rate(column("altitude"), seconds, flight),
        temperature=column("celsius") + 273.15,
        phase=column("phase").astype(int),
        icing=np.nan_to_num(column("icing"), nan=-1).astype(int),
        **gradients,
        grid_convergence=column("convergence"),
        lead_time=np.ones(n),
        position_resolution=unknown,
        time_resolution=unknown,
        wind_speed_resolution=unknown,
        wind_direction_resolution=unknown,
    )
    good = np.isfinite(frame.u_ref) & np.isfinite(frame.u_rep) & np.isfinite(frame.heading)
    return frame.take(np.flatnonzero(good))


def draw_effect(
    rng: np.random.Generator, name: str, size: float, tails: list[str], days: int
) -> dict[str, Any]:
    """One effect of about this rms (m/s) where it acts, on drawn aircraft, from a drawn date."""
    values: dict[str, Any] = {k: v * size for k, v in UNIT_SIZE.get(name, {}).items()}
    sign = float(rng.choice([-1, 1]))
    chosen: list[str] | None = sorted(
        rng.choice(tails, int(rng.choice([1, 1, 2, 3])), replace=False).tolist()
    )
    period = None
    for key in values:
        if key != "amplitude_deg":
            values[key] *= sign
    if "amplitude_deg" in values and name not in ("acceleration_error", "turn_error"):
        values["phase_deg"] = float(rng.uniform(-180, 180))
    if name in FLEET:
        chosen = None
    if name == "reference_speed_bias":
        values["above_hPa"] = float(rng.choice([700.0, 600.0, 500.0]))
    if name == "declination_error":
        values["epoch_year"] = 1990.0
    if name == "reference_grid_relative":
        values["fraction"] = abs(values["fraction"])
    if name in ("compass_step", "tail_swap"):
        first = START + np.timedelta64(int(rng.integers(days // 4, 3 * days // 4)), "D")
        period = [str(first), None]
    return {"name": name, "tails": chosen, "parameters": values, "period": period}


def draw_case(kind: str, index: int, seed: int, days: int, aircraft: int) -> dict[str, Any]:
    """What to simulate: a null, a single effect, a pair, or one outside the catalogue."""
    rng = np.random.default_rng([seed, index])
    tails = [f"N{401 + k}" for k in range(aircraft)]
    inside = [n for n in UNIT_SIZE if n not in OUTSIDE]
    size = float(np.exp(rng.uniform(np.log(0.4), np.log(1.6))))
    effects: list[dict[str, Any]] = []
    if kind == "single":
        effects = [draw_effect(rng, inside[index % len(inside)], size, tails, days)]
    elif kind == "outside":
        effects = [draw_effect(rng, OUTSIDE[index % len(OUTSIDE)], size, tails, days)]
    elif kind == "pair":
        sensor = [n for n in inside if n not in FLEET]
        for name in rng.choice(sensor, 2, replace=False):
            effects.append(draw_effect(rng, str(name), float(rng.uniform(0.6, 1.6)), tails, days))
    return {
        "kind": kind,
        "index": index,
        "size": size,
        "effects": effects,
        "archive_seed": int(1000 * seed + index % 12),
    }


def true_size(frame: Frame, clean: Any) -> float | None:
    """The effect's rms where it acts, and the true closure, from the paired archive."""
    if clean is None or clean.size != frame.size:
        return None
    change = frame.residual - clean.residual
    there = np.abs(change).max(axis=1) > 0.02
    return float(np.sqrt((change[there] ** 2).sum(axis=1).mean())) if there.any() else 0.0


def run_case(
    case: dict[str, Any], days: int, aircraft: int, world: str, cleans: dict[int, Any]
) -> dict[str, Any]:
    """Simulate, diagnose and record one case."""
    seed = case["archive_seed"]
    options = {"days": days, "aircraft": aircraft, "seed": seed, "world": world}
    frame = frame_of(simulate_arrays(effects=case["effects"], **options))
    started = time.time()
    made = diagnose(frame, maps=False)
    report = made.report
    clean = cleans.get(seed)
    if clean is None and case["effects"]:
        clean = frame_of(simulate_arrays(**options))
        cleans[seed] = clean
    keep = (
        "name",
        "tails",
        "parameters",
        "standard_errors",
        "period",
        "ambiguous_with",
        "evidence_nats",
        "held_out_energy",
        "held_out_energy_standard_error",
        "size_m_s",
        "probability",
    )
    left = [entry for entry in report.evidence if entry.instead_of is None]
    left.sort(key=lambda entry: -entry.tempered_nats)
    content = report.content()
    return case | {
        "seconds": time.time() - started,
        "rms": true_size(frame, clean),
        "true_after": None if clean is None else float(np.hypot(*clean.residual.T).mean() / KNOT),
        "found": [{k: e[k] for k in keep} for e in content["effects"]],
        "unknown": [
            {k: w[k] for k in ("group", "tails", "evidence_nats", "size_m_s")}
            for w in content["unknown"]["where"]
        ],
        "closure": content["closure"],
        "left": [[e.name, e.scope, round(e.tempered_nats, 2)] for e in left[:4]],
    }


def score(lines: list[dict[str, Any]]) -> str:
    """Plain table of the scores by kind and effect."""
    out: list[str] = []
    rows = defaultdict(list)
    for case in lines:
        key = case["effects"][0]["name"] if case["kind"] in ("single", "outside") else case["kind"]
        rows[(case["kind"], key)].append(case)
    out.append(
        f"{'kind':8s}{'effect':26s}{'n':>4s}{'found':>7s}{'first':>7s}{'set':>7s}{'tailsP':>8s}{'tailsR':>8s}{'extra':>7s}{'par%':>7s}{'close':>7s}"
    )
    totals: dict[str, list[float]] = defaultdict(list)
    for (kind, key), cases in sorted(rows.items()):
        stats = [score_case(c) for c in cases]

        def mean(name: str, stats: list[dict[str, Any]] = stats) -> str:
            values = [s[name] for s in stats if s.get(name) is not None]
            return f"{np.mean(values):.2f}" if values else "-"

        def median(name: str, stats: list[dict[str, Any]] = stats) -> str:
            values = [s[name] for s in stats if s.get(name) is not None]
            return f"{np.median(values):.2f}" if values else "-"

        out.append(
            f"{kind:8s}{key:26s}{len(cases):4d}{mean('found'):>7s}{mean('first'):>7s}{mean('set'):>7s}"
            f"{mean('precision'):>8s}{mean('recall'):>8s}{mean('extra'):>7s}{median('parameter'):>7s}{median('closure'):>7s}"
        )
        for s in stats:
            for name, value in s.items():
                if value is not None:
                    totals[f"{kind}:{name}"].append(value)
    out.append("")
    out += [
        f"{k}: mean {np.mean(v):.3f} median {np.median(v):.3f} (n={len(v)})"
        for k, v in sorted(totals.items())
    ]
    return "\n".join(out)


def score_case(case: dict[str, Any]) -> dict[str, Any]:
    """Scores of one case; None where a score does not apply."""
    found = case["found"]
    names = [f["name"] for f in found]
    truth = [e["name"] for e in case["effects"]]
    out: dict[str, Any] = {}
    out["claimed"] = float(bool(found or case["unknown"]))
    if case["kind"] == "null":
        out["extra"] = out["claimed"]
        return out
    if case["kind"] == "outside":
        out["found"] = out["claimed"]
        out["first"] = float(bool(case["unknown"]) and not found)
        return out
    out["found"] = out["claimed"]
    if case["kind"] == "pair":
        out["first"] = float(all(t in names for t in truth))
        out["extra"] = float(any(n not in truth for n in names) or bool(case["unknown"]))
        return out
    true = case["effects"][0]
    out["first"] = float(bool(names) and names[0] == true["name"])
    out["set"] = float(bool(names) and (true["name"] in [names[0], *found[0]["ambiguous_with"]]))
    out["extra"] = float(len(set(names) - {true["name"]}) + len(case["unknown"]) > 0)
    if case["true_after"] is not None:
        out["closure"] = abs(case["closure"]["after"] - case["true_after"])
        out["covered"] = float(
            case["closure"]["ci"][0] <= case["true_after"] <= case["closure"]["ci"][1]
        )
    if out["first"]:
        mine = found[0]
        if true["tails"]:
            hit = set(mine["tails"]) & set(true["tails"])
            out["precision"], out["recall"] = (
                len(hit) / len(mine["tails"]),
                len(hit) / len(true["tails"]),
            )
        left_out = ("phase_deg", "above_hPa", "epoch_year")
        told = {k for k, v in mine["parameters"].items() if v is not None and k not in left_out}
        key = next(k for k in true["parameters"] if k in told)
        value = true["parameters"][key]
        out["parameter"] = abs(mine["parameters"][key] - value) / abs(value) * 100
        if true["period"] and mine["period"] and mine["period"][0]:
            out["days"] = abs(
                (np.datetime64(mine["period"][0]) - np.datetime64(true["period"][0])).astype(int)
            )
    return out


def main() -> None:
    """Run drawn cases, or score a file of results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=32)
    parser.add_argument("--kind", choices=("single", "null", "pair", "outside"), default="single")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--days", type=int, default=45)
    parser.add_argument("--aircraft", type=int, default=14)
    parser.add_argument("--world", default="default")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--score", type=Path, nargs="*")
    options = parser.parse_args()
    if options.score:
        print(score([json.loads(x) for p in options.score for x in p.read_text().splitlines()]))
        return
    lines, cleans = [], {}
    for index in range(options.first, options.first + options.cases):
        case = draw_case(options.kind, index, options.seed, options.days, options.aircraft)
        lines.append(run_case(case, options.days, options.aircraft, options.world, cleans))
        text = json.dumps(lines[-1])
        if options.output:
            with options.output.open("a") as handle:
                handle.write(text + "\n")
        print(
            case["kind"],
            index,
            [e["name"] for e in case["effects"]],
            "->",
            [f["name"] for f in lines[-1]["found"]],
            [u["group"] for u in lines[-1]["unknown"]],
            f"{lines[-1]['seconds']:.1f} s",
            file=sys.stderr,
        )
    print(score(lines))


if __name__ == "__main__":
    main()
