"""Field test, ranking, comparison of references and observation errors: figures and sections.

Contents as in ``field_test.json``, ``virtual_field_test.json`` and ``sensitivity.json``
(docs/formats.md), and ``observation_errors.nc``. Without its product a section is empty and the
page omits it. Intervals are 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.evaluation.results import Content
from airswing.report.html.document import Column, Row, Section, folded, heading, listing, table
from airswing.report.html.embed import Figures
from airswing.report.html.style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    SOFT,
    VERMILION,
    Units,
    blank,
    empty_figure,
    new_figure,
    plural,
    series_style,
    shown_per_kt,
    shown_per_m_s,
    styled,
    thousands,
)
from airswing.report.run.fleet import rows_axis
from airswing.report.run.selection import number_text, range_text, scaled
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Rows of a figure; the products contain all aircraft.
_MOST_ROWS = 40


# --- field test ------------------------------------------------------------------------------


@styled
def field_test_figure(field_test: Content, *, units: Units = "kt") -> Figure:
    """Draw the disagreement of each group before and during the field test, and the reductions.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json``.
    units : {"kt", "m/s"}, optional

    Returns
    -------
    Figure
    """
    groups, factor = field_test["groups"], shown_per_kt(units)
    figure = new_figure(1.5 + 0.5 * len(groups))
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    series = (("before", ORANGE, "o", -0.14), ("during", BLUE, "D", 0.14))
    for name, colour, marker, shift in series:
        values = [factor * float(entry[f"{name}_kt"]) for entry in groups.values()]
        left.plot(values, range(len(groups)), marker, color=colour, markersize=7, label=name)
        for row, (value, entry) in enumerate(zip(values, groups.values(), strict=True)):
            interval = scaled(entry.get(f"{name}_ci_kt"), factor)
            left.plot(interval, [row + shift] * 2, color=colour, linewidth=1.3)
            right_of = (entry["before_kt"] > entry["during_kt"]) == (name == "before")
            left.annotate(
                f"{value:.2f}",
                (value, row),
                xytext=(9 if right_of else -9, 0),
                textcoords="offset points",
                va="center",
                ha="left" if right_of else "right",
                fontsize=9,
            )
    rows_axis(left, [f"{name}\n{entry['aircraft']} aircraft" for name, entry in groups.items()])
    left.margins(x=0.16)
    left.set_xlabel(f"mean vector disagreement ({units})")
    entries: list[tuple[str, float, Any, str]] = [
        (f"{name}: reduction", entry["reduction_kt"], entry.get("reduction_ci_kt"), SOFT)
        for name, entry in groups.items()
    ]
    for key, label in (("", "linear"), ("_quadrature", "quadrature")):
        if (change := field_test.get(f"adjusted_reduction{key}_kt")) is not None:
            ends = field_test.get(f"adjusted_reduction{key}_ci_kt")
            entries.append((f"adjusted, {label}", change, ends, BLUE))
    for row, (_, value, interval, colour) in enumerate(entries):
        right.plot(scaled(interval, factor), [row, row], color=colour, linewidth=1.6)
        right.plot(factor * value, row, "o", color=colour, markersize=6)
        label_style = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        right.annotate(
            f"{factor * value:+.2f}",
            (factor * value, row),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8.5,
            bbox=label_style,
        )
    right.axvline(0.0, color=INK, linewidth=0.8)
    rows_axis(right, [entry[0] for entry in entries])
    right.margins(x=0.14)
    right.set_xlabel(f"reduction ({units})")
    figure.legend(loc="outside upper left", ncols=2)
    number = sum(
        int(entry.get(f"reports_{when}", 0))
        for entry in groups.values()
        for when in ("before", "during")
    )
    return figure.say(
        "Field test: mean length of the difference between reported and reference wind of each "
        "group before and during the test, and the reduction of the corrected aircraft beyond "
        f"that of the controls; lines are 95 % intervals (n = {plural(number, 'report')})."
    )


@styled
def scrutiny_figure(field_test: Content, *, units: Units = "kt") -> Figure:
    """Draw each aircraft before against during, and the effect among permuted groups."""
    figure = new_figure(3.7)
    left, right = figure.subplots(1, 2)
    number = _each_aircraft(left, field_test.get("by_aircraft", []), units)
    words = _permutation(right, field_test.get("permutation"), units)
    return figure.say(
        f"Left: mean disagreement of each aircraft before and during the test (n = "
        f"{plural(number, 'aircraft', 'aircraft')}); below the line it fell. {words}"
    )


def _equal_axes(axes: Axes, values: Floats, x_label: str, y_label: str) -> None:
    """Give both axes one range that holds the values, and draw the line of equality."""
    low, high = float(values.min()), float(values.max())
    margin = 0.1 * (high - low) + 0.2
    axes.plot([low - margin, high + margin], [low - margin, high + margin], color=FAINT, zorder=1)
    axes.set(xlim=(low - margin, high + margin), ylim=(low - margin, high + margin))
    axes.set_aspect("equal")
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)


def _each_aircraft(axes: Axes, rows: Sequence[Content], units: Units) -> int:
    axes.set_title("Each aircraft")
    factor = shown_per_kt(units)
    for group, colour, marker in (("controls", SOFT, "s"), ("corrected", BLUE, "o")):
        both = [(row["before_kt"], row["during_kt"]) for row in rows if row["group"] == group]
        if both:
            x, y = factor * np.array(both, float).T
            axes.plot(x, y, marker, color=colour, alpha=0.85, markersize=5.5, label=group)
    values = np.array([[row["before_kt"], row["during_kt"]] for row in rows], float)
    values = factor * values[np.isfinite(values)]
    if not values.size:
        blank(axes, "No single aircraft given.")
        return 0
    _equal_axes(axes, values, f"before ({units})", f"during ({units})")
    axes.legend(loc="upper left")
    return len(rows)


def _permutation(axes: Axes, permutation: Content | None, units: Units) -> str:
    axes.set_title("Permutation test over aircraft")
    factor = shown_per_kt(units)
    draws = factor * np.asarray(permutation["null_effects_kt"] if permutation else [], float)
    if permutation is None or draws.size == 0:
        blank(axes, "Too few aircraft for a permutation test.")
        return "Too few aircraft for a permutation test."
    effect = factor * permutation["effect_kt"]
    axes.hist(draws, bins=30, color=FAINT)
    axes.axvline(effect, color=VERMILION, linewidth=2.0, label=f"effect {effect:+.2f} {units}")
    axes.legend(loc="upper left")
    axes.set_xlabel(f"effect with randomly drawn groups ({units})")
    axes.set_ylabel("draws")
    return (
        f"Right: effects of randomly drawn groups ({thousands(draws.size)} draws shown); "
        f"p value of the effect {permutation['p_value']:.3g}."
    )


def field_test_section(field_test: Content | None, show: Figures) -> Section:
    """Return the section on the field test."""
    if not field_test or not field_test.get("groups"):
        return Section("field-test", "Field test")
    units, factor = show.units, shown_per_kt(show.units)

    def amount(key: str) -> str:
        interval = range_text(field_test.get(f"{key}_ci_kt"), factor=factor)
        return f"{factor * float(field_test[f'{key}_kt']):.2f} {units}{interval}"

    lead = (
        f"Reduction of the corrected aircraft beyond the controls: {amount('adjusted_reduction')}"
    )
    if field_test.get("adjusted_reduction_quadrature_kt") is not None:
        lead += f" as a linear difference, {amount('adjusted_reduction_quadrature')} in quadrature"
    if field_test.get("reference"):
        lead += f", against {field_test['reference']}"
    titles = ("before", "during", "reduction")
    columns = [Column("group", "words"), Column("aircraft")]
    columns += [Column(f"{name} ({units})") for name in titles]
    columns += [Column("reports before"), Column("reports during")]
    rows = [
        Row(
            [
                name,
                entry["aircraft"],
                *(
                    number_text(entry[f"{key}_kt"], factor=factor)
                    + range_text(entry.get(f"{key}_ci_kt"), factor=factor)
                    for key in titles
                ),
                f"{int(entry.get('reports_before', 0)):,}",
                f"{int(entry.get('reports_during', 0)):,}",
            ]
        )
        for name, entry in field_test["groups"].items()
    ]
    caption = "Mean vector disagreement; in brackets 95 % intervals."
    parts = [show("field_test", field_test_figure(field_test, units=units))]
    parts.append(table(columns, rows, caption=caption))
    checks: list[Markup] = []
    if field_test.get("by_aircraft") or field_test.get("permutation"):
        checks.append(show("field_test_checks", scrutiny_figure(field_test, units=units)))
    if lines := _field_test_lines(field_test, units):
        checks.append(listing(lines))
    if checks:
        parts.append(folded("Checks: single aircraft, permutation, choice of groups", checks))
    return Section("field-test", "Field test", f"{lead}.", parts)


def _field_test_lines(field_test: Content, units: Units) -> list[str]:
    factor, lines = shown_per_kt(units), []
    chosen = field_test.get("regression_to_the_mean")
    if chosen and (by_chance := chosen["spurious_reduction_kt"]) is not None:
        lines.append(
            "Regression to the mean: choosing as many of the worst aircraft in an earlier period "
            f"would have given {factor * by_chance:+.2f} {units} without any correction."
        )
    nearest = field_test.get("matched_controls")
    if nearest and (matched := nearest["adjusted_reduction_kt"]) is not None:
        lines.append(
            f"Matched controls: against the control most similar before the test, a corrected "
            f"aircraft improved by {factor * matched:+.2f} {units} on average."
        )
    if (predicted := field_test.get("predicted_reduction_kt")) is not None:
        interval = range_text(field_test.get("predicted_reduction_ci_kt"), factor=factor)
        lines.append(
            f"Predicted from the fits before the test: {factor * predicted:.2f} {units}{interval}."
        )
    return lines + [str(note) for note in field_test.get("notes", [])]


# --- ranking and virtual field test ----------------------------------------------------------


@styled
def ranking_figure(ranking: Sequence[Content], *, units: Units = "kt") -> Figure:
    """Draw the expected reduction of the disagreement from correcting each aircraft."""
    known = [(gain, entry) for entry in ranking if (gain := entry["expected_gain_kt"]) is not None]
    shown = known[:_MOST_ROWS]
    if not shown:
        return empty_figure("No aircraft has a usable fit")
    factor = shown_per_kt(units)
    figure = new_figure(1.1 + 0.26 * max(len(shown), 2))
    axes = figure.add_subplot()
    for row, (gain, entry) in enumerate(shown):
        interval = scaled(entry["expected_gain_ci_kt"], factor)
        axes.plot(interval, [row, row], color=BLUE, linewidth=1.6)
        axes.plot(factor * gain, row, "o", color=BLUE, markersize=5.5)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    rows_axis(axes, [entry["aircraft"] for _, entry in shown])
    axes.set_xlabel(f"expected reduction of the mean vector disagreement ({units})")
    left_out = len(ranking) - len(known)
    return figure.say(
        "Expected reduction of the disagreement from correcting each aircraft, from its fit alone, "
        f"with 95 % intervals (n = {plural(len(shown), 'aircraft', 'aircraft')}"
        + (f"; {left_out} without a usable fit" if left_out else "")
        + ")."
    )


@styled
def prediction_figure(virtual: Content, *, units: Units = "kt") -> Figure:
    """Draw predicted against realised reduction of each aircraft on reports not used in the fit."""
    figure = new_figure(3.8)
    parts = {
        "Later reports": virtual.get("later"),
        "Days held out of the fit": virtual.get("held_out"),
    }
    total = 0
    for axes, (title, part) in zip(figure.subplots(1, 2), parts.items(), strict=True):
        axes.set_title(title)
        rows = part["by_aircraft"] if part and "why" not in part else []
        total += len(rows)
        if rows:
            _predicted_and_realised(axes, rows, units)
        else:
            blank(axes, "Too few reports.")
    return figure.say(
        "Reduction predicted from the fit and reduction realised on reports that were not used in "
        "the fit, by aircraft, with 95 % intervals. On the line they are equal; orange: they "
        f"differ by more than the interval of their difference (n = {plural(total, 'point')})."
    )


def _predicted_and_realised(axes: Axes, rows: Sequence[Content], units: Units) -> None:
    factor = shown_per_kt(units)
    x, y = (
        factor * np.array([row[f"{kind}_gain_kt"] for row in rows], float)
        for kind in ("predicted", "realised")
    )
    across, along = (
        factor * np.array([row[f"{kind}_gain_ci_kt"] for row in rows], float)
        for kind in ("predicted", "realised")
    )
    axes.hlines(y, *across.T, color=FAINT, linewidth=1.4)
    axes.vlines(x, *along.T, color=FAINT, linewidth=1.4)
    apart = np.array([row["agree"] is False for row in rows])
    for chosen, color in ((~apart, BLUE), (apart, VERMILION)):
        axes.plot(x[chosen], y[chosen], "o", color=color, markersize=5.5 if len(rows) < 200 else 3)
    if len(rows) <= 12:
        for row, place in zip(rows, zip(x, y, strict=True), strict=True):
            look: dict[str, Any] = {"fontsize": 8, "color": SOFT, "textcoords": "offset points"}
            axes.annotate(row["aircraft"], place, xytext=(5, -9), **look)
    values = np.concatenate([x, y, [0.0]])
    _equal_axes(axes, values, f"predicted reduction ({units})", f"realised reduction ({units})")


def ranking_section(
    ranking: Sequence[Content] | None, virtual: Content | None, show: Figures
) -> Section:
    """Return the section on which aircraft to correct first and on how such predictions held."""
    title = "Which aircraft to correct first"
    known = [entry for entry in ranking or [] if entry["expected_gain_kt"] is not None]
    if ranking is None or not known:
        return Section("ranking", title)
    first, units = known[0], show.units

    def amount(value: float | None, interval: Sequence[float] | None) -> str:
        factor = shown_per_kt(units)
        return f"{number_text(value, factor=factor)} {units}{range_text(interval, factor=factor)}"

    gain = amount(first["expected_gain_kt"], first["expected_gain_ci_kt"])
    lead = (
        f"Largest expected reduction: {first['aircraft']}, by {gain} of "
        f"{amount(first.get('disagreement_kt'), None)}."
    )
    parts = [show("ranking", ranking_figure(ranking, units=units))]
    lines = []
    for key, words in (
        ("later", "Fitted up to {learned_until}, applied on all later days"),
        ("held_out", "Cross-validation over days ({folds} parts)"),
    ):
        part = (virtual or {}).get(key)
        if part and "why" not in part:
            gains = [part[f"{kind}_gain_kt"] for kind in ("realised", "predicted")]
            if None not in gains:
                realised = amount(gains[0], part["realised_gain_ci_kt"])
                predicted = amount(gains[1], part["predicted_gain_ci_kt"])
                aircraft = plural(len(part["by_aircraft"]), "aircraft", "aircraft")
                line = (
                    f"{words.format_map(part)}, {plural(part['reports'], 'report')} of {aircraft}: "
                    f"realised reduction {realised}, predicted {predicted}"
                )
                lines.append(f"{line}{_outside(part)}.")
    if virtual and lines:
        inner = [show("virtual_field_test", prediction_figure(virtual, units=units))]
        parts.append(listing(lines))
        parts.append(folded("Predicted and realised reduction of each aircraft", inner))
    return Section("ranking", title, lead, parts)


def _outside(part: Content) -> str:
    """Say that the realised reduction is outside the prediction's interval, and which aircraft."""
    low, high = scaled(part["predicted_gain_ci_kt"], 1.0)
    if not (part["realised_gain_kt"] < low or part["realised_gain_kt"] > high):
        return ""
    text = ". The realised reduction is outside the interval of the prediction"
    apart = [row["aircraft"] for row in part["by_aircraft"] if row["agree"] is False]
    if not apart:
        return text
    more = f" and {len(apart) - 8} more" if len(apart) > 8 else ""
    return f"{text}; the two differ by more than their errors for {', '.join(apart[:8])}{more}"


