"""The catalogue of effects: every module of this folder that holds an ``EFFECT`` is in it.

Adding an effect means adding one file here with an ``EFFECT``, or one call of `register`.
"""

from airswing.gap.effects.base import (
    CATALOGUE,
    ActiveEffect,
    Effect,
    Parameter,
    State,
    discover,
    register,
    unregister,
)
from airswing.gap.effects.empirical import EMPIRICAL
from airswing.gap.effects.forms import (
    HeadingEffect,
    MomentEffect,
    OffsetAndCycle,
    OneCoefficient,
    WindEffect,
)

__all__ = [
    "CATALOGUE",
    "EMPIRICAL",
    "ActiveEffect",
    "Effect",
    "HeadingEffect",
    "MomentEffect",
    "OffsetAndCycle",
    "OneCoefficient",
    "Parameter",
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
    """Effect of this name, of the catalogue or the empirical table; None where there is none."""
    return EMPIRICAL if name == EMPIRICAL.name else CATALOGUE.get(name)


def separated_by(effect: str, other: str, *, otherwise: str = "other flights") -> str:
    """Data that would tell two effects apart, in words, as the file of either of them says."""
    for own, rival in ((effect, other), (other, effect)):
        if own in CATALOGUE and rival in CATALOGUE[own].distinguished_by:
            return CATALOGUE[own].distinguished_by[rival]
    return otherwise
