"""The verdict of a gap diagnosis in plain words.

Assumes ``gap.json`` of docs/formats.md: disagreement in knots, shares in 0 to 1, parameter names
that end in their unit.  ``±`` is one standard error, as the file gives it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from airswing.gap.effects import CATALOGUE

UNITS: tuple[tuple[str, str], ...] = (
    ("_deg_per_day", "°/day"),
    ("_deg", "°"),
    ("_percent", " %"),
    ("_m_s", " m/s"),
    ("_hPa", " hPa"),
    ("_nT", " nT"),
    ("_ft", " ft"),
    ("_kt", " kt"),
    ("_h", " h"),
    ("_s", " s"),
)
MOST_TAILS = 6


def plain_name(name: str) -> str:
    """Return an effect's name in plain words; an unknown name with its underscores gone."""
    effect = CATALOGUE.get(name)
    return effect.title if effect and effect.title else name.replace("_", " ")


def joined(words: Sequence[str], *, most: int = MOST_TAILS) -> str:
    """Return ``a, b and c``, cut after a few with the number of the rest."""
    shown = [str(word) for word in words[:most]]
    if len(words) > most:
        shown.append(f"{len(words) - most} more")
    if len(shown) < 2:
        return "".join(shown)
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def small_text(value: float, *, least: float = 1e-6) -> str:
    """Return ``= 0.02`` for a probability, ``< 1e-06`` where no one needs its size."""
    return f"< {least:.0e}" if value < least else f"= {value:.2g}"


def digits_for(error: float) -> int:
    """Return the decimals that show a standard error with one or two figures."""
    if not np.isfinite(error) or error <= 0:
        return 2
    return int(np.clip(np.ceil(-np.log10(error * 1.05)), 0, 4))


def label_and_unit(name: str) -> tuple[str, str]:
    """Split ``amplitude_deg`` into ``amplitude`` and its unit; ``at_..._nT`` is plain ``at``."""
    for ending, symbol in UNITS:
        if name.endswith(ending):
            label = "at" if name.startswith("at_") else name[: -len(ending)].replace("_", " ")
            return label, symbol
    return name.replace("_", " "), ""


def parameter_text(name: str, value: Any, error: Any = None) -> str:
    """Return ``amplitude 3.9 ± 0.2°`` for ``amplitude_deg``."""
    label, unit = label_and_unit(name)
    if not isinstance(value, int | float):
        return f"{label} {value}"
    spread = float(error) if isinstance(error, int | float) else float("nan")
    if not np.isfinite(spread) or spread == 0:
        number = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        return f"{label} {number}{unit}"
    digits = digits_for(spread)
    return f"{label} {value:.{digits}f} ± {spread:.{digits}f}{unit}"


def parameters_text(effect: Mapping[str, Any], *, brief: bool = False) -> str:
    """Return all parameters of an effect in one line.

    Where single aircraft carry it with values of their own, their range stands instead of the
    median, and phases, which have no middle, are left to the table of aircraft.

    Parameters
    ----------
    effect : mapping
        One of ``effects`` of ``gap.json``.
    brief : bool, optional
        Leave out the conditions a parameter is stated at (``at_...``).

    Returns
    -------
    str
    """
    errors = effect.get("standard_errors") or {}
    each = [entry["parameters"] for entry in (effect.get("per_tail") or {}).values()]
    parts = []
    for name, value in (effect.get("parameters") or {}).items():
        if value is None or (brief and name.startswith("at_")):
            continue
        if isinstance(value, list | tuple):  # the aircraft of a pair, who are told as such
            continue
        spread = _spread(name, each, errors.get(name))
        if spread is not None and name.startswith("phase"):
            continue
        text = parameter_text(name, value, errors.get(name))
        parts.append(_range_text(name, spread) if spread is not None else text)
    return ", ".join(parts)


def _spread(name: str, each: Sequence[Mapping[str, Any]], error: Any) -> tuple[float, float] | None:
    """Return the least and the greatest value over aircraft, where they differ beyond error."""
    values = [entry[name] for entry in each if isinstance(entry.get(name), int | float)]
    if len(values) < 2:
        return None
    room = 4.0 * float(error) if isinstance(error, int | float) else 0.0
    if name.startswith("phase"):
        turned = np.degrees(np.angle(np.exp(1j * np.radians(np.subtract(values, values[0])))))
        values = (values[0] + turned).tolist()
    low, high = float(min(values)), float(max(values))
    return (low, high) if high - low > room else None