# --- comparison of references ----------------------------------------------------------------

COEFFICIENTS = ("A", "B", "C", "D", "E")
_SLICES = {
    "by_lead_time": "lead time",
    "by_phase": "phase of flight",
    "by_level": "level",
    "by_season": "season",
}


def pair_name(pair: Content) -> str:
    """Return ``ruc - rtfdaa`` for a pair, in the order of the difference."""
    return " - ".join(str(name) for name in pair["references"])


def verdict_word(pair: Content) -> str:
    """Return whether the references of a pair can be pooled."""
    if pair.get("poolable") is None:
        return "undecided"
    return "poolable" if pair["poolable"] else "not poolable"


@styled
def pair_differences_figure(pairs: Sequence[Content]) -> Figure:
    """Draw the fleet's common difference of each coefficient for every pair of references.

    Parameters
    ----------
    pairs : sequence of mappings
        ``pairs`` of ``sensitivity.json`` or a slice of it: ``references``, ``fleet`` with
        ``difference`` and ``standard_error`` (degree), ``poolable``.

    Returns
    -------
    Figure
    """
    shown = [pair for pair in pairs if pair["fleet"].get("difference")]
    if not shown:
        return empty_figure("No pair of references has enough reports to compare")
    figure = new_figure(1.2 + 0.55 * len(shown))
    axes = figure.add_subplot()
    for index, name in enumerate(COEFFICIENTS):
        value = np.array([pair["fleet"]["difference"][name] for pair in shown], float)
        half = NORMAL_95 * np.array([pair["fleet"]["standard_error"][name] for pair in shown])
        y = np.arange(len(shown)) + 0.14 * (index - 2)
        colour, marker = series_style(index)
        axes.hlines(y, value - half, value + half, color=colour, linewidth=1.3)
        axes.plot(value, y, marker, color=colour, markersize=5, label=name)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_xlabel("difference of the coefficient (degree)")
    slices = [f"{pair['slice']}: " if pair.get("slice") else "" for pair in shown]
    rows_axis(
        axes, [f"{s}{pair_name(p)}\n{verdict_word(p)}" for s, p in zip(slices, shown, strict=True)]
    )
    for label, pair in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_color({None: SOFT, True: BLUE, False: VERMILION}[pair.get("poolable")])
    figure.legend(loc="outside upper right", ncols=len(COEFFICIENTS))
    reports = max(int(pair.get("reports", 0)) for pair in shown)
    aircraft = max(int(pair["fleet"].get("aircraft", 0)) for pair in shown)
    return figure.say(
        "Common difference of the fleet's deviation coefficients between two references fitted to "
        f"the same reports, 95 % intervals (n = {plural(reports, 'report')}, "
        f"{plural(aircraft, 'aircraft', 'aircraft')})."
    )


