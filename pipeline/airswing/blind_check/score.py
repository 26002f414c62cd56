"""Score of one diagnosis (the documented keys of ``gap.json``) against the label of its case.

Hard worlds contain gross errors, and archives with the record of a real sensor contain irregular
heading errors of all aircraft. Such background effects are neither required nor counted as false. A
false name precedes an unknown if it closes more than every entry of the unknown.

Units: kt for closures, days for dates, fractions of 1 for shares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.effects import CATALOGUE
from airswing.synthetic.sealed.draws import Draw
from airswing.synthetic.sealed.labels import Injected, Label
from airswing.units import DAY

Entry = Mapping[str, Any]
Score = dict[str, Any]

#: Variables of a diagnosis and of the generator (`outside_effects.VARIABLES`) that are one.
SYNONYMS = ({"magnetic_heading", "heading"}, {"date", "time"}, {"bank", "turn"})


def draws() -> dict[str, Draw]:
    """How each effect of the catalogue that the check uses is drawn, by name."""
    return {name: effect.draw for name, effect in CATALOGUE.items() if effect.draw is not None}


def score_case(
    label: Label, gap: Entry | None, *, failure: str | None = None, fleet: Sequence[str] = ()
) -> Score:
    """Score one diagnosis, the content of ``gap.json``; None if it failed, with the message.

    ``fleet`` are all aircraft of the archive. Returns the case (``name, rung, kind, variant, world,
    size, focus``), ``failure`` and, for a diagnosis that succeeded, its scores. A key that does not
    apply is absent or None.
    """
    keys = ("name", "rung", "kind", "variant", "world", "size", "focus")
    asked: Score = {key: label[key] for key in keys}
    asked["failure"] = failure if gap is None else None
    if gap is None:
        return asked
    claims: Sequence[Entry] = gap["effects"]
    places: Sequence[Entry] = gap["unknown"]["where"]
    truth = [n for n in label["names"] if n in CATALOGUE and n not in label["without"]]
    background = set(label["background"]) - set(truth)
    names = list(dict.fromkeys(claim["name"] for claim in claims))
    false = [name for name in names if name not in truth and name not in background]
    judged = [claim for claim in claims if claim["name"] not in background]
    of_background = label.get("background_components", ())
    unknown = [place for place in places if place["component"] not in of_background]
    # every statement that can be judged: its kind, its stated probability, whether it is right
    stated = [("name", float(claim["probability"]), claim["name"] in truth) for claim in judged]
    if label["world"] != "hard" and label["kind"] != "removed":
        right = label["kind"] == "outside"
        stated += [("unknown", float(place["probability"]), right) for place in unknown]
    first = {judged[0]["name"], *judged[0]["ambiguous_with"]} if judged else set()
    score: Score = {
        "claimed": names,
        "unknown": bool(unknown),
        "detected": bool(judged or unknown),
        "first_right": bool(judged) and judged[0]["name"] in truth,
        "all_named": bool(truth) and set(label["focus"]) & set(truth) <= set(names),
        "in_set": bool(first & set(truth)) if truth else None,
        "false_names": false,
        "claims": stated,
    }
    if label["kind"] in ("single", "pair"):
        score |= _score_names(label, claims)
    if label["outside"] is not None:
        score |= _score_unknown(label, claims, unknown, false, fleet)
    return asked | score | _score_closure(label, gap, background)


def _score_names(label: Label, claims: Sequence[Entry]) -> Score:
    precision, recall, errors, deviations, dates = [], [], [], [], []
    for name in label["focus"]:
        effects = [effect for effect in label["effects"] if effect["name"] == name]
        named = [claim for claim in claims if claim["name"] == name]
        if not named:
            continue
        draw = draws().get(name, Draw())
        true_tails = effects[0]["tails"]
        if draw.scope != "fleet" and true_tails is not None:
            stated = {tail for claim in named for tail in claim["tails"]}
            common = len(stated & set(true_tails))
            precision.append(common / len(stated) if stated else 0.0)
            recall.append(common / len(true_tails))
        compared = draw.compared(effects[0]["parameters"])
        errors += parameter_errors(compared, effects[0], named)
        deviations += standardised_errors(compared, effects[0], named)
        if effects[0]["period"]:
            dates.append(date_error(effects[0]["period"], [claim["period"] for claim in named]))
    valid = [value for value in dates if value is not None]
    return {
        "precision": float(np.mean(precision)) if precision else None,
        "recall": float(np.mean(recall)) if recall else None,
        "parameter_error": float(np.median(errors)) if errors else None,
        "standardised_errors": deviations,
        "date_error": float(np.median(valid)) if valid else None,
    }


def _entries(effect: Injected, claims: Sequence[Entry]) -> list[Entry]:
    tails = effect["tails"]
    out: list[Entry] = []
    for claim in claims:
        rows = claim.get("per_tail") or {}
        out += [row for tail, row in rows.items() if tails is None or tail in tails] or [claim]
    return out


def parameter_errors(
    compared: Sequence[str], effect: Injected, claims: Sequence[Entry]
) -> list[float]:
    """Relative errors of the stated parameters, one for each aircraft that has the effect.

    The length of the difference over the length of the truth; amplitude and phase of a cycle are
    two orthogonal components.
    """
    true = _components(compared, effect["parameters"])
    size = float(np.linalg.norm(true))
    if size == 0.0:
        return []
    stated = [_components(compared, row["parameters"]) for row in _entries(effect, claims)]
    return [float(np.linalg.norm(row - true)) / size for row in stated]


def standardised_errors(
    compared: Sequence[str], effect: Injected, claims: Sequence[Entry]
) -> list[float]:
    """Errors of parameters in their stated standard errors (angles of phase excluded)."""
    out = []
    for row in _entries(effect, claims):
        for key in compared:
            error = _number(row.get("standard_errors", {}), key)
            if key != "phase_deg" and error > 0.0:
                true, stated = _number(effect["parameters"], key), _number(row["parameters"], key)
                out.append((stated - true) / error)
    return out


def _components(compared: Sequence[str], parameters: Mapping[str, object]) -> NDArray[np.float64]:
    out: list[float] = []
    for key in compared:
        value = _number(parameters, key)
        if key == "amplitude_deg" and "phase_deg" in compared:
            angle = np.radians(_number(parameters, "phase_deg"))
            out += [value * np.cos(angle) / np.sqrt(2), value * np.sin(angle) / np.sqrt(2)]
        elif key != "phase_deg":
            out.append(value)
    return np.array(out, float)


def _number(parameters: Mapping[str, object], key: str) -> float:
    value = parameters.get(key)
    return float(value) if isinstance(value, int | float) else 0.0


def date_error(
    period: Sequence[str | None], stated: Sequence[Sequence[str | None] | None]
) -> float | None:
    """Days from the true start to the nearest stated one; None without a stated start."""
    true = _date(period[0])
    starts = [_date(p[0]) for p in stated if p]
    return min(
        (abs((s - true).total_seconds()) / DAY for s in starts if s is not None and true),
        default=None,
    )


def _date(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text.rstrip("Z")).replace(tzinfo=None)


def same_variable(stated: str, true: str) -> bool:
    """Whether two names denote the same variable of a report."""
    return stated == true or any({stated, true} <= names for names in SYNONYMS)


def _reduction(entry: Entry) -> float:
    closure = entry.get("closure")
    return 0.0 if closure is None else float(closure["reduction"])


def _score_unknown(
    label: Label,
    claims: Sequence[Entry],
    unknown: Sequence[Entry],
    false: Sequence[str],
    fleet: Sequence[str],
) -> Score:
    if not unknown:
        return {"unknown_first": False}
    places = sorted(unknown, key=_reduction, reverse=True)
    largest = max((_reduction(claim) for claim in claims if claim["name"] in false), default=0.0)
    truth = label["outside"]
    assert truth is not None
    variable = (list(places[0]["variables"]) or [places[0]["variable"]])[0]
    stated = {tail for place in places for tail in place["tails"] or fleet}
    true = {tail for effect in label["effects"] for tail in effect["tails"] or fleet}
    common = len(stated & true)
    return {
        "unknown_first": not false or largest <= _reduction(places[0]),
        "variable_first": any(same_variable(variable, name) for name in truth["variables"]),
        "precision": common / len(stated) if stated else 0.0,
        "recall": common / len(true) if true else 0.0,
    }


def _score_closure(label: Label, gap: Entry, background: set[str]) -> Score:
    """Stated and true closure, kt; effects of the background are subtracted from the stated one."""
    closure = gap["closure"]
    true = label["closure"]["before"] - label["closure"]["after"]
    subtracted = sum(_reduction(claim) for claim in gap["effects"] if claim["name"] in background)
    stated = closure["before"] - closure["after"] - subtracted
    ends = [end - subtracted for end in closure["reduction_ci"]]
    return {
        "closure_true": true,
        "closure_stated": stated,
        "closure_error": abs(stated - true),
        "closure_interval": ends,
        "closure_covered": bool(ends[0] <= true <= ends[1]),
    }
