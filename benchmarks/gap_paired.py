"""Paired benchmark of the gap diagnosis: the same archives before and after a change.

    python -m benchmarks.gap_paired prepare [--folder DIR] [--cases 48] [--seed S] [--real DIR]
    python -m benchmarks.gap_paired run NAME [--folder DIR] [--only CASE ...]
    python -m benchmarks.gap_paired compare OLD NEW [--folder DIR]
    python -m benchmarks.gap_paired calibrate SCORES.JSON

``compare`` prints every figure of two sets of results and the mean paired difference with its
standard error, ``calibrate`` the constants of probabilities and standard errors that the scores of
a `airswing gap-check` imply, whose seed judges nothing else.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from airswing.blind_check.check import Plan
from airswing.blind_check.score import draws, score_case
from airswing.gap.archive.frame import Frame
from airswing.gap.effects import CATALOGUE
from airswing.synthetic.sealed.cases import Case, Size, plan_cases
from airswing.synthetic.sealed.draws import World
from airswing.synthetic.sealed.labels import Label

SEED = 20261126
#: Constants of probabilities that `calibrate` starts from: 0.57 at a gate of 3, 0.87 at one of 100.
START = (-0.4, 0.5)
CASES = 48
NULLS = 8
#: Archives of the development set: three and a half weeks of twelve aircraft, fields of 57 km.
SIZE = Size(days=24, aircraft=12, sizes=(0.2, 0.4, 0.8, 1.6, 3.2), coarse=True)


def prepare(folder: Path, cases: int, seed: int, real: Path | None) -> None:
    """Write frames and truth of all cases; those already there are kept."""
    from airswing.synthetic.sealed.sealed_archives import Archivist

    folder.mkdir(parents=True, exist_ok=True)
    worlds: dict[Any, list[Case]] = {}
    rungs = Plan(real=real).played
    for case in plan_cases(cases, seed=seed, size=SIZE, draws=draws(), rungs=rungs, nulls=NULLS):
        worlds.setdefault(case.world, []).append(case)
    # one archive of every world in turn, so that a set that is cut short holds every kind
    archivists = {world: Archivist(folder / "made", real) for world in worlds}
    for turn in range(max(len(of_world) for of_world in worlds.values())):
        for world, of_world in worlds.items():
            if turn >= len(of_world) or (folder / f"{of_world[turn].name}.npz").exists():
                continue
            began = time.perf_counter()
            case = of_world[turn]
            label = archivists[world].write(case)
            frame = headings_frame(folder / "made" / "cases" / case.name / "config.yaml")
            shutil.rmtree(folder / "made" / "cases" / case.name)
            arrays = {f.name: np.asarray(getattr(frame, f.name)) for f in fields(Frame)}
            np.savez_compressed(folder / f"{case.name}.npz", **arrays)
            (folder / f"{case.name}.json").write_text(json.dumps(label, default=float))
            spent = time.perf_counter() - began
            print(
                f"{case.name} {case.kind} {label['focus']} {frame.size} {spent:.0f} s", flush=True
            )


def headings_frame(config: Path) -> Frame:
    from airswing.config_file import load_config
    from airswing.workflow.gap_stage import frame_of, with_near_winds
    from airswing.workflow.job import Job
    from airswing.workflow.months import make_headings
    from airswing.workflow.progress import Progress

    job = Job(load_config(config), Progress(quiet=True))
    return frame_of(job, with_near_winds(job, make_headings(job).load()))


def read_frame(path: Path) -> Frame:
    with np.load(path) as stored:
        values: dict[str, Any] = {name: stored[name] for name in stored.files}
    values["tails"] = tuple(str(name) for name in values["tails"])
    for name in ("epoch", "reference_field"):
        values[name] = float(values[name])
    return Frame(**values)


def labels(folder: Path) -> Iterator[Label]:
    for path in sorted(folder.glob("case_*.json")):
        yield json.loads(path.read_text())


def run(folder: Path, name: str, only: Sequence[str]) -> None:
    from airswing.gap.diagnose import diagnose

    target = folder / "results" / name
    target.mkdir(parents=True, exist_ok=True)
    every = {label["name"]: label for label in labels(folder)}
    for case in only or every:
        label = every[case]
        if (target / f"{case}.json").exists():
            continue
        frame = read_frame(folder / f"{case}.npz")
        catalogue = {k: v for k, v in CATALOGUE.items() if k not in label["without"]}
        began = time.process_time()
        try:
            content: Mapping[str, object] = diagnose(frame, catalogue=catalogue).report.content()
        except Exception as err:
            content = {"failure": f"{type(err).__name__}: {err}"}
        spent = time.process_time() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        text = json.dumps({"seconds": spent, "gigabytes": peak, "gap": content}, default=float)
        (target / f"{case}.json").write_text(text)
        print(line(label, target), flush=True)


def scored(
    folder: Path, name: str
) -> dict[str, tuple[Label, dict[str, Any], dict[str, Any] | None]]:
    out = {}
    for label in labels(folder):
        path = folder / "results" / name / f"{label['name']}.json"
        if path.exists():
            out[label["name"]] = (label, *score(label, path))
    return out


def score(label: Label, path: Path) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Score one result: figures of the sealed check, log score, closure, time; and its gap.json."""
    stored = json.loads(path.read_text())
    gap, fleet = stored["gap"], World(0, "default", SIZE.days, SIZE.aircraft).tails
    if "failure" in gap:
        return score_case(label, None, failure=gap["failure"], fleet=fleet), None
    scores = score_case(label, gap, fleet=fleet)
    scores["log_score"] = log_score(label, gap)
    scores["seconds"], scores["gigabytes"] = stored["seconds"], stored["gigabytes"]
    return scores, gap


