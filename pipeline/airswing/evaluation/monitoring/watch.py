"""States and events of a fleet from the products of a run.

Assumes screened headings, the fits with their tables and, where given, the corrected winds of the
same reports. What is told is what the reports up to the last day asked for show, taken in night by
night as if each had been the last one: the date an event is noticed is the first night that shows
it. An event that an earlier look told is not told again.

A change of a compass raises the disagreement of its wind too: that is one event, the change's. An
aircraft is silent when it has not reported for much longer than its own habit explains, counted on
days on which the fleet reports.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.events_file import (
    Event,
    Evidence,
    Kind,
    Monitoring,
    State,
    UnitTable,
)
from airswing.evaluation.monitoring.daily_evidence import Names, Rows, daily_rows
from airswing.evaluation.monitoring.fleet_watch import (
    COMPASS,
    COMPASS_COMMON,
    COMPASS_NOISE,
    WIND,
    WIND_COMMON,
    WIND_NOISE,
    Alarm,
    KeptWatch,
    watch_fleet,
)
from airswing.evaluation.monitoring.presence import first_and_silent_days
from airswing.evaluation.monitoring.sequential_test import LONGEST
from airswing.evaluation.monitoring.table_difference import differ, tables_of
from airswing.units import KNOT

LAST_DAYS = 7
"""Days with reports whose disagreement is held against the days before."""
LEARNING = 14
"""Days of an archive in which an aircraft's first report is no news."""
SAME = 3
"""Days by which the date of one and the same event may differ between two looks."""


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
) -> Monitoring:
    """Say how every aircraft stands, and what happened to the fleet.

    Parameters
    ----------
    headings : Dataset
        Screened, ragged, in memory or opened lazily: some whole aircraft are read at a time.
    fits : Dataset
        With tables.
    corrected : Dataset, optional
        The same reports corrected: the disagreement is that of the corrected winds.
    previous : Monitoring, optional
        Of the last look: what it told is not told again, and the tables it had in use still are.
    until : datetime64 or str, optional
        Last day that is looked at; the last one with a report by default.
    reference : str, optional
        Whose fits and tables; the first pool, else the first reference, by default.
    members : list of str, optional
        References whose mean the reports are compared with; by default ``reference`` itself where
        the headings have it, else all.
    tables_in_use : mapping of str to UnitTable, optional
        Tables that are on board, by aircraft. By default those of ``previous``, else those of the
        fits: what was in use is then what was first seen.
    """
    name = reference or leading_reference(fits)
    known = headings["reference"].to_numpy().astype(str).tolist()
    members = members or ([name] if name in known else known)
    abscissa = str(fits.attrs.get("abscissa", "magnetic"))
    rows = daily_rows(headings, members, abscissa=abscissa, corrected=corrected)
    return events_of(
        headings["aircraft"].to_numpy().astype(str),
        rows,
        fits.sel(reference=name),
        previous=previous,
        until=until,
        tables_in_use=tables_in_use,
    )


def events_of(
    names: Names,
    rows: Rows,
    fit: xr.Dataset,
    *,
    previous: Monitoring | None = None,
    until: np.datetime64 | str | None = None,
    tables_in_use: Mapping[str, UnitTable] | None = None,
    kept: Mapping[str, KeptWatch] | None = None,
) -> Monitoring:
    """As :func:`find_events`, from the rows of an archive that was read before.

    Parameters
    ----------
    names : array of str
        Aircraft that the rows number.
    rows : Rows
        Of :func:`airswing.evaluation.monitoring.daily_evidence.daily_rows`.
    fit : Dataset
        Fits with tables of one reference.
    previous, until, tables_in_use
        As for :func:`find_events`.
    kept : mapping of str to KeptWatch, optional
        Where the watch of the ``compass`` and of the ``wind`` is kept from one look to the next.

    Raises
    ------
    InputError
        If there is no report up to the day.
    """
    name = str(fit["reference"].item())
    last = int(rows.day.max(initial=0)) if until is None else _day(until)
    # what came later must not be known: a look at an earlier day tells what was told then
    rows = rows.of(rows.day <= last)
    if not rows.day.size:
        raise InputError("no report to watch", field="until", found=_date(last))
    if previous is not None and previous.reference != name:  # tables of another reference
        states = [replace(state, table_in_use=None) for state in previous.states]
        previous = replace(previous, states=states)
    silent, presence = _presence(rows, names, last, new=previous is None)
    found = [*_alarms(rows, names, kept or {}), *presence]
    if previous is not None:
        seen = {state.aircraft for state in previous.states}
        found += _new_aircraft(rows, names, seen)
        found = _not_told(found, previous)
    told = [] if previous is None else previous.events
    # a reference's event has no aircraft
    order = sorted(found, key=lambda event: (event.noticed, event.date, event.aircraft or ""))
    now = tables_of(fit)
    before = {} if previous is None else {state.aircraft: state for state in previous.states}
    in_use = {who: state.table_in_use for who, state in before.items() if state.table_in_use}
    # the last one counts: what the user says over what was first seen over what the fits have
    in_use = now | in_use | dict(tables_in_use or {})
    states = _states(rows, names, silent, now, in_use)
    there = {one.aircraft for one in states}
    # an aircraft whose reports were removed is still known, and not new when it comes back
    gone = [state for who, state in before.items() if who not in there]
    unsaid = 0 if previous is None else previous.unsaid
    return Monitoring(_date(last), name, [*states, *gone], [*told, *order], len(told) - unsaid)


