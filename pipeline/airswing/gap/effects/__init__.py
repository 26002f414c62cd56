"""Catalogue of effects: every module of this folder that defines an ``EFFECT``.

An effect is added by a file in this folder with an ``EFFECT``, or by a call of `register`.
"""

from airswing.gap.effects.base import (
    CATALOGUE,
    ActiveEffect,
    CycleEffect,
    Effect,
    HeadingEffect,
    MomentEffect,
    OffsetAndCycle,
    Parameter,
    ProportionalEffect,
    State,
    WindEffect,
    discover,
    register,
    unregister,
)
from airswing.gap.effects.empirical import EMPIRICAL

__all__ = [
    "CATALOGUE",
    "EMPIRICAL",
    "ActiveEffect",
    "CycleEffect",
    "Effect",
    "HeadingEffect",
    "MomentEffect",
    "OffsetAndCycle",
    "Parameter",
    "ProportionalEffect",
    "State",
    "WindEffect",
    "discover",
    "effect_named",
    "register",
    "separated_by",
    "unregister",
]

discover(__name__)


def effect_named(name: str) -> Effect | None:
    """Return the effect of a name, from the catalogue or the empirical table; None if unknown."""
    return EMPIRICAL if name == EMPIRICAL.name else CATALOGUE.get(name)


def separated_by(effect: str, other: str, *, otherwise: str = "other flights") -> str:
    """Return, in words, the data that would separate two effects, as given by either of them."""
    for name, rival in ((effect, other), (other, effect)):
        if name in CATALOGUE and rival in CATALOGUE[name].distinguished_by:
            return CATALOGUE[name].distinguished_by[rival]
    return otherwise
