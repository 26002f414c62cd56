"""What a diagnosis got right, case by case, against the label of a sealed case.

Assumptions
-----------
* What is scored is the content of ``gap.json`` (`airswing.gap.result.schema.GapReport`); parameters
  of each aircraft are used where they are told.
* A name is *claimed* when it stands among ``effects``. The ambiguity set of a claim is its name and
  its ``ambiguous_with``.
* In the hard world gross errors are really there, and a real valve's record errs across the heading
  of every aircraft that has it: naming them is neither right nor wrong. What a name of the
  background closes is taken off before a closure is compared with the twin's, which has it as well.
* Log score: the mean over all catalogue names of log2 of the probability given to what is true
  (each name at work or not), probabilities held in [0.001, 0.999]; 0 is perfect.
* A false name is *ahead* of a raised unknown when it is claimed and closes more kt than the unknown
  (or, where that is not told, more held-out energy); with no place told, whenever it is claimed.

Units: kt, days, fractions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from airswing.blind_check.reliability_table import stated_claims
from airswing.blind_check.scores import Asked, Found, Score
from airswing.blind_check.unknown_scores import only_of_background, same_variable, unknown_scores
from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import EffectEntry, GapReport, UnknownEntry
from airswing.synthetic.sealed.draws import Draw
from airswing.synthetic.sealed.labels import Injected, Label
from airswing.units import DAY

__all__ = ["aircraft_overlap", "draws", "parameter_errors", "score_case"]


def draws() -> dict[str, Draw]:
    """Return how each effect of the catalogue that the check draws is drawn and judged."""
    return {name: one.draw for name, one in CATALOGUE.items() if one.draw is not None}


def score_case(
    label: Label, gap: GapReport | None, *, failure: str | None = None, fleet: Sequence[str] = ()
) -> Score:
    """Score one diagnosis.

    Parameters
    ----------
    label : Label
        Truth of the case.
    gap : GapReport or None
        None where the diagnosis failed.
    fleet : sequence of str
        All aircraft of the archive.
    """
    asked: Asked = {
        "name": label["name"],
        "rung": label["rung"],
        "kind": label["kind"],
        "variant": label["variant"],
        "world": label["world"],
        "size": label["size"],
        "focus": label["focus"],
        "failure": failure if gap is None else None,
    }
    # spelled out for the type checker: of a failed diagnosis no score is there
    nothing: Found = {}
    if gap is None:
        return {**asked, **nothing}
    claims = gap.effects
    names = list(dict.fromkeys(claim.name for claim in claims))
    truth = [name for name in label["names"] if name not in label["without"]]
    truth = [name for name in truth if name in CATALOGUE]
    # what a hard world has by itself is neither asked for nor wrong to tell
    beside = set(label["background"]) - set(truth)
    judged = [claim for claim in claims if claim.name not in beside]
    false = [n for n in names if n not in truth and n not in label["background"]]
    raised = gap.unknown.present and not only_of_background(label, gap)
    found: Found = {
        "claimed": names,
        "detected": bool(judged) or raised,
        "first_right": bool(judged) and judged[0].name in truth,
        "all_named": bool(truth) and set(label["focus"]) & set(truth) <= set(names),
        "false_names": false,
        "repeated_names": repeated_names(label, claims),
        "claims": stated_claims(label, gap, truth),
        "log_score": log_score(claims, truth, skip=[*label["background"], *label["without"]]),
        "unknown": raised,
        "of_background": gap.unknown.present and not raised,
        "unknown_first": raised and not _ahead(claims, false, gap),
        "placed": _placed(label, gap.unknown) if raised else False,
        "outside": label["outside"],
        "stated_before": gap.closure.before,
    }
    found |= _set_scores(judged, truth) | _closure_scores(label, gap, beside)
    if label["kind"] in ("single", "pair"):
        found |= _match_scores(label, claims)
    if label["outside"] is not None:
        found |= unknown_scores(label, label["outside"], gap, fleet)
    return {**asked, **found}


def repeated_names(label: Label, claims: Sequence[EffectEntry]) -> list[str]:
    """Return the effects told more often than they are there, on aircraft in common."""
    out = []
    for name in dict.fromkeys(claim.name for claim in claims):
        own = [set(claim.tails) for claim in claims if claim.name == name]
        there = sum(effect["name"] == name for effect in label["effects"])
        # on other aircraft a second entry is no repetition
        common = sum(bool(a & b) for k, a in enumerate(own) for b in own[:k])
        if common and len(own) > max(there, 1):
            out.append(name)
    return out


def log_score(
    claims: Sequence[EffectEntry], truth: Sequence[str], *, skip: Sequence[str] = ()
) -> float:
    """Return the mean log2 probability given to what is true, over the catalogue's names.

    Parameters
    ----------
    truth, skip : sequence of str
        Names at work; names not judged.

    Returns
    -------
    float
        Zero is perfect, -1 a coin for every name.
    """
    stated = {name: 0.0 for name in draws() if name not in skip}
    for claim in claims:
        if claim.name in stated:
            stated[claim.name] = max(stated[claim.name], claim.probability)
    total = 0.0
    for name, probability in stated.items():
        given = probability if name in truth else 1.0 - probability
        # a certain answer that is wrong costs ten bits, not infinitely many
        total += float(np.log2(np.clip(given, 1e-3, 1 - 1e-3)))
    return total / len(stated)


def _how(name: str) -> Draw:
    return draws().get(name, Draw())


def _set_scores(claims: Sequence[EffectEntry], truth: Sequence[str]) -> Found:
    """Return whether the first claim's ambiguity set holds a truth, and how large it is."""
    if not claims or not truth:
        return {"in_set": None if not truth else False, "set_size": None}
    # a name comes with those it could not be told from: told together, one of them is right
    first = {claims[0].name, *claims[0].ambiguous_with}
    everyone = {name for claim in claims for name in (claim.name, *claim.ambiguous_with)}
    return {
        "in_set": bool(first & set(truth)),
        "in_any_set": set(truth) <= everyone,
        "set_size": len(first),
    }


