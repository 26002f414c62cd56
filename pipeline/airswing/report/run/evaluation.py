"""Field test, ranking, comparison of references and observation errors: figures and sections.

Contents as in ``field_test.json``, ``virtual_field_test.json`` and ``sensitivity.json``
(docs/formats.md), and ``observation_errors.nc``. Without its product a section is empty and the
page omits it. Intervals are 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.evaluation import Content
from airswing.physics.compass_deviation import COEFFICIENTS
from airswing.report.html import style
from airswing.report.html.document import Column, Figures, Section, folded, heading, listing, table
from airswing.report.html.style import BLUE, FAINT, SOFT, VERMILION, intervals, rows_axis, zero_line
from airswing.report.html.text import (
    Units,
    amount,
    cut,
    number_text,
    plural,
    range_text,
    scaled,
    shown_per_kt,
    shown_per_m_s,
)
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Rows of a figure; the products contain all aircraft.
_MOST_ROWS = 40


# --- field test ------------------------------------------------------------------------------


@style.drawing()
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
    figure = style.new_figure(1.5 + 0.5 * len(groups))
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    series = (("before", style.ORANGE, "o", -0.14), ("during", BLUE, "D", 0.14))
    for name, colour, marker, shift in series:
        values = [factor * float(entry[f"{name}_kt"]) for entry in groups.values()]
        left.plot(values, range(len(groups)), marker, color=colour, markersize=7, label=name)
        for row, (value, entry) in enumerate(zip(values, groups.values(), strict=True)):
            ends = scaled(entry.get(f"{name}_ci_kt"), factor)
            left.plot(ends, [row + shift] * 2, color=colour, linewidth=1.3)
            side = 1 if (entry["before_kt"] > entry["during_kt"]) == (name == "before") else -1
            look = {"va": "center", "ha": "left" if side > 0 else "right", "fontsize": 9}
            style.annotate(left, f"{value:.2f}", (value, row), (9 * side, 0), **look)
    names = [f"{name}\n{entry['aircraft']} aircraft" for name, entry in groups.items()]
    rows_axis(left, names, f"mean vector disagreement ({units})")
    left.margins(x=0.16)
    entries: list[tuple[str, float, Any, str]] = [
        (f"{name}: reduction", entry["reduction_kt"], entry.get("reduction_ci_kt"), SOFT)
        for name, entry in groups.items()
    ]
    for key, label in (("", "linear"), ("_quadrature", "quadrature")):
        if (change := field_test.get(f"adjusted_reduction{key}_kt")) is not None:
            interval = field_test.get(f"adjusted_reduction{key}_ci_kt")
            entries.append((f"adjusted, {label}", change, interval, BLUE))
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
    for row, (_, value, interval, colour) in enumerate(entries):
        intervals(right, factor * value, scaled(interval, factor), row, color=colour, markersize=6)
        label, place = f"{factor * value:+.2f}", (factor * value, row)
        style.annotate(right, label, place, (0, 6), ha="center", fontsize=8.5, bbox=box)
    zero_line(right)
    rows_axis(right, [entry[0] for entry in entries], f"reduction ({units})")
    right.margins(x=0.14)
    figure.legend(loc="outside upper left", ncols=2)
    both = ("reports_before", "reports_during")
    number = sum(int(entry.get(name, 0)) for entry in groups.values() for name in both)
    return figure.say(
        "Field test: mean length of the difference between reported and reference wind of each "
        "group before and during the test, and the reduction of the corrected aircraft beyond "
        f"that of the controls; lines are 95 % intervals (n = {plural(number, 'report')})."
    )


def scrutiny_figure(field_test: Content, units: Units) -> Figure:
    """Draw each aircraft before against during, and the effect among permuted groups."""
    figure = style.new_figure(3.7)
    left, right = figure.subplots(1, 2)
    number = _each_aircraft(left, field_test.get("by_aircraft", []), units)
    words = _permutation(right, field_test.get("permutation"), units)
    return figure.say(
        f"Left: mean disagreement of each aircraft before and during the test (n = "
        f"{plural(number, 'aircraft')}); below the line it fell. {words}"
    )


def _equal_axes(axes: Axes, values: Floats, x_label: str, y_label: str) -> None:
    """Give both axes one range that holds the values, and draw the line of equality."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.1 * (high - low) + 0.2
    ends = low - margin, high + margin
    axes.plot(ends, ends, color=FAINT, zorder=1)
    axes.set(xlim=ends, ylim=ends, aspect="equal", xlabel=x_label, ylabel=y_label)