@styled
def aircraft_differences_figure(pair: Content) -> Figure:
    """Draw the difference of offset and amplitude of each aircraft between two references."""
    known = [entry for entry in pair.get("aircraft", []) if entry.get("amplitude")]
    rows = sorted(known, key=lambda entry: -abs(entry["amplitude"]["difference"] or 0.0))
    rows = rows[:_MOST_ROWS]
    if not rows:
        return empty_figure("No aircraft has enough reports against both references")
    figure = new_figure(1.2 + max(0.2 * len(rows), 0.8))
    panels = figure.subplots(1, 2, sharey=True)
    _differences(panels[0], "Amplitude", [entry["amplitude"] for entry in rows])
    _differences(panels[1], "Offset", [entry["offset"] for entry in rows])
    rows_axis(panels[0], [str(entry["aircraft"]) for entry in rows])
    more = f" of {len(known)}, those with the largest" if len(known) > len(rows) else ""
    return figure.say(
        f"{pair_name(pair)}: difference of each aircraft's amplitude and offset with 95 % "
        "intervals that account for the shared reports (n = "
        f"{plural(len(rows), 'aircraft', 'aircraft')}{more}). Orange: the interval excludes zero."
    )


def _differences(axes: Axes, title: str, rows: Sequence[Content]) -> None:
    value = np.array([entry["difference"] for entry in rows], float)
    low, high = np.array([scaled(entry["ci"], 1.0) for entry in rows]).T
    includes_zero = ~((low > 0) | (high < 0))
    colours = np.where(includes_zero, SOFT, VERMILION).tolist()
    y = np.arange(len(rows))
    axes.hlines(y, low, high, colors=colours, linewidth=1.3)
    axes.scatter(value, y, s=16, c=colours, zorder=2)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    axes.set_title(title)
    axes.set_xlabel("difference (degree)")
    ends = np.concatenate([low, high])
    if np.isfinite(ends).any():
        reach = 1.1 * float(np.nanpercentile(np.abs(ends), 97)) or 1.0
        axes.set_xlim(-reach, reach)


