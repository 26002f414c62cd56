"""Changes of the compasses and events of the fleet: figures, sections, and the monitoring page.

Contents as in ``stability.json`` (docs/formats.md) and ``events.json``
(:mod:`airswing.evaluation.monitoring`). Angles in degrees, dates in UTC, intervals 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from airswing.evaluation.results import Content
from airswing.products.whole_files import write_text
from airswing.report.html.document import Column, Row, Section, document, folded, table
from airswing.report.html.embed import Figures
from airswing.report.html.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    SOFT,
    VERMILION,
    Units,
    empty_figure,
    new_figure,
    place_panels,
    plural,
    shown_per_kt,
    styled,
)
from airswing.report.run.fleet import rows_axis
from airswing.report.run.selection import interval_text, number_text
from airswing.units import NORMAL_95
from airswing.version import __version__

if TYPE_CHECKING:
    from airswing.evaluation.monitoring import Event, Monitoring

# Aircraft in a figure; rows of the tables. The files contain all.
FEWEST_AIRCRAFT, MOST_AIRCRAFT, MOST_EVENT_ROWS = 2, 10, 24
_MOST_EVENTS, _MOST_STATES = 60, 200
_SHORTEST = 30  # days that a time axis spans at least
_FLEET = "all aircraft at once"
_KINDS = {
    "compass_changed": ("compass changed", VERMILION, "D"),
    "disagreement_rose": ("wind disagreement rose", ORANGE, "^"),
    "aircraft_silent": ("no reports", SOFT, "s"),
    "aircraft_new": ("new aircraft", GREEN, "o"),
    "reference_changed": ("reference changed", BLUE, "*"),
}


def date_axis(axes: Axes, *, low: float | None = None, high: float | None = None) -> None:
    """Make the x axis one of dates (days since 1970), with few ticks."""
    axes.xaxis_date()
    if low is not None and high is not None:
        axes.set_xlim(low, high)
    locator = AutoDateLocator(minticks=3, maxticks=7)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def days_since_1970(days: ArrayLike) -> NDArray[np.float64]:
    """Return dates as places on a date axis."""
    return np.asarray(days).astype("datetime64[D]").astype(np.float64)


@styled
def stability_figure(stability: Content, period: tuple[str, str] | None = None) -> Figure:
    """Draw each aircraft's offset and amplitude by calendar window, with the dates of changes.

    Aircraft that changed, at least two and at most ten. Windows end at the first and the last day
    of the reports, `period`, if given.
    """
    changes = {entry["aircraft"]: entry["changes"] for entry in stability["changes"]}
    windows = [entry for entry in stability["windows"] if entry["status"] == "ok"]
    fitted = {entry["aircraft"] for entry in windows}
    known = [name for name in changes if changes[name] or name in fitted]
    known.sort(key=lambda name: (not changes[name], name not in fitted, name))
    changed = sum(bool(changes[name]) for name in known)
    aircraft = known[: min(max(changed, FEWEST_AIRCRAFT), MOST_AIRCRAFT)]
    if not aircraft:
        return empty_figure("No calendar window has enough reports for a fit")
    figure = new_figure(0.9 + 1.05 * len(aircraft), constrained=False)
    grid = figure.subplots(len(aircraft), 2, squeeze=False, sharex=True, sharey="col")
    step = np.timedelta64(1 if stability["window"] == "month" else 3, "M")
    for panels, name in zip(grid, aircraft, strict=True):
        fits = [entry for entry in windows if entry["aircraft"] == name]
        for axes, quantity, colour in zip(
            panels, ("offset", "amplitude"), (BLUE, ORANGE), strict=True
        ):
            _windows(axes, fits, quantity, colour, step, period)
            _change_dates(axes, changes.get(name, []))
        panels[0].set_ylabel(name)
    grid[0, 0].set_title("offset (degree)")
    grid[0, 1].set_title("amplitude (degree)")
    date_axis(grid[-1, 0])
    place_panels(figure, left=0.75, wspace=0.5)
    number = sum(len(changes.get(name, [])) for name in aircraft)
    text = (
        f"Fits by {stability['window']} with 95 % intervals, each from the reports of its window "
        f"(n = {plural(len(aircraft), 'aircraft', 'aircraft')}); orange line and band: date of a "
        f"change of the compass and its 95 % interval ({number} found)."
    )
    if not changed:
        text += " No compass changed: the first aircraft are shown as examples."
    missing = [
        f"{entry['aircraft']} from {entry['window']} ({entry['status'].replace('_', ' ')})"
        for entry in stability["windows"]
        if entry["aircraft"] in aircraft and entry["status"] != "ok"
    ]
    if missing:
        more = f" and {len(missing) - 6} more" if len(missing) > 6 else ""
        text += f" Not drawn, because the reports allow no curve: {', '.join(missing[:6])}{more}."
    return figure.say(text)


def _windows(
    axes: Axes,
    fits: Sequence[Content],
    quantity: str,
    colour: str,
    step: np.timedelta64,
    period: tuple[str, str] | None,
) -> None:
    first = np.array([entry["window"] for entry in fits], dtype="datetime64[M]")
    begin, end = days_since_1970(first), days_since_1970(first + step)
    if period is not None:
        start, last = days_since_1970(period)
        begin, end = np.maximum(begin, start), np.minimum(end, last + 1)
    value = np.array([entry[quantity] for entry in fits], float)
    error = np.array([entry[f"{quantity}_standard_error"] for entry in fits], float)
    middle = (begin + end) // 2
    axes.hlines(value, begin, end, color=colour, linewidth=1.4)
    axes.vlines(middle, value - NORMAL_95 * error, value + NORMAL_95 * error, color=colour)
    axes.plot(middle, value, "o", color=colour, markersize=4)


def _change_dates(axes: Axes, changes: Sequence[Content]) -> None:
    for change in changes:
        low, high = days_since_1970(change["date_ci"]).tolist()
        axes.axvspan(low, high + 1, color=VERMILION, alpha=0.18, linewidth=0)
        axes.axvline(float(days_since_1970(change["date"])), color=VERMILION, linewidth=1.4)


def stability_section(
    stability: Content | None, show: Figures, period: tuple[str, str] | None = None
) -> Section:
    """Return the section on changes of the compasses; `period` is the first and the last day."""
    title = "Changes of the compasses"
    if not stability:
        return Section("stability", title)
    tested = [entry for entry in stability["changes"] if entry["p_value"] is not None]
    changed = [entry for entry in tested if entry["changes"]]
    lead = f"None of {len(tested)} compasses changed within the period."
    if changed:
        lead = (
            f"{len(changed)} of {len(tested)} compasses changed within the period. One fit over "
            "the whole period then describes neither part."
        )
    elif not tested:
        lead = "The period is too short for a test of changes."
    parts = [show("changes", stability_figure(stability, period))]
    rows = [
        Row(
            [
                entry["aircraft"],
                change["date"],
                f"{change['date_ci'][0]} to {change['date_ci'][1]}",
                *(
                    interval_text(
                        change["change_deg"][name],
                        NORMAL_95 * change["standard_error_deg"][name],
                        sign=True,
                    )
                    for name in "ABC"
                ),
                number_text(change["p_value"], digits=3),
            ]
        )
        for entry in changed
        for change in entry["changes"]
    ]
    if rows:
        columns = [Column(name, "words") for name in ("aircraft", "changed on", "95 % interval")]
        columns += [Column(f"change of {name} (degree)") for name in "ABC"]
        caption = "Changes found, with 95 % intervals."
        parts.append(table([*columns, Column("p value")], rows, caption=caption))
    return Section("stability", title, lead, parts)


@styled
def timeline_figure(monitoring: Monitoring) -> Figure:
    """Draw the events, at least one, by date, one row an aircraft, the latest first."""
    events = sorted(monitoring.events, key=lambda one: (one.noticed, one.date), reverse=True)
    names = list(dict.fromkeys(one.aircraft or _FLEET for one in events))
    shown = names[:MOST_EVENT_ROWS]
    figure = new_figure(1.25 + 0.3 * max(len(shown), 2))
    axes = figure.add_subplot()
    drawn = [one for one in events if (one.aircraft or _FLEET) in shown]
    silent = {state.aircraft for state in monitoring.states if state.silent}
    last = first = float(days_since_1970(monitoring.until))
    for one in drawn:
        row, (_, colour, marker) = shown.index(one.aircraft or _FLEET), _KINDS[one.kind]
        day = float(days_since_1970(one.date))
        low, high = days_since_1970(one.evidence.get("date_ci", [one.date] * 2)).tolist()
        axes.plot([low, high], [row, row], color=colour, alpha=0.3, linewidth=7, zorder=2)
        if one.kind == "aircraft_silent":
            end = last if one.aircraft in silent else day + one.evidence["days"]
            axes.plot([day, end], [row, row], color=FAINT, linewidth=7, zorder=1)
        axes.plot(day, row, marker, color=colour, markersize=_size(marker), zorder=3)
        first = min(first, low, day)
    axes.axvline(last, color=INK, linewidth=0.8)
    span = max(last - first, _SHORTEST)
    date_axis(axes, low=last - 1.06 * span, high=last + 0.02 * span)
    rows_axis(axes, shown)
    for kind, (words, colour, marker) in _KINDS.items():
        if any(one.kind == kind for one in drawn):
            axes.plot([], [], marker, color=colour, label=words, markersize=_size(marker))
    figure.legend(loc="outside upper left", ncols=len(_KINDS), handletextpad=0.3, columnspacing=1.3)
    rest = f"; {len(names) - len(shown)} more are in events.json" if len(names) > len(shown) else ""
    return figure.say(
        f"Events up to {monitoring.until}, the latest first (n = {plural(len(drawn), 'event')} "
        f"in {plural(len(shown), 'row')}{rest}). Bands: 95 % interval of the date; grey bar: time "
        "without reports; vertical line: the last day."
    )


def _size(marker: str) -> float:
    return 10.0 if marker == "*" else 6.5


def monitoring_section(monitoring: Monitoring | None, show: Figures) -> Section:
    """Return the section on new events and on the state of every aircraft."""
    title = "Monitoring"
    if not monitoring:
        return Section("monitoring", title)
    events = list(reversed(monitoring.events))
    parts = []
    if events:
        parts = [show("monitoring", timeline_figure(monitoring))]
        parts.append(_events_table(monitoring, events))
    states = [_states_table(monitoring, show.units)]
    parts.append(folded("State of every aircraft", states, unfolded=not events))
    return Section("monitoring", title, monitoring_sentence(monitoring), parts)


def write_monitoring_page(path: Path, monitoring: Monitoring, *, units: Units = "kt") -> Path:
    """Write the section on events as a separate page."""
    text = document(
        title="airswing: monitoring of the fleet",
        kicker=f"Monitoring of {plural(len(monitoring.states), 'aircraft', 'aircraft')}  ·  up to "
        f"{monitoring.until}, against {monitoring.reference}",
        headline=monitoring_sentence(monitoring),
        sections=[monitoring_section(monitoring, Figures(units=units))],
        footer=[f"airswing {__version__}. Intervals are 95 %."],
    )
    return write_text(path, text)


def monitoring_sentence(monitoring: Monitoring) -> str:
    """Return the new events by kind, and the aircraft that need another table."""
    new = monitoring.new_events
    counts = [
        f"{words} ({number})"
        for kind, (words, *_) in _KINDS.items()
        if (number := sum(one.kind == kind for one in new))
    ]
    text = f"New up to {monitoring.until}: {', '.join(counts)}." if new else "No new event."
    if names := monitoring.differing:
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        text += f" Another table is needed for {', '.join(names[:8])}{more}."
    return text


def _events_table(monitoring: Monitoring, events: list[Event]) -> Markup:
    new = len(monitoring.new_events)
    rows = [
        Row(
            [
                one.date,
                " to ".join(dict.fromkeys(one.evidence.get("date_ci", []))) or "-",
                one.aircraft or _FLEET,
                _KINDS[one.kind][0],
                _event_size(one),
                one.noticed,
                "new" if number < new else "",
            ]
        )
        for number, one in enumerate(events[:_MOST_EVENTS])
    ]
    titles = ("since", "95 % interval", "aircraft", "event", "size", "noticed", "")
    more = f", the latest {_MOST_EVENTS} shown" if len(events) > _MOST_EVENTS else ""
    return table(
        [Column(title, "words") for title in titles],
        rows,
        caption=f"Events (n = {len(events)}{more}). Size: change of the deviation in degrees rms "
        "over all headings with the change of the offset, or the factor of the disagreement.",
    )


def _event_size(event: Event) -> str:
    evidence = event.evidence
    if "factor" in evidence:
        return f"× {interval_text(evidence['factor'], NORMAL_95 * evidence['standard_error'])}"
    if "curve_rms_deg" in evidence:
        half = NORMAL_95 * evidence["standard_error_deg"]["A"]
        offset = interval_text(evidence["change_deg"]["A"], half, digits=1, sign=True)
        return f"{evidence['curve_rms_deg']:.1f}° rms, offset {offset}°"
    return f"{evidence['days']} days" if "days" in evidence else "-"


def _states_table(monitoring: Monitoring, units: Units) -> Markup:
    factor = shown_per_kt(units)

    def ratio(past: float | None, now: float | None) -> float:
        return (now or 0.0) / past if past else 0.0

    states = sorted(
        monitoring.states,
        key=lambda one: (
            not one.tables_differ,
            -ratio(one.past_disagreement_kt, one.disagreement_kt),
            one.aircraft,
        ),
    )
    rows = [
        Row(
            [
                one.aircraft,
                one.last_day + (" (no reports since)" if one.silent else ""),
                number_text(one.disagreement_kt, factor=factor),
                number_text(one.past_disagreement_kt, factor=factor),
                {None: "-", False: "no", True: "yes"}[one.tables_differ],
                number_text(one.table_difference_deg),
            ]
        )
        for one in states[:_MOST_STATES]
    ]
    columns = [
        Column("aircraft", "words"),
        Column("last report", "words"),
        Column(f"disagreement, last days ({units})"),
        Column(f"before ({units})"),
        Column("another table needed", "words"),
        Column("difference of the tables (° rms)"),
    ]
    more = f", {_MOST_STATES} shown" if len(states) > _MOST_STATES else ""
    return table(
        columns,
        rows,
        caption="Mean wind vector disagreement of the last seven days with reports and of the days "
        "before; whether the table fitted now differs from the table in use by more than the "
        f"error of both (n = {plural(len(states), 'aircraft', 'aircraft')}{more}).",
    )
