"""From the scores of the cases to the figures a check is judged by.

Assumptions: an effect is *detectable* from 0.4 m/s where it acts; medians and shares are over the
cases a score applies to, and every share is given with how many cases that is.

Units: kt, days, fractions of 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypedDict

import numpy as np

from airswing.blind_check.reliability_table import worst_gap
from airswing.blind_check.scores import BaselineScore, MeanKey, Score, ShareKey
from airswing.synthetic.sealed.outside_truth import WORTH_KT

__all__ = [
    "BY",
    "TARGETS",
    "baseline_rows",
    "grouped",
    "hard_and_real",
    "of_default",
    "summarise",
    "targets",
]

Reached = tuple[float | None, int]
Group = str | float
Target = float | tuple[float, float]
# m/s: a smaller effect is scored and shown, but counts in no target.
_DETECTABLE = 0.4


class TargetReached(TypedDict):
    """A target and what was reached; both None without cases."""

    what: str
    sense: str
    target: Target
    reached: float | None
    cases: int
    met: bool | None


class MethodRow(TypedDict):
    """One method on the cases all were played on; shares None without cases."""

    method: str
    detected: float | None
    first_right: float | None
    false_alarms: float | None
    extra_names: float | None
    singles: int
    nulls: int


def _of_all(values: Sequence[bool | float]) -> Reached:
    return (float(np.mean(values)) if values else None), len(values)


def _share(scores: Iterable[Score], key: ShareKey) -> Reached:
    return _of_all([bool(score[key]) for score in scores if score.get(key) is not None])


def _told(scores: Iterable[Score], key: MeanKey) -> list[float]:
    values = [score.get(key) for score in scores]
    return [float(value) for value in values if value is not None]


def _median(scores: Iterable[Score], key: MeanKey) -> Reached:
    values = _told(scores, key)
    return (float(np.median(values)) if values else None), len(values)


def _mean(scores: Iterable[Score], key: MeanKey) -> Reached:
    return _of_all(_told(scores, key))


def summarise(scores: Sequence[Score]) -> dict[str, float | None]:
    """Return shares and medians of a group of cases with an effect in the catalogue.

    Parameters
    ----------
    scores : sequence of mapping
        From `airswing.blind_check.scoring.score_case`.

    Returns
    -------
    dict
        ``cases`` and the scores; None where none applies.
    """
    done = [score for score in scores if score.get("failure") is None]
    named = [score for score in done if score.get("all_named")]
    return {
        "cases": len(scores),
        "failed": len(scores) - len(done),
        "detected": _share(done, "detected")[0],
        "first_right": _share(done, "first_right")[0],
        "all_named": _share(done, "all_named")[0],
        "in_set": _share(done, "in_set")[0],
        "set_size": _mean(done, "set_size")[0],
        "extra_names": float(np.mean([bool(s["false_names"]) for s in done])) if done else None,
        "precision": _mean(named, "precision")[0],
        "recall": _mean(named, "recall")[0],
        "jaccard": _mean(named, "jaccard")[0],
        "parameter_error": _median(named, "parameter_error")[0],
        "date_error": _median(named, "date_error")[0],
        "closure_error": _median(done, "closure_error")[0],
        "closure_covered": _share(done, "closure_covered")[0],
        "unknown": _share(done, "unknown")[0],
        "log_score": _mean(done, "log_score")[0],
    }


# Ways to split the cases.
BY: dict[str, Callable[[Score], Group]] = {
    "effect": lambda score: " + ".join(score["focus"]) or "nothing",
    "variant": lambda score: score["variant"],
    "size": lambda score: score["size"],
    "rung": lambda score: score["rung"],
}


def grouped(scores: Sequence[Score], by: str) -> dict[Group, dict[str, float | None]]:
    """Return the summary of every group.

    Parameters
    ----------
    by : str
        Key of `BY`.

    Returns
    -------
    dict
        In ascending order of the group's name.
    """
    key = BY[by]
    # words or numbers, never both
    names = sorted(
        {key(score) for score in scores},
        key=lambda name: (0.0, name) if isinstance(name, str) else (name, ""),
    )
    return {name: summarise([s for s in scores if key(s) == name]) for name in names}


def _detectable(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _of(scores, "single") if score["size"] >= _DETECTABLE]


def _of(scores: Sequence[Score], kind: str) -> list[Score]:
    return [score for score in scores if score["kind"] == kind and not score.get("failure")]


def _outside(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _of(scores, "outside") if score["size"] >= _DETECTABLE]


def _worth(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _outside(scores) if score["closure_true"] >= WORTH_KT]


def _raised(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _outside(scores) if score["unknown"]]


def _with_false_names(scores: Sequence[Score]) -> Reached:
    """Archives in which a name stands that is not at work; what was taken out has none."""
    judged = [s for s in scores if not s.get("failure") and s["kind"] != "removed"]
    return _of_all([bool(score["false_names"]) for score in judged])


def _with_repeats(scores: Sequence[Score]) -> Reached:
    return _of_all([bool(s["repeated_names"]) for s in scores if not s.get("failure")])


def _claims_on_nulls(scores: Sequence[Score]) -> Reached:
    nulls = _of(scores, "null")
    return _of_all([bool(score["false_names"]) or bool(score["unknown"]) for score in nulls])


def _named(scores: Sequence[Score]) -> list[Score]:
    """Single effects and pairs of which every one is named."""
    both = [*_detectable(scores), *_of(scores, "pair")]
    return [score for score in both if score.get("all_named")]


def _named_singles(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _detectable(scores) if score.get("all_named")]


def _both_named(scores: Sequence[Score]) -> Reached:
    return _share([s for s in _of(scores, "pair") if s["size"] >= _DETECTABLE], "all_named")


def _removed(scores: Sequence[Score]) -> list[Score]:
    """Effects taken out of the catalogue whose truth closes enough to be missed."""
    return [score for score in _of(scores, "removed") if score["closure_true"] >= WORTH_KT]


def _same_aircraft(scores: Sequence[Score]) -> list[Score]:
    return [s for s in _of(scores, "pair") if s["variant"] == "same aircraft"]


def _reliability(scores: Sequence[Score]) -> Reached:
    return worst_gap([claim for s in scores if not s.get("failure") for claim in s["claims"]])


TARGETS: tuple[tuple[str, str, Target, Callable[[Sequence[Score]], Reached]], ...]
# What is measured, which way is good, the target, how it is computed (and from how many cases).
TARGETS = (
    (
        "outside, 0.4 m/s and more: unknown raised, no false name ahead",
        ">=",
        0.90,
        lambda s: _share(_outside(s), "unknown_first"),
    ),
    (
        "the same, where the truth closes 0.1 kt or more",
        ">=",
        0.90,
        lambda s: _share(_worth(s), "unknown_first"),
    ),
    (
        "of those raised: a true variable named first",
        ">=",
        0.85,
        lambda s: _share(_raised(s), "variable_first"),
    ),
    (
        "of those raised: aircraft precision",
        ">=",
        0.90,
        lambda s: _mean(_raised(s), "unknown_precision"),
    ),
    ("of those raised: aircraft recall", ">=", 0.90, lambda s: _mean(_raised(s), "unknown_recall")),
    (
        "outside: closure error, median, kt",
        "<=",
        0.10,
        lambda s: _median(_outside(s), "unknown_closure_error"),
    ),
    (
        "outside: closure interval holds the truth",
        "in",
        (0.90, 0.98),
        lambda s: _share(_outside(s), "unknown_closure_covered"),
    ),
    (
        "outside and not told: closes no more than is said could hide",
        ">=",
        0.95,
        lambda s: _share(_outside(s), "could_hide_holds"),
    ),
    (
        "first name right, single effects and their forms, any scope",
        ">=",
        0.95,
        lambda s: _share(_detectable(s), "first_right"),
    ),
    (
        "truth in the ambiguity set, the same",
        ">=",
        0.99,
        lambda s: _share(_detectable(s), "in_set"),
    ),
    ("both of a pair named", ">=", 0.92, _both_named),
    ("the same, on the same aircraft", ">=", 0.92, lambda s: _both_named(_same_aircraft(s))),
    (
        "archives with a false name (of all but those with an effect removed)",
        "<=",
        0.03,
        _with_false_names,
    ),
    ("archives with an effect told more than once", "<=", 0.03, _with_repeats),
    ("claims on nulls (a name or an unknown)", "<=", 0.02, _claims_on_nulls),
    ("reliability: worst bin of 20 claims and more", "<=", 0.05, _reliability),
    (
        "removed from the catalogue, truth closes 0.1 kt or more: never silent",
        ">=",
        0.95,
        lambda s: _share(_removed(s), "detected"),
    ),
    (
        "closure error of what is named, median, kt",
        "<=",
        0.05,
        lambda s: _median(_named(s), "closure_error"),
    ),
    (
        "closure interval of what is named holds the truth",
        "in",
        (0.90, 0.98),
        lambda s: _share(_named(s), "closure_covered"),
    ),
    ("aircraft precision of names", ">=", 0.95, lambda s: _mean(_named_singles(s), "precision")),
    ("aircraft recall of names", ">=", 0.95, lambda s: _mean(_named_singles(s), "recall")),
    (
        "parameter error, median",
        "<=",
        0.08,
        lambda s: _median(_named_singles(s), "parameter_error"),
    ),
    ("date error, median, days", "<=", 3.0, lambda s: _median(_named_singles(s), "date_error")),
)


def hard_and_real(scores: Sequence[Score]) -> Reached:
    """Share of first names right in the hard world and with real errors, at 0.4 m/s and more."""
    return _share(
        [s for s in _detectable(scores) if s["world"] not in ("default", "short")], "first_right"
    )


def short_nulls(scores: Sequence[Score]) -> Reached:
    """Share of nulls of two weeks on which something is claimed, and their number."""
    return _claims_on_nulls([score for score in scores if score["world"] == "short"])


def of_default(scores: Sequence[Score]) -> list[Score]:
    """Scores of default archives: not short, neither of the hard world nor with real errors."""
    return [score for score in scores if score["world"] == "default"]


def targets(scores: Sequence[Score]) -> list[TargetReached]:
    """Return every target with what was reached."""
    out: list[TargetReached] = []
    for what, sense, target, measure in TARGETS:
        reached, number = measure(scores)
        met = None if reached is None else _is_met(reached, sense, target, number)
        out.append(
            {
                "what": what,
                "sense": sense,
                "target": target,
                "reached": reached,
                "cases": number,
                "met": met,
            }
        )
    return out


def _is_met(reached: float, sense: str, target: Target, number: int) -> bool:
    """Whether a target is met; all of a few cases do not exceed what a larger number would show."""
    if isinstance(target, tuple):
        # of so few, none missed is what the upper end of the target lets expect
        few = number * (1.0 - target[1]) < 1.0
        return target[0] <= reached and (few or reached <= target[1])
    return reached >= target if sense == ">=" else reached <= target


def baseline_rows(
    scores: Sequence[Score], baselines: Mapping[str, Sequence[BaselineScore]]
) -> list[MethodRow]:
    """Return ours and the baselines on the same cases.

    Parameters
    ----------
    scores : sequence of Score
        Ours.
    baselines : mapping
        Name to theirs.
    """
    ours: Sequence[Score | BaselineScore] = scores
    rows: list[MethodRow] = []
    for name, own in {"airswing gap": ours, **baselines}.items():
        done = [s for s in own if not s.get("failure")]
        singles = [s for s in done if s["kind"] == "single" and s["size"] >= _DETECTABLE]
        nulls = [s for s in done if s["kind"] == "null"]
        alarms = [bool(s["false_names"]) or bool(s.get("unknown", s["detected"])) for s in nulls]
        rows.append(
            {
                "method": name,
                "detected": _of_all([s["detected"] for s in singles])[0],
                "first_right": _of_all([s["first_right"] for s in singles])[0],
                "false_alarms": _of_all(alarms)[0],
                "extra_names": _of_all([bool(s["false_names"]) for s in singles])[0],
                "singles": len(singles),
                "nulls": len(nulls),
            }
        )
    return rows