def _each_aircraft(axes: Axes, rows: Sequence[Content], units: Units) -> int:
    axes.set_title("Each aircraft")
    table = pd.DataFrame(rows, columns=["group", "before_kt", "during_kt"])
    values = shown_per_kt(units) * table[["before_kt", "during_kt"]].to_numpy(float)
    if not np.isfinite(values).any():
        style.blank(axes, "No single aircraft given.")
        return 0
    for name, colour, marker in (("controls", SOFT, "s"), ("corrected", BLUE, "o")):
        x, y = values[table["group"] == name].T
        axes.plot(x, y, marker, color=colour, alpha=0.85, markersize=5.5, label=name)
    _equal_axes(axes, values, f"before ({units})", f"during ({units})")
    axes.legend(loc="upper left")
    return len(rows)


def _permutation(axes: Axes, permutation: Content | None, units: Units) -> str:
    axes.set_title("Permutation test over aircraft")
    factor = shown_per_kt(units)
    draws = factor * np.asarray(permutation["null_effects_kt"] if permutation else [], float)
    if permutation is None or draws.size == 0:
        style.blank(axes, "Too few aircraft for a permutation test.")
        return "Too few aircraft for a permutation test."
    effect = factor * permutation["effect_kt"]
    axes.hist(draws, bins=30, color=FAINT)
    axes.axvline(effect, color=VERMILION, linewidth=2.0, label=f"effect {effect:+.2f} {units}")
    axes.legend(loc="upper left")
    axes.set(xlabel=f"effect with randomly drawn groups ({units})", ylabel="draws")
    return (
        f"Right: effects of randomly drawn groups ({draws.size:,} draws shown); "
        f"p value of the effect {permutation['p_value']:.3g}."
    )


def field_test_section(field_test: Content | None, show: Figures) -> Section:
    """Return the section on the field test."""
    if not field_test or not field_test.get("groups"):
        return Section("field-test", "Field test")
    units, factor = show.units, shown_per_kt(show.units)

    def reduction(entry: Content, key: str, unit: str = units) -> str:
        return amount(entry[f"{key}_kt"], entry.get(f"{key}_ci_kt"), factor=factor, unit=unit)

    gain = reduction(field_test, "adjusted_reduction")
    lead = f"Reduction of the corrected aircraft beyond the controls: {gain}"
    if field_test.get("adjusted_reduction_quadrature_kt") is not None:
        quadrature = reduction(field_test, "adjusted_reduction_quadrature")
        lead += f" as a linear difference, {quadrature} in quadrature"
    if field_test.get("reference"):
        lead += f", against {field_test['reference']}"
    groups = field_test["groups"].values()
    columns = [
        Column("group", field_test["groups"], "words"),
        Column("aircraft", [entry["aircraft"] for entry in groups]),
        *(
            Column(f"{key} ({units})", [reduction(entry, key, "") for entry in groups])
            for key in ("before", "during", "reduction")
        ),
        *(
            Column(f"reports {when}", [f"{int(one.get(f'reports_{when}', 0)):,}" for one in groups])
            for when in ("before", "during")
        ),
    ]
    caption = "Mean vector disagreement; in brackets 95 % intervals."
    parts = [show("field_test", field_test_figure(field_test, units=units))]
    parts.append(table(columns, caption=caption))
    checks: list[Markup] = []
    if field_test.get("by_aircraft") or field_test.get("permutation"):
        checks.append(show("field_test_checks", scrutiny_figure(field_test, units)))
    lines = []
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
    if field_test.get("predicted_reduction_kt") is not None:
        predicted = reduction(field_test, "predicted_reduction")
        lines.append(f"Predicted from the fits before the test: {predicted}.")
    if lines := lines + [str(note) for note in field_test.get("notes", [])]:
        checks.append(listing(lines))
    if checks:
        parts.append(folded("Checks: single aircraft, permutation, choice of groups", checks))
    return Section("field-test", "Field test", f"{lead}.", parts)