def _range_text(name: str, spread: tuple[float, float]) -> str:
    label, unit = label_and_unit(name)
    digits = int(np.clip(np.ceil(-np.log10(spread[1] - spread[0])) + 1, 1, 5))
    return f"{label} {spread[0]:.{digits}f} to {spread[1]:.{digits}f}{unit}"


def period_text(effect: Mapping[str, Any]) -> str:
    """Return since when, until when or between when an effect holds, or nothing."""
    first, last = period_bounds(effect)
    if first and last:
        return f"from {first} to {last}"
    if last:
        return f"until {last}"
    return f"from {first}" if first else ""


def period_bounds(effect: Mapping[str, Any]) -> tuple[str, str]:
    """Return the first and the last date of an effect; empty where it has none."""
    period = effect.get("period")
    if isinstance(period, Mapping):
        period = list(period.values())
    if isinstance(period, str):
        period = [period]
    bounds = [str(value)[:10] if value else "" for value in period or []]
    first, last, *_ = [*bounds, "", ""]
    return first, last


def rival_names(effect: Mapping[str, Any]) -> list[str]:
    """Return the names of the effects that could not be told from one."""
    rivals = effect.get("ambiguous_with") or []
    return [str(rival["name"] if isinstance(rival, Mapping) else rival) for rival in rivals]


def rival_advice(effect: Mapping[str, Any]) -> list[str]:
    """Return the data that would tell an effect from its rivals, each once."""
    listed = [*(effect.get("ambiguous_with") or []), *(effect.get("ambiguity") or [])]
    rivals = [rival for rival in listed if isinstance(rival, Mapping)]
    told = [str(rival["separated_by"]) for rival in rivals if "separated_by" in rival]
    own = effect.get("separated_by") or effect.get("would_separate") or []
    told += [own] if isinstance(own, str) else [str(line) for line in own]
    return list(dict.fromkeys(told))


def who_text(effect: Mapping[str, Any]) -> str:
    """Return whom an effect concerns: its aircraft, the whole fleet, or the reference."""
    scope, tails = effect.get("scope"), list(effect.get("tails") or [])
    if scope == "reference" or str(effect.get("name", "")).startswith("reference_"):
        return "the reference"
    return joined(tails) if tails and scope != "fleet" else "the whole fleet"


def effect_sentence(effect: Mapping[str, Any]) -> str:
    """Return one effect as a sentence without its stop."""
    return capitalised(effect_clause(effect))


def capitalised(text: str) -> str:
    """Return a text that begins a sentence; names of aircraft stay as they are."""
    return f"The {text[4:]}" if text.startswith("the ") else text


def effect_clause(effect: Mapping[str, Any]) -> str:
    """Return one effect as it stands within a sentence."""
    text = f"{who_text(effect)}: {plain_name(str(effect['name']))}"
    details = [part for part in (parameters_text(effect, brief=True), period_text(effect)) if part]
    text += "".join(f", {part}" for part in details)
    share = effect.get("share_of_gap")
    if share is not None and float(share) >= 0.005:
        text += f"; explains {100 * float(share):.0f} % of the gap"
    return text


def closure_sentence(gap: Mapping[str, Any]) -> str:
    """Return what adding the effects does to the disagreement, with the noise floor."""
    closure = gap.get("closure") or {}
    floor = (gap.get("gap") or {}).get("noise_floor_kt")
    floor_text = f", noise floor {float(floor):.1f}" if floor is not None else ""
    effects = gap.get("effects") or []
    before, after = closure.get("before"), closure.get("after")
    if not effects or before is None or after is None:
        return ""
    what = "it" if len(effects) == 1 else "them"
    where = " on held-out flights" if closure.get("held_out", True) else ""
    return (
        f"adding {what} takes the disagreement from {float(before):.1f} to {float(after):.1f} kt"
        f"{where}{floor_text}"
    )


def start_words(gap: Mapping[str, Any]) -> str:
    """Return what the diagnosis started from; empty for the perfect instrument.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``; ``simulation`` and ``known`` where given.

    Returns
    -------
    str
        Whole sentences, each with a blank behind it.
    """
    out = []
    other = gap.get("simulation")
    if other:
        text = f"Against the simulation in {other['source']}"
        if other["matched_by"] == "distribution":
            text += ", which flew other paths and was compared by what it has"
        else:
            text += f" ({other['matched']:,} of {other['of']:,} reports matched)"
        out.append(f"{text}.")
    for known in gap.get("known") or []:
        number = len(known["effects"])
        out.append(
            f"Beyond {number} known effect{'' if number == 1 else 's'} of {known['source']}, which "
            f"take{'s' if number == 1 else ''} the disagreement from "
            f"{float(known['disagreement_without_kt']):.1f} to "
            f"{float(known['disagreement_with_kt']):.1f} kt:"
        )
    return "".join(f"{text} " for text in out)


