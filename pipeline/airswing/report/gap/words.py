"""What a gap diagnosis names, in plain words: effects, parameters, aircraft, dates, slices.

Assumes a report in the shapes of :mod:`airswing.gap.result.schema`: disagreement in knots, shares
in 0 to 1, parameter names that end in their unit.  ``±`` is one standard error.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import (
    EffectEntry,
    PlaceEntry,
    SliceEntry,
    TailEntry,
)
from airswing.gap.result.schema.entries import Parameter
from airswing.physics.triangle import wrap_degrees
from airswing.units import ZERO_CELSIUS

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
_MOST_TAILS = 6
#: Aircraft that are listed even where they are all there are: names of so few say more.
_FEW = 3


def plain_name(name: str) -> str:
    """Return an effect's name in plain words; an unknown name with its underscores gone."""
    effect = CATALOGUE.get(name)
    return effect.title if effect and effect.title else name.replace("_", " ")


class Nature(NamedTuple):
    """What an effect is, in whole sentences but for the title; ``alike`` empty where nothing is."""

    title: str
    physics: str
    source: str
    alike: str


def nature_of(name: str) -> Nature | None:
    """Return what happens in an effect, who says so, and what is easily taken for it.

    Returns
    -------
    Nature or None
        None for a name that is not in the catalogue.
    """
    effect = CATALOGUE.get(name)
    if effect is None:
        return None
    title = plain_name(name)
    alike = "; ".join(map(_alike_text, effect.confused_with))
    return Nature(
        f"{title[0].upper()}{title[1:]}",
        effect.physics,
        f"Source: {effect.source}",
        f"Easily confused with {alike}." if alike else "",
    )


def _alike_text(hint: str) -> str:
    """A hint such as ``compass_drift, compass_step: where ...``, effects called by their titles."""
    names, _, when = hint.partition(": ")
    told = " or ".join(plain_name(one) if one in CATALOGUE else one for one in names.split(", "))
    return f"{told} ({when})" if when else told


def joined(words: Sequence[str], *, most: int = _MOST_TAILS) -> str:
    """Return ``a, b and c``, cut after a few with the number of the rest."""
    shown = [str(word) for word in words[:most]]
    if len(words) > most:
        shown.append(f"{len(words) - most} more")
    if len(shown) < 2:
        return "".join(shown)
    return f"{', '.join(shown[:-1])} and {shown[-1]}"


def small_text(value: float) -> str:
    """Return ``= 0.02`` for a probability, ``< 1e-06`` where no one needs its size."""
    return "< 1e-06" if value < 1e-6 else f"= {value:.2g}"


def digits_for(error: float) -> int:
    """Return the decimals that show a standard error with one or two figures."""
    if not np.isfinite(error) or error <= 0:
        return 2
    # 1.05: an error of 0.096 is shown as 0.1, not as 0.10.
    return int(np.clip(np.ceil(-np.log10(error * 1.05)), 0, 4))


def _label_and_unit(name: str) -> tuple[str, str]:
    """Split ``amplitude_deg`` into ``amplitude`` and its unit; ``at_..._nT`` is plain ``at``."""
    for ending, symbol in UNITS:
        if name.endswith(ending):
            label = "at" if name.startswith("at_") else name[: -len(ending)].replace("_", " ")
            return label, symbol
    return name.replace("_", " "), ""


def parameter_text(name: str, value: Parameter, error: float | None = None) -> str:
    """Return ``amplitude 3.9 ± 0.2°`` for ``amplitude_deg``."""
    label, unit = _label_and_unit(name)
    if not isinstance(value, int | float):
        return f"{label} {value}"
    spread = float("nan") if error is None else error
    if not np.isfinite(spread) or spread == 0:
        number = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        return f"{label} {number}{unit}"
    digits = digits_for(spread)
    return f"{label} {value:.{digits}f} ± {spread:.{digits}f}{unit}"


def parameters_text(effect: EffectEntry | TailEntry, *, brief: bool = False) -> str:
    """Return all parameters of an effect in one line.

    Where single aircraft carry it with values of their own, their range stands instead of the
    median, and phases, which have no middle, are left to the table of aircraft.

    Parameters
    ----------
    brief : bool, optional
        Leave out the conditions a parameter is stated at (``at_...``).
    """
    errors = effect.standard_errors or {}
    per_tail = effect.per_tail if isinstance(effect, EffectEntry) else None
    each = [entry.parameters for entry in (per_tail or {}).values()]
    parts = []
    for name, value in effect.parameters.items():
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


def _spread(
    name: str, each: Sequence[Mapping[str, Parameter]], error: float | None
) -> tuple[float, float] | None:
    """Return the least and the greatest value over aircraft, where they differ beyond error."""
    values = [float(x) for entry in each if isinstance(x := entry.get(name), int | float)]
    if len(values) < 2:
        return None
    room = 4.0 * error if error is not None else 0.0
    if name.startswith("phase"):
        turned = wrap_degrees(np.subtract(values, values[0]))
        values = (values[0] + turned).tolist()
    low, high = min(values), max(values)
    return (low, high) if high - low > room else None


