"""Field test, ranking, comparison of references and observation errors: figures and sections.

Contents as in ``field_test.json``, ``virtual_field_test.json`` and ``sensitivity.json``
(docs/formats.md), and ``observation_errors.nc``. Intervals are 95 %.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from airswing.evaluation import Content
from airswing.physics.compass_deviation import COEFFICIENTS
from airswing.report import html
from airswing.report.html import BLUE, FAINT, SOFT, VERMILION, Look, plural
from airswing.units import KNOT, NORMAL_95

Floats = NDArray[np.float64]
# Rows of a figure; the products contain all aircraft.
_MOST_ROWS = 40
# Checks of a field test: part of its content, key of a reduction (kt), sentence.
_CHECKS = (
    (
        "regression_to_the_mean",
        "spurious_reduction_kt",
        "Regression to the mean: choosing as many of the worst aircraft in an earlier period "
        "would have given {} without any correction.",
    ),
    (
        "matched_controls",
        "adjusted_reduction_kt",
        "Matched controls: against the control most similar before the test, a corrected "
        "aircraft improved by {} on average.",
    ),
)
# Words on a part of ``virtual_field_test.json``: title of its panel, and how it was fitted.
_HELD_OUT = {
    "later": ("Later reports", "Fitted up to {learned_until}, applied on all later days"),
    "held_out": ("Days held out of the fit", "Cross-validation over days ({folds} parts)"),
}
_PERIODS = ("before", "during")
_SLICES = ("lead time", "phase of flight", "level", "season")
# Words and colour of ``poolable``.
_VERDICTS = {
    None: ("undecided", SOFT),
    True: ("poolable", BLUE),
    False: ("not poolable", VERMILION),
}
_METHODS = {"separation": "separation by neighbours", "three_cornered_hat": "three-cornered hat"}
_USED_ELSEWHERE = {
    "wrfda_tamdar_error": ("WRFDA, TAMDAR", "-"),
    "wrfda_airep_error": ("WRFDA, AIREP", "--"),
    "nam_tamdar_error": ("NAM, TAMDAR", "-."),
    "nam_mdcrs_error": ("NAM, MDCRS", ":"),
}


def _change(content: Content, key: str) -> str:
    return html.amount(content.get(f"{key}_kt"), content.get(f"{key}_ci_kt"), unit="kt")


def _speeds(entries: Iterable[Content], key: str) -> tuple[Floats, Floats]:
    pairs = [(entry[f"{key}_kt"], entry.get(f"{key}_ci_kt") or (None, None)) for entry in entries]
    value, ends = (np.array(column, float) for column in zip(*pairs, strict=True))
    return value, ends.T


@html.drawing()
def field_test_figure(field_test: Content) -> Figure:
    """Draw the disagreement of each group before and during the field test, and the reductions.

    Parameters
    ----------
    field_test : mapping
        Content of ``field_test.json``.

    Returns
    -------
    Figure
    """
    groups = field_test["groups"]
    figure, (left, right) = html.panels(1.5 + 0.5 * len(groups), 1, 2, width_ratios=(1.5, 1))
    looks = (html.ORANGE, "o", -1), (BLUE, "D", 1)
    for when, (colour, marker, shift) in zip(_PERIODS, looks, strict=True):
        look = Look(color=colour, marker=marker, markersize=7, label=when)
        y = np.arange(len(groups)) + 0.14 * shift
        html.intervals(left, *_speeds(groups.values(), when), y, **look)
    names = [f"{name}\n{entry['aircraft']} aircraft" for name, entry in groups.items()]
    html.rows_axis(left, names, "mean vector disagreement (kt)")
    left.margins(x=0.16)
    changes = [(f"{name}: reduction", entry, "reduction", SOFT) for name, entry in groups.items()]
    for ending, label in (("", "linear"), ("_quadrature", "quadrature")):
        key = f"adjusted_reduction{ending}"
        if field_test.get(f"{key}_kt") is not None:
            changes.append((f"adjusted, {label}", field_test, key, BLUE))
    for row, (_, entry, key, colour) in enumerate(changes):
        value, ends = _speeds([entry], key)
        html.intervals(right, value, ends, row, color=colour, markersize=6)
    html.zero_line(right)
    html.rows_axis(right, [label for label, *_ in changes], "reduction (kt)")
    right.margins(x=0.14)
    figure.legend(loc="outside upper left", ncols=2)
    number = sum(int(row.get(f"reports_{when}", 0)) for row in groups.values() for when in _PERIODS)
    return figure.say(
        "Mean length of the difference between reported and reference wind of each group, and its "
        f"reduction, with 95 % intervals (n = {plural(number, 'report')})."
    )


def _each_aircraft_figure(rows: Sequence[Content]) -> Figure:
    table = pd.DataFrame(rows).set_index("group")[["before_kt", "during_kt"]].astype(float).dropna()
    if table.empty:
        return html.empty_figure("No aircraft has reports before and during the test")
    figure, axes = html.panels(3.7)
    for name, colour, marker in (("controls", SOFT, "s"), ("corrected", BLUE, "o")):
        look = Look(color=colour, alpha=0.85, markersize=5.5, label=name)
        axes.plot(*table[table.index == name].to_numpy().T, marker, **look)
    low, high = table.to_numpy().min(), table.to_numpy().max()
    margin = 0.1 * (high - low) + 0.2
    ends = low - margin, high + margin
    axes.plot(ends, ends, color=FAINT, zorder=1)
    axes.set(xlim=ends, ylim=ends, aspect="equal", xlabel="before (kt)", ylabel="during (kt)")
    figure.legend(loc="outside upper center", ncols=2)
    return figure.say(
        f"Mean disagreement of each aircraft (n = {len(table)} aircraft); below the line it fell."
    )


def field_test_section(field_test: Content, show: html.Figures) -> html.Section:
    """Return the section on the field test."""
    gain = "adjusted_reduction"
    lead = "Reduction of the corrected aircraft beyond the controls: "
    lead += _change(field_test, gain)
    if field_test.get(f"{gain}_quadrature_kt") is not None:
        quadrature = _change(field_test, f"{gain}_quadrature")
        lead += f" as a linear difference, {quadrature} in quadrature"
    if field_test.get("reference"):
        lead += f", against {field_test['reference']}"
    groups = field_test["groups"]
    rows = []
    for name, entry in groups.items():
        row = {"group": name, "aircraft": entry["aircraft"]}
        for key in ("before", "during", "reduction"):
            row[key] = _change(entry, key)
        reports = {f"reports {when}": int(entry.get(f"reports_{when}", 0)) for when in _PERIODS}
        rows.append(row | reports)
    caption = "Mean vector disagreement; in brackets 95 % intervals."
    checks, lines = [], ["Permutation test over aircraft: too few aircraft."]
    if by_aircraft := field_test.get("by_aircraft"):
        checks.append(show("field_test_checks", _each_aircraft_figure(by_aircraft)))
    p_value = (field_test.get("permutation") or {}).get("p_value")
    if p_value is not None and np.isfinite(p_value):
        lines = [f"Permutation test over aircraft: p value {p_value:.3g}."]
    for check, key, words in _CHECKS:
        if (value := (field_test.get(check) or {}).get(key)) is not None:
            lines.append(words.format(f"{value:+.2f} kt"))
    if field_test.get("predicted_reduction_kt") is not None:
        predicted = _change(field_test, "predicted_reduction")
        lines.append(f"Predicted from the fits before the test: {predicted}.")
    checks.append(html.listing([*lines, *field_test.get("notes", [])]))
    parts = [
        show("field_test", field_test_figure(field_test)),
        html.table(rows, words=["group"], caption=caption),
        html.folded("Checks: single aircraft, permutation, choice of groups", *checks),
    ]
    return html.Section("field-test", "Field test", f"{lead}.", parts)


def ranking_section(
    ranking: Sequence[Content], virtual: Content | None, show: html.Figures
) -> html.Section:
    """Return the section on the ranking of aircraft and the accuracy of its predictions."""
    title = "Which aircraft to correct first"
    ranked = [entry for entry in ranking if entry["expected_gain_kt"] is not None]
    if not ranked:
        return html.Section("ranking", title)
    gain, level = (_change(ranked[0], key) for key in ("expected_gain", "disagreement"))
    lead = f"Largest expected reduction: {ranked[0]['aircraft']}, by {gain} of {level}."
    shown = ranked[:_MOST_ROWS]
    figure, axes = html.panels(1.1 + 0.26 * max(len(shown), 2))
    names, label = [entry["aircraft"] for entry in shown], "expected reduction of the mean vector"
    values = names, *_speeds(shown, "expected_gain"), f"{label} disagreement (kt)"
    html.interval_rows(axes, *values, color=BLUE, markersize=5.5)
    left_out = len(ranking) - len(ranked)
    omitted = f"; {left_out} without a usable fit" if left_out else ""
    figure.say(
        "Expected reduction of the disagreement from correcting each aircraft, from its fit, "
        f"with 95 % intervals (n = {plural(len(shown), 'aircraft')}{omitted})."
    )
    parts, lines, points = [show("ranking", figure)], [], 0
    figure, panels = html.panels(1.4 + 0.3 * max(len(shown), 2), 1, 2)
    looks = {"predicted": (SOFT, "o", -0.14), "realised": (BLUE, "D", 0.14)}
    for axes, (key, (panel, words)) in zip(panels, _HELD_OUT.items(), strict=True):
        axes.set_title(panel)
        content = (virtual or {}).get(key) or {}
        rows = content.get("by_aircraft") or []
        if not rows:
            html.blank(axes, "Too few reports.")
            continue
        first = sorted(rows, key=lambda row: (row["agree"] is not False, -row["predicted_gain_kt"]))
        drawn = first[:_MOST_ROWS]
        points += len(drawn)
        for kind, (color, marker, shift) in looks.items():
            look, y = Look(color=color, marker=marker, label=kind), np.arange(len(drawn)) + shift
            html.intervals(axes, *_speeds(drawn, f"{kind}_gain"), y, **look)
        html.zero_line(axes)
        html.rows_axis(axes, [row["aircraft"] for row in drawn], "reduction (kt)")
        for label, row in zip(axes.get_yticklabels(), drawn, strict=True):
            label.set_color(VERMILION if row["agree"] is False else html.INK)
        (low, high), outside = np.array(content["predicted_gain_ci_kt"], float), ""
        if content["realised_gain_kt"] < low or content["realised_gain_kt"] > high:
            outside = ". The realised reduction is outside the interval of the prediction"
            if names := [row["aircraft"] for row in rows if row["agree"] is False]:
                outside += "; the two differ by more than their errors for "
                outside += html.joined(names, most=8)
        predicted, realised = (_change(content, f"{kind}_gain") for kind in looks)
        lines.append(
            f"{words.format_map(content)}, {plural(content['reports'], 'report')} of "
            f"{plural(len(rows), 'aircraft')}: realised reduction {realised}, predicted "
            f"{predicted}{outside}."
        )
    if lines:
        handles = next(axes for axes in panels if axes.lines).get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper right", ncols=2)
        figure.say(
            "Reduction predicted and realised on reports not used in the fit, with 95 % intervals. "
            "Names in orange: the two differ by more than their errors "
            f"(n = {plural(points, 'row')})."
        )
        inner = show("virtual_field_test", figure)
        parts.append(html.listing(lines))
        parts.append(html.folded("Predicted and realised reduction of each aircraft", inner))
    return html.Section("ranking", title, lead, parts)


def _pair_name(pair: Content) -> str:
    return " - ".join(map(str, pair["references"]))


@html.drawing()
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
        return html.empty_figure("No pair of references has enough reports to compare")
    figure, axes = html.panels(1.2 + 0.55 * len(shown))
    for index, name in enumerate(COEFFICIENTS):
        value, error = (
            np.array([pair["fleet"][kind][name] for pair in shown], float)
            for kind in ("difference", "standard_error")
        )
        half, y = NORMAL_95 * error, np.arange(len(shown)) + 0.14 * (index - 2)
        look = html.series(index, label=name)
        html.intervals(axes, value, (value - half, value + half), y, **look)
    names, colours = [], []
    for pair in shown:
        words, colour = _VERDICTS[pair.get("poolable")]
        prefix = f"{pair['slice']}: " if pair.get("slice") else ""
        names.append(f"{prefix}{_pair_name(pair)}\n{words}")
        colours.append(colour)
    html.zero_line(axes)
    html.rows_axis(axes, names, "difference of the coefficient (degree)")
    for label, colour in zip(axes.get_yticklabels(), colours, strict=True):
        label.set_color(colour)
    figure.legend(loc="outside upper right", ncols=len(COEFFICIENTS))
    reports = max(int(pair.get("reports", 0)) for pair in shown)
    aircraft = max(int(pair["fleet"].get("aircraft", 0)) for pair in shown)
    return figure.say(
        "Difference of each coefficient between two references, mean of the fleet, with 95 % "
        f"intervals (n = "
        f"{plural(reports, 'report')}, {aircraft} aircraft)."
    )


def sensitivity_section(sensitivity: Content, show: html.Figures) -> html.Section:
    """Return the section on the comparison of references."""
    title, pairs = "Comparison of references", sensitivity.get("pairs")
    if not pairs:
        return html.Section("sensitivity", title)
    lead = "Some pairs of references have too few reports to decide."
    if all(pair.get("poolable") for pair in pairs):
        lead = "No two references differ significantly by a size that matters: they can be pooled."
    elif unpoolable := [pair for pair in pairs if pair.get("poolable") is False]:
        named = "; ".join(f"{_pair_name(pair)} ({_why(pair)})" for pair in unpoolable[:2])
        count = len(unpoolable) - 2
        more = f", and {plural(count, 'more pair')}" if count > 0 else ""
        lead = f"Not poolable: {named}{more}."
    details = [_pair_table(pairs, "Every pair.")]
    for words in _SLICES:
        if slices := sensitivity.get(f"by_{words.removesuffix(' of flight').replace(' ', '_')}"):
            details.append(_pair_table(slices, f"By {words}."))
    corners = [
        {
            "three references": ", ".join(entry["references"]),
            "reference": corner["reference"],
            "error of a component (kt rms)": float(corner["component_rms"] or np.nan) / KNOT,
            "reports": int(entry["reports"]),
        }
        for entry in sensitivity.get("three_way") or []
        for corner in entry.get("errors", [])
    ]
    note = (
        "Three-cornered hat. It assumes independent errors of the three references; references "
        "that assimilate the same reports get too small an error, or a negative variance (-)."
    )
    if corners:
        details.append(html.heading("Error of each reference"))
    details.append(html.table(corners, words=("three references", "reference"), caption=note))
    parts = [
        show("references", pair_differences_figure(pairs)),
        html.folded("Tables, also by slices of the reports", *details),
    ]
    return html.Section("sensitivity", title, lead, parts)


def _pair_table(pairs: Sequence[Content], caption: str) -> Markup:
    rows = []
    for pair in pairs:
        p_value = pair["fleet"].get("p_value") if pair.get("own_test", True) else None
        speed = np.array(pair.get("mean_vector_difference_m_s"), float)
        row = {
            "pair": _pair_name(pair),
            "verdict": _VERDICTS[pair.get("poolable")][0],
            "why": _why(pair),
            "difference of the curves (degree rms)": pair["fleet"].get("curve_rms_deg"),
            "p value": "-" if p_value is None or np.isnan(p_value) else f"{p_value:.2g}",
            "mean vector difference of the winds (kt)": speed / KNOT,
            "reports": int(pair.get("reports", 0)),
        }
        rows.append(({"slice": pair["slice"]} if pair.get("slice") else {}) | row)
    doubt, words = [pair.get("poolable") is None for pair in pairs], ("slice", "pair", "verdict")
    return html.table(rows, words=words, long=["why"], caption=caption, doubt=doubt)


def _why(pair: Content) -> str:
    if not pair.get("own_test", True) and pair.get("poolable"):
        return "a pool and one of its members: part of the difference of the members"
    return str(pair.get("why", "")).replace(" +- ", " ± ")


def report_errors_section(errors: xr.Dataset, show: html.Figures) -> html.Section:
    """Return the section on the observation error of the reports alone."""
    title = "Observation error of the reports"
    why = str(errors.attrs.get("method_reason", "")).replace("m2/s2", "m²/s²")
    used = str(errors.attrs.get("method", ""))
    if not used:
        return html.Section("report-errors", title, "It could not be determined.", [why])
    lines = [f"Method: {_METHODS[used]} ({why})."]
    before, after = errors["aircraft_observation_error"].transpose("state", ...) / KNOT
    gain = (before - after).to_numpy()
    if np.isfinite(gain).any():
        best = int(np.nanargmax(gain))
        lines.append(
            f"Largest improvement: {errors['aircraft'].to_numpy()[best]}, {before[best]:.2f} "
            f"kt as reported, {after[best]:.2f} corrected."
        )
    rows, name = [], "fleet_observation_error_by_method"
    for way, words in _METHODS.items():
        row = {"method": words}
        for state, *_ in html.STATES:
            selected = errors.sel(state=state, way=way)
            ends = selected[f"{name}_interval"].to_numpy()
            row[f"{state} (kt)"] = html.amount(selected[name] / KNOT, ends / KNOT)
        rows.append(row)
    caption = (
        "Error of a component over all reports, with 95 % intervals. The three-cornered hat counts "
        "the common error of the references as error of the reports. Grey italics: not used."
    )
    doubt = [method != used for method in _METHODS]
    methods = html.table(rows, words=["method"], caption=caption, doubt=doubt)
    parts = [
        show("observation_errors", _report_errors_figure(errors)),
        html.folded("Both methods", methods, html.listing(lines)),
    ]
    return html.Section("report-errors", title, worth_sentence(errors), parts)


def _report_errors_figure(errors: xr.Dataset) -> Figure:
    valid = errors["observation_error"].notnull().any("state").sum("layer")
    cells = {phase: int(valid.sel(flight_phase=phase)) for phase in ("ascent", "cruise", "descent")}
    phases = [phase for phase in cells if cells[phase]]
    if not phases:
        return html.empty_figure(
            "Too few reports near each other to separate the observation error"
        )
    figure, (panels,) = html.panels(4.2, 1, len(phases), sharey=True, sharex=True, squeeze=False)
    level = (errors["layer_bottom_pressure"] + errors["layer_top_pressure"]).to_numpy() / 200.0
    for axes, phase in zip(panels, phases, strict=True):
        for name, (label, line) in _USED_ELSEWHERE.items():
            look = Look(color=SOFT, linewidth=1.0, linestyle=line, label=label)
            axes.plot(errors[name].to_numpy() / KNOT, level, **look)
        for index, (state, colour, marker) in enumerate(html.STATES):
            selected = errors.sel(flight_phase=phase, state=state)
            value = selected["observation_error"].to_numpy() / KNOT
            ends = selected["observation_error_interval"].to_numpy().T / KNOT
            shown = np.isfinite(value)
            ends = np.where(np.isnan(ends), value, ends)[:, shown]
            look = Look(color=colour, marker=marker, linestyle="-", linewidth=1.4)
            y = level[shown] + 8.0 * (index - 0.5)
            html.intervals(axes, value[shown], ends, y, label=f"as {state}", **look)
        axes.set(title=phase, xlabel="standard error of a wind component (kt)")
    panels[0].set(xlim=(0.0, None), ylim=(1000, 200), ylabel="pressure (hPa)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    number = int(errors["observation_count"].sel(flight_phase="all").sum())
    missing = " and ".join(phase for phase in cells if phase not in phases)
    few = f" Too few reports near each other in {missing}." if missing else ""
    return figure.say(
        "Standard error of a wind component, with 95 % intervals; grey: used in assimilation (n = "
        f"{plural(number, 'report')}, {plural(sum(cells.values()), 'cell')} of phase and level)."
        f"{few}"
    )


def worth_sentence(errors: xr.Dataset) -> str:
    """Return a sentence on the observation error and on the weight of a corrected report."""
    value = errors["fleet_observation_error"] / KNOT
    before, after = (float(value.sel(state=state)) for state, *_ in html.STATES)
    sentence = (
        f"Standard error of a wind component, without the error of the reference: {before:.2f} "
        f"kt as reported, {after:.2f} kt corrected."
    )
    gain = float(errors["fleet_weight_gain"])
    if np.isfinite(gain):
        ends, digits = errors["fleet_weight_gain_interval"].to_numpy(), 0 if gain >= 10 else 1
        sentence += (
            f" In an analysis a corrected report has the weight of {gain:.{digits}f} uncorrected "
            f"reports{html.range_text(ends, digits=digits)}."
        )
    return sentence
