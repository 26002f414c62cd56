"""From the scores of the cases to the figures a check is judged by.

Assumptions: an effect is *detectable* from 0.4 m/s where it acts; medians and shares are over the
cases a score applies to, and every share is given with how many cases that is.

Units: kt, days, fractions of 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["BY", "TARGETS", "baseline_rows", "grouped", "of_default", "summarise", "targets"]

Score = Mapping[str, Any]
DETECTABLE = 0.4


def _share(scores: Iterable[Score], key: str) -> tuple[float | None, int]:
    values = [bool(score[key]) for score in scores if score.get(key) is not None]
    return (float(np.mean(values)) if values else None), len(values)


def _median(scores: Iterable[Score], key: str) -> tuple[float | None, int]:
    values = [float(score[key]) for score in scores if score.get(key) is not None]
    return (float(np.median(values)) if values else None), len(values)


def _mean(scores: Iterable[Score], key: str) -> tuple[float | None, int]:
    values = [float(score[key]) for score in scores if score.get(key) is not None]
    return (float(np.mean(values)) if values else None), len(values)


def summarise(scores: Sequence[Score]) -> dict[str, Any]:
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


BY: dict[str, Callable[[Score], Any]] = {
    "effect": lambda score: " + ".join(score["focus"]) or "nothing",
    "size": lambda score: score["size"],
    "rung": lambda score: score["rung"],
}
"""Ways to split the cases."""


def grouped(scores: Sequence[Score], by: str) -> dict[Any, dict[str, Any]]:
    """Return the summary of every group.

    Parameters
    ----------
    scores : sequence of mapping
        Of the cases.
    by : str
        Key of `BY`.

    Returns
    -------
    dict
        In ascending order of the group's name.
    """
    key = BY[by]
    names = sorted({key(score) for score in scores})
    return {name: summarise([s for s in scores if key(s) == name]) for name in names}


def _detectable(scores: Sequence[Score]) -> list[Score]:
    return [
        score
        for score in scores
        if score["kind"] == "single" and score["size"] >= DETECTABLE and not score.get("failure")
    ]


def _of(scores: Sequence[Score], kind: str) -> list[Score]:
    return [score for score in scores if score["kind"] == kind and not score.get("failure")]


def _claims_on_nulls(scores: Sequence[Score]) -> tuple[float | None, int]:
    nulls = _of(scores, "null")
    values = [bool(score["false_names"]) or bool(score["unknown"]) for score in nulls]
    return (float(np.mean(values)) if values else None), len(values)


def _named_singles(scores: Sequence[Score]) -> list[Score]:
    return [score for score in _detectable(scores) if score.get("all_named")]


def _both_named(scores: Sequence[Score]) -> tuple[float | None, int]:
    return _share([s for s in _of(scores, "pair") if s["size"] >= DETECTABLE], "all_named")


TARGETS: tuple[tuple[str, str, float, Callable[[Sequence[Score]], tuple[float | None, int]]], ...]
TARGETS = (
    ("first name right, single effects of 0.4 m/s and more", ">=", 0.95,
     lambda s: _share(_detectable(s), "first_right")),
    ("truth in the ambiguity set, the same", ">=", 0.99,
     lambda s: _share(_detectable(s), "in_set")),
    ("both of a pair named", ">=", 0.90, _both_named),
    ("claims on nulls (a name or an unknown)", "<=", 0.02, _claims_on_nulls),
    ("outside the catalogue: unknown raised, no false name ahead", ">=", 0.90,
     lambda s: _share(_of(s, "outside"), "unknown_first")),
    ("outside the catalogue: placed", ">=", 0.90, lambda s: _share(_of(s, "outside"), "placed")),
    ("removed from the catalogue: never silent", ">=", 0.95,
     lambda s: _share(_of(s, "removed"), "detected")),
    ("aircraft precision", ">=", 0.95, lambda s: _mean(_named_singles(s), "precision")),
    ("aircraft recall", ">=", 0.95, lambda s: _mean(_named_singles(s), "recall")),
    ("parameter error, median", "<=", 0.08,
     lambda s: _median(_named_singles(s), "parameter_error")),
    ("date error, median, days", "<=", 3.0, lambda s: _median(_named_singles(s), "date_error")),
    ("closure error, median, kt", "<=", 0.15,
     lambda s: _median(_detectable(s), "closure_error")),
    ("closure interval holds the truth", ">=", 0.90,
     lambda s: _share(_detectable(s), "closure_covered")),
)  # fmt: skip
"""What is measured, which way is good, the target, how it is computed (and from how many cases)."""


def of_default(scores: Sequence[Score]) -> list[Score]:
    """Scores of default archives: neither of the hard world nor with real errors.

    Parameters
    ----------
    scores : sequence of mapping

    Returns
    -------
    list of mapping
    """
    return [score for score in scores if score["world"] == "default"]


def targets(scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Return every target with what was reached.

    Parameters
    ----------
    scores : sequence of mapping
        Of all cases.

    Returns
    -------
    list of dict
        ``what, sense, target, reached, cases, met`` (met is None without cases).
    """
    out = []
    for what, sense, target, measure in TARGETS:
        reached, number = measure(scores)
        met = None
        if reached is not None:
            met = reached >= target if sense == ">=" else reached <= target
        out.append(
            {"what": what, "sense": sense, "target": target, "reached": reached,
             "cases": number, "met": met}
        )  # fmt: skip
    return out


def baseline_rows(
    scores: Sequence[Score], baselines: Mapping[str, Sequence[Score]]
) -> list[dict[str, Any]]:
    """Return ours and the baselines on the same cases.

    Parameters
    ----------
    scores : sequence of mapping
        Ours.
    baselines : mapping
        Name to theirs.

    Returns
    -------
    list of dict
        ``method, detected, first_right, false_alarms, extra_names``.
    """
    rows = []
    for name, own in {"airswing gap": scores, **baselines}.items():
        singles = [s for s in _of(own, "single") if s["size"] >= DETECTABLE]
        nulls = _of(own, "null")
        alarms = [bool(s["false_names"]) or bool(s.get("unknown", s["detected"])) for s in nulls]
        rows.append(
            {
                "method": name,
                "detected": _share(singles, "detected")[0],
                "first_right": _share(singles, "first_right")[0],
                "false_alarms": float(np.mean(alarms)) if alarms else None,
                "extra_names": float(np.mean([bool(s["false_names"]) for s in singles]))
                if singles
                else None,
                "singles": len(singles),
                "nulls": len(nulls),
            }
        )
    return rows
