"""States of the aircraft and events since the last run: the content of ``events.json``.

A run tests the whole archive and reports the events that no earlier run reported. A state gives, of
every aircraft, the table in use and the one that would be sent now. Two tables differ where the
difference at a node is beyond the 95 % limit of the largest of eight independent ones (Sidak 1967,
J. Am. Stat. Assoc. 62, 626-633) and beyond the resolution of a unit. Days are UTC dates, angles
degrees, winds knots.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from pydantic import TypeAdapter

from airswing.compass.correction import (
    NODES,
    SIGNS,
    curve_standard_error,
    error_from_table,
    main_reference,
    require_tables,
)
from airswing.errors import InputError
from airswing.evaluation.innovations import Ints, chunks, members_of
from airswing.evaluation.monitoring.changes import (
    CompassWatch,
    date_of,
    rows_by_aircraft,
    step_numbers,
    watch_compasses,
)
from airswing.evaluation.monitoring.fleet_watch import COMPASS, WIND, watch_fleet
from airswing.evaluation.monitoring.step_test import LONGEST, Step
from airswing.flags import is_corrected, published
from airswing.products.whole_files import write_json
from airswing.units import KNOT, NORMAL_95

VERSION = 2
NAMED = 20  # most aircraft of a list that the text names; the file names all
LAST_DAYS = 7  # days with reports whose disagreement is compared with that of the days before
LEARNING = 14  # days of an archive in which an aircraft's first report is not reported as new
SAME = 3  # days by which the date of a silence may differ between two runs
RARE = 1e-6  # probability of a silence by chance, at the aircraft's share of days with reports
SHORTEST = 5  # days without a report that are never reported
REPORTING = 0.2  # share of the fleet's median number below which a day is a gap of the archive
LARGEST_OF_EIGHT = 2.727
"""95 % point of the largest absolute value of eight standard normal numbers."""
RESOLUTION = 0.1  # degrees by which two tables may differ from rounding
LEAST = 0.3
"""m/s: smaller differences are set to this, so that rounding does not enter the logarithm."""
Kind = Literal[
    "compass_changed", "disagreement_rose", "aircraft_new", "aircraft_silent", "reference_changed"
]
WORDS: dict[str, str] = {
    "compass_changed": "compass changed",
    "disagreement_rose": "disagreement rose",
    "aircraft_new": "new aircraft",
    "aircraft_silent": "silent",
    "reference_changed": "reference changed for all aircraft",
}


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    kind: Kind
    date: str  # its first day
    noticed: str  # day on which it was detected
    aircraft: str | None  # None: all aircraft
    # of a step ``date_ci``, ``statistic``, its ``threshold`` and ``aircraft_that_night``; of a
    # compass ``change_deg``, ``standard_error_deg`` (of A to E) and ``curve_rms_deg``; of a
    # disagreement ``factor`` and ``standard_error``; of a silence ``days`` and ``usual_days``
    evidence: dict[str, Any]

    @property
    def details(self) -> str:
        """Size of a change with its 95 % interval, or length of a silence."""
        facts = self.evidence
        if "factor" in facts:
            half = NORMAL_95 * facts["standard_error"]
            return f"{facts['factor']:.2f} ± {half:.2f} times the past disagreement"
        if "curve_rms_deg" in facts:
            offset, half = (facts[key]["A"] for key in ("change_deg", "standard_error_deg"))
            offset_text = f"offset {offset:+.1f} ± {NORMAL_95 * half:.1f}"
            return f"by {facts['curve_rms_deg']:.1f} degrees rms, {offset_text}"
        if "days" in facts:
            return f"no report for {facts['days']} days; up to {facts['usual_days']} is usual"
        return ""

    @property
    def line(self) -> str:
        """The event in one line."""
        details, (low, high) = self.details, self.evidence.get("date_ci", ("", ""))
        details += f", between {low} and {high}" if low != high else ""
        details = f" ({details}; noticed {self.noticed})" if details else ""
        return f"{self.date}  {self.aircraft or 'fleet'}: {WORDS[self.kind]}{details}"


@dataclass(frozen=True)
class UnitTable:
    """A correction table at the eight nodes, to add to the indicated heading; degrees."""

    correction_deg: list[float]
    standard_error_deg: list[float]


@dataclass
class State:
    """State of an aircraft on the last day."""

    aircraft: str
    first_day: str  # with reports
    last_day: str
    silent: bool = False
    table_in_use: UnitTable | None = None  # on board, or applied
    table_now: UnitTable | None = None  # would be sent now
    tables_differ: bool | None = None  # follows from the tables; None without both
    table_difference_deg: float | None = None  # rms over the nodes
    disagreement_kt: float | None = None  # mean wind vector difference of the last days
    past_disagreement_kt: float | None = None  # and of the days before

    def __post_init__(self) -> None:
        if self.table_in_use is None or self.table_now is None:
            self.tables_differ = self.table_difference_deg = None
        else:
            differences = tables_differ(self.table_in_use, self.table_now)
            self.tables_differ, self.table_difference_deg = differences


@dataclass(frozen=True)
class Monitoring:
    """States and events of a fleet."""

    until: str  # last day
    reference: str
    states: list[State]
    events: list[Event]  # of all runs, in the order they were noticed
    reported_before: int = 0  # number of events that earlier runs reported; the others are new
    # number of the last events that may not have been shown, because a command was killed: they are
    # also new to the next run
    unsaid: int = 0

    def __repr__(self) -> str:
        return self.text

    @property
    def new_events(self) -> list[Event]:
        """Events that no earlier run reported."""
        return self.events[self.reported_before :]

    @property
    def differing(self) -> list[str]:
        """Aircraft to which another table should be sent."""
        return [state.aircraft for state in self.states if state.tables_differ]

    @property
    def text(self) -> str:
        """Summary: a line for every new event, and the aircraft that need a table or are silent."""
        news, silent = self.new_events, [state.aircraft for state in self.states if state.silent]
        lines = [
            f"Monitoring up to {self.until}: {len(news) or 'no'} new event{'s' * (len(news) != 1)}",
            *(event.line for event in news),
        ]
        for words, names in (("another table for", self.differing), ("silent", silent)):
            if names:
                more = f" and {len(names) - NAMED:,} more" if len(names) > NAMED else ""
                lines.append(f"{words}: {', '.join(names[:NAMED])}{more}")
        return "\n".join(lines)


def write_events(monitoring: Monitoring, path: Path) -> Path:
    """Write ``events.json``."""
    return write_json(path, {"version": VERSION, **asdict(monitoring)})


def read_events(path: Path) -> Monitoring:
    """Read ``events.json``; InputError if it is not such a file."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        if content.pop("version") != VERSION:
            raise ValueError("version")
        return TypeAdapter(Monitoring).validate_python(content)
    except (ValueError, TypeError, KeyError, AttributeError) as err:
        raise InputError(
            "not an events.json that this version can read",
            file=path,
            found=err,
            remedy="Remove it: monitoring restarts, and may report events again",
        ) from err