def verdict(gap: Mapping[str, Any], *, most: int = 3) -> str:
    """Return the verdict: what is missing, how much of the gap it is, what adding it buys.

    What the diagnosis started from stands before it where that is not the perfect instrument.

    Parameters
    ----------
    gap : mapping
        Content of ``gap.json``.
    most : int, optional
        Effects named in full.

    Returns
    -------
    str
    """
    return start_words(gap) + _what_is_missing(gap, most)


def _what_is_missing(gap: Mapping[str, Any], most: int) -> str:
    effects = list(gap.get("effects") or [])
    unknown = bool((gap.get("unknown") or {}).get("present"))
    if not effects:
        if unknown:
            return (
                "Something is missing that the catalogue does not hold"
                f"{_unknown_place(gap)}: no known effect explains it{_unknown_closure(gap)}."
            )
        return _nothing_missing(gap)
    text = capitalised("; ".join(effect_clause(effect) for effect in effects[:most]))
    if len(effects) > most:
        rest = len(effects) - most
        text += f"; and {rest} smaller effect{'s' if rest > 1 else ''}"
    closing = closure_sentence(gap)
    text += f"; {closing}." if closing else "."
    if unknown:
        text += f" Something unknown remains{_unknown_place(gap)}{_unknown_closure(gap)}."
    return text


def _nothing_missing(gap: Mapping[str, Any]) -> str:
    numbers = gap.get("gap") or {}
    level, floor = numbers.get("mean_vector_disagreement_kt"), numbers.get("noise_floor_kt")
    if (gap.get("counts") or {}).get("days") == 1:
        return (
            "One day of reports is too short to tell what is missing: no finding could be checked "
            "on other days, and none is stated."
        )
    text = "Nothing is missing from the simulation that these reports can show"
    if level is None:
        return text + "."
    text += f": the disagreement is {float(level):.1f} kt"
    return text + (f" and the noise floor {float(floor):.1f} kt." if floor is not None else ".")


def _unknown_closure(gap: Mapping[str, Any]) -> str:
    """What a table closes of the gap beside what has a name; nothing where that is not known."""
    unknown = gap.get("unknown") or {}
    closure = unknown.get("closure")
    tables = [
        place
        for place in unknown.get("where") or []
        if isinstance(place, Mapping) and "edges" in (place.get("curve") or {})
    ]
    if not closure or not tables:
        return ""
    names = joined([" and ".join(place["variables"]).replace("_", " ") for place in tables], most=2)
    low, high = closure["reduction_ci"]
    return (
        f"; a table by {names} closes {closure['reduction']:.2f} kt ({low:.2f} to {high:.2f}) of "
        f"{closure['before']:.2f}"
    )


def _unknown_place(gap: Mapping[str, Any]) -> str:
    places = (gap.get("unknown") or {}).get("where") or []
    named = [slice_words(p) if isinstance(p, Mapping) else str(p) for p in places]
    return f" ({joined(named, most=2)})" if named else ""


COMPONENTS = {
    "cross": "across the heading",
    "across": "across the heading",
    "along": "along the heading",
    "scatter": "of single reports",
    "across_heading": "across the heading",
    "along_heading": "along the heading",
    "heading_angle": "an angle of the heading",
    "airspeed_factor": "a factor of the airspeed",
    "across_wind": "across the wind",
    "along_wind": "along the wind",
    "wind_angle": "an angle of the wind",
    "wind_factor": "a factor of the wind",
}


def slice_words(entry: Mapping[str, Any], *, most: int = 4) -> str:
    """Return a slice of the archive in words: variable, component and at most a few values."""
    variables = entry.get("variables") or [entry.get("variable", "")]
    of_wind = entry.get("component") == "wind"
    names = [str(name).replace("_", " ") for name in (variables[:1] if of_wind else variables)]
    text = ("the reference's wind, " if of_wind else "") + " by ".join(names)
    component = COMPONENTS.get(str(entry.get("component", "")))
    text += f", {component}" if component else ""
    values = entry.get("values", entry.get("tails", []))
    named = [str(value) for value in values] if isinstance(values, list | tuple) else [str(values)]
    return f"{text}: {joined(named, most=most)}" if named else text
