"""Figures of a blind check against their targets, the report and its figure.

An effect counts as detectable from 0.4 m/s where it acts. Intervals of shares are 95 % Wilson
intervals (Wilson 1927); reliability follows Murphy (1973). Units: kt for closures, days for dates.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import binomtest

from airswing.blind_check.check import Check
from airswing.blind_check.score import Score
from airswing.products.whole_files import write_text
from airswing.synthetic.outside_effects import WORTH_KT

DETECTABLE_M_S = 0.4
#: Edges of the bins of stated probabilities; finer where most claims are.
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
#: Fewest claims in a bin for an estimate of reliability: with fewer its standard error exceeds 0.1.
LEAST_CLAIMS = 20

Reached = tuple[float | None, int]
Target = float | tuple[float, float]


def _reach(share: float, number: int) -> tuple[float, float]:
    """Distances from a share to the ends of its 95 % Wilson interval."""
    if not number:
        return share, 1.0 - share
    ends = binomtest(round(share * number), number).proportion_ci(method="wilson")
    return max(share - ends.low, 0.0), max(ends.high - share, 0.0)


def reliability(claims: Sequence[tuple[str, float, bool]]) -> pd.DataFrame:
    """Stated probability (mean), share of right claims and number of each bin of `EDGES`."""
    frame = pd.DataFrame(claims, columns=["kind", "stated", "right"]).astype({"right": float})
    index = np.clip(np.searchsorted(EDGES, frame["stated"], side="right") - 1, 0, len(EDGES) - 2)
    grouped = frame.groupby(index)
    means = grouped[["stated", "right"]].mean()
    return means.assign(number=grouped.size())


def _values(scores: Sequence[Score], key: str) -> list[float]:
    return [float(score[key]) for score in scores if score.get(key) is not None]


def _reliability(claims: Sequence[tuple[str, float, bool]]) -> Reached:
    """The largest distance of stated probability and share of right claims over the bins."""
    table = reliability(claims)
    table = table[table["number"] >= LEAST_CLAIMS]
    if table.empty:
        return None, 0
    return float((table["stated"] - table["right"]).abs().max()), int(table["number"].sum())


def _figures(scores: Sequence[Score]) -> list[tuple[str, str, Target, Reached]]:
    """Every figure: its name, direction, target, and its value with the number of cases."""
    done = [score for score in scores if score["failure"] is None]
    singles, pairs, outside = (
        [s for s in done if s["kind"] == kind and s["size"] >= DETECTABLE_M_S]
        for kind in ("single", "pair", "outside")
    )
    nulls = [s for s in done if s["kind"] == "null"]
    removed = [s for s in done if s["kind"] == "removed" and s["closure_true"] >= WORTH_KT]
    raised = [s for s in outside if s["unknown"]]
    named = [s for s in singles if s["all_named"]]
    # Cases in which an effect of the archive was identified.
    stated = named + [s for s in pairs if s["all_named"]] + raised
    deviations = [abs(z) <= 2.0 for s in named for z in s["standardised_errors"]]
    claims = [claim for s in done for claim in s["claims"]]

    def mean(values: Sequence[float]) -> Reached:
        return (float(np.mean(values)) if values else None), len(values)

    def share(group: Sequence[Score], key: str) -> Reached:
        return mean(_values(group, key))

    def median(group: Sequence[Score], key: str) -> Reached:
        values = _values(group, key)
        return (float(np.median(values)) if values else None), len(values)

    def identified(score: Score) -> bool:
        return score["unknown_first"] and bool(score.get("variable_first"))

    def close(score: Score) -> bool:
        return bool(score["closure_error"] <= max(0.05 * score["closure_true"], 0.03))

    any_claim = [bool(s["false_names"]) or s["unknown"] for s in nulls]
    false_name = [bool(s["false_names"]) for s in done if s["kind"] != "removed"]
    right = "outside the catalogue: raised with the right variable, no false name first"
    detected = "withheld effects of 0.1 kt and more: something stated"
    error, interval = "closure of what is stated: median error, kt", (0.90, 0.98)
    covered = "closure interval contains the truth"
    return [
        ("first name right, single effects", ">=", 0.95, share(singles, "first_right")),
        ("both effects of a pair named", ">=", 0.92, share(pairs, "all_named")),
        (right, ">=", 0.85, mean([identified(s) for s in outside])),
        ("outside: precision of the aircraft", ">=", 0.90, share(raised, "precision")),
        ("outside: recall of the aircraft", ">=", 0.90, share(raised, "recall")),
        ("archives with a false name", "<=", 0.03, mean(false_name)),
        ("nulls with any claim", "<=", 0.02, mean(any_claim)),
        ("parameters: median relative error", "<=", 0.03, median(named, "parameter_error")),
        ("parameters within two standard errors", "in", (0.93, 0.97), mean(deviations)),
        (error, "<=", 0.03, median(stated, "closure_error")),
        ("closure within 5 % or 0.03 kt", ">=", 0.50, mean([close(s) for s in stated])),
        (covered, "in", interval, share(stated, "closure_covered")),
        ("stated probability: largest error of a bin", "<=", 0.05, _reliability(claims)),
        (detected, ">=", 0.95, share(removed, "detected")),
        ("truth in the credible set, single effects", ">=", 0.95, share(singles, "in_set")),
        ("dates: median error, days", "<=", 3.0, median(named, "date_error")),
    ]


def targets(scores: Sequence[Score]) -> pd.DataFrame:
    """Every figure with its target: ``figure, target, reached, number, met``.

    ``met`` is None without cases.
    """
    rows: list[dict[str, Any]] = []
    for name, direction, target, (reached, number) in _figures(scores):
        met = None
        if isinstance(target, tuple):
            text = f"{target[0]:g} to {target[1]:g}"
            if reached is not None:
                # With few cases the upper target is compatible with a share of 1.
                few = number * (1.0 - target[1]) < 1.0
                met = target[0] <= reached and (few or reached <= target[1])
        else:
            text = f"{direction} {target:g}"
            if reached is not None:
                met = reached >= target if direction == ">=" else reached <= target
        row = {"figure": name, "target": text, "reached": reached, "number": number, "met": met}
        rows.append(row)
    return pd.DataFrame(rows)


def of_default(scores: Sequence[Score]) -> list[Score]:
    """Return the scores of ordinary archives (not short, hard, or with real errors)."""
    return [score for score in scores if score["world"] == "default"]


def _number(value: float | None) -> str:
    return "-" if value is None or np.isnan(value) else f"{value:.3g}"


def _markdown_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def summary_table(check: Check) -> str:
    """Return the figures of ordinary archives and of all cases as a Markdown table."""
    tables = targets(of_default(check.scores)), targets(check.scores)
    rows = []
    for (_, ordinary), (_, every) in zip(tables[0].iterrows(), tables[1].iterrows(), strict=True):
        row = [str(every["figure"]), str(every["target"])]
        for values in (ordinary, every):
            missed = "**" if values["met"] is False else ""
            row.append(f"{missed}{_number(values['reached'])}{missed} ({values['number']})")
        rows.append(row)
    columns = ["figure", "target", "ordinary archives (number)", "all cases (number)"]
    return _markdown_table(columns, rows)


def case_table(check: Check) -> str:
    """Return one row for each case as a Markdown table."""
    rows = []
    for score in sorted(check.scores, key=lambda s: s["name"]):
        stated = score["failure"] or ", ".join(score["claimed"] + ["unknown"] * score["unknown"])
        rows.append(
            [
                score["name"],
                str(score["rung"]),
                f"{score['kind']}, {score['variant']}",
                score["world"],
                ", ".join(score["focus"]) or "-",
                f"{score['size']:g}",
                stated or "nothing",
                _number(score.get("closure_stated")),
                _number(score.get("closure_true")),
            ]
        )
    columns = ["case", "rung", "kind", "world", "truth", "m/s", "stated", "closure, kt", "true, kt"]
    return _markdown_table(columns, rows)


def write_report(output: Path, check: Check, *, command: str) -> Path:
    """Write ``gap_check.md``, whose path is returned, and ``gap_check.png`` of a finished check."""
    check_figure(check.scores).savefig(output / "gap_check.png", dpi=120)
    nulls = sum(score["kind"] == "null" for score in check.scores)
    outside = sum(score["kind"] == "outside" for score in check.scores)
    text = f"""# Blind check of the gap diagnosis

