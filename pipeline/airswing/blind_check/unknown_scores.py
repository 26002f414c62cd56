"""What a diagnosis got right about an effect for which there is no name.

Assumptions
-----------
* The places of an unknown (``unknown.where``) are judged as they stand, the one that closes most
  first: its first variable is what the diagnosis says carries the effect.
* A variable is right when it is one of those the effect acts by, under any of the names a report
  has for it (`SAME`). Beside that strict score stands a lenient one: a variable that alone carries
  at least `CARRIES` of what the best of the true ones carries on this archive is as good.
* A place without aircraft is the whole fleet.
* The closure of an unknown is ``unknown.closure`` with what the names beside it close; its truth is
  the archive's against its twin. An unknown that states none, or is not raised, states nil.

Units: kt, fractions.
"""

from __future__ import annotations

from collections.abc import Sequence

from airswing.blind_check.scores import Found
from airswing.gap.result.schema import GapReport, PlaceEntry
from airswing.synthetic.sealed.labels import Label, OutsideTruth

__all__ = [
    "CARRIES",
    "SAME",
    "of_background",
    "only_of_background",
    "same_variable",
    "unknown_scores",
]

# Variables go together (pressure and temperature): one that tells nearly as much is no error.
CARRIES = 0.8

# Other names of a variable.
SAME: dict[str, tuple[str, ...]] = {
    "magnetic_heading": ("heading", "true_heading", "indicated_heading"),
    "heading": ("magnetic_heading", "true_heading", "indicated_heading"),
    "track": ("ground_track",),
    "wind_direction": ("reported_wind_direction", "reported_direction", "direction"),
    "wind_speed": ("reported_wind_speed", "reported_speed", "wind"),
    "hour": ("hour_of_day", "time_of_day"),
    "date": ("time", "day"),
    "altitude": ("pressure", "level", "pressure_altitude", "height"),
    "airspeed": ("true_airspeed", "indicated_airspeed"),
    "temperature": ("air_temperature",),
    "phase": ("flight_phase",),
    "bank": ("roll", "turn"),
    "drift": ("drift_angle", "crosswind"),
    "acceleration": ("longitudinal_acceleration",),
    "longitude": ("region",),
    "latitude": ("region",),
}


def same_variable(told: str, true: str) -> bool:
    """Return whether a variable told is the true one, under any of its names."""
    return told == true or told in SAME.get(true, ())


def of_background(label: Label, place: PlaceEntry) -> bool:
    """Return whether a place is of what the world has in the background, on all aircraft.

    Parameters
    ----------
    label : Label
        ``background_components``: components in which the background errs; none where not given.
    place : PlaceEntry
        One of ``unknown.where``.
    """
    return place.component in label.get("background_components", ())


def only_of_background(label: Label, gap: GapReport) -> bool:
    """Return whether every place of an unknown is of the background.

    Returns
    -------
    bool
        False where there is no place.
    """
    places = gap.unknown.where
    return bool(places) and all(of_background(label, place) for place in places)


def _variables(place: PlaceEntry) -> list[str]:
    return list(place.variables) or [place.variable]


def _closes(place: PlaceEntry) -> float:
    return 0.0 if place.closure is None else place.closure.reduction


def unknown_scores(
    label: Label, truth: OutsideTruth, gap: GapReport, fleet: Sequence[str]
) -> Found:
    """Score the unknown of a diagnosis.

    Parameters
    ----------
    label : Label
        Truth of an outside case.
    truth : OutsideTruth
        Its ``outside``.
    fleet : sequence of str
        All aircraft of the archive.

    Returns
    -------
    dict
        ``variable_first, variable_near, variable_any, unknown_precision, unknown_recall,
        unknown_closure_stated, unknown_closure_interval, unknown_closure_error,
        unknown_closure_covered``; all but the closure None where no unknown is raised; there
        ``could_hide_holds``, whether it closes no more than the report says could hide.
    """
    if gap.unknown.present and gap.unknown.where:
        return _raised(label, truth, gap, fleet) | _closure(label, gap)
    silent: Found = {
        "variable_first": None,
        "variable_near": None,
        "variable_any": None,
        "unknown_precision": None,
        "unknown_recall": None,
    }
    most = gap.closure.could_hide_kt
    if most is not None:
        true = label["closure"]["before"] - label["closure"]["after"]
        silent["could_hide_holds"] = true <= most
    return silent | _closure(label, gap)


def _raised(label: Label, truth: OutsideTruth, gap: GapReport, fleet: Sequence[str]) -> Found:
    """Return whether the places of an unknown have its variables and its aircraft."""
    places = sorted(gap.unknown.where, key=_closes, reverse=True)
    first = _variables(places[0])[0]
    every = [name for place in places for name in _variables(place)]
    strict = any(same_variable(first, name) for name in truth["variables"])
    carried = truth["carried"]
    best = max((carried[name] for name in truth["variables"]), default=0.0)
    near = max(
        (share for name, share in carried.items() if same_variable(first, name)), default=0.0
    )
    told = {tail for place in places for tail in place.tails or fleet}
    own = {tail for effect in label["effects"] for tail in effect["tails"] or fleet}
    return {
        "variable_first": strict,
        "variable_near": strict or (best > 0.0 and near >= CARRIES * best),
        "variable_any": any(same_variable(t, n) for t in every for n in truth["variables"]),
        "unknown_precision": len(told & own) / len(told) if told else 0.0,
        "unknown_recall": len(told & own) / len(own) if own else 0.0,
    }


def _closure(label: Label, gap: GapReport) -> Found:
    """Return what names and unknown close together against the truth, kt."""
    true = label["closure"]["before"] - label["closure"]["after"]
    whole = [gap.unknown.closure] if gap.unknown.closure is not None else []
    each = [place.closure for place in gap.unknown.where if place.closure is not None]
    stated, low, high = 0.0, 0.0, 0.0
    for part in (gap.closure, *(whole or each)):
        ends = part.reduction_ci or [part.reduction] * 2
        stated, low, high = stated + part.reduction, low + ends[0], high + ends[1]
    return {
        "unknown_closure_stated": stated,
        "unknown_closure_interval": [low, high],
        "unknown_closure_error": abs(stated - true),
        "unknown_closure_covered": bool(low <= true <= high),
    }