def sensitivity_section(sensitivity: Content | None, show: Figures) -> Section:
    """Return the section on the comparison of references."""
    title = "Comparison of references"
    pairs = sensitivity.get("pairs") if sensitivity else None
    if not sensitivity or not pairs:
        return Section("sensitivity", title)
    apart = [pair for pair in pairs if pair.get("poolable") is False]
    if all(pair.get("poolable") for pair in pairs):
        lead = "No two references differ significantly by a size that matters: they can be pooled."
    elif apart:
        named = "; ".join(f"{pair_name(pair)} ({_why(pair)})" for pair in apart[:2])
        more = f", and {len(apart) - 2} more pairs" if len(apart) > 2 else ""
        lead = f"Not poolable: {named}{more}."
    else:
        lead = "Some pairs of references have too few reports to decide."
    parts = [show("references", pair_differences_figure(pairs))]
    details = [_pair_table(pairs, "Every pair.", show.units)]
    for pair in pairs:
        # A pool against its member repeats the difference of the members, reduced.
        if pair.get("aircraft") and pair.get("own_test", True):
            name = f"references_{'_'.join(pair['references'])}"
            details.append(show(name, aircraft_differences_figure(pair)))
    for key, words in _SLICES.items():
        if slices := sensitivity.get(key):
            details.append(_pair_table(slices, f"By {words}.", show.units))
    details += _three_way(sensitivity.get("three_way") or [], show.units)
    parts.append(folded("Tables, single aircraft, and slices of the reports", details))
    return Section("sensitivity", title, lead, parts)