def _closure_scores(label: Label, gap: GapReport, beside: set[str]) -> Found:
    """Return the error of the stated closure and whether its interval holds the truth, kt.

    The twin has the background too: what names ``beside`` the truth close is no part of it.
    """
    closure, truth = gap.closure, label["closure"]
    true = truth["before"] - truth["after"]
    known = sum(
        claim.closure.reduction
        for claim in gap.effects
        if claim.name in beside and claim.closure is not None
    )
    stated = closure.before - closure.after - known
    interval = closure.reduction_ci
    if interval is None and closure.ci is not None:
        interval = [closure.before - closure.ci[1], closure.before - closure.ci[0]]
    if interval is not None:
        interval = [end - known for end in interval]
    return {
        "closure_true": true,
        "closure_stated": stated,
        "closure_error": abs(stated - true),
        "closure_covered": None if interval is None else bool(interval[0] <= true <= interval[1]),
        "closure_interval": interval,
    }


def _ahead(claims: Sequence[EffectEntry], false: Sequence[str], gap: GapReport) -> bool:
    """Whether a false name stands before the unknown."""
    wrong = [claim for claim in claims if claim.name in false]
    if not wrong:
        return False
    places = gap.unknown.where
    if not places:
        return True
    closed = [place.closure.reduction for place in places if place.closure is not None]
    if len(closed) == len(places):
        share = max(claim.share_of_gap for claim in wrong)
        return share * gap.closure.reduction > max(closed)
    energy = max(claim.held_out_energy for claim in wrong)
    return energy > max(place.held_out_energy for place in places)


def _placed(label: Label, unknown: UnknownEntry) -> bool:
    """Whether a place of the unknown names a variable of the effect, or exactly its aircraft."""
    wanted = {name for focus in label["focus"] for name in _how(focus).places}
    if label["outside"] is not None:
        wanted = set(label["outside"]["variables"])
    tails = {tail for effect in label["effects"] for tail in effect["tails"] or ()}
    for place in unknown.where:
        told = {place.variable, *place.variables}
        if any(same_variable(name, true) for name in told for true in wanted):
            return True
        named = set(place.tails)
        # half of all named or struck in common: a single aircraft too many or too few is near
        # enough
        if not wanted and tails and named and len(tails & named) / len(tails | named) >= 0.5:
            return True
    return False


