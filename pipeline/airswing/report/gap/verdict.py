"""The verdict of a gap diagnosis: what is missing, how much of the gap it is, what adding it buys.

Assumes a report in the shapes of :mod:`airswing.gap.result.schema`, said in the words of
:mod:`airswing.report.gap.words`. Disagreement in knots, shares in 0 to 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airswing.gap.result.schema import GapReport, KnownEntry, PlaceEntry, SimulationEntry
from airswing.report.gap.words import capitalised, effect_clause, joined, plain_name, slice_words

#: Share of an unknown that an effect explains from which its name is said and not that it has none.
NEAR = 0.8


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
    text = capitalised(
        "; ".join(effect_clause(effect, gap.counts.aircraft) for effect in effects[:most])
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