# --- ranking and virtual field test ----------------------------------------------------------


def ranking_figure(known: Sequence[Content], left_out: int, units: Units) -> Figure:
    """Draw the expected reduction of the disagreement from correcting each aircraft."""
    shown, factor = known[:_MOST_ROWS], shown_per_kt(units)
    figure = style.new_figure(1.1 + 0.26 * max(len(shown), 2))
    axes = figure.add_subplot()
    gain = factor * np.array([entry["expected_gain_kt"] for entry in shown])
    ends = np.transpose([scaled(entry["expected_gain_ci_kt"], factor) for entry in shown])
    intervals(axes, gain, ends, np.arange(len(shown)), color=BLUE, markersize=5.5)
    zero_line(axes)
    label = f"expected reduction of the mean vector disagreement ({units})"
    rows_axis(axes, [entry["aircraft"] for entry in shown], label)
    others = f"; {left_out} without a usable fit" if left_out else ""
    return figure.say(
        "Expected reduction of the disagreement from correcting each aircraft, from its fit alone, "
        f"with 95 % intervals (n = {plural(len(shown), 'aircraft')}{others})."
    )


def prediction_figure(virtual: Content, units: Units) -> Figure:
    """Draw predicted against realised reduction of each aircraft on reports not used in the fit."""
    figure = style.new_figure(3.8)
    titles = {"later": "Later reports", "held_out": "Days held out of the fit"}
    total = 0
    for axes, (key, title) in zip(figure.subplots(1, 2), titles.items(), strict=True):
        axes.set_title(title)
        rows = (virtual.get(key) or {}).get("by_aircraft") or []
        total += len(rows)
        if rows:
            _predicted_and_realised(axes, rows, units)
        else:
            style.blank(axes, "Too few reports.")
    return figure.say(
        "Reduction predicted from the fit and reduction realised on reports that were not used in "
        "the fit, by aircraft, with 95 % intervals. On the line they are equal; orange: they "
        f"differ by more than the interval of their difference (n = {plural(total, 'point')})."
    )


def _predicted_and_realised(axes: Axes, rows: Sequence[Content], units: Units) -> None:
    kinds, factor = ("predicted", "realised"), shown_per_kt(units)
    place = factor * np.array([[row[f"{kind}_gain_kt"] for kind in kinds] for row in rows], float)
    ends = factor * np.array([[row[f"{kind}_gain_ci_kt"] for kind in kinds] for row in rows], float)
    x, y = place.T
    axes.hlines(y, *ends[:, 0].T, color=FAINT, linewidth=1.4)
    axes.vlines(x, *ends[:, 1].T, color=FAINT, linewidth=1.4)
    colours = [VERMILION if row["agree"] is False else BLUE for row in rows]
    axes.scatter(x, y, s=30 if len(rows) < 200 else 9, c=colours, zorder=2)
    for row, one in zip(rows, place, strict=True) if len(rows) <= 12 else ():
        style.annotate(axes, row["aircraft"], tuple(one), (5, -9), fontsize=8, color=SOFT)
    values = np.append(place, 0.0)
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
    shown = partial(amount, factor=shown_per_kt(units), unit=units)
    gain = shown(first["expected_gain_kt"], first["expected_gain_ci_kt"])
    level = shown(first.get("disagreement_kt"))
    lead = f"Largest expected reduction: {first['aircraft']}, by {gain} of {level}."
    figure = ranking_figure(known, len(ranking) - len(known), units)
    parts, lines = [show("ranking", figure)], []
    for key, words in (
        ("later", "Fitted up to {learned_until}, applied on all later days"),
        ("held_out", "Cross-validation over days ({folds} parts)"),
    ):
        part = (virtual or {}).get(key) or {"why": "not computed"}
        if "why" in part or None in (part["realised_gain_kt"], part["predicted_gain_kt"]):
            continue
        realised, predicted = (
            shown(part[f"{kind}_gain_kt"], part[f"{kind}_gain_ci_kt"])
            for kind in ("realised", "predicted")
        )
        aircraft = plural(len(part["by_aircraft"]), "aircraft")
        lines.append(
            f"{words.format_map(part)}, {plural(part['reports'], 'report')} of {aircraft}: "
            f"realised reduction {realised}, predicted {predicted}{_outside(part)}."
        )
    if virtual and lines:
        inner = [show("virtual_field_test", prediction_figure(virtual, units))]
        parts.append(listing(lines))
        parts.append(folded("Predicted and realised reduction of each aircraft", inner))
    return Section("ranking", title, lead, parts)


