"""One effect at unit strength, drawn at random: aircraft, date, signs and phases.

How an effect is drawn is stated with the effect (`Draw`, in its file of the catalogue); its physics
is the generator's. A draw is later scaled so that it changes the wind by a stated root mean square
where it acts (its strength); effects on the variance only (coding) or on rare reports (gross
errors) have a ladder of steps instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any, Literal

import numpy as np
import pandas as pd

from airswing.synthetic.instrument import Mask, UnitFault
from airswing.synthetic.sealed.labels import Injected

Unit = Callable[[np.random.Generator], dict[str, object]]
Acts = Callable[[pd.DataFrame, Mapping[str, Any]], Mask]
SIZES = (0.2, 0.4, 0.8, 1.6)
"""Strengths where an effect acts, m/s root mean square."""
START = datetime(2009, 3, 1)
"""First day of every sealed archive, UTC."""


def sign(rng: np.random.Generator) -> float:
    """-1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def _phase(rng: np.random.Generator) -> float:
    return round(float(rng.uniform(-180, 180)), 1)


@dataclass(frozen=True)
class Signed:
    """Draws one parameter of a given size and either sign."""

    key: str
    value: float = 1.0

    def __call__(self, rng: np.random.Generator) -> dict[str, object]:
        """Return the parameter."""
        return {self.key: self.value * sign(rng)}


def cycle(rng: np.random.Generator) -> dict[str, object]:
    """Draw one cycle of any phase."""
    return {"amplitude_deg": 1.0, "phase_deg": _phase(rng)}


def offset_and_cycle(rng: np.random.Generator) -> dict[str, object]:
    """Draw an offset together with one cycle of any share."""
    share = float(rng.uniform(0.0, 1.0))
    offset = sign(rng) * (1.0 - 0.5 * share)
    return {"offset_deg": offset, "amplitude_deg": share, "phase_deg": _phase(rng)}


@dataclass(frozen=True)
class Draw:
    """How the blind check draws, scales and judges one effect."""

    unit: Unit | None = None  # parameters at unit strength; None for an effect with a ladder
    scaled: tuple[str, ...] = ()  # parameters that a strength multiplies
    limit: float = np.inf  # largest size of those
    ladder: tuple[dict[str, float], ...] = ()  # four steps in place of the four sizes
    form: Unit | None = None  # parameters that another form of the effect adds
    # drawn aircraft, all of them (or the model), or two that exchange
    scope: Literal["aircraft", "fleet", "pair"] = "aircraft"
    # begins at a date: never, in one variant (in the last week), or always
    dated: Literal["never", "late", "always"] = "never"
    grows: bool = False  # its strength grows with the length of the archive
    on_real_data: bool = False  # can be added to a real valve's record, and shows in one day
    acts: Acts | None = None  # reports it acts on by its nature; all by default
    fault: UnitFault | None = None  # physics, where it is not among the generator's

    def compared(self, parameters: Mapping[str, Any]) -> tuple[str, ...]:
        """Which of the true parameters are compared with the stated ones."""
        if self.scope == "pair":
            return ()  # its deviations are two further effects
        if self.ladder:
            return tuple(self.ladder[0])[:1]
        return (*self.scaled, *("phase_deg",) * ("phase_deg" in parameters))

    @property
    def variants(self) -> tuple[str, ...]:
        """``plain``, ``fleet`` (all aircraft), ``form`` (another form of it), ``last week``."""
        fleet = ("fleet",) * (self.scope == "aircraft")
        form = ("form",) * (self.form is not None)
        return ("plain", *fleet, *form, *("last week",) * (self.dated != "never"))


@dataclass(frozen=True)
class Drawn:
    """One effect before or after scaling."""

    name: str  # effect the case is about
    # for the generator; of a swap also the two deviations that make it visible
    effects: tuple[Injected, ...]
    draw: Draw = field(default_factory=Draw)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the active effects, each once, that of the case first."""
        return tuple(dict.fromkeys([self.name, *(effect["name"] for effect in self.effects)]))

    @property
    def tails(self) -> tuple[str, ...] | None:
        """Aircraft it acts on; None for all."""
        main = next(effect for effect in self.effects if effect["name"] == self.name)
        return None if main["tails"] is None else tuple(main["tails"])


@dataclass(frozen=True)
class World:
    """Fleet, length and model fields of an archive, shared by several cases."""

    seed: int
    # "default", "short" (the same for two weeks), "hard", "sensor" (errors of a real flux valve) or
    # "model" (of a real forecast)
    kind: str
    days: int
    aircraft: int
    coarse: bool = False  # fields of 57 km every 2 hours instead of 41 km every hour

    @property
    def tails(self) -> list[str]:
        """Names of the aircraft."""
        return [f"N{401 + index}" for index in range(self.aircraft)]


def draw_effect(
    name: str,
    draw: Draw,
    rng: np.random.Generator,
    world: World,
    *,
    step: int = 1,
    among: Sequence[str] | None = None,
    variant: str = "plain",
) -> Drawn:
    """Draw aircraft (unless they are ``among`` some), date and signs, at unit strength."""
    last, tails = variant == "last week", world.tails
    if draw.scope == "pair":
        return _swap(name, draw, rng, tails, _date(rng, world.days, last=last))
    affected = None if draw.scope == "fleet" else list(among or _aircraft(rng, tails))
    if variant == "fleet":
        affected = sorted(tails)
    parameters = dict(draw.ladder[step]) if draw.unit is None else draw.unit(rng)
    if variant == "form" and draw.form is not None:
        parameters |= draw.form(rng)
    dated = draw.dated == "always" or last
    period = [_date(rng, world.days, last=last), None] if dated else None
    effect = {"name": name, "tails": affected, "parameters": parameters, "period": period}
    return Drawn(name, (effect,), draw)


def _aircraft(rng: np.random.Generator, tails: list[str]) -> list[str]:
    number = int(rng.integers(1, max(2, len(tails) // 3) + 1))
    return sorted(str(tail) for tail in rng.choice(tails, min(number, len(tails)), replace=False))


def _date(rng: np.random.Generator, days: int, *, last: bool) -> str:
    day = round(float(rng.uniform(0.25, 0.75)) * days)
    if last:
        day = days - int(rng.integers(2, 7))
    return (START + timedelta(days=day)).isoformat()


def _swap(name: str, draw: Draw, rng: np.random.Generator, tails: list[str], date: str) -> Drawn:
    pair = sorted(str(tail) for tail in rng.choice(tails, 2, replace=False))
    phase = _phase(rng)
    effects: list[Injected] = [
        {
            "name": "hard_iron",
            "tails": [tail],
            "parameters": {"amplitude_deg": 0.5, "phase_deg": phase + turn},
            "period": None,
        }
        for tail, turn in zip(pair, (0.0, 180.0), strict=True)
    ]
    effects += [{"name": name, "tails": pair, "parameters": {"pair": pair}, "period": [date, None]}]
    return Drawn(name, tuple(effects), draw)


def scaled(drawn: Drawn, factor: float) -> Drawn:
    """Multiply the scaled parameters of an effect; unchanged for effects with a ladder."""
    draw = drawn.draw
    if draw.ladder:
        return drawn
    effects: list[Injected] = []
    for effect in drawn.effects:
        changed = {
            key: float(f"{np.clip(factor * float(value), -draw.limit, draw.limit):.5g}")
            if key in draw.scaled
            else value
            for key, value in effect["parameters"].items()
        }
        effects.append({**effect, "parameters": changed})
    return replace(drawn, effects=tuple(effects))