def log_score(label: Label, gap: Mapping[str, Any]) -> float:
    """Mean over the catalogue of log2 of the probability given to what is true; 0 is perfect."""
    skip = {*label["background"], *label["without"]}
    stated = {name: 0.0 for name in draws() if name not in skip}
    for claim in gap["effects"]:
        if claim["name"] in stated:
            stated[claim["name"]] = max(stated[claim["name"]], claim["probability"])
    right = [p if name in label["names"] else 1.0 - p for name, p in stated.items()]
    return float(np.mean(np.log2(np.clip(right, 1e-3, 1 - 1e-3))))


def figures(label: Label, scores: Mapping[str, Any]) -> dict[str, float]:
    """Figures of one archive; those that do not apply are left out."""
    out: dict[str, Any] = {"failed": bool(scores["failure"])}
    if scores["failure"]:
        return {"failed": 1.0}
    kind, unknown, false = label["kind"], scores["unknown"], bool(scores["false_names"])
    out |= {"log score": scores["log_score"], "false name": false}
    if kind == "null":
        out["null: any claim"] = scores["detected"]
    elif kind == "single":
        out["single: first right"] = scores["first_right"]
        if label["size"] >= 0.8:
            out["single: first right (0.8 m/s and more)"] = scores["first_right"]
        out["single: in the set"] = bool(scores["in_set"])
    elif kind == "pair":
        out["pair: both named"] = scores["all_named"]
        out["pair: first right"] = scores["first_right"]
    elif kind == "removed":
        out["removed: raised, no false name"] = unknown and not false
    if kind in ("single", "pair"):
        out |= {f"named: {k}": scores[k] for k in ("precision", "recall", "parameter_error")}
        if z := scores["standardised_errors"]:
            out["parameters within two standard errors"] = np.mean(np.abs(z) < 2)
    if label["outside"] is not None:
        right = bool(unknown and scores["unknown_first"] and scores["variable_first"])
        out |= {"outside: raised": unknown, "outside: right variable, no false name ahead": right}
        if unknown:
            out |= {f"outside: {key}": scores[key] for key in ("precision", "recall")}
    if kind not in ("null", "removed"):
        true = abs(label["closure"]["before"] - label["closure"]["after"])
        out["closure: error, kt"] = scores["closure_error"]
        out["closure: relative error"] = scores["closure_error"] / true if true >= 0.05 else None
        if scores["claimed"] or unknown:
            out["closure: interval holds"] = scores["closure_covered"]
    if claims := scores["claims"]:
        out["Brier score of claims"] = np.mean([(p - right) ** 2 for _, p, right in claims])
    out |= {name: scores[name] for name in ("seconds", "gigabytes")}
    return {name: float(value) for name, value in out.items() if value is not None}


def compare(folder: Path, old: str, new: str) -> None:
    before, after = scored(folder, old), scored(folder, new)
    common = sorted(before.keys() & after.keys())
    print(f"{len(common)} archives")
    print(f"{'':52}{old:>10}{new:>10}{'change':>10}{'error':>8}{'n':>5}{'n':>5}")
    a = {case: figures(*before[case][:2]) for case in common}
    b = {case: figures(*after[case][:2]) for case in common}
    keys = list(dict.fromkeys(key for case in common for key in [*a[case], *b[case]]))
    for key in keys:
        x = {c: a[c][key] for c in common if key in a[c]}
        y = {c: b[c][key] for c in common if key in b[c]}
        paired = np.array([y[c] - x[c] for c in x if c in y])
        change = paired.mean() if paired.size else np.nan
        error = paired.std(ddof=1) / np.sqrt(paired.size) if paired.size > 1 else np.nan
        mean = [np.mean(list(values.values())) if values else np.nan for values in (x, y)]
        print(
            f"{key:52}{mean[0]:10.3f}{mean[1]:10.3f}{change:10.3f}{error:8.3f}{len(x):5}{len(y):5}"
        )
    for name, of in ((old, before), (new, after)):
        print(f"reliability of {name}:")
        claims = [c for case in common if not of[case][1]["failure"] for c in of[case][1]["claims"]]
        p, right = np.array([c[1] for c in claims]), np.array([c[2] for c in claims])
        for low, high in ((0.0, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)):
            selection = (p >= low) & (p < high)
            if selection.any():
                print(
                    f"  stated {p[selection].mean():.3f} right {right[selection].mean():.3f}"
                    f" ({selection.sum()} claims)"
                )