def _outside(part: Content) -> str:
    """Say that the realised reduction is outside the prediction's interval, and which aircraft."""
    low, high = scaled(part["predicted_gain_ci_kt"], 1.0)
    if not (part["realised_gain_kt"] < low or part["realised_gain_kt"] > high):
        return ""
    apart = [row["aircraft"] for row in part["by_aircraft"] if row["agree"] is False]
    whom = f"; the two differ by more than their errors for {cut(apart, 8)}" if apart else ""
    return f". The realised reduction is outside the interval of the prediction{whom}"


# --- comparison of references ----------------------------------------------------------------

_SLICES = {
    "by_lead_time": "lead time",
    "by_phase": "phase of flight",
    "by_level": "level",
    "by_season": "season",
}
_VERDICTS = {None: "undecided", True: "poolable", False: "not poolable"}


def _pair_name(pair: Content) -> str:
    """Return ``ruc - rtfdaa`` for a pair, in the order of the difference."""
    return " - ".join(str(name) for name in pair["references"])


@style.drawing()
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
        return style.empty_figure("No pair of references has enough reports to compare")
    figure = style.new_figure(1.2 + 0.55 * len(shown))
    axes = figure.add_subplot()
    for index, name in enumerate(COEFFICIENTS):
        value = np.array([pair["fleet"]["difference"][name] for pair in shown], float)
        half = NORMAL_95 * np.array([pair["fleet"]["standard_error"][name] for pair in shown])
        colour, marker = style.series_style(index)
        y = np.arange(len(shown)) + 0.14 * (index - 2)
        look = {"color": colour, "marker": marker, "label": name}
        intervals(axes, value, (value - half, value + half), y, **look)
    zero_line(axes)
    slices = [f"{pair['slice']}: " if pair.get("slice") else "" for pair in shown]
    names = [f"{_pair_name(pair)}\n{_VERDICTS[pair.get('poolable')]}" for pair in shown]
    names = [part + name for part, name in zip(slices, names, strict=True)]
    rows_axis(axes, names, "difference of the coefficient (degree)")
    for label, pair in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_color({None: SOFT, True: BLUE, False: VERMILION}[pair.get("poolable")])
    figure.legend(loc="outside upper right", ncols=len(COEFFICIENTS))
    reports = max(int(pair.get("reports", 0)) for pair in shown)
    aircraft = max(int(pair["fleet"].get("aircraft", 0)) for pair in shown)
    return figure.say(
        "Common difference of the fleet's deviation coefficients between two references fitted to "
        f"the same reports, 95 % intervals (n = {plural(reports, 'report')}, "
        f"{plural(aircraft, 'aircraft')})."
    )