def _pair_table(pairs: Sequence[Content], caption: str, units: Units) -> Markup:
    sliced = any(pair.get("slice") for pair in pairs)
    columns = [Column("slice", "words")] if sliced else []
    columns += [
        Column("pair", "words"),
        Column("verdict", "words"),
        Column("why", "long"),
        Column("difference of the curves (degree rms)"),
        Column("p value"),
        Column(f"difference of the winds ({units})"),
        Column("reports"),
    ]
    rows = []
    for pair in pairs:
        p_value = pair["fleet"].get("p_value") if pair.get("own_test", True) else None
        known = p_value is not None and p_value == p_value
        cells = [
            pair_name(pair),
            verdict_word(pair),
            _why(pair),
            number_text(pair["fleet"].get("curve_rms_deg")),
            f"{p_value:.2g}" if known else "-",
            number_text(pair.get("mean_vector_difference_m_s"), factor=shown_per_m_s(units)),
            f"{int(pair.get('reports', 0)):,}",
        ]
        first = [pair.get("slice", "")] if sliced else []
        rows.append(Row([*first, *cells], doubt=pair.get("poolable") is None))
    return table(columns, rows, caption=caption)


def _why(pair: Content) -> str:
    if not pair.get("own_test", True) and pair.get("poolable"):
        return "a pool and one of its members: part of the difference of the members"
    return str(pair.get("why", "")).replace(" +- ", " ± ")


