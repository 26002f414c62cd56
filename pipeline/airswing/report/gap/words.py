"""A gap diagnosis in words: headline, effects, parameters, aircraft, dates, slices.

Disagreement in knots, shares in 0 to 1, parameter names that end in their unit, NaN or None for an
unknown number. ± is half the 95 % interval.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import (
    ClosesEntry,
    ClosureEntry,
    EffectEntry,
    GapReport,
    KnownEntry,
    PlaceEntry,
    SimulationEntry,
    SliceEntry,
    TailEntry,
)
from airswing.physics.triangle import wrap_degrees
from airswing.report import html
from airswing.report.html import joined, plural
from airswing.units import KNOT, NORMAL_95

#: Unit that is shown for a parameter whose name ends in one; m/s are converted to knots.
_ENDINGS = {
    "_deg_per_day": "°/day",
    "_degC": " °C",
    "_deg": "°",
    "_percent": " %",
    "_m_s": " kt",
    "_hPa": " hPa",
    "_nT": " nT",
    "_ft": " ft",
    "_kt": " kt",
    "_h": " h",
    "_s": " s",
}
_COMPONENTS = {
    "both": "both components",
    "scatter": "scatter of single reports",
    "reported_speed": "distribution of reported speeds",
    "reported_direction": "distribution of reported directions",
    "reported_wind": "steps of reported winds",
    "reported_position": "steps of reported positions",
    "reported_heading": "steps of headings",
    "reported_time": "steps of reported times",
    "airspeed_factor": "factor of the airspeed",
    "wind_angle": "wind direction",
    "wind_factor": "factor of the wind speed",
}


def number(value: float | None) -> float:
    """Return a number, NaN for None."""
    return math.nan if value is None else float(value)


def plain_name(name: str) -> str:
    """Return an effect's name with blanks: ``hard iron``, ``TAS scale``."""
    return re.sub(r"\btas\b", "TAS", name.replace("_", " "))


def _component(name: str) -> str:
    return _COMPONENTS.get(name, re.sub("^(across|along)_", r"\1 the ", name).replace("_", " "))


def capital(text: str) -> str:
    """Return a text that begins with a capital letter."""
    return text[0].upper() + text[1:]


def p_text(value: float | None) -> str:
    """Return a p or q value: ``= 0.02``, ``< 1e-06``."""
    p_value = number(value)
    return "unknown" if math.isnan(p_value) else "< 1e-06" if p_value < 1e-6 else f"= {p_value:.2g}"


def nature_of(name: str) -> Markup:
    """Return title, physics, source and confusions of an effect of the catalogue, else nothing."""
    effect = CATALOGUE.get(name)
    if effect is None:
        return Markup()
    hints = []
    for hint in effect.confused_with:
        names, _, when = hint.partition(": ")
        rivals = [plain_name(item) if item in CATALOGUE else item for item in names.split(", ")]
        hints.append(" or ".join(rivals) + (f" ({when})" if when else ""))
    confused = f"Easily confused with {'; '.join(hints)}." if hints else ""
    title = f"{capital(plain_name(name))} ({effect.title})."
    text = '<b>{}</b> {}<span class="small">Source: {}</span><span class="small">{}</span>'
    return Markup(text).format(title, effect.physics, effect.source, confused)


def parameters_text(effect: EffectEntry | TailEntry, brief: bool = False) -> str:
    """Return all parameters of an effect in one line; `brief` omits the conditions (``at_...``).

    If the values of single aircraft differ by more than their errors, their range replaces the
    median; phases, which have no range, are then omitted.
    """
    errors = effect.standard_errors or {}
    by_tail = [entry.parameters for entry in (getattr(effect, "per_tail", None) or {}).values()]
    parts = []
    for name, value in effect.parameters.items():
        # a list: the two aircraft of an exchange
        if value is None or isinstance(value, list | tuple) or (brief and name.startswith("at_")):
            continue
        half = NORMAL_95 * np.nan_to_num(number(errors.get(name)))
        values = [float(x) for entry in by_tail if isinstance(x := entry.get(name), int | float)]
        if values and name.startswith("phase"):
            values = (values[0] + wrap_degrees(np.subtract(values, values[0]))).tolist()
        differ = len(values) > 1 and max(values) - min(values) > 2 * half
        if not (differ and name.startswith("phase")):
            parts.append(_parameter_text(name, value, half, values if differ else []))
    return ", ".join(parts)