def aircraft_differences_figure(pair: Content) -> Figure:
    """Draw the difference of offset and amplitude of each aircraft between two references."""
    known = [entry for entry in pair.get("aircraft", []) if entry.get("amplitude")]
    rows = sorted(known, key=lambda entry: -abs(entry["amplitude"]["difference"] or 0.0))
    rows = rows[:_MOST_ROWS]
    if not rows:
        return style.empty_figure("No aircraft has enough reports against both references")
    figure = style.new_figure(1.2 + max(0.2 * len(rows), 0.8))
    panels = figure.subplots(1, 2, sharey=True)
    for axes, name in zip(panels, ("amplitude", "offset"), strict=True):
        value = np.array([entry[name]["difference"] for entry in rows], float)
        ends = np.transpose([scaled(entry[name]["ci"], 1.0) for entry in rows])
        excludes_zero = (ends[0] > 0) | (ends[1] < 0)
        colours, y = np.where(excludes_zero, VERMILION, SOFT), np.arange(len(rows))
        axes.hlines(y, *ends, colors=colours, linewidth=1.3)
        axes.scatter(value, y, s=16, c=colours, zorder=2)
        zero_line(axes)
        axes.set(title=name.capitalize(), xlabel="difference (degree)")
        if np.isfinite(ends).any():
            reach = 1.1 * float(np.nanpercentile(np.abs(ends), 97)) or 1.0
            axes.set_xlim(-reach, reach)
    rows_axis(panels[0], [str(entry["aircraft"]) for entry in rows])
    more = f" of {len(known)}, those with the largest" if len(known) > len(rows) else ""
    return figure.say(
        f"{_pair_name(pair)}: difference of each aircraft's amplitude and offset with 95 % "
        "intervals that account for the shared reports (n = "
        f"{plural(len(rows), 'aircraft')}{more}). Orange: the interval excludes zero."
    )


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
        named = "; ".join(f"{_pair_name(pair)} ({_why(pair)})" for pair in apart[:2])
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
    factor, fleets = shown_per_m_s(units), [pair["fleet"] for pair in pairs]
    winds = (pair.get("mean_vector_difference_m_s") for pair in pairs)
    apart = [number_text(x, factor=factor) for x in winds]
    curves = [number_text(fleet.get("curve_rms_deg")) for fleet in fleets]

    def p_text(pair: Content) -> str:
        p_value = pair["fleet"].get("p_value") if pair.get("own_test", True) else None
        return f"{p_value:.2g}" if p_value is not None and p_value == p_value else "-"

    columns = [
        Column("slice", [pair.get("slice", "") for pair in pairs], "words"),
        Column("pair", map(_pair_name, pairs), "words"),
        Column("verdict", [_VERDICTS[pair.get("poolable")] for pair in pairs], "words"),
        Column("why", map(_why, pairs), "long"),
        Column("difference of the curves (degree rms)", curves),
        Column("p value", map(p_text, pairs)),
        Column(f"difference of the winds ({units})", apart),
        Column("reports", [f"{int(pair.get('reports', 0)):,}" for pair in pairs]),
    ]
    sliced = any(pair.get("slice") for pair in pairs)
    doubt = [pair.get("poolable") is None for pair in pairs]
    return table(columns if sliced else columns[1:], caption=caption, doubt=doubt)


def _why(pair: Content) -> str:
    if not pair.get("own_test", True) and pair.get("poolable"):
        return "a pool and one of its members: part of the difference of the members"
    return str(pair.get("why", "")).replace(" +- ", " ± ")


def _three_way(found: Sequence[Content], units: Units) -> list[Markup]:
    rows = [(entry, corner) for entry in found for corner in entry.get("errors", [])]
    if not rows:
        return []

    def error(rms: float | None) -> str:
        return "negative variance" if rms is None else number_text(rms, factor=shown_per_m_s(units))

    columns = [
        Column("three references", [", ".join(one["references"]) for one, _ in rows], "words"),
        Column("reference", [corner["reference"] for _, corner in rows], "words"),
        Column(
            f"error of a component ({units} rms)",
            [error(corner.get("component_rms")) for _, corner in rows],
        ),
        Column("reports", [f"{int(entry['reports']):,}" for entry, _ in rows]),
    ]
    note = (
        "Three-cornered hat. It assumes independent errors of the three references; references "
        "that assimilate the same reports get too small an error."
    )
    return [heading("Error of each reference"), table(columns, caption=note)]