def _range_text(name: str, spread: tuple[float, float]) -> str:
    label, unit = _label_and_unit(name)
    digits = int(np.clip(np.ceil(-np.log10(spread[1] - spread[0])) + 1, 1, 5))
    return f"{label} {spread[0]:.{digits}f} to {spread[1]:.{digits}f}{unit}"


def period_text(effect: EffectEntry) -> str:
    """Return since when, until when or between when an effect holds, or nothing."""
    first, last = ((day or "")[:10] for day in effect.period or (None, None))
    if first and last:
        return f"from {first} to {last}"
    if last:
        return f"until {last}"
    return f"from {first}" if first else ""


def who_text(effect: EffectEntry, aircraft: int = 0) -> str:
    """Return whom an effect concerns: its aircraft, the whole fleet, or the reference.

    Parameters
    ----------
    aircraft : int, optional
        Number of all aircraft: many that are all of them are not listed.
    """
    if effect.scope == "reference" or effect.name.startswith("reference_"):
        return "the reference"
    if not effect.tails or effect.scope == "fleet":
        return "the whole fleet"
    if len(effect.tails) == aircraft > _FEW:
        return f"each of the {aircraft:,} aircraft"
    return joined(effect.tails)


def effect_sentence(effect: EffectEntry, aircraft: int = 0) -> str:
    """Return one effect as a sentence without its stop."""
    return capitalised(effect_clause(effect, aircraft))


def capitalised(text: str) -> str:
    """Return a text that begins a sentence; names of aircraft stay as they are."""
    return text[0].upper() + text[1:] if text.startswith(("the ", "each ")) else text


def effect_clause(effect: EffectEntry, aircraft: int) -> str:
    """Return one effect as it stands within a sentence."""
    text = f"{who_text(effect, aircraft)}: {plain_name(effect.name)}"
    details = [part for part in (parameters_text(effect, brief=True), period_text(effect)) if part]
    text += "".join(f", {part}" for part in details)
    if effect.share_of_gap >= 0.005:
        text += f"; explains {100 * effect.share_of_gap:.0f} % of the gap"
    return text


COMPONENTS = {
    "cross": "across the heading",
    "across": "across the heading",
    "along": "along the heading",
    "scatter": "of single reports",
    "reported_speed": "speeds sent in the place of others",
    "reported_direction": "directions sent too often or never",
    "reported_wind": "winds sent again unchanged",
    "wind_map": "winds sent as a map of themselves",
    "across_heading": "across the heading",
    "along_heading": "along the heading",
    "heading_angle": "an angle of the heading",
    "airspeed_factor": "a factor of the airspeed",
    "across_wind": "across the wind",
    "along_wind": "along the wind",
    "wind_angle": "an angle of the wind",
    "wind_factor": "a factor of the wind",
}


#: How the dictionary's variables (`airswing.gap.design.basis.variable`) are said.
SAID: Mapping[str, Callable[[float], str]] = {
    "altitude": lambda x: f"{1000.0 * np.exp(-x):.0f} hPa",
    "temperature": lambda x: f"{x - ZERO_CELSIUS:.0f} °C",
    "airspeed": lambda x: f"{x:.0f} m/s",
    "wind_speed": lambda x: f"{x:.0f} m/s",
    "acceleration": lambda x: f"{x:.2f} m/s²",
    "hour": lambda x: f"{x:.0f} UTC",
    "date": lambda x: f"day {x:.0f}",
    "latitude": lambda x: f"{abs(x):.1f}°{'N' if x >= 0 else 'S'}",
    "longitude": lambda x: f"{abs(x):.1f}°{'E' if x >= 0 else 'W'}",
    "bank": lambda x: f"{x:.1f}°",
    "drift": lambda x: f"{x:.1f}°",
}
_WAVE = re.compile(r"(?:(?P<where>\w+) )?(?P<wave>sin|cos)(?P<cycles>\d)")


def value_words(variable: str, value: str) -> str:
    """Return a column of a slice in words: ``10 °C``, ``cos 2 × heading``.

    Parameters
    ----------
    value : str
        A value of the variable where its curve bends, a wave of the magnetic heading, or a name.
    """
    wave = _WAVE.fullmatch(value)
    if wave:
        times = "" if wave["cycles"] == "1" else f"{wave['cycles']} × "
        of = f"{wave['wave']} {times}heading"
        return f"{wave['where']} {of}" if wave["where"] else of
    try:
        number = float(value)
    except ValueError:
        return value
    return SAID[variable](number) if variable in SAID else value


def slice_words(entry: SliceEntry | PlaceEntry, *, most: int = 4) -> str:
    """Return a slice of the archive in words: variable, component and at most a few values."""
    if isinstance(entry, PlaceEntry) and entry.title is not None:
        whose = joined(list(entry.tails), most=most)
        return f"{entry.title}: {whose}" if whose else entry.title
    if isinstance(entry, PlaceEntry):
        variables, values = entry.variables, entry.tails
    else:
        variables = [entry.variable]
        values = [value_words(entry.variable, value) for value in entry.values]
    of_wind = entry.component == "wind"
    names = [name.replace("_", " ") for name in (variables[:1] if of_wind else variables)]
    text = ("the reference's wind, " if of_wind else "") + " by ".join(names)
    component = COMPONENTS.get(entry.component)
    text += f", {component}" if component else ""
    return f"{text}: {joined(values, most=most)}" if values else text