def _three_way(found: Sequence[Content], units: Units) -> list[Markup]:
    factor = shown_per_m_s(units)
    rows = [
        Row(
            [
                ", ".join(entry["references"]),
                corner["reference"],
                "negative variance"
                if (rms := corner.get("component_rms")) is None
                else number_text(rms, factor=factor),
                f"{int(entry['reports']):,}",
            ]
        )
        for entry in found
        for corner in entry.get("errors", [])
    ]
    if not rows:
        return []
    columns = [
        Column("three references", "words"),
        Column("reference", "words"),
        Column(f"error of a component ({units} rms)"),
        Column("reports"),
    ]
    note = (
        "Three-cornered hat. It assumes independent errors of the three references; references "
        "that assimilate the same reports get too small an error."
    )
    return [heading("Error of each reference"), table(columns, rows, caption=note)]


# --- observation errors ----------------------------------------------------------------------

_PHASES = ("ascent", "cruise", "descent")
_STATES = (("reported", ORANGE, "o"), ("corrected", BLUE, "D"))


_METHODS = {"separation": "separation by neighbours", "three_cornered_hat": "three-cornered hat"}
_USED_ELSEWHERE = {
    "wrfda_tamdar_error": ("WRFDA, TAMDAR", "-"),
    "wrfda_airep_error": ("WRFDA, AIREP", "--"),
    "nam_tamdar_error": ("NAM, TAMDAR", "-."),
    "nam_mdcrs_error": ("NAM, MDCRS", ":"),
}


