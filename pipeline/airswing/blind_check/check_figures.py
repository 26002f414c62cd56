"""The check in one picture: identification against size, what is taken for what, closure.

Assumes the scores of finished cases. Shares are drawn with Wilson 68 % intervals.
Units: m/s, kt.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from airswing.blind_check.reliability_table import reliability_rows
from airswing.blind_check.scores import Score, ShareKey
from airswing.report.html.style import (
    BLUE,
    GREEN,
    SOFT,
    VERMILION,
    CaptionedFigure,
    blank,
    new_figure,
    styled,
)

__all__ = ["check_figure", "confusion", "wilson"]


def wilson(right: int, number: int) -> tuple[float, float]:
    """Return the 68 % Wilson interval of a share (Wilson 1927)."""
    if number == 0:
        return 0.0, 1.0
    share, z2 = right / number, 1.0
    centre = (share + z2 / (2 * number)) / (1 + z2 / number)
    half = np.sqrt(share * (1 - share) / number + z2 / (4 * number**2)) / (1 + z2 / number)
    return float(centre - half), float(centre + half)


def confusion(scores: Sequence[Score]) -> tuple[list[str], list[str], NDArray[np.float64]]:
    """Return what was taken for what.

    Returns
    -------
    truths, told : list of str
        Rows: effects of single cases (and ``nothing``). Columns: first name claimed, ``unknown``,
        ``nothing``.
    counts : ndarray (rows, columns)
    """
    pairs = []
    for score in scores:
        if score.get("failure") or score["kind"] == "pair":
            continue
        truth = score["focus"][0] if score["focus"] else "nothing"
        truth += " (removed)" if score["kind"] == "removed" else ""
        right = score["first_right"] and truth in score["claimed"]
        pairs.append((truth, truth if right else _first_told(score)))
    truths = sorted({truth for truth, _ in pairs}, key=lambda name: (name == "nothing", name))
    told = sorted({t for _, t in pairs}, key=lambda n: (n == "nothing", n == "unknown", n))
    counts = np.zeros((len(truths), len(told)))
    for truth, name in pairs:
        counts[truths.index(truth), told.index(name)] += 1
    return truths, told, counts


def _first_told(score: Score) -> str:
    """Return what a diagnosis tells first: an unknown where it stands ahead of the names."""
    if score["unknown"] and (score.get("unknown_first") or not score["claimed"]):
        return "unknown"
    return str(score["claimed"][0]) if score["claimed"] else "nothing"


@styled
def check_figure(scores: Sequence[Score]) -> CaptionedFigure:
    """Draw the check."""
    figure = new_figure(10.5)
    # laid out apart: the long names below would make the panels above narrow
    above, below = figure.subfigures(2, 1, height_ratios=[1, 2.2], squeeze=False)[:, 0]
    size, closure, stated = above.subplots(1, 3)
    _size_panel(size, scores)
    _closure_panel(closure, scores)
    _reliability_panel(stated, scores)
    _confusion_panel(below.subplots(), scores)
    return figure.say(
        f"Sealed cases: {len(scores)}. Above left, share of single effects detected, named first, "
        "and in the ambiguity set, by their size where they act. Above middle, closure stated "
        "against closure true, kt, with its interval; of outside effects what names and unknown "
        "close together. Above right, of claims stated with a probability the share that is right, "
        "with 68 % intervals. Below, what each effect was taken for first.",
        alternative="Scores of the blind check",
    )


def _size_panel(axes: Axes, scores: Sequence[Score]) -> None:
    singles = [s for s in scores if s["kind"] == "single" and not s.get("failure")]
    sizes = sorted({s["size"] for s in singles})
    axes.set_title("Identification against size")
    if not sizes:
        blank(axes, "no single effects")
        return
    place = np.arange(len(sizes), dtype=float)
    curves: tuple[tuple[ShareKey, str, str, str], ...] = (
        ("detected", "detected", SOFT, "o"),
        ("first_right", "first name right", BLUE, "s"),
        ("in_set", "truth in the set", GREEN, "^"),
    )
    for shift, (key, name, colour, marker) in enumerate(curves):
        share, low, high = [], [], []
        for size in sizes:
            values = [bool(s[key]) for s in singles if s["size"] == size and s[key] is not None]
            bounds = wilson(sum(values), len(values))
            share.append(sum(values) / max(len(values), 1))
            low.append(max(share[-1] - bounds[0], 0.0))
            high.append(max(bounds[1] - share[-1], 0.0))
        axes.errorbar(
            place + 0.06 * (shift - 1),
            share,
            yerr=[low, high],
            color=colour,
            marker=marker,
            label=name,
            capsize=2,
        )
    number = [sum(s["size"] == size for s in singles) for size in sizes]
    labels = [f"{size:g}\n({count})" for size, count in zip(sizes, number, strict=True)]
    axes.set_xticks(place, labels)
    axes.set_xlabel("effect where it acts, m/s rms (cases)")
    axes.set_ylabel("share of cases")
    axes.set_ylim(-0.03, 1.05)
    # shares grow with size: below on the right nothing lies
    axes.legend(loc="lower right")


def _closure_panel(axes: Axes, scores: Sequence[Score]) -> None:
    done = [s for s in scores if not s.get("failure") and s.get("closure_stated") is not None]
    axes.set_title("Closure, stated against true")
    if not done:
        blank(axes, "no closure stated")
        return
    for kind, colour, marker in (
        (("single", "pair"), BLUE, "o"),
        (("outside", "removed"), VERMILION, "^"),
        (("null",), SOFT, "s"),
    ):
        own = [s for s in done if s["kind"] in kind]
        if own:
            told = [_closure_told(s) for s in own]
            stated = np.array([one[0] for one in told])
            ends = [one[1] for one in told]
            reach = np.abs(np.array(ends).T - stated)  # below and above, which differ
            axes.errorbar(
                [s["closure_true"] for s in own],
                stated,
                yerr=reach,
                color=colour,
                marker=marker,
                linestyle="none",
                markersize=4,
                elinewidth=0.6,
                label=" or ".join(kind),
            )
    span = [min(s["closure_true"] for s in done), max(s["closure_true"] for s in done)]
    axes.plot(span, span, color=SOFT, linewidth=1)
    axes.set_xlabel("true, kt")
    axes.set_ylabel("stated, kt")
    axes.legend(loc="upper left")


def _closure_told(score: Score) -> tuple[float, Sequence[float]]:
    """Return the closure stated and its interval: with the unknown's for an outside effect."""
    if score.get("unknown_closure_stated") is not None:
        return score["unknown_closure_stated"], score["unknown_closure_interval"]
    stated = score["closure_stated"]
    return stated, score.get("closure_interval") or [stated] * 2


