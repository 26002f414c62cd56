"""Diagnoses made up by hand: entries of gap.json with what a test does not say filled in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import TypeAdapter

from airswing.gap.result.schema import EffectEntry, GapReport, PlaceEntry, UnknownClosureEntry

NOISE = {
    "correlated_sd_m_s": 2.0,
    "white_sd_m_s": 1.0,
    "length_km": 200.0,
    "height_ln_p": 0.3,
    "level_hPa": [],
    "level_factor": [],
    "day_field_sd_m_s": [],
    "climatology_sd_m_s": [],
    "distance_km": [],
    "autocovariance": [],
    "autocovariance_model": [],
}
COUNTS = {
    "reports": 1000,
    "flights": 100,
    "reports_in_view": 1000,
    "days": 10,
    "clipped": 0.0,
    "gross": 0.0,
}


def claimed(name: str = "hard_iron", **changes: Any) -> EffectEntry:
    """One of ``effects``; tails None, as a label has it of the fleet, is none told."""
    content = {
        "name": name,
        "probability": 0.99,
        "tails": [],
        "parameters": {},
        "standard_errors": {},
        "period": None,
        "scope": "aircraft",
        "evidence_nats": 50.0,
    } | changes
    content["tails"] = content["tails"] or []
    return TypeAdapter(EffectEntry).validate_python(content)


def placed(variable: str = "hour", **changes: Any) -> PlaceEntry:
    """One of ``unknown.where``."""
    content = {
        "component": "along_heading",
        "variable": variable,
        "variables": [variable],
        "group": "",
        "tails": [],
        "scope": "aircraft",
        "evidence_nats": 50.0,
        "size_m_s": 1.0,
        "curve": {"labels": [], "m_s": []},
    } | changes
    return TypeAdapter(PlaceEntry).validate_python(content)


def diagnosis(
    effects: Sequence[EffectEntry] = (),
    *,
    places: Sequence[PlaceEntry] = (),
    closure: Mapping[str, Any],
    places_close: UnknownClosureEntry | None = None,
) -> GapReport:
    """The content of gap.json; of a closure without ``reduction`` that of its two numbers."""
    told = {
        "ci": None,
        "fraction_of_excess": 1.0,
        "held_out": True,
        "reduction": closure["before"] - closure["after"],
        "reduction_ci": None,
    }
    return GapReport.of(
        {
            "gap": {
                "mean_vector_disagreement_kt": closure["before"],
                "noise_floor_kt": closure["after"],
                "significance": 0.001,
            },
            "where": [],
            "effects": effects,
            "unknown": {"present": bool(places), "where": places, "closure": places_close},
            "closure": told | dict(closure),
            "counts": COUNTS,
            "noise": NOISE,
        }
    )