@styled
def report_errors_figure(errors: xr.Dataset, *, units: Units = "kt") -> Figure:
    """Draw the observation error by layer for each phase of flight, with errors used elsewhere."""
    known = {
        phase: int(errors["observation_error"].sel(flight_phase=phase).notnull().any("state").sum())
        for phase in _PHASES
    }
    phases = [phase for phase, cells in known.items() if cells]
    if not phases:
        return empty_figure("Too few reports near each other to separate the observation error")
    factor = shown_per_m_s(units)
    figure = new_figure(4.2)
    panels = figure.subplots(1, len(phases), sharey=True, sharex=True, squeeze=False)[0]
    level = (errors["layer_bottom_pressure"] + errors["layer_top_pressure"]).to_numpy() / 200.0
    for axes, phase in zip(panels, phases, strict=True):
        for name, (label, line) in _USED_ELSEWHERE.items():
            value = factor * errors[name].to_numpy()
            axes.plot(value, level, color=SOFT, linewidth=1.0, linestyle=line, label=label)
        for index, (state, colour, marker) in enumerate(_STATES):
            cells = errors.sel(flight_phase=phase, state=state)
            value = factor * cells["observation_error"].to_numpy()
            low, high = factor * cells["observation_error_interval"].to_numpy().T
            shown = np.isfinite(value)
            reach = np.nan_to_num(np.array([value - low, high - value])[:, shown]).clip(0.0)
            axes.errorbar(
                value[shown],
                level[shown] + 8.0 * (index - 0.5),
                xerr=reach,
                color=colour,
                marker=marker,
                markersize=5,
                linewidth=1.4,
                label=f"as {state}",
            )
        axes.set_title(phase)
        axes.set_xlabel(f"error of a component ({units})")
    panels[0].set_ylim(1000, 200)
    panels[0].set_xlim(left=0.0)
    panels[0].set_ylabel("pressure (hPa)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    number = int(errors["observation_count"].sel(flight_phase="all").sum())
    missing = " and ".join(phase for phase in _PHASES if phase not in phases)
    few = f" Too few reports near each other in {missing}." if missing else ""
    return figure.say(
        "Standard error of a wind component of the reports, without the error of the reference, by "
        "phase of flight and layer, with 95 % intervals; grey: errors used in assimilation systems "
        f"(n = {plural(number, 'report')}, {plural(sum(known.values()), 'cell')} known).{few}"
    )


def report_errors_section(errors: xr.Dataset | None, show: Figures) -> Section:
    """Return the section on the observation error of the reports alone."""
    title = "Observation error of the reports"
    if errors is None:
        return Section("report-errors", title)
    why = str(errors.attrs.get("method_reason", "")).replace("m2/s2", "m²/s²")
    method = str(errors.attrs.get("method", ""))
    if not method:
        return Section("report-errors", title, "It could not be determined.", [listing([why])])
    factor, units = shown_per_m_s(show.units), show.units
    lines = [f"Method: {_METHODS.get(method, method)} ({why})."]
    by_aircraft = factor * errors["aircraft_observation_error"].transpose("state", ...).to_numpy()
    gain = by_aircraft[0] - by_aircraft[1]
    if np.isfinite(gain).any():
        best = int(np.nanargmax(gain))
        name = str(errors["aircraft"].to_numpy()[best])
        before, after = by_aircraft[:, best]
        lines.append(
            f"Largest improvement: {name}, {before:.2f} {units} as reported, {after:.2f} corrected."
        )
    parts = [
        show("observation_errors", report_errors_figure(errors, units=units)),
        folded("Both methods", [_methods_table(errors, units), listing(lines)]),
    ]
    return Section("report-errors", title, worth_sentence(errors, units=units), parts)


def worth_sentence(errors: xr.Dataset, *, units: Units = "kt") -> str:
    """Return a sentence on the observation error and on the weight of a corrected report."""
    value = shown_per_m_s(units) * errors["fleet_observation_error"]
    before, after = (float(value.sel(state=state)) for state in ("reported", "corrected"))
    text = (
        f"Standard error of a wind component, without the error of the reference: {before:.2f} "
        f"{units} as reported, {after:.2f} {units} corrected"
    )
    gain = float(errors["fleet_weight_gain"])
    if not np.isfinite(gain):
        return f"{text}."
    digits = 0 if gain >= 10 else 1
    interval = range_text(errors["fleet_weight_gain_interval"].to_numpy().tolist(), digits=digits)
    return (
        f"{text}. In an analysis a corrected report has the weight of {gain:.{digits}f} "
        f"uncorrected reports{interval}."
    )


def _methods_table(errors: xr.Dataset, units: Units) -> Markup:
    factor, rows = shown_per_m_s(units), []
    for method, words in _METHODS.items():
        chosen = errors.sel(way=method)
        cells = []
        for state in ("reported", "corrected"):
            value = chosen["fleet_observation_error_by_method"].sel(state=state)
            ends = chosen["fleet_observation_error_by_method_interval"].sel(state=state)
            text = number_text(value, factor=factor)
            cells.append(text + range_text(ends.to_numpy().tolist(), factor=factor))
        rows.append(Row([words, *cells], doubt=method != errors.attrs.get("method")))
    columns = [Column("method", "words")]
    columns += [Column(f"{state} ({units})") for state in ("reported", "corrected")]
    caption = (
        "Error of a component over all reports, with 95 % intervals. The three-cornered hat counts "
        "the common error of the references as error of the reports. Grey italics: not used."
    )
    return table(columns, rows, caption=caption)