def changed_since(found: Monitoring) -> dict[str, str]:
    """Aircraft whose compass changed, and the last day that its last change may have been."""
    since: dict[str, str] = {}
    for event in found.events:
        if event.kind == "compass_changed" and event.aircraft is not None:
            # a table learned from before it could be half of the compass before
            latest = str(event.evidence["date_ci"][1])
            since[event.aircraft] = max(latest, since.get(event.aircraft, latest))
    return since


def with_tables(found: Monitoring, now: Mapping[str, UnitTable | None]) -> Monitoring:
    """The same with other tables that would be sent now.

    Parameters
    ----------
    now : mapping of str to UnitTable or None
        By aircraft; None where none is to be sent yet.
    """
    states = [
        _compared(replace(one, table_now=now[one.aircraft])) if one.aircraft in now else one
        for one in found.states
    ]
    return replace(found, states=states)


def _compared(state: State) -> State:
    if state.table_in_use is None or state.table_now is None:
        return replace(state, tables_differ=None, table_difference_deg=None)
    unlike, rms = differ(state.table_in_use, state.table_now)
    return replace(state, tables_differ=unlike, table_difference_deg=rms)


def _alarms(rows: Rows, names: Names, kept: Mapping[str, KeptWatch]) -> list[Event]:
    """Steps of compasses and of disagreements, those of the reference among them."""
    used = rows.of(rows.count > 0)
    turned = watch_fleet(
        (used.aircraft, used.day, used.normal, used.right),
        COMPASS,
        usual=COMPASS_NOISE,
        common=COMPASS_COMMON,
        number=names.size,
        kept=kept.get("compass"),
    )
    wind = watch_fleet(
        (
            used.aircraft,
            used.day,
            used.count[:, np.newaxis, np.newaxis],
            # logarithms: a rise is a factor, whatever an aircraft's own level
            used.log_difference[:, np.newaxis],
        ),
        WIND,
        usual=WIND_NOISE,
        common=WIND_COMMON,
        number=names.size,
        kept=kept.get("wind"),
    )
    # a disagreement that falls is no news to act on
    rose = [alarm for alarm in wind if alarm.step.size[0] > 0 and not _explained(alarm, turned)]
    return [
        *(_compass_event(alarm, names) for alarm in turned),
        *(_wind_event(alarm, names) for alarm in rose),
    ]


def _explained(rise: Alarm, turned: list[Alarm]) -> bool:
    """Whether the same compass, or the reference, stepped when the disagreement rose."""
    return any(
        other.step.number == rise.step.number
        and abs(other.step.day - rise.step.day) <= LONGEST // 2
        for other in turned
    )


def _compass_event(alarm: Alarm, names: Names) -> Event:
    degrees, error = np.degrees(alarm.step.size[:5]), np.degrees(alarm.step.error[:5])
    return _step_event(
        alarm,
        names,
        "compass_changed",
        {
            "change_deg": dict(zip("ABCDE", map(float, degrees), strict=True)),
            "standard_error_deg": dict(zip("ABCDE", map(float, error), strict=True)),
            # rms over the compass
            "curve_rms_deg": float(np.sqrt(degrees[0] ** 2 + (degrees[1:] ** 2).sum() / 2.0)),
            "threshold": COMPASS.threshold,
        },
    )


def _wind_event(alarm: Alarm, names: Names) -> Event:
    size, error = float(alarm.step.size[0]), float(alarm.step.error[0])
    evidence: Evidence = {
        "factor": float(np.exp(size)),
        # of a factor whose logarithm has this error
        "standard_error": float(np.exp(size) * error),
        "threshold": WIND.threshold,
    }
    return _step_event(alarm, names, "disagreement_rose", evidence)