# --- observation errors ----------------------------------------------------------------------

_PHASES = ("ascent", "cruise", "descent")
_METHODS = {"separation": "separation by neighbours", "three_cornered_hat": "three-cornered hat"}
_USED_ELSEWHERE = {
    "wrfda_tamdar_error": ("WRFDA, TAMDAR", "-"),
    "wrfda_airep_error": ("WRFDA, AIREP", "--"),
    "nam_tamdar_error": ("NAM, TAMDAR", "-."),
    "nam_mdcrs_error": ("NAM, MDCRS", ":"),
}


def report_errors_figure(errors: xr.Dataset, units: Units) -> Figure:
    """Draw the observation error by layer for each phase of flight, with errors used elsewhere."""
    known = {
        phase: int(errors["observation_error"].sel(flight_phase=phase).notnull().any("state").sum())
        for phase in _PHASES
    }
    phases = [phase for phase, cells in known.items() if cells]
    if not phases:
        message = "Too few reports near each other to separate the observation error"
        return style.empty_figure(message)
    factor = shown_per_m_s(units)
    figure = style.new_figure(4.2)
    panels = figure.subplots(1, len(phases), sharey=True, sharex=True, squeeze=False)[0]
    level = (errors["layer_bottom_pressure"] + errors["layer_top_pressure"]).to_numpy() / 200.0
    for axes, phase in zip(panels, phases, strict=True):
        for name, (label, line) in _USED_ELSEWHERE.items():
            look: dict[str, Any] = {"color": SOFT, "linewidth": 1.0, "linestyle": line}
            axes.plot(factor * errors[name].to_numpy(), level, label=label, **look)
        for index, (state, colour, marker) in enumerate(style.STATES):
            cells = errors.sel(flight_phase=phase, state=state)
            value = factor * cells["observation_error"].to_numpy()
            ends = factor * cells["observation_error_interval"].to_numpy().T
            shown = np.isfinite(value)
            ends = np.where(np.isnan(ends), value, ends)[:, shown]
            look = {"color": colour, "marker": marker, "linestyle": "-", "linewidth": 1.4}
            y = level[shown] + 8.0 * (index - 0.5)
            intervals(axes, value[shown], ends, y, label=f"as {state}", **look)
        axes.set(title=phase, xlabel=f"error of a component ({units})")
    panels[0].set_xlim(left=0.0)
    panels[0].set(ylim=(1000, 200), ylabel="pressure (hPa)")
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
        show("observation_errors", report_errors_figure(errors, units)),
        folded("Both methods", [_methods_table(errors, units), listing(lines)]),
    ]
    return Section("report-errors", title, worth_sentence(errors, units=units), parts)


def worth_sentence(errors: xr.Dataset, *, units: Units = "kt") -> str:
    """Return a sentence on the observation error and on the weight of a corrected report."""
    value = shown_per_m_s(units) * errors["fleet_observation_error"]
    before, after = (float(value.sel(state=state)) for state, *_ in style.STATES)
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
    factor = shown_per_m_s(units)
    columns = [Column("method", _METHODS.values(), "words")]
    for state, *_ in style.STATES:
        cells = []
        for method in _METHODS:
            chosen = errors.sel(way=method, state=state)
            ends = chosen["fleet_observation_error_by_method_interval"].to_numpy().tolist()
            value = chosen["fleet_observation_error_by_method"]
            cells.append(amount(value, ends, factor=factor))
        columns.append(Column(f"{state} ({units})", cells))
    caption = (
        "Error of a component over all reports, with 95 % intervals. The three-cornered hat counts "
        "the common error of the references as error of the reports. Grey italics: not used."
    )
    doubt = [method != errors.attrs.get("method") for method in _METHODS]
    return table(columns, caption=caption, doubt=doubt)
