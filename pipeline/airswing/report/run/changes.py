"""Changes of the compasses and events of the fleet: sections, and the monitoring page.

Contents as in ``stability.json`` (docs/formats.md) and ``events.json``
(:mod:`airswing.evaluation.monitoring`). Angles in degrees, dates in UTC, intervals 95 %.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from airswing.evaluation import Content
from airswing.evaluation.monitoring.events import WORDS, Monitoring, State
from airswing.report import html
from airswing.report.html import Look, interval_text, number_text, plural
from airswing.units import NORMAL_95

# Aircraft in a figure; rows of the tables. The files contain all.
FEWEST_AIRCRAFT, MOST_AIRCRAFT = 2, 10
_MOST_EVENTS, _MOST_STATES = 60, 200


def _stability_figure(stability: Content, period: tuple[str, str] | None) -> Figure:
    changes = {entry["aircraft"]: entry["changes"] for entry in stability["changes"]}
    windows = [entry for entry in stability["windows"] if entry["status"] == "ok"]
    fitted = Counter(entry["aircraft"] for entry in windows)
    tested = [name for name in changes if changes[name] or name in fitted]
    # without changes, aircraft with most windows are examples
    tested.sort(key=lambda name: (not changes[name], -fitted[name], name))
    changed = sum(bool(changes[name]) for name in tested)
    aircraft = tested[: min(max(changed, FEWEST_AIRCRAFT), MOST_AIRCRAFT)]
    if not aircraft:
        return html.empty_figure("No calendar window has enough reports for a fit")
    shared = Look(squeeze=False, sharex=True, sharey="col")
    figure, grid = html.panels(0.9 + 1.05 * len(aircraft), len(aircraft), 2, **shared)
    step = np.timedelta64(1 if stability["window"] == "month" else 3, "M")
    looks = (("offset", html.BLUE), ("amplitude", html.ORANGE))
    for panels, name in zip(grid, aircraft, strict=True):
        fits = [entry for entry in windows if entry["aircraft"] == name]
        first = np.array([entry["window"] for entry in fits], dtype="datetime64[M]")
        begin, end = first.astype("datetime64[D]"), (first + step).astype("datetime64[D]")
        if period is not None:
            start, last = np.array(period, "datetime64[D]")
            begin, end = np.maximum(begin, start), np.minimum(end, last + 1)
        for axes, (quantity, colour) in zip(panels, looks, strict=True):
            value = np.array([entry[quantity] for entry in fits], float)
            half = [NORMAL_95 * entry[f"{quantity}_standard_error"] for entry in fits]
            axes.hlines(value, begin, end, color=colour, linewidth=1.4)
            dots = Look(fmt="o", color=colour, markersize=4)
            axes.errorbar(begin + (end - begin) // 2, value, yerr=half, **dots)
            for change in changes[name]:
                date, low, high = np.array([change["date"], *change["date_ci"]], "datetime64[D]")
                axes.axvspan(low, high + 1, color=html.VERMILION, alpha=0.18, linewidth=0)
                axes.axvline(date, color=html.VERMILION, linewidth=1.4)
        panels[0].set_ylabel(name)
    for axes, (quantity, _) in zip(grid[0], looks, strict=True):
        axes.set_title(f"{quantity} (degree)")
    axis = grid[-1, 0].xaxis
    locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
    axis.set_major_locator(locator)
    years = ["", *["%Y"] * 5]  # the ticks name the months
    formatter = ConciseDateFormatter(locator, offset_formats=years)  # type: ignore[no-untyped-call]
    axis.set_major_formatter(formatter)
    text = (
        f"Fits by {stability['window']} with 95 % intervals (n = "
        f"{plural(len(aircraft), 'aircraft')}); orange line and band: date of a change of the "
        f"compass and its 95 % interval ({sum(len(changes[name]) for name in aircraft)} found)."
    )
    if not changed:
        text += " No compass changed: aircraft with most windows are shown as examples."
    missing = [
        f"{entry['aircraft']} from {entry['window']} ({entry['status'].replace('_', ' ')})"
        for entry in stability["windows"]
        if entry["aircraft"] in aircraft and entry["status"] != "ok"
    ]
    if missing:
        text += f" Not drawn, because the reports allow no curve: {html.joined(missing)}."
    return figure.say(text)


def stability_section(
    stability: Content, show: html.Figures, period: tuple[str, str] | None = None
) -> html.Section:
    """Return the section on changes of the compasses; `period` is the first and the last day."""
    tested = [entry for entry in stability["changes"] if entry["p_value"] is not None]
    rows = [(entry["aircraft"], change) for entry in tested for change in entry["changes"]]
    lead = f"None of {len(tested)} compasses changed within the period."
    if rows:
        lead = (
            f"{len(dict(rows))} of {len(tested)} compasses changed within the period. One fit over "
            "the whole period then describes neither part."
        )
    elif not tested:
        lead = "The period is too short for a test of changes."
    parts = [show("changes", _stability_figure(stability, period))]

    def change_of(letter: str) -> list[str]:
        sizes = ((change["change_deg"], change["standard_error_deg"]) for _, change in rows)
        return [interval_text(x[letter], NORMAL_95 * e[letter], sign=True) for x, e in sizes]

    columns = {
        "aircraft": [name for name, _ in rows],
        "changed on": [change["date"] for _, change in rows],
        "95 % interval": [" to ".join(change["date_ci"]) for _, change in rows],
        **{f"change of {letter} (degree)": change_of(letter) for letter in "ABC"},
        "p value": [number_text(change["p_value"], digits=3) for _, change in rows],
    }
    words, caption = tuple(columns)[:3], "Changes found, with 95 % intervals."
    parts.append(html.table(columns, words=words, caption=caption))
    return html.Section("stability", "Changes of the compasses", lead, parts)


@html.drawing()
def write_monitoring_page(path: Path, monitoring: Monitoring) -> Path:
    """Write the section on events as a separate page."""
    return html.write_document(
        path,
        title="airswing: monitoring of the fleet",
        kicker=f"Monitoring of {plural(len(monitoring.states), 'aircraft')}  ·  up to "
        f"{monitoring.until}, against {monitoring.reference}",
        headline=_new_events(monitoring),
        sections=[monitoring_section(monitoring)],
        footer="Intervals are 95 %.",
    )


def monitoring_section(monitoring: Monitoring) -> html.Section:
    """Return the section on new events and on the state of every aircraft."""
    states = _states_table(monitoring)
    folded = html.folded("State of every aircraft", states, unfolded=not monitoring.events)
    parts = [_events_table(monitoring), folded]
    return html.Section("monitoring", "Monitoring", _new_events(monitoring), parts)


def _new_events(monitoring: Monitoring) -> str:
    named = {
        words: [e.aircraft or "all aircraft" for e in monitoring.new_events if e.kind == kind]
        for kind, words in WORDS.items()
    }
    new = [f"{words} ({html.joined(names, most=8)})" for words, names in named.items() if names]
    text = f"New events up to {monitoring.until}: {', '.join(new)}." if new else "No new event."
    if names := monitoring.differing:
        text += f" Another table is needed for {html.joined(names, most=8)}."
    return text


def _events_table(monitoring: Monitoring) -> Markup:
    new, every = len(monitoring.new_events), len(monitoring.events)
    events = monitoring.events[::-1][:_MOST_EVENTS]
    dates = (" to ".join(dict.fromkeys(event.evidence.get("date_ci", []))) for event in events)
    columns = {
        "since": [event.date for event in events],
        "95 % interval": [text or "-" for text in dates],
        "aircraft": [event.aircraft or "all aircraft at once" for event in events],
        "event": [WORDS[event.kind] for event in events],
        "details": [event.details or "-" for event in events],
        "noticed": [event.noticed for event in events],
        "": ["new" if number < new else "" for number in range(len(events))],
    }
    more = f", the latest {_MOST_EVENTS} shown" if every > _MOST_EVENTS else ""
    caption = (
        f"Events (n = {every}{more}). Change of a compass: rms over all headings, and the offset, "
        "degrees, with 95 % intervals."
    )
    return html.table(columns, words=columns, caption=caption)


def _states_table(monitoring: Monitoring) -> Markup:
    """Return the states, first where another table is needed, then where winds became worse."""
    every = len(monitoring.states)

    def urgency(state: State) -> tuple[object, ...]:
        worse = (state.disagreement_kt or 0.0) / (state.past_disagreement_kt or np.inf)
        return not state.tables_differ, -worse, state.aircraft

    states = sorted(monitoring.states, key=urgency)[:_MOST_STATES]
    needs, rows = {None: "-", False: "no", True: "yes"}, []
    for state in states:
        speeds = (state.disagreement_kt, state.past_disagreement_kt)
        now, past = (number_text(speed) for speed in speeds)
        same = state.table_difference_deg == 0.0
        rows.append(
            {
                "aircraft": state.aircraft,
                "last report": f"{state.last_day}{' (no reports since)' if state.silent else ''}",
                "disagreement, last days (kt)": now,
                "before (kt)": past,
                "another table needed": "no, same table" if same else needs[state.tables_differ],
                "difference of the tables (° rms)": number_text(state.table_difference_deg),
            }
        )
    more = f", {_MOST_STATES} shown" if every > _MOST_STATES else ""
    caption = (
        "Mean wind vector disagreement of the last seven days with reports and of the days before; "
        "whether the table fitted now differs from the table in use by more than the error of both "
        f"(n = {plural(every, 'aircraft')}{more}). Without monitoring.tables_in_use, the first "
        "table fitted counts as in use."
    )
    words = ("aircraft", "last report", "another table needed")
    return html.table(rows, words=words, caption=caption)
