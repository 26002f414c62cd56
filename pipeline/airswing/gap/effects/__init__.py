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
from airswing.gap.effects.forms import (
    HeadingEffect,
    MomentEffect,
    OffsetAndCycle,
    OneCoefficient,
    WindEffect,
)

__all__ = [
    "CATALOGUE",
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
    "register",
    "unregister",
]

discover(__name__)
