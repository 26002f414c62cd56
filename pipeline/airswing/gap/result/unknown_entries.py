"""What unknowns close, put into gap.json beside what has a name.

Assumptions: unknowns with a table were taken off before the names were searched for a last time, so
the names' closure is measured without them; unknowns of the dictionary come after the names. All
steps are on weeks left out.

Units: kt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from airswing.gap.held_out.reduction import Closure
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem
from airswing.gap.witness.taken_off import Taken, entry, interval
from airswing.units import KNOT


def with_unknowns(
    report: dict[str, Any],
    details: dict[str, Any],
    taken: Sequence[Taken],
    *,
    problem: Problem,
    found: Found,
    whole: Closure,
) -> None:
    """Add unknowns, their closure and their steps of the waterfall, in place.

    Parameters
    ----------
    report, details : dict
        From `airswing.gap.result.assembled.assemble`.
    taken : sequence of Taken
        Unknowns taken off before.
    problem : Problem
        Of the archive without them.
    found : Found
    whole : Closure
        With the dictionary's unknown terms; in the order of the terms.
    """
    day, seed = problem.day, problem.seed
    tables = [entry(one, problem.archive.tails, day, seed) for one in taken]
    others = report["unknown"]["where"]
    _dictionary_closures(others, found, whole)
    after_names = report["closure"]["after"]
    curves = max(after_names - whole.after, 0.0) if others else 0.0
    report["unknown"]["where"] = [*tables, *others]
    report["unknown"]["present"] = bool(tables or others)
    saved = sum((one.saved for one in taken), np.zeros(problem.archive.size))
    moved = float(saved.mean()) / KNOT
    low, high = interval(saved, day, seed) if taken else (0.0, 0.0)
    if others:
        spread = 0.5 * curves + 0.01
        low, high = low - spread, high + spread
    if tables or others:
        left = (
            report["gap"]["mean_vector_disagreement_kt"]
            + moved
            - (report["closure"]["before"] - after_names)
        )
        report["unknown"]["closure"] = {
            "before": left,
            "after": left - moved - curves,
            "reduction": moved + curves,
            "reduction_ci": [low + curves, high + curves],
        }
    if taken:
        _moved(report, details, taken, moved)


def _dictionary_closures(places: Sequence[dict[str, Any]], found: Found, whole: Closure) -> None:
    """Give each unknown of the dictionary the step its term makes."""
    before, steps = whole.before, []
    for term, (_, after, low, high) in zip(found.terms, whole.sequence, strict=False):
        if not term.candidate.known:
            steps.append((term.candidate.name, before - after, low, high))
        before = after
    for place in places:
        if "closure" in place:  # of scatter, told where it was found
            continue
        own = [step for step in steps if step[0] == place.get("group")]
        _, reduction, low, high = own[0] if own else ("", 0.0, 0.0, 0.0)
        place["closure"] = {"reduction": reduction, "reduction_ci": [low, high]}
        if own:
            steps.remove(own[0])


def _moved(
    report: dict[str, Any], details: dict[str, Any], taken: Sequence[Taken], moved: float
) -> None:
    """Start the closure and the waterfall from the archive as it is."""
    closure = report["closure"]
    closure["before"] += moved
    closure["after"] += moved
    if closure["ci"] is not None:
        closure["ci"] = [end + moved for end in closure["ci"]]
    report["gap"]["mean_vector_disagreement_kt"] += moved
    strongest = max(one.unknown.evidence for one in taken)
    report["gap"]["significance"] = min(
        report["gap"]["significance"], float(50.0 * np.exp(-min(strongest, 60.0)))
    )
    everything = closure["before"] - report["gap"]["noise_floor_kt"]
    if everything > 1e-6:
        closure["fraction_of_excess"] = float(np.clip(closure["reduction"] / everything, 0, 1))
    now, steps = closure["before"], []
    for one in taken:
        step = float(one.saved.mean()) / KNOT
        now -= step
        names = " x ".join(one.unknown.grid.variables)
        what = one.unknown.component.replace("_", " ")
        steps.append({"label": f"unknown: {what} by {names}", "kt": now, "step_ci": None})
    first, *rest = details["waterfall"]
    details["waterfall"] = [first | {"kt": closure["before"]}, *steps, *rest]
