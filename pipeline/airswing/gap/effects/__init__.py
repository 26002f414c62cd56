"""Catalogue of effects: the ``EFFECT`` of every module of this folder."""

import importlib
import pkgutil

from airswing.gap.effects.base import CATALOGUE, ActiveEffect, Effect, Parameter, State
from airswing.gap.effects.empirical import EMPIRICAL

__all__ = ["CATALOGUE", "EMPIRICAL", "ActiveEffect", "Effect", "Parameter", "State"]

for _name in sorted(module.name for module in pkgutil.iter_modules(__path__)):
    _effect = getattr(importlib.import_module(f"{__name__}.{_name}"), "EFFECT", None)
    if isinstance(_effect, Effect):
        CATALOGUE[_effect.name] = _effect


def effect_named(name: str) -> Effect | None:
    """Return the effect of a name, from the catalogue or the empirical table; None if unknown."""
    return EMPIRICAL if name == EMPIRICAL.name else CATALOGUE.get(name)


def separated_by(effect: str, other: str, *, otherwise: str = "other flights") -> str:
    """Return, in words, the data that would separate two effects, as given by either of them."""
    for name, rival in ((effect, other), (other, effect)):
        if name in CATALOGUE and rival in CATALOGUE[name].distinguished_by:
            return CATALOGUE[name].distinguished_by[rival]
    return otherwise