def _parameter_text(name: str, value: object, half: float, values: Sequence[float]) -> str:
    ending = next((suffix for suffix in _ENDINGS if name.endswith(suffix)), "")
    label = "at" if name.startswith("at_") else name.removesuffix(ending).replace("_", " ")
    unit, factor = _ENDINGS.get(ending, ""), 1.0 / KNOT if ending == "_m_s" else 1.0
    if values:
        low, high = factor * min(values), factor * max(values)
        digits = int(np.clip(np.ceil(-np.log10(high - low)) + 1, 1, 5))
        return f"{label} {low:.{digits}f} to {high:.{digits}f}{unit}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"{label} {value}"
    shown, half = factor * value, factor * half
    if half == 0:
        return f"{label} {shown:{',.0f' if abs(shown) >= 1000 else '.4g'}}{unit}"
    # One or two figures of the half width; 1.05: 0.096 is shown as 0.1, not as 0.10.
    digits = int(np.clip(np.ceil(-np.log10(half * 1.05)), 0, 4))
    return f"{label} {shown:z.{digits}f} ± {half:.{digits}f}{unit}"


def period_text(effect: EffectEntry) -> str:
    """Return the dates between which an effect acts; empty if always."""
    return f"from {' to '.join(filter(None, effect.period))}" if effect.period else ""


def who_text(effect: EffectEntry | PlaceEntry, aircraft: int = 0, *, brief: bool = False) -> str:
    """Return the aircraft that an effect acts on; `brief` gives the number of more than two."""
    names, name = effect.tails, getattr(effect, "name", "")
    if effect.scope == "reference" or name.startswith("reference_"):
        return f"the reference {getattr(effect, 'reference', None) or ''}".strip()
    if not names or effect.scope == "fleet":
        return "all aircraft"
    if len(names) == aircraft > 2:
        return f"all {aircraft} aircraft"
    if len(names) > 2 and brief:
        return f"{len(names)} of {aircraft} aircraft" if aircraft else f"{len(names)} aircraft"
    return joined(names)


def closure_text(entry: ClosesEntry | ClosureEntry | None) -> str:
    """Return a reduction with its 95 % interval: ``1.20 kt (1.05 to 1.34)``."""
    if not entry:
        return "-"
    return html.amount(entry.reduction, entry.reduction_ci, unit="kt")


def levels_text(before: float, after: float) -> str:
    """Return two disagreements with the decimals that show their difference: ``8.3 → 6.3 kt``."""
    difference = max(abs(before - after), 1e-9)
    digits = int(np.clip(np.ceil(-np.log10(difference)), 1, 3))
    return f"{before:.{digits}f} → {after:.{digits}f} kt"


def headline(gap: GapReport) -> str:
    """Return the result of a diagnosis in at most 25 words, with its closure."""
    effects, places, closure = gap.effects, gap.unknown.where, gap.closure
    fleet = gap.counts.aircraft
    if not effects and not places:
        level = f"{closure.before:.1f} kt"
        if gap.counts.days == 1:
            return f"One day of reports is too short to decide what explains the gap of {level}."
        return (
            f"No missing effect found: noise of reports and reference explains the gap of {level}."
        )
    claims = []
    for effect in effects:
        name, who = plain_name(effect.name), who_text(effect, fleet, brief=True)
        claims.append(name if name.startswith("reference") else f"{name} on {who}")
    for place in places:
        text = _unexplained(place)
        text = text if place.component == "scatter" else f"an {text}"
        claims.append(text if effects else f"{text} on {who_text(place, fleet, brief=True)}")
    ending = "" if len(claims) > 1 else "s"
    if len(claims) > 2:
        claims = [claims[0], f"{len(claims) - 1} more effects"]
    verb = f"account{ending} for" if places else f"explain{ending}"
    share = number(closure.fraction_of_excess)
    of = f"{100 * share:.0f} % of the gap" if share < 0.95 else "the gap"
    levels = levels_text(closure.before, closure.after)
    if closure.after >= closure.before:
        verb, of = f"do{'es' if ending else ''} not reduce", "the gap"
    return f"{capital(joined(claims))} {verb} {of}: {levels}."