def _reliability_panel(axes: Axes, scores: Sequence[Score]) -> None:
    claims = [claim for s in scores if not s.get("failure") for claim in s.get("claims", ())]
    axes.set_title("Stated and right")
    rows = reliability_rows(claims)
    if not rows:
        blank(axes, "no claim stated")
        return
    for row in rows:
        low, high = wilson(round(row["right"] * row["claims"]), row["claims"])
        reach = [[max(row["right"] - low, 0.0)], [max(high - row["right"], 0.0)]]
        axes.errorbar(row["stated"], row["right"], yerr=reach, color=BLUE, marker="o", capsize=2)
        axes.annotate(
            f"{row['claims']}",
            (row["stated"], 0.0),
            fontsize=7.5,
            # most claims are stated near one: upright, at the foot, none covers another
            rotation=90,
            ha="center",
        )
    axes.plot([0, 1], [0, 1], color=SOFT, linewidth=1)
    axes.set_xlim(min(0.45, rows[0]["stated"] - 0.05), 1.03)
    axes.set_ylim(-0.03, 1.05)
    axes.set_xlabel("probability stated (claims)")
    axes.set_ylabel("share right")


def _confusion_panel(axes: Axes, scores: Sequence[Score]) -> None:
    axes.set_title("What each effect was taken for first")
    truths, told, counts = confusion(scores)
    if not truths:
        blank(axes, "no cases")
        return
    # by rows: how often each truth came is the draw's doing
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1.2, aspect="auto")
    for (row, column), count in np.ndenumerate(counts):
        if count:
            axes.text(
                column,
                row,
                f"{count:.0f}",
                ha="center",
                va="center",
                fontsize=7.5,
                color="white" if share[row, column] > 0.7 else "black",
            )
    axes.set_xticks(range(len(told)), told, rotation=55, ha="right", fontsize=7.5)
    axes.set_yticks(range(len(truths)), truths, fontsize=7.5)
    axes.set_xlabel("named first")
    axes.set_ylabel("truth")
    axes.grid(False)