def find_events(
    headings: xr.Dataset,
    fits: xr.Dataset,
    *,
    corrected: xr.Dataset | None = None,
    previous: Monitoring | None = None,
    until: np.datetime64 | str | None = None,
    reference: str | None = None,
    members: list[str] | None = None,
    tables_in_use: Mapping[str, UnitTable] | None = None,
    compass: CompassWatch | None = None,
) -> Monitoring:
    """Find the states of all aircraft and the events since the last run.

    Parameters
    ----------
    headings : Dataset
        Screened headings of the whole archive, in memory or lazy (all months joined).
    fits : Dataset
        With tables.
    corrected : Dataset, optional
        Corrected winds of the same reports; the disagreement is that of the corrected winds.
    previous : Monitoring, optional
        State of the last run: its events are not reported again, and its tables in use remain.
    until : datetime64 or str, optional
        Last day; that of the last report by default.
    reference : str, optional
        Reference or pool of the fits; the first pool, else the first reference, by default.
    members : list of str, optional
        References whose mean the reports are compared with; by default the members of
        ``reference`` (:func:`airswing.evaluation.innovations.members_of`).
    tables_in_use : mapping of str to UnitTable, optional
        Tables on board, by aircraft. By default those of ``previous``, else those of the fits.
    compass : CompassWatch, optional
        Result of :func:`airswing.watch_compasses` for the same headings, if available.

    Returns
    -------
    Monitoring
        States of the aircraft, all ``events``, and the ``new_events`` since ``previous``.

    Raises
    ------
    InputError
        If there is no report up to the day.

    Examples
    --------
    >>> monitoring = airswing.find_events(headings, fits, reference="ruc", members=["ruc"])
    >>> len(monitoring.new_events) <= len(monitoring.events)
    True
    """
    name, aircraft = reference or main_reference(fits), headings["aircraft"].to_numpy().astype(str)
    members = members or members_of(headings, name)
    winds = wind_days(headings, members, corrected=corrected)
    last = int(winds["day"].to_numpy().max(initial=0)) if until is None else _day(until)
    winds = winds[winds["day"] <= last]
    if winds.empty:
        raise InputError("no report to monitor", field="until", found=date_of(last))
    if compass is None:
        abscissa: Any = fits.attrs.get("abscissa", "magnetic")
        compass = watch_compasses(headings, members=members, abscissa=abscissa)
    # a run for an earlier day reports what was noticed until then
    turned = [step for step in compass.tested.alarms if step.night <= last]
    used = winds[winds["count"] > 0]
    risen = watch_fleet(
        used["aircraft"].to_numpy(),
        used["day"].to_numpy(),
        used["count"].to_numpy()[:, np.newaxis, np.newaxis],
        used["log_difference"].to_numpy()[:, np.newaxis],
        WIND,
        aircraft.size,
    ).alarms
    events = [_step_event(step, aircraft, "compass_changed") for step in turned]
    steps = [(step.number, step.day) for step in turned]
    for step in risen:
        covered = any(k == step.number and abs(day - step.day) <= LONGEST // 2 for k, day in steps)
        # a decrease needs no action, and a step explains an increase
        if step.change[0] > 0 and not covered:
            events.append(_step_event(step, aircraft, "disagreement_rose"))
    days = winds["aircraft"].to_numpy(), winds["day"].to_numpy()
    begin, silences = first_days_and_silences(*days, aircraft.size, last)
    for silence in silences:
        dates = date_of(silence.first), date_of(silence.noticed)
        evidence = {"days": silence.usual_days + 1, "usual_days": silence.usual_days}
        events.append(Event("aircraft_silent", *dates, str(aircraft[silence.number]), evidence))
    # an aircraft that begins with the archive is not new
    new = (begin >= winds["day"].min() + LEARNING) & (begin <= last)
    if previous is None:
        previous = Monitoring(date_of(0), name, [], [])
    else:
        new = (begin <= last) & ~np.isin(aircraft, [state.aircraft for state in previous.states])
    events += [
        Event("aircraft_new", date_of(day), date_of(day), str(who), {})
        for who, day in zip(aircraft[new], begin[new], strict=True)
    ]
    news = _not_reported(events, previous)
    news.sort(key=lambda event: (event.noticed, event.date, event.aircraft or ""))
    before = {state.aircraft: state for state in previous.states}
    if previous.reference != name:  # its tables are of another reference
        before = {who: replace(state, table_in_use=None) for who, state in before.items()}
    now = tables_of(fits.sel(reference=name))
    in_use = now | {who: state.table_in_use for who, state in before.items() if state.table_in_use}
    in_use |= tables_in_use or {}
    silent = {silence.number for silence in silences if silence.lasts}
    present = {}
    for _, rows in winds.groupby("aircraft"):
        number = int(rows["aircraft"].iloc[0])
        who, (first, seen) = str(aircraft[number]), map(date_of, rows["day"].iloc[[0, -1]])
        measured = rows[rows["count"] > 0]
        means = [
            float(span["difference"].sum() / span["count"].sum() / KNOT) if len(span) else None
            for span in (measured[-LAST_DAYS:], measured[:-LAST_DAYS])
        ]
        state = State(who, first, seen, number in silent, in_use.get(who), now.get(who))
        present[who] = replace(state, disagreement_kt=means[0], past_disagreement_kt=means[1])
    # an aircraft whose reports were removed is remembered, and is not new when it returns
    gone = [state for who, state in before.items() if who not in present]
    return Monitoring(
        date_of(last),
        name,
        [*present.values(), *gone],
        [*previous.events, *news],
        len(previous.events) - previous.unsaid,
    )


def wind_days(
    headings: xr.Dataset, members: list[str], *, corrected: xr.Dataset | None = None
) -> pd.DataFrame:
    """Sum the wind vector differences of a fleet from the mean of some references, by day.

    Corrected winds, where given, are used where a correction was applied. Rows are sorted by
    ``aircraft`` (its number) and ``day`` (since 1970) with reports; ``count`` of reports used, 0
    where screening left none, summed ``difference`` (m/s) and ``log_difference`` (natural).
    """
    tables = []
    for chunk in chunks(headings, {"": members}, ["screening"], corrected):
        wind = np.where(is_corrected(chunk.applied), chunk.corrected, chunk.wind)
        difference = np.hypot(*(wind - chunk.model[""]))
        used = (chunk.column("screening") == 0) & np.isfinite(difference)
        values = {
            "aircraft": chunk.aircraft,
            "day": chunk.day,
            "count": used * 1.0,
            "difference": np.where(used, difference, 0.0),
            "log_difference": np.where(used, np.log(np.maximum(difference, LEAST)), 0.0),
        }
        tables.append(pd.DataFrame(values).groupby(["aircraft", "day"], as_index=False).sum())
    return pd.concat(tables, ignore_index=True)


def changed_since(monitoring: Monitoring) -> dict[str, str]:
    """Aircraft whose compass changed, and the latest possible day of the last change."""
    since: dict[str, str] = {}
    for event in monitoring.events:
        if event.kind == "compass_changed" and event.aircraft is not None:
            # a table from earlier reports could partly describe the old compass
            latest = str(event.evidence["date_ci"][1])
            since[event.aircraft] = max(latest, since.get(event.aircraft, latest))
    return since


def with_tables(monitoring: Monitoring, now: Mapping[str, UnitTable | None]) -> Monitoring:
    """States with other tables that would be sent now, by aircraft (None: no table yet)."""
    tables = ((state, now.get(state.aircraft, state.table_now)) for state in monitoring.states)
    return replace(monitoring, states=[replace(state, table_now=table) for state, table in tables])


def _step_event(step: Step, aircraft: NDArray[np.str_], kind: Kind) -> Event:
    dates = date_of(step.day), date_of(step.night)
    if kind == "compass_changed":
        evidence, law = step_numbers(step), COMPASS.law
    else:
        factor, law = float(np.exp(step.change[0])), WIND.law
        evidence = {"factor": factor, "standard_error": factor * float(step.error[0])}
        evidence["date_ci"] = [date_of(step.earliest), date_of(step.latest)]
    evidence |= {"threshold": law.threshold, "statistic": step.statistic}
    evidence["aircraft_that_night"] = step.reporting
    if step.number < 0:
        return Event("reference_changed", *dates, None, evidence)
    return Event(kind, *dates, str(aircraft[step.number]), evidence)


class Silence(NamedTuple):
    """A silence of an aircraft; days since 1970."""

    number: int  # of the aircraft
    first: int
    noticed: int
    usual_days: int  # it is noticed on the day after
    lasts: bool  # until the last day


def first_days_and_silences(
    aircraft: Ints, day: Ints, number: int, last: int
) -> tuple[Ints, list[Silence]]:
    """First day of every aircraft (beyond ``last`` if it never reported), and its silences.

    An aircraft is silent when it has not reported for longer than twice its longest gap and longer
    than a gap of probability :data:`RARE` at its share of days with reports. Days on which hardly
    any aircraft reports are gaps of the archive. ``aircraft`` and ``day`` (since 1970) are the days
    with reports, sorted by aircraft and day.
    """
    base = int(day.min())
    counts = np.bincount(day - base, minlength=last + 1 - base)
    open_days = np.cumsum(counts >= REPORTING * np.median(counts[counts > 0]))
    begin, silences = np.full(number, last + 1), []
    for k, rows in enumerate(rows_by_aircraft(aircraft, number)):
        if rows.start == rows.stop:
            continue
        begin[k] = day[rows.start]
        edge = np.append(open_days[day[rows] - base], open_days[-1])
        gaps = np.diff(edge) - 1  # open days between two days with reports
        gaps[-1] += 1
        # longest gap that is usual by the days before each gap
        flown = np.arange(1, gaps.size + 1)
        before = np.concatenate([[0], np.cumsum(gaps)[:-1]])
        idle = (before + 1.0) / (flown + before + 2.0)
        longest = np.concatenate([[0], np.maximum.accumulate(gaps)[:-1]])
        chance = np.ceil(np.log(RARE) / np.log(idle))
        usual = np.maximum(np.maximum(SHORTEST, 2 * longest), chance).astype(np.int64)
        for j in np.flatnonzero(gaps > usual):
            first, noticed = np.searchsorted(open_days, edge[j] + [1, usual[j] + 1]) + base
            lasts = bool(j == gaps.size - 1)
            silences.append(Silence(k, int(first), int(noticed), int(usual[j]), lasts))
    return begin, silences


def _not_reported(events: list[Event], before: Monitoring) -> list[Event]:
    """Events not among the earlier ones, whose dates may differ slightly when reports arrive late.

    An event of a month ago and more that earlier runs could have noticed and did not is not
    reported either: they estimated the errors of the days differently.
    """
    remaining: dict[tuple[str, str | None], list[Event]] = {}
    for event in before.events:
        remaining.setdefault((event.kind, event.aircraft), []).append(event)
    news = []
    seen = {None, *(state.aircraft for state in before.states)}
    for event in sorted(events, key=lambda event: event.date):
        span = SAME if event.kind == "aircraft_silent" else LONGEST
        earlier = remaining.get((event.kind, event.aircraft), [])
        gaps = [(abs(_day(old.date) - _day(event.date)), k) for k, old in enumerate(earlier)]
        gap, k = min(gaps, default=(span + 1, -1))
        # an aircraft is new only once, even if its first day has changed
        if gap <= span or (gaps and event.kind == "aircraft_new"):
            # an old event explains a single new event: a second at the same date is new
            del earlier[k]
        elif event.aircraft not in seen or _day(event.noticed) > _day(before.until) - LONGEST:
            news.append(event)
    return news


def tables_differ(first: UnitTable, second: UnitTable) -> tuple[bool, float]:
    """Whether two tables differ beyond the error of both, and their rms difference, degrees."""
    gap = np.subtract(first.correction_deg, second.correction_deg)
    error = np.hypot(first.standard_error_deg, second.standard_error_deg)
    beyond = (np.abs(gap) > LARGEST_OF_EIGHT * error) & (np.abs(gap) > RESOLUTION)
    return bool(beyond.any()), float(np.sqrt((gap**2).mean()))


def tables_of(fits: xr.Dataset) -> dict[str, UnitTable]:
    """Tables that would be sent, by aircraft, of the published fits of one reference."""
    require_tables(fits)
    correction = -error_from_table(fits).transpose("aircraft", "node").to_numpy()
    covariance = fits["deviation_covariance"].to_numpy()
    good = published(fits["status"].to_numpy()) & np.isfinite(correction).all(axis=1)
    return {
        str(fits["aircraft"].to_numpy()[k]): UnitTable(
            [round(float(value), 4) + 0.0 for value in correction[k]],
            [round(float(value), 4) for value in curve_standard_error(covariance[k], NODES)],
        )
        for k in np.flatnonzero(good)
    }


def read_tables(path: Path | str, *, reference: str) -> dict[str, UnitTable]:
    """Tables in use by aircraft, from a file in the format of ``tables.csv``.

    Only rows of ``reference`` are used if the file has several references, and only aircraft with
    all eight nodes. Rows without a number are ignored. InputError if it is not such a file.
    """
    try:
        numbers = ("table_correction_deg", "standard_error_deg")
        lines = pd.read_csv(
            path,
            dtype={"aircraft": str, "reference": str, "sign": str},
            keep_default_na=False,
            na_values={name: [""] for name in numbers},
        )
        references = lines["reference"].drop_duplicates().tolist()
        if reference not in references and len(references) > 1:
            raise ValueError(f"tables against {', '.join(references)}, none against {reference}")
        wanted = reference if reference in references else next(iter(references), reference)
        lines = lines[(lines["reference"] == wanted) & lines["table_correction_deg"].notna()]
        lines["to_add"] = -lines["sign"].map(SIGNS.__getitem__) * lines["table_correction_deg"]
        lines["error"] = lines["standard_error_deg"].fillna(0.0)
        bad = ~(lines["to_add"].abs() <= 180.0) | ~lines["error"].between(0.0, 180.0)
        if bad.any():
            row = lines[bad].iloc[0]
            raise ValueError(f"{row.to_add} with error {row.error} at {row.aircraft}")
        lines = lines.drop_duplicates(["aircraft", "heading_deg"], keep="last")
        lines = lines.sort_values("heading_deg", kind="stable")
    except (OSError, ValueError, KeyError, TypeError, UnicodeError) as err:
        field, remedy = "monitoring.tables_in_use", "Give the path of a tables.csv of a run"
        message = "not a file of tables"
        raise InputError(message, file=path, field=field, found=err, remedy=remedy) from err
    return {
        str(name): UnitTable(rows["to_add"].tolist(), rows["error"].tolist())
        for name, rows in lines.groupby("aircraft")
        if rows["heading_deg"].tolist() == NODES.tolist()
    }


def _day(day: np.datetime64 | str) -> int:
    return int(np.datetime64(day).astype("datetime64[D]").astype(np.int64))