def _unexplained(place: PlaceEntry) -> str:
    variables = " and ".join(place.variables).replace("_", " ")
    if place.component != "scatter":
        return f"unexplained error by {variables}"
    return "unexplained scatter" + (f" by {variables}" if variables != "scatter" else "")


def start_words(
    known_effects: Sequence[KnownEntry] | None,
    simulation: SimulationEntry | None = None,
) -> str:
    """Return a description of the simulation in a diagnosis; empty for a perfect instrument."""
    text = ""
    if simulation:
        text = f"Compared with the simulation in {simulation.source}"
        if simulation.matched_by == "distribution":
            text += ", which flew other paths: distributions were compared. "
        else:
            text += f" ({simulation.matched:,} of {simulation.of:,} reports matched). "
    for entry in known_effects or ():
        ends = entry.disagreement_without_kt, entry.disagreement_with_kt
        text += (
            f"The simulation contains {plural(len(entry.effects), 'known effect')} of "
            f"{entry.source} ({levels_text(*ends)}). "
        )
    return text


def verdict(gap: GapReport) -> str:
    """Return the result of a diagnosis as text: headline, then a line for every finding."""
    start = start_words(gap.known, gap.simulation)
    fleet = gap.counts.aircraft
    lines = [effect_sentence(effect, fleet) for effect in gap.effects]
    lines += [place_sentence(place, fleet) for place in gap.unknown.where]
    lines += caution_lines(gap)
    return "\n  ".join([start + headline(gap), *lines])


def effect_sentence(effect: EffectEntry, fleet: int) -> str:
    """Return an effect with aircraft, parameters, period, probability and closure."""
    details = [
        parameters_text(effect, brief=True),
        period_text(effect),
        f"probability {effect.probability:.2f}",
    ]
    if effect.closure:
        details.append(f"closes {closure_text(effect.closure)}")
    text = f"{plain_name(effect.name)} on {who_text(effect, fleet)}"
    return f"{capital(text)}: {', '.join(detail for detail in details if detail)}."


def place_sentence(place: PlaceEntry, fleet: int) -> str:
    """Return an unexplained error: variable, component, shape, aircraft, closure, nearest name."""
    text = _unexplained(place)
    if place.component != "scatter":
        text += f", {_component(place.component)},"
    text = f"{capital(text)} on {who_text(place, fleet)}"
    details = [place.title] if place.title else []
    if place.closure:
        details.append(f"closes {closure_text(place.closure)}")
    if steps := place.steps:
        details.append(f"directions in steps of {steps.step_deg:g}° up to {steps.up_to_kt:.0f} kt")
    if place.nearest_effect:
        share = 100 * number(place.nearest_effect_share)
        nearest = plain_name(place.nearest_effect)
        details.append(f"closest catalogue effect: {nearest} ({share:.0f} % of the evidence)")
    return f"{text}{': ' if details else ''}{'; '.join(details)}."


def caution_lines(gap: GapReport) -> list[str]:
    """Return a sentence on effects that could remain undetected, where none is stated."""
    hidden = number(gap.closure.could_hide_kt)
    if not np.isfinite(hidden) or gap.effects or gap.unknown.where:
        return []
    return [
        f"An error outside the catalogue could close up to {hidden:.2g} kt without being detected; "
        "errors of the model common to all aircraft on all days count as weather and may be larger."
    ]


def slice_words(entry: SliceEntry) -> str:
    """Return a slice of the archive: variable and component, and the name of an aircraft.

    A variable is tested over all its values, so no value is named.
    """
    component = _component(entry.component)
    text = entry.variable.replace("_", " ") + (f", {component}" if component else "")
    return f"{text}: {joined(entry.values)}" if entry.variable == "aircraft" else text
