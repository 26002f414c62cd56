"""What scoring a case gives, key by key, for who scores and who sums up and shows it.

Assumes scores as `airswing.blind_check.scoring.score_case` and
`airswing.blind_check.baselines.run_baselines` make them. A key that does not apply to a kind of
case is not there; None stands where a score applies and nothing can be told.

Units: kt for closures, m/s for sizes, days for dates, fractions of 1.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypedDict

from airswing.synthetic.sealed.labels import OutsideTruth

__all__ = ["Asked", "BaselineScore", "Found", "MeanKey", "Score", "ShareKey", "StatedClaim"]


class StatedClaim(NamedTuple):
    """A claim of a diagnosis with the probability stated and whether it is right."""

    kind: Literal["name", "unknown"]
    probability: float
    right: bool


class BaselineScore(TypedDict):
    """One case by a simple method."""

    name: str
    kind: str
    rung: int
    size: float
    claimed: list[str]
    detected: bool
    first_right: bool
    false_names: list[str]


class Asked(TypedDict):
    """What a case was, and whether its diagnosis ended well."""

    name: str
    rung: int
    kind: str
    variant: str
    world: str
    size: float
    focus: list[str]
    failure: str | None  # message of a diagnosis that did not end well


class Found(TypedDict, total=False):
    """What a diagnosis that ended well got right."""

    claimed: list[str]
    detected: bool
    first_right: bool
    all_named: bool
    false_names: list[str]
    repeated_names: list[str]
    claims: list[StatedClaim]
    log_score: float
    unknown: bool
    of_background: bool
    unknown_first: bool
    placed: bool
    outside: OutsideTruth | None
    stated_before: float
    # in_set, in_any_set, set_size: of the first claim's ambiguity set; without a truth None
    in_set: bool | None
    in_any_set: bool
    set_size: int | None
    closure_true: float
    closure_stated: float
    closure_error: float
    closure_covered: bool | None
    closure_interval: list[float] | None
    # of single effects and pairs, of what was named: None without
    precision: float | None
    recall: float | None
    jaccard: float | None
    parameter_error: float | None
    date_error: float | None
    # of outside effects; all but the closure None where no unknown is raised
    variable_first: bool | None
    variable_near: bool | None
    variable_any: bool | None
    unknown_precision: float | None
    unknown_recall: float | None
    unknown_closure_stated: float
    unknown_closure_interval: list[float]
    unknown_closure_error: float
    unknown_closure_covered: bool
    # of what was not raised: whether it closes no more than the report says could hide
    could_hide_holds: bool | None


class Score(Asked, Found):
    """One case: what was asked, and what of it was found (nothing where the diagnosis failed)."""


ShareKey = Literal[
    "detected",
    "first_right",
    "all_named",
    "in_set",
    "closure_covered",
    "unknown",
    "unknown_first",
    "unknown_closure_covered",
    "could_hide_holds",
    "variable_first",
]
MeanKey = Literal[
    "set_size",
    "precision",
    "recall",
    "jaccard",
    "parameter_error",
    "date_error",
    "closure_error",
    "log_score",
    "unknown_precision",
    "unknown_recall",
    "unknown_closure_error",
]