{len(check.scores)} sealed archives, {nulls} of them without an effect and {outside} with an effect
outside the catalogue, diagnosed by the public command. Figures that miss their target are bold.

Command: `{command}`. SHA-256 of the labels, published before the first diagnosis:
`{check.digest}`.

{summary_table(check)}

![Identification, closure and reliability](gap_check.png)

## Cases

{case_table(check)}
"""
    return write_text(output / "gap_check.md", text)


def check_figure(scores: Sequence[Score]) -> Figure:
    """Draw identification against size, closure, reliability, and the confusion matrix."""
    done = [score for score in scores if score["failure"] is None]
    figure = Figure(figsize=(11, 10), layout="constrained")
    axes = figure.subplot_mosaic(
        [["size", "closure", "stated"], ["named"] * 3], height_ratios=[1, 2]
    )
    _draw_identification(axes["size"], [s for s in done if s["kind"] == "single"])
    _draw_closure(axes["closure"], done)
    _draw_reliability(axes["stated"], done)
    _draw_confusion(axes["named"], done)
    return figure


def _draw_identification(axes: Axes, singles: Sequence[Score]) -> None:
    sizes = sorted({score["size"] for score in singles})
    names = (("detected",) * 2, ("first_right", "first name right"), ("in_set", "in credible set"))
    for shift, (key, name) in enumerate(names if sizes else ()):
        shares, reach = [], []
        for size in sizes:
            values = _values([s for s in singles if s["size"] == size], key)
            shares.append(float(np.mean(values)) if values else np.nan)
            reach.append(_reach(shares[-1], len(values)))
        places = np.arange(len(sizes)) + 0.08 * (shift - 1)
        axes.errorbar(places, shares, np.transpose(reach), marker="o", capsize=2, label=name)
    counts = [sum(score["size"] == size for score in singles) for size in sizes]
    labels = [f"{size:g}\n({count})" for size, count in zip(sizes, counts, strict=True)]
    axes.set_xticks(range(len(sizes)), labels)
    axes.set(title="Single effects", xlabel="size, m/s (cases)", ylabel="share", ylim=(-0.03, 1.4))
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    if sizes:
        axes.legend(frameon=False, loc="upper left")


def _draw_closure(axes: Axes, scores: Sequence[Score]) -> None:
    for kinds, name in (
        (("single", "pair"), "named"),
        (("outside", "removed"), "unknown"),
        (("null",), "null"),
    ):
        used = [s for s in scores if s["kind"] in kinds]
        if used:
            stated = np.array(_values(used, "closure_stated"))
            ends = np.array([score["closure_interval"] for score in used]).T
            axes.errorbar(
                _values(used, "closure_true"),
                stated,
                np.maximum([stated - ends[0], ends[1] - stated], 0.0),
                fmt="o",
                markersize=4,
                elinewidth=0.6,
                label=name,
            )
    axes.axline((0, 0), slope=1, color="0.6", linewidth=1)
    axes.set(title="Closure", xlabel="true, kt", ylabel="stated, kt (95 % interval)")
    if axes.containers:
        axes.legend(frameon=False)


def _draw_reliability(axes: Axes, scores: Sequence[Score]) -> None:
    table = reliability([claim for score in scores for claim in score["claims"]])
    for k, (_, row) in enumerate(table.iterrows()):
        number = int(row["number"])
        reach = np.reshape(_reach(row["right"], number), (2, 1))
        axes.errorbar(row["stated"], row["right"], reach, marker="o", color="C0", capsize=2)
        height = 0.0 if k % 2 else 0.06  # neighbouring bins may be close
        axes.annotate(f"{number}", (row["stated"], height), ha="center", fontsize=7.5)
    axes.axline((0, 0), slope=1, color="0.6", linewidth=1)
    axes.set(title="Reliability", xlabel="stated probability (claims)", ylabel="share right")
    axes.set(xlim=(0.3, 1.03), ylim=(-0.03, 1.05))


def confusion(scores: Sequence[Score]) -> pd.DataFrame:
    """Number of cases by truth (rows) and first statement (columns); pairs are omitted."""
    truths, stated = [], []
    for score in scores:
        if score["kind"] == "pair":
            continue
        truth = score["focus"][0] if score["focus"] else "nothing"
        first = score["claimed"][0] if score["claimed"] else "nothing"
        if score["unknown"] and (score.get("unknown_first") or not score["claimed"]):
            first = "unknown"
        truths.append(truth + " (withheld)" * (score["kind"] == "removed"))
        stated.append(truth if score["first_right"] else first)
    counts = pd.crosstab(np.array(truths), np.array(stated))
    last = ("nothing", "unknown")
    rows, columns = (sorted(names, key=lambda name: (name in last, name)) for names in counts.axes)
    return counts.loc[rows, columns]


def _draw_confusion(axes: Axes, scores: Sequence[Score]) -> None:
    counts = confusion(scores)
    if counts.empty:
        axes.set_axis_off()
        return
    share = counts.div(counts.sum(axis=1), axis=0).to_numpy()
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
    for (row, column), count in np.ndenumerate(counts.to_numpy()):
        if count:
            colour = "white" if share[row, column] > 0.7 else "black"
            axes.text(
                column, row, f"{count:.0f}", ha="center", va="center", color=colour, fontsize=8
            )
    axes.set_xticks(range(counts.shape[1]), counts.columns, rotation=55, ha="right", fontsize=8)
    axes.set_yticks(range(counts.shape[0]), counts.index, fontsize=8)
    axes.set(title="Truth and first statement", xlabel="stated first", ylabel="truth")
