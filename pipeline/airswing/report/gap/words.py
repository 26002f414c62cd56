"""The verdict of a gap diagnosis in plain words.

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
    GapReport,
    KnownEntry,
    PlaceEntry,
    SimulationEntry,
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
#: Share of an unknown that an effect explains from which its name is said and not that it has none.
NEAR = 0.8


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
    return _capitalised(_effect_clause(effect, aircraft))


def _capitalised(text: str) -> str:
    """Return a text that begins a sentence; names of aircraft stay as they are."""
    return text[0].upper() + text[1:] if text.startswith(("the ", "each ")) else text


def _effect_clause(effect: EffectEntry, aircraft: int) -> str:
    """Return one effect as it stands within a sentence."""
    text = f"{who_text(effect, aircraft)}: {plain_name(effect.name)}"
    details = [part for part in (parameters_text(effect, brief=True), period_text(effect)) if part]
    text += "".join(f", {part}" for part in details)
    if effect.share_of_gap >= 0.005:
        text += f"; explains {100 * effect.share_of_gap:.0f} % of the gap"
    return text


def _closure_sentence(gap: GapReport) -> str:
    """Return what adding the effects does to the disagreement, with the noise floor."""
    what = "it" if len(gap.effects) == 1 else "them"
    where = " on held-out flights" if gap.closure.held_out else ""
    digits = digits_that_tell(gap.closure.before, gap.closure.after)
    return (
        f"adding {what} takes the disagreement from {gap.closure.before:.{digits}f} to "
        f"{gap.closure.after:.{digits}f} kt{where}, noise floor {gap.gap.noise_floor_kt:.{digits}f}"
    )


def digits_that_tell(before: float, after: float) -> int:
    """Return the decimals, 1 to 3, in which two disagreements differ."""
    return int(np.clip(np.ceil(-np.log10(max(abs(before - after), 1e-9))), 1, 3))


def start_words(
    known: Sequence[KnownEntry] | None, simulation: SimulationEntry | None = None
) -> str:
    """Return what a diagnosis started from; empty for the perfect instrument.

    Returns
    -------
    str
        Whole sentences, each with a blank behind it.
    """
    out = []
    if simulation is not None:
        text = f"Against the simulation in {simulation.source}"
        if simulation.matched_by == "distribution":
            text += ", which flew other paths and was compared by what it has"
        else:
            text += f" ({simulation.matched:,} of {simulation.of:,} reports matched)"
        out.append(f"{text}.")
    for one in known or ():
        number = len(one.effects)
        out.append(
            f"Beyond {number} known effect{'' if number == 1 else 's'} of {one.source}, which "
            f"take{'s' if number == 1 else ''} the disagreement from "
            f"{one.disagreement_without_kt:.1f} to {one.disagreement_with_kt:.1f} kt:"
        )
    return "".join(f"{text} " for text in out)


def verdict(gap: GapReport) -> str:
    """Return the verdict: what is missing, how much of the gap it is, what adding it buys.

    What the diagnosis started from stands before it where that is not the perfect instrument.
    """
    return start_words(gap.known, gap.simulation) + _what_is_missing(gap) + _likelier_than_not(gap)


def _what_is_missing(gap: GapReport) -> str:
    effects, most = gap.effects, 3  # a headline of more is not read
    if not effects:
        if gap.unknown.present:
            return f"Something is missing{_unknown_alone(gap)}{_unknown_closure(gap)}."
        return _nothing_missing(gap)
    text = _capitalised(
        "; ".join(_effect_clause(effect, gap.counts.aircraft) for effect in effects[:most])
    )
    if len(effects) > most:
        rest = len(effects) - most
        text += f"; and {rest} smaller effect{'s' if rest > 1 else ''}"
    text += f"; {_closure_sentence(gap)}."
    if gap.unknown.present:
        text += f" Something unknown remains{_unknown_place(gap)}{_unknown_closure(gap)}."
    return text


def _likelier_than_not(gap: GapReport) -> str:
    """Names that are likelier than not and not stated."""
    near = [one for one in gap.unconfirmed if one.probability >= 0.5]
    # rounded down: 0.9 is what is counted as found
    told = [
        f"{plain_name(one.name)} (probability {np.floor(100 * one.probability) / 100:.2f})"
        for one in near
    ]
    return f" Likelier than not, but not counted as found: {joined(told, most=2)}." if told else ""


def _nothing_missing(gap: GapReport) -> str:
    if gap.counts.days == 1:
        return (
            "One day of reports is too short to tell all that may be missing: only what single "
            "aircraft show on all parts of the day could be stated, and nothing does."
        )
    return (
        "Nothing is missing from the simulation that these reports can show: the disagreement is "
        f"{gap.gap.mean_vector_disagreement_kt:.1f} kt and the noise floor "
        f"{gap.gap.noise_floor_kt:.1f} kt.{_could_hide(gap)}"
    )


def _could_hide(gap: GapReport) -> str:
    """What nobody thought of could close without being told."""
    most = gap.closure.could_hide_kt
    if most is None:
        return ""
    return (
        f" What nobody thought of could close up to {most:.2g} kt and not be seen; what the "
        "model's winds err alike for all aircraft on all days is taken for its weather and may "
        "be more."
    )


def _unknown_closure(gap: GapReport) -> str:
    """What a table closes of the gap beside what has a name; nothing where that is not known."""
    closure = gap.unknown.closure
    tables = [place for place in gap.unknown.where if place.curve.edges is not None]
    if closure is None or not tables:
        return "".join(_steps_words(place) for place in gap.unknown.where)
    names = joined([" and ".join(place.variables).replace("_", " ") for place in tables], most=2)
    low, high = closure.reduction_ci
    return (
        f"; a table by {names} closes {closure.reduction:.2f} kt ({low:.2f} to {high:.2f}) of "
        f"{closure.before:.2f}"
    )


def _steps_words(place: PlaceEntry) -> str:
    """What directions in steps make of the disagreement; nothing of another unknown."""
    steps, closes = place.steps, place.closure
    if steps is None or closes is None:
        return ""
    low, high = closes.reduction_ci
    return (
        f"; directions come in steps of {steps.step_deg:g}° up to {steps.up_to_kt:.0f} kt, which "
        f"lengthens the disagreement by {closes.reduction:.2f} kt ({low:.2f} to {high:.2f}), "
        "though no report can be turned back"
    )


def _unknown_alone(gap: GapReport) -> str:
    """Where an unknown shows, and how near an effect of the catalogue comes to it."""
    where = _unknown_place(gap)
    first = gap.unknown.where[0] if gap.unknown.where else None
    share = (first.nearest_effect_share or 0.0) if first is not None else 0.0
    near = ""
    if first is not None and first.nearest_effect is not None and share > 0:
        name = plain_name(first.nearest_effect)
        near = f"{name} comes nearest, which explains {100 * share:.0f} % of it"
    if share >= NEAR and near:
        return f"{where}: {near}, though days left out do not confirm it as that"
    near = f" ({near})" if near else ""
    return f" that the catalogue does not hold{where}: no known effect explains it{near}"


def _unknown_place(gap: GapReport) -> str:
    named = [slice_words(place) for place in gap.unknown.where]
    return f" ({joined(named, most=2)})" if named else ""


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
