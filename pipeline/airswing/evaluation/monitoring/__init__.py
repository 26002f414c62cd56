"""Watching a fleet night by night: how every aircraft stands, and what happened, told once."""

from airswing.evaluation.events_file import (
    Event,
    Monitoring,
    State,
    UnitTable,
    read_events,
    write_events,
)
from airswing.evaluation.monitoring.table_difference import read_tables
from airswing.evaluation.monitoring.watch import events_of, find_events

__all__ = [
    "Event",
    "Monitoring",
    "State",
    "UnitTable",
    "events_of",
    "find_events",
    "read_events",
    "read_tables",
    "write_events",
]
