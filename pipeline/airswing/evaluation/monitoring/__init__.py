"""Changes of the fleet: compasses that changed, events since the last run, states of the aircraft.

:func:`watch_compasses` tests the compasses of an archive; its ``changes`` are those of
``stability.json`` and, by :func:`add_changes`, of ``fits.nc``. :func:`find_events` takes the
headings of the whole archive (lazy, all months joined), the fits and the state of the last run, and
returns the content of ``events.json``.
"""

from airswing.evaluation.monitoring.changes import (
    CompassWatch,
    add_changes,
    change_warnings,
    fit_by_window,
    noted_changes,
    watch_compasses,
)
from airswing.evaluation.monitoring.events import (
    Event,
    Monitoring,
    State,
    UnitTable,
    changed_since,
    find_events,
    read_events,
    read_tables,
    tables_of,
    with_tables,
    write_events,
)

__all__ = [
    "CompassWatch",
    "Event",
    "Monitoring",
    "State",
    "UnitTable",
    "add_changes",
    "change_warnings",
    "changed_since",
    "find_events",
    "fit_by_window",
    "noted_changes",
    "read_events",
    "read_tables",
    "tables_of",
    "watch_compasses",
    "with_tables",
    "write_events",
]