def _match_scores(label: Label, claims: Sequence[EffectEntry]) -> Found:
    """Return aircraft, parameter and date scores of the effects that were named."""
    overlaps, errors, dates = [], [], []
    for name in label["focus"]:
        own = [effect for effect in label["effects"] if effect["name"] == name]
        found = [claim for claim in claims if claim.name == name]
        if not found:
            continue
        if _how(name).whose != "fleet" and own[0]["tails"] is not None:
            overlaps.append(aircraft_overlap(own, found))
        errors += parameter_errors(name, own, found)
        if own[0]["period"]:
            dates.append(date_error(own[0]["period"], [claim.period for claim in found]))
    known = [value for value in dates if value is not None]
    mean = [float(np.mean([o[k] for o in overlaps])) if overlaps else None for k in range(3)]
    return {
        "precision": mean[0],
        "recall": mean[1],
        "jaccard": mean[2],
        "parameter_error": float(np.median(errors)) if errors else None,
        "date_error": float(np.median(known)) if known else None,
    }


def aircraft_overlap(
    own: Sequence[Injected], found: Sequence[EffectEntry]
) -> tuple[float, float, float]:
    """Return precision, recall and Jaccard index of the aircraft named.

    Parameters
    ----------
    own, found : sequence
        True and claimed entries of one name.
    """
    true = {tail for effect in own for tail in effect["tails"] or ()}
    told = {tail for claim in found for tail in claim.tails}
    both = len(true & told)
    return (
        both / len(told) if told else 0.0,
        both / len(true) if true else 0.0,
        both / len(true | told) if true | told else 0.0,
    )


def parameter_errors(
    name: str, own: Sequence[Injected], found: Sequence[EffectEntry]
) -> list[float]:
    """Return the relative errors of the stated parameters.

    Parameters
    ----------
    own, found : sequence
        True and claimed entries.

    Returns
    -------
    list of float
        One per aircraft that was named rightly and has parameters of its own, else one: the
        length of the difference over the length of the truth, where offset and cycle are
        orthogonal components (a cycle counts by its root mean square).
    """
    true = own[0]["parameters"]
    stated: list[Mapping[str, object]] = []
    for claim in found:
        tails = own[0]["tails"]
        each = claim.per_tail or {}
        chosen = [one.parameters for tail, one in each.items() if tails is None or tail in tails]
        stated += chosen or [claim.parameters]
    wanted = _vector(name, true)
    size = float(np.linalg.norm(wanted))
    if size == 0.0:
        return []
    return [float(np.linalg.norm(_vector(name, one) - wanted)) / size for one in stated]


def _vector(name: str, parameters: Mapping[str, object]) -> NDArray[np.float64]:
    """Return the primary parameters as orthogonal components."""
    out = []
    compared = _how(name).compared
    for key in compared:
        if key == "phase_deg":
            continue
        value = _number(parameters, key)
        if key == "amplitude_deg" and "phase_deg" in compared:
            angle = np.radians(_number(parameters, "phase_deg"))
            out += [value * np.cos(angle) / np.sqrt(2), value * np.sin(angle) / np.sqrt(2)]
        else:
            out.append(value)
    return np.array(out, float)


def _number(parameters: Mapping[str, object], key: str) -> float:
    value = parameters.get(key)
    return float(value) if isinstance(value, int | float) else 0.0


def date_error(
    period: Sequence[str | None], told: Sequence[Sequence[str | None] | None]
) -> float | None:
    """Return the distance in days between the true start and the nearest one told; None if none."""
    true = _date(period[0])
    starts = [_date(one[0]) for one in told if one]
    apart = [
        abs((start - true).total_seconds()) / DAY
        for start in starts
        if start is not None and true is not None
    ]
    return min(apart) if apart else None


def _date(text: str | None) -> datetime | None:
    if text is None:
        return None
    return datetime.fromisoformat(text.replace("Z", "")).replace(tzinfo=None)
