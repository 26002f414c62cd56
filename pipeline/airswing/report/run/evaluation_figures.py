"""The field test as pictures.

Assumes ``field_test.json`` as :mod:`airswing.evaluation` writes it; what it leaves out (intervals,
permutation draws, single aircraft) is not drawn.  Disagreement is the mean vector one, in knots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.report.html.style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    SOFT,
    VERMILION,
    blank,
    new_figure,
    plural,
    styled,
    thousands,
)


def _interval(axes: Axes, entry: Mapping[str, Any], key: str, y: float, colour: str) -> None:
    bounds = entry.get(f"{key}_ci_kt")
    if bounds:
        axes.plot(bounds, [y, y], color=colour, linewidth=1.3, solid_capstyle="butt", zorder=2)


@styled
def field_test_figure(field_test: Mapping[str, Any]) -> Figure:
    """Draw disagreement before and during the test by group, and the reductions.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json`` (docs/formats.md).

    Returns
    -------
    CaptionedFigure
    """
    groups: Mapping[str, Mapping[str, Any]] = field_test["groups"]
    figure = new_figure(1.5 + 0.5 * len(groups))
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    for row, entry in enumerate(groups.values()):
        before, during = float(entry["before_kt"]), float(entry["during_kt"])
        left.annotate(
            "",
            (during, row),
            (before, row),
            zorder=1,
            arrowprops={"arrowstyle": "-|>", "color": FAINT, "linewidth": 2.2},
        )
        _interval(left, entry, "before", row - 0.14, ORANGE)
        _interval(left, entry, "during", row + 0.14, BLUE)
        left.plot(
            before,
            row,
            "o",
            color=ORANGE,
            markersize=7,
            zorder=3,
            label="before" if row == 0 else None,
        )
        left.plot(
            during,
            row,
            "D",
            color=BLUE,
            markersize=6.5,
            zorder=3,
            label="during" if row == 0 else None,
        )
        for value, up in ((before, before > during), (during, during >= before)):
            left.annotate(
                f"{value:.2f}",
                (value, row),
                xytext=(9 if up else -9, 0),
                va="center",
                textcoords="offset points",
                ha="left" if up else "right",
                fontsize=9,
            )
    names = [f"{name}\n{entry['aircraft']} aircraft" for name, entry in groups.items()]
    left.set_yticks(range(len(groups)), names)
    left.set_ylim(len(groups) - 0.5, -0.5)
    left.margins(x=0.16)
    left.set_xlabel("mean vector disagreement (kt)")
    left.grid(axis="y", visible=False)
    _reductions(right, field_test)
    figure.legend(loc="outside upper left", ncols=2)
    number = sum(
        int(e.get(f"reports_{w}", 0)) for e in groups.values() for w in ("before", "during")
    )
    return figure.say(
        "The field test: mean length of the difference between reported and reference wind of "
        "each group before and during the test (thin lines: 95 % intervals where given), and "
        f"what the corrected aircraft gained beyond the controls (n = {plural(number, 'report')})."
    )


def _reductions(axes: Axes, field_test: Mapping[str, Any]) -> None:
    entries = [
        (f"{name}: reduction", entry.get("reduction_kt"), entry.get("reduction_ci_kt"), SOFT)
        for name, entry in field_test["groups"].items()
    ]
    for key, label in (
        ("adjusted_reduction", "adjusted, linear"),
        ("adjusted_reduction_quadrature", "adjusted, quadrature"),
    ):
        entries.append((label, field_test.get(f"{key}_kt"), field_test.get(f"{key}_ci_kt"), BLUE))
    entries = [entry for entry in entries if entry[1] is not None]
    for row, (_, value, bounds, colour) in enumerate(entries):
        if bounds:
            axes.plot(bounds, [row, row], color=colour, linewidth=1.6, zorder=2)
        axes.plot(value, row, "o", color=colour, markersize=6, zorder=3)
        axes.annotate(
            f"{value:+.2f}",
            (value, row),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8.5,
        )
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(entries)), [entry[0] for entry in entries])
    axes.set_ylim(len(entries) - 0.5, -0.7)
    axes.margins(x=0.14)
    axes.set_xlabel("reduction (kt)")


@styled
def scrutiny_figure(field_test: Mapping[str, Any]) -> Figure:
    """Draw each aircraft before against during, and the effect among permuted groups.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json`` with ``by_aircraft`` and ``permutation``.

    Returns
    -------
    CaptionedFigure
    """
    figure = new_figure(3.7)
    left, right = figure.subplots(1, 2)
    number = _each_aircraft(left, field_test.get("by_aircraft", []))
    words = _permutation(right, field_test.get("permutation", {}))
    return figure.say(
        f"Left: each aircraft's mean disagreement before and during the test (n = "
        f"{plural(number, 'aircraft', 'aircraft')}); below the line it fell. {words}"
    )


def _each_aircraft(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> int:
    axes.set_title("Each aircraft")
    look = {"controls": (SOFT, "s"), "corrected": (BLUE, "o")}
    for group, (colour, marker) in look.items():
        both = [(row["before_kt"], row["during_kt"]) for row in rows if row["group"] == group]
        if both:
            axes.plot(
                *zip(*both, strict=True),
                marker,
                color=colour,
                alpha=0.85,
                markersize=5.5,
                linestyle="none",
                label=group,
            )
    values = [row[key] for row in rows for key in ("before_kt", "during_kt")]
    values = [value for value in values if value is not None and np.isfinite(value)]
    if not values:
        blank(axes, "No single aircraft given.")
        return 0
    low, high = min(values) - 0.5, max(values) + 0.5
    axes.plot([low, high], [low, high], color=FAINT, linewidth=1.0, zorder=1)
    axes.annotate(
        "no change",
        (high, high),
        ha="right",
        va="bottom",
        fontsize=8,
        color=SOFT,
        rotation=45,
        rotation_mode="anchor",
        xytext=(-4, 3),
        textcoords="offset points",
    )
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.set_xlabel("before (kt)")
    axes.set_ylabel("during (kt)")
    axes.legend(loc="upper left")
    return len(rows)


def _permutation(axes: Axes, permutation: Mapping[str, Any]) -> str:
    draws = np.asarray(permutation.get("null_effects_kt", []), float)
    effect, p_value = permutation.get("effect_kt"), permutation.get("p_value")
    axes.set_title("Permutation test over aircraft")
    if draws.size == 0 or effect is None:
        blank(axes, "Too few aircraft for a permutation test.")
        return "Too few aircraft for a permutation test."
    axes.hist(draws, bins=30, color=FAINT)
    axes.axvline(effect, color=VERMILION, linewidth=2.0)
    side = "right" if effect > 0.5 * (draws.min() + max(draws.max(), effect)) else "left"
    axes.annotate(
        f"found {effect:+.2f} kt",
        (effect, 0.97),
        xycoords=("data", "axes fraction"),
        xytext=(-5 if side == "right" else 5, 0),
        textcoords="offset points",
        ha=side,
        va="top",
        color=VERMILION,
    )
    axes.set_xlabel("effect with groups drawn by lot (kt)")
    axes.set_ylabel("draws")
    return (
        f"Right: the effect that drawing the groups by lot gives ({thousands(draws.size)} draws "
        f"shown); the effect found is as large or larger by luck with probability {p_value:.3g}."
    )
