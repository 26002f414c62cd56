"""The field test as pictures, and errors by layer and phase of flight as panels of text.

Assumes ``field_test.json`` and ``error_profiles.nc`` as :mod:`airswing.evaluation` writes them;
what they leave out (intervals, permutation draws, single aircraft) is not drawn.  Disagreement
is mean vector disagreement in knots, profiles are rms in m/s and degrees by layer of pressure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from airswing.evaluation.results import Content
from airswing.report.html.document import drawing, paragraph
from airswing.report.html.style import (
    BLUE,
    FAINT,
    HEAVY,
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
from airswing.report.html.svg_panel import Panel
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]

PROFILES = (
    ("eastward_rms", "eastward wind, rms (m/s)"),
    ("northward_rms", "northward wind, rms (m/s)"),
    ("direction_rms", "wind direction, rms (degree)"),
)
_STATES = (("reported", ORANGE, False, -0.1), ("corrected", BLUE, True, 0.1))


def _interval(axes: Axes, bounds: Sequence[float] | None, y: float, colour: str) -> None:
    if bounds:
        axes.plot(bounds, [y, y], color=colour, linewidth=1.3, solid_capstyle="butt", zorder=2)


@styled
def field_test_figure(field_test: Content) -> Figure:
    """Draw disagreement before and during the test by group, and the reductions.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json`` (docs/formats.md).
    """
    groups = field_test["groups"]
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
        _interval(left, entry.get("before_ci_kt"), row - 0.14, ORANGE)
        _interval(left, entry.get("during_ci_kt"), row + 0.14, BLUE)
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
    number = sum(_reports(entry) for entry in groups.values())
    return figure.say(
        "The field test: mean length of the difference between reported and reference wind of "
        "each group before and during the test (thin lines: 95 % intervals where given), and "
        f"what the corrected aircraft gained beyond the controls (n = {plural(number, 'report')})."
    )


def _reports(entry: Content) -> int:
    return int(entry.get("reports_before", 0)) + int(entry.get("reports_during", 0))


def _reductions(axes: Axes, field_test: Content) -> None:
    entries = [
        *(
            (f"{name}: reduction", entry.get("reduction_kt"), entry.get("reduction_ci_kt"), SOFT)
            for name, entry in field_test["groups"].items()
        ),
        (
            "adjusted, linear",
            field_test.get("adjusted_reduction_kt"),
            field_test.get("adjusted_reduction_ci_kt"),
            BLUE,
        ),
        (
            "adjusted, quadrature",
            field_test.get("adjusted_reduction_quadrature_kt"),
            field_test.get("adjusted_reduction_quadrature_ci_kt"),
            BLUE,
        ),
    ]
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
            # the line of no reduction may run through it
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_yticks(range(len(entries)), [entry[0] for entry in entries])
    axes.set_ylim(len(entries) - 0.5, -0.7)
    axes.margins(x=0.14)
    axes.set_xlabel("reduction (kt)")


@styled
def scrutiny_figure(field_test: Content) -> Figure:
    """Draw each aircraft before against during, and the effect among permuted groups.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json`` with ``by_aircraft`` and ``permutation``.
    """
    figure = new_figure(3.7)
    left, right = figure.subplots(1, 2)
    number = _each_aircraft(left, field_test.get("by_aircraft", []))
    words = _permutation(right, field_test.get("permutation"))
    return figure.say(
        f"Left: each aircraft's mean disagreement before and during the test (n = "
        f"{plural(number, 'aircraft', 'aircraft')}); below the line it fell. {words}"
    )


def _each_aircraft(axes: Axes, rows: Sequence[Content]) -> int:
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
                rasterized=len(rows) > HEAVY,
            )
    values = [value for row in rows for value in (row["before_kt"], row["during_kt"])]
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


def _permutation(axes: Axes, permutation: Content | None) -> str:
    draws = np.asarray(permutation["null_effects_kt"] if permutation else [], float)
    axes.set_title("Permutation test over aircraft")
    if permutation is None or draws.size == 0:
        blank(axes, "Too few aircraft for a permutation test.")
        return "Too few aircraft for a permutation test."
    effect, p_value = permutation["effect_kt"], permutation["p_value"]
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


def profile_panels(profiles: xr.Dataset, reference: str) -> Markup:
    """Wind and direction error by layer and phase of flight, before and after the correction.

    Parameters
    ----------
    profiles : Dataset
        ``eastward_rms``, ``northward_rms``, ``direction_rms`` with ``*_standard_error``
        (reference, state, flight_phase, layer) and ``profile_count``.
    reference : str
        Reference or pool.
    """
    chosen = profiles.sel(reference=reference)
    counts = chosen["profile_count"].sel(state="reported")
    phases = [
        str(p) for p in chosen["flight_phase"].to_numpy() if int(counts.sel(flight_phase=p).sum())
    ]
    if not phases:
        return paragraph("No report has a layer and a phase (n = 0).")
    bottom, top = (chosen[f"layer_{end}_pressure"].to_numpy() / 100.0 for end in ("bottom", "top"))
    layers = [f"{low:.0f}-{high:.0f}" for low, high in zip(bottom, top, strict=True)]
    width = 940.0 / max(len(phases), 2)
    panels = []
    for name, label in PROFILES:
        values, halves = _values(chosen, name, phases)
        shown = values + halves
        most = 1.05 * float(np.nanmax(shown)) if bool(np.isfinite(shown).any()) else 1.0
        for number, phase in enumerate(phases):
            size = (width, 42.0 + 24.0 * len(layers))
            panel = Panel(size, (64, 12, 24, 38), x=(0.0, most), y=(-0.6, len(layers) - 0.4))
            ticks = [
                t
                for t in MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, most)
                if 0.0 <= t <= most
            ]
            panel.scales([(t, f"{t:g}") for t in ticks], list(enumerate(layers)), points=11)
            title = f"{phase}, layers in hPa" if number == 0 else phase
            panel.words(64, 15, title, points=13, at="start", more=' font-weight="bold"')
            panel.words(64 + panel.width / 2, size[1] - 5, label, points=12)
            if name == PROFILES[0][0]:
                _counts(panel, counts.sel(flight_phase=phase).to_numpy())
            looks = zip(_STATES, values[number], halves[number], strict=True)
            for (_, colour, diamond, shift), value, half in looks:
                level = np.arange(len(layers)) + shift
                panel.line(value, level, colour, width=1.5)
                panel.bars_across(level, value - half, value + half, colour)
                panel.marks(value, level, colour, size=4.0 if diamond else 3.0, diamond=diamond)
            panels.append(panel.svg(f"{label} by layer in {phase}, against {reference}"))
    caption = (
        f"Difference from {reference} by layer and phase of flight, as reported (orange discs) and "
        f"corrected (blue diamonds), with 95 % intervals clustered by flight (n = "
        f"{plural(int(counts.sum()), 'report')}; numbers at the left: reports of the layer)."
    )
    return drawing(panels, caption, columns=len(phases))


def _values(chosen: xr.Dataset, name: str, phases: list[str]) -> tuple[Floats, Floats]:
    """Values and half widths of their 95 % intervals (none where there is no standard error).

    Each (phase, state, layer), states as drawn.
    """
    shown = chosen.sel(flight_phase=phases, state=[state for state, *_ in _STATES])
    value, error = (
        shown[f"{name}{end}"].transpose("flight_phase", "state", "layer").to_numpy().astype(float)
        for end in ("", "_standard_error")
    )
    return value, NORMAL_95 * np.where(np.isnan(error), 0.0, error)


def _counts(panel: Panel, counts: NDArray[np.int64]) -> None:
    for layer, number in enumerate(counts.tolist()):
        at = panel.top + float(panel.down(layer)) + 4.0
        panel.words(panel.left + 4.0, at, thousands(number), points=10, at="start", color=SOFT)