def _step_event(alarm: Alarm, names: Names, kind: Kind, evidence: Evidence) -> Event:
    step, all_at_once = alarm.step, alarm.step.number < 0
    return Event(
        "reference_changed" if all_at_once else kind,
        _date(step.day),
        _date(alarm.night),
        None if all_at_once else str(names[step.number]),
        {
            "date_ci": [_date(step.earliest), _date(step.latest)],
            "statistic": step.statistic,
            **evidence,
            "aircraft_that_night": alarm.aircraft,
        },
    )


def _presence(
    rows: Rows, names: Names, last: int, *, new: bool
) -> tuple[NDArray[np.bool_], list[Event]]:
    """Which aircraft are silent now, and events of aircraft that fell silent or are new."""
    found: list[Event] = []
    silent = np.zeros(names.size, dtype=np.bool_)
    begin, spells = first_and_silent_days(rows.aircraft, rows.day, names.size, last)
    for spell in spells:
        silent[spell.number] |= spell.lasts
        evidence: Evidence = {"days": spell.days, "usual_days": spell.usual_days}
        found.append(
            Event(
                "aircraft_silent",
                _date(spell.first),
                _date(spell.noticed),
                str(names[spell.number]),
                evidence,
            )
        )
    # at the first look only: an aircraft that begins with the archive is not new, one that joins it
    # is
    late = new & (begin >= rows.day.min() + LEARNING) & (begin <= last)
    found += [_first_seen(str(names[k]), int(begin[k])) for k in np.flatnonzero(late)]
    return silent, found


def _new_aircraft(rows: Rows, names: Names, seen: set[str]) -> list[Event]:
    """Aircraft that the last look did not know."""
    never = np.iinfo(np.int64).max
    begin = np.full(names.size, never)
    np.minimum.at(begin, rows.aircraft, rows.day)
    return [
        _first_seen(str(name), int(day))
        for name, day in zip(names, begin, strict=True)
        if name not in seen and day != never
    ]


def _first_seen(name: str, day: int) -> Event:
    return Event("aircraft_new", _date(day), _date(day), name, {})


def _not_told(found: list[Event], before: Monitoring) -> list[Event]:
    """Events that none of the earlier ones is: dates move a little when reports come late.

    What earlier looks at the same aircraft could have noticed a month ago and more, and did not,
    is no news either: the errors of the days were estimated otherwise then.
    """
    left: dict[tuple[str, str | None], list[Event]] = {}
    for told in before.events:
        left.setdefault((told.kind, told.aircraft), []).append(told)
    news = []
    seen = {None, *(state.aircraft for state in before.states)}
    for event in sorted(found, key=lambda event: event.date):
        span = SAME if event.kind == "aircraft_silent" else LONGEST
        alike = left.get((event.kind, event.aircraft), [])
        gaps = [(abs(_day(one.date) - _day(event.date)), k) for k, one in enumerate(alike)]
        gap, k = min(gaps, default=(span + 1, -1))
        # an aircraft is new once, whatever its first day is now
        if gap <= span or (gaps and event.kind == "aircraft_new"):
            # an old event explains one new one: a second at the same date is news
            del alike[k]
        elif event.aircraft not in seen or _day(event.noticed) > _day(before.until) - LONGEST:
            news.append(event)
    return news


def _states(
    rows: Rows,
    names: Names,
    silent: NDArray[np.bool_],
    now: dict[str, UnitTable],
    in_use: dict[str, UnitTable],
) -> list[State]:
    """How every aircraft that ever reported stands."""
    edges = np.searchsorted(rows.aircraft, np.arange(names.size + 1))
    found = []
    for k, (begin, stop) in enumerate(pairwise(edges)):
        if begin == stop:
            continue
        own, name = rows.of(slice(begin, stop)), str(names[k])
        # days of reports that screening or a missing model left none of
        winds = own.of(own.count > 0)
        state = State(
            name,
            _date(int(own.day[0])),
            _date(int(own.day[-1])),
            bool(silent[k]),
            in_use.get(name),
            now.get(name),
            disagreement_kt=_mean_knots(winds.of(slice(-LAST_DAYS, None))),
            past_disagreement_kt=_mean_knots(winds.of(slice(0, -LAST_DAYS))),
        )
        found.append(_compared(state))
    return found


def _mean_knots(rows: Rows) -> float | None:
    number = float(rows.count.sum())
    return float(rows.difference.sum()) / number / KNOT if number else None


def leading_reference(fits: xr.Dataset) -> str:
    """First pool, else first reference, of fits as a run makes them."""
    names = fits["reference"].to_numpy().astype(str)
    single = int(fits.attrs.get("reference_count", names.size))
    return str(names[single if single < names.size else 0])


def _day(day: np.datetime64 | str) -> int:
    return int(np.datetime64(day).astype("datetime64[D]").astype(np.int64))


def _date(day: int) -> str:
    return str(np.datetime64(int(day), "D"))
