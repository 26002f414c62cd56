"""The page's section on what happened to the fleet, and the same as a page of its own.

Assumes a look at the fleet, as ``events.json`` keeps it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from airswing.products.whole_files import write_text
from airswing.report.html.document import Column, Row, Section, document, folded, table
from airswing.report.html.embed import embedded
from airswing.report.html.style import plural
from airswing.report.run.monitoring_figures import KINDS, timeline_figure
from airswing.report.run.page_numbers import number_text
from airswing.units import NORMAL_95
from airswing.version import __version__

if TYPE_CHECKING:  # the watch itself is not needed to show it
    from airswing.evaluation.monitoring import Event, Monitoring, State

MOST_EVENTS, MOST_STATES = 60, 200  # Rows of the tables; the file has all


def monitoring_section(watched: Monitoring | None) -> Section:
    """Return what is new, the line of time, the events and how the aircraft stand."""
    title = "Watch"
    if not watched:
        return Section("watch", title)
    parts = [embedded(timeline_figure(watched))]
    events = list(reversed(watched.events))
    if events:
        parts.append(_events_table(watched, events))
    parts.append(folded("How the aircraft stand", [_states_table(watched)], unfolded=not events))
    return Section("watch", title, _lead(watched), parts)


def write_monitoring_page(path: Path, watched: Monitoring) -> Path:
    """Write the section as a page of its own.

    Parameters
    ----------
    watched : Monitoring
    """
    text = document(
        title="airswing: watch over the fleet",
        kicker=f"Watch over {plural(len(watched.states), 'aircraft', 'aircraft')}  ·  to "
        f"{watched.until}, against {watched.reference}",
        headline=_lead(watched),
        sections=[monitoring_section(watched)],
        footer=[f"airswing {__version__}. Intervals are 95 %."],
    )
    return write_text(path, text)


def _lead(watched: Monitoring) -> str:
    news = watched.events[watched.told_before :]
    differing = watched.differing
    counts = [
        f"{sum(one.kind == kind for one in news)} {words}"
        for kind, (words, *_) in KINDS.items()
        if any(one.kind == kind for one in news)
    ]
    told = f"New up to {watched.until}: {', '.join(counts)}." if news else "Nothing new."
    if differing:
        more = f" and {len(differing) - 8} more" if len(differing) > 8 else ""
        told += f" Another table should go to {', '.join(differing[:8])}{more}."
    return told


def _events_table(watched: Monitoring, events: list[Event]) -> Markup:
    number = len(events) - watched.told_before
    rows = [
        Row(
            [
                one.date,
                " to ".join(dict.fromkeys(one.evidence.get("date_ci", []))) or "-",
                one.aircraft or "all at once",
                KINDS[one.kind][0],
                _size(one),
                one.noticed,
                "new" if k < number else "",
            ]
        )
        for k, one in enumerate(events[:MOST_EVENTS])
    ]
    titles = ("since", "95 % interval", "aircraft", "event", "size", "noticed", "")
    more = f", the latest {MOST_EVENTS}" if len(events) > MOST_EVENTS else ""
    return table(
        [Column(one, "words") for one in titles],
        rows,
        caption=f"Events (n = {len(events)}{more}); a change of the compass in degrees rms over "
        "all headings, with its offset; a rise of the wind disagreement as a factor.",
    )


def _size(event: Event) -> str:
    told = event.evidence
    if "factor" in told:
        return f"× {told['factor']:.2f} ± {NORMAL_95 * told['standard_error']:.2f}"
    if "curve_rms_deg" in told:
        return (
            f"{told['curve_rms_deg']:.1f}° rms, offset {told['change_deg']['A']:+.1f} ± "
            f"{NORMAL_95 * told['standard_error_deg']['A']:.1f}°"
        )
    return f"{told['days']} days" if "days" in told else "-"


def _states_table(watched: Monitoring) -> Markup:
    states = sorted(watched.states, key=_worst_first)
    rows = [
        Row(
            [
                one.aircraft,
                one.last_day + (" (silent)" if one.silent else ""),
                _number(one.disagreement_kt),
                _number(one.past_disagreement_kt),
                {None: "-", False: "no", True: "yes"}[one.tables_differ],
                _number(one.table_difference_deg),
            ]
        )
        for one in states[:MOST_STATES]
    ]
    columns = [
        Column("aircraft", "words"),
        Column("last report", "words"),
        Column("disagreement, last days (kt)"),
        Column("before (kt)"),
        Column("another table?", "words"),
        Column("tables apart (° rms)"),
    ]
    more = f", {MOST_STATES} shown" if len(states) > MOST_STATES else ""
    return table(
        columns,
        rows,
        caption="Mean wind vector disagreement of the last seven days with reports and of the days "
        "before; whether the table that would be sent now differs from the one in use beyond the "
        f"error of both (n = {plural(len(states), 'aircraft', 'aircraft')}{more}).",
    )


def _worst_first(state: State) -> tuple[bool, float, str]:
    past = state.past_disagreement_kt
    risen = (state.disagreement_kt or 0.0) / past if past else 0.0
    return (not state.tables_differ, -risen, state.aircraft)


def _number(value: float | None) -> str:
    return "-" if value is None else number_text(value)
