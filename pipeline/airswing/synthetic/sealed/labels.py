"""What is true of a sealed case, key by key, for who writes a label and who scores by it.

Assumes labels as `airswing.synthetic.sealed.sealed_archives.Archivist.write` makes them. Sizes in
m/s root mean square where an effect acts, disagreements in kt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict


class Injected(TypedDict):
    """One effect as the generator is told it; ``tails`` None is the whole fleet."""

    name: str
    tails: Sequence[str] | None
    # of an outside effect also text and lists of parts
    parameters: Mapping[str, object]
    period: Sequence[str | None] | None


class TwinClosure(TypedDict):
    """Mean vector disagreement of an archive and of its twin without the effect, kt."""

    before: float
    after: float


class OutsideTruth(TypedDict):
    """An outside effect as measured on its archive."""

    component: str
    shape: str
    variables: list[str]
    scope: str
    reports: int
    size_m_s: float
    named_share: float  # of its energy, what has a name explains
    closes_kt: float
    carried: dict[str, float]  # share of its energy that a curve of each variable alone carries


class Label(TypedDict):
    """Truth of one case."""

    name: str
    rung: int
    kind: str
    variant: str
    world: str
    size: float  # the largest of ``sizes``
    sizes: list[float]
    focus: list[str]  # effects the case is about
    names: list[str]  # all at work
    effects: list[Injected]
    without: list[str]  # effects the diagnosis does without
    # background, background_components: names and components in which the world errs by itself
    background: list[str]
    background_components: NotRequired[list[str]]
    closure: TwinClosure
    outside: OutsideTruth | None