def calibrate(scores: Path) -> None:
    """Print the constants of stated probabilities and of standard errors that scores imply.

    Log odds that a claim is right are c0 + c1 ln(1 + gate), fitted by maximum likelihood with a
    Gaussian prior of standard deviation 0.5 about `START`, which keeps few claims from an infinite
    slope.
    """
    from scipy.optimize import minimize

    from airswing.gap.result.statement import CALIBRATION

    cases = [case for case in json.loads(scores.read_text())["scores"] if not case["failure"]]
    claims = [(p, right) for case in cases for _, p, right in case["claims"]]
    stated = np.clip([p for p, _ in claims], 1e-6, 1 - 1e-6)
    right = np.array([right for _, right in claims], float)
    logs = (np.log(stated / (1 - stated)) - CALIBRATION[0]) / CALIBRATION[1]

    def loss(c: np.ndarray) -> float:
        odds = c[0] + c[1] * logs
        prior = 0.5 * float((((c - START) / 0.5) ** 2).sum())
        return float((np.logaddexp(0.0, odds) - right * odds).sum()) + prior

    best = minimize(loss, np.array(START)).x
    print(f"CALIBRATION = ({best[0]:.2f}, {best[1]:.2f}) from {len(claims)} claims,")
    print(f"  {int(right.sum())} right, mean stated {stated.mean():.3f}")
    z = np.concatenate([case.get("standardised_errors") or [0.0][:0] for case in cases])
    print(f"{z.size} parameters, rms error in standard errors {np.sqrt(np.mean(z**2)):.2f}")
    covered = [case["closure_covered"] for case in cases if case["claimed"] or case["unknown"]]
    print(f"closure intervals hold {np.mean([c for c in covered if c is not None]):.2f}")


def line(label: Label, target: Path) -> str:
    scores, gap = score(label, target / f"{label['name']}.json")
    truth = "; ".join(
        f"{e['name']}{'' if e['tails'] is None else len(e['tails'])}" for e in label["effects"]
    )
    if label["outside"] is not None:
        truth += f" {label['outside']['component']}:{'x'.join(label['outside']['variables'])}"
    size = "+".join(f"{s:.1f}" for s in label["sizes"])
    lead = f"{label['name']} {label['kind']:7} {label['world']:7} {truth} {size} {label['variant']}"
    if gap is None:
        return f"{lead} | FAILED {scores['failure']}"
    claims = [f"{e['name']}/{len(e['tails'])} {e['probability']:.2f}" for e in gap["effects"]]
    places = [
        f"?{'x'.join(p['variables'])}|{p['component']}/{len(p['tails'])}"
        for p in gap["unknown"]["where"]
    ]
    right = {
        "null": not scores["detected"],
        "single": scores["first_right"],
        "pair": scores["all_named"],
        "outside": bool(scores.get("variable_first")),
        "removed": scores["unknown"],
    }[label["kind"]]
    good = right and not scores["false_names"]
    return (
        f"{'ok  ' if good else 'MISS'} {lead} | {', '.join(claims + places) or 'nothing'}"
        f" | closes {scores['closure_stated']:.2f} of {scores['closure_true']:.2f} kt,"
        f" {scores['seconds']:.0f} s {scores['gigabytes']:.1f} GB"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for command, names in (
        ("prepare", ()),
        ("run", ("name",)),
        ("compare", ("old", "new")),
        ("calibrate", ("scores",)),
    ):
        sub = commands.add_parser(command)
        for argument in names:
            sub.add_argument(argument)
        sub.add_argument(
            "--folder", type=Path, default=Path(tempfile.gettempdir()) / "airswing-gap-paired"
        )
        if command == "prepare":
            sub.add_argument("--cases", type=int, default=CASES)
            sub.add_argument("--seed", type=int, default=SEED)
            sub.add_argument("--real", type=Path)
        if command == "run":
            sub.add_argument("--only", nargs="*", default=())
    options = parser.parse_args()
    if options.command == "prepare":
        prepare(options.folder, options.cases, options.seed, options.real)
    elif options.command == "run":
        run(options.folder, options.name, options.only)
    elif options.command == "compare":
        compare(options.folder, options.old, options.new)
    else:
        calibrate(Path(options.scores))
    return 0


if __name__ == "__main__":
    sys.exit(main())
