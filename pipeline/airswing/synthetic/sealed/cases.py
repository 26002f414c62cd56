"""Plan of a blind check: which cases, on which rung, with which effect, in which world.

Rungs: 1 the generator's ordinary world; 2 its hard world; 3 two effects, in every second case on
the same aircraft; 4 effects outside the catalogue, and catalogue effects removed from it for the
diagnosis; 5 real data: the residual errors of a real flux valve, and the real error of a real
forecast, with an effect added. A quarter of every rung has no effect, or as many as are asked for.
Effects, their variants and sizes are drawn without replacement; cases of one rung share worlds, so
that fields are not written for each; names are drawn last and carry no information. An outside
effect has several draws, one of which is chosen on the archive (`sealed_archives`).

Units: m/s for sizes; kt and degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta

import numpy as np

from airswing.synthetic.outside_effects import (
    COMPONENTS,
    CYCLIC,
    FLAGS,
    SCATTER,
    SHAPES,
    VARIABLES,
)
from airswing.synthetic.sealed.draws import SIZES, START, Draw, Drawn, World, draw_effect
from airswing.synthetic.sealed.labels import Injected

RUNGS: dict[int, float] = {1: 0.35, 2: 0.1, 3: 0.15, 4: 0.3, 5: 0.1}
"""Share of the cases on each rung."""
SHORT_RUNGS, SHORT_DAYS = (1, 4), (14, 15)
"""Rungs in which every fourth world is short, so that weather looks like a lasting error."""
OUTSIDE_SHAPES = (*SHAPES, "product", "threshold", "scatter")
"""Shapes of outside effects: of one variable, of two, and those that change no mean."""
ALIKE: tuple[frozenset[str], ...] = (
    frozenset({"magnetic_heading", "heading", "track"}),
    frozenset({"altitude", "temperature"}),
    frozenset({"airspeed", "ground_speed"}),
    frozenset({"wind_speed", "drift"}),
)
"""Strongly correlated variables, which are never multiplied with each other."""
_CASES_PER_WORLD = 8
_MOST_DRAWS = 24  # draws of an outside effect
_PHASES = (1.0, 2.0, 3.0)
# Range of widths, as fractions of the turn or of the range.
_SPREAD = {"sector": (0.04, 0.125), "bump": (0.05, 0.12), "saw": (0.26, 0.52)}
# Range of beginnings, as quantiles: acting on most reports they would be an offset.
_SPANS = {"step": (0.65, 0.9), "hinge": (0.5, 0.85)}
_LAST_WEEK = 0.1  # share of outside effects that begin in the last week


@dataclass(frozen=True)
class Size:
    """Size of the archives of a check."""

    days: int = 45
    aircraft: int = 14
    sizes: tuple[float, ...] = SIZES  # strengths that are drawn, m/s
    coarse: bool = False  # see `airswing.synthetic.sealed.draws.World`

    @classmethod
    def fast(cls) -> Size:
        """A short check: three weeks, eight aircraft, clear effects."""
        return cls(days=21, aircraft=8, sizes=(0.8, 1.6), coarse=True)


@dataclass(frozen=True)
class Case:
    """One case as drawn, at unit strength."""

    name: str
    rung: int
    kind: str  # null, single, pair, outside, removed
    world: World
    drawn: tuple[Drawn, ...] = ()
    sizes: tuple[float, ...] = ()  # wanted strength of each effect, m/s
    without: tuple[str, ...] = ()  # effects withheld from the diagnosis
    # of `Draw.variants`; of a pair "same aircraft" or "apart"; of an outside effect its shape
    variant: str = "plain"
    instead: tuple[Drawn, ...] = ()  # further draws of an outside effect
    worth: bool = False  # prefer a draw that closes a tenth of a knot


def plan_cases(
    number: int,
    *,
    seed: int,
    size: Size,
    draws: Mapping[str, Draw],
    rungs: Sequence[int] = tuple(RUNGS),
    nulls: int | None = None,
) -> list[Case]:
    """Draw the cases of a check, in the order of their names, which is random.

    The shares of rungs that are not used are spread over the others; ``nulls`` cases, by default a
    quarter, have no effect.
    """
    rng = np.random.default_rng([seed, 8])
    counts = _counts(number, rungs)
    empty = {rung: round(count / 4) for rung, count in counts.items()}
    if nulls is not None:
        empty = _counts(min(nulls, number), rungs)
    drawn: list[Case] = []
    for rung, count in counts.items():
        drawn += _Dealer(rung, rng, seed, size, draws).cases(count, min(empty[rung], count))
    order = rng.permutation(len(drawn))
    width = max(3, len(str(len(drawn))))
    return [
        replace(drawn[int(k)], name=f"case_{place + 1:0{width}d}") for place, k in enumerate(order)
    ]


def _counts(number: int, rungs: Sequence[int]) -> dict[int, int]:
    total = sum(RUNGS[rung] for rung in rungs)
    exact = {rung: number * RUNGS[rung] / total for rung in rungs}
    counts = {rung: int(value) for rung, value in exact.items()}
    by_remainder = sorted(exact, key=lambda rung: counts[rung] - exact[rung])
    for rung in by_remainder[: number - sum(counts.values())]:
        counts[rung] += 1
    return counts


class _Deck:
    """Draws (name, size, variant): every name before any is repeated, the others in turn."""

    def __init__(
        self, draws: Mapping[str, Draw], sizes: Sequence[float], rng: np.random.Generator
    ) -> None:
        self._draws, self._sizes, self._rng = draws, list(sizes), rng
        self._hand: list[str] = []
        self._turn = {name: int(rng.integers(len(self._sizes))) for name in draws}
        self._variant = {name: int(rng.integers(8)) for name in draws}

    def deal(self) -> tuple[str, float, str]:
        if not self._hand:
            self._hand = [str(name) for name in self._rng.permutation(list(self._draws))]
        name = self._hand.pop()
        self._turn[name] += 1
        self._variant[name] += 1
        forms = self._draws[name].variants
        size = self._sizes[self._turn[name] % len(self._sizes)]
        return name, size, forms[self._variant[name] % len(forms)]


class _Dealer:
    def __init__(
        self,
        rung: int,
        rng: np.random.Generator,
        seed: int,
        size: Size,
        draws: Mapping[str, Draw],
    ) -> None:
        self.rung, self.rng, self.seed, self.size, self._draws = rung, rng, seed, size, draws
        self._sizes = [value for value in size.sizes if value >= 0.4]
        alone = {name: draw for name, draw in draws.items() if draw.scope != "pair"}
        real = {name: draw for name, draw in draws.items() if draw.on_real_data} or alone
        # the order of these is that of the draws from the generator
        self._single = _Deck(draws, size.sizes, rng)
        self._removed = _Deck(alone, [0.8], rng)
        self._paired = _Deck(alone, self._sizes, rng)
        self._injected = _Deck(real, self._sizes, rng)
        self._shapes: list[str] = []
        self._number = 0

    def cases(self, count: int, nulls: int) -> list[Case]:
        # Archives without effects are equal where their worlds are: each has another world.
        worlds = max(nulls, -(-count // _CASES_PER_WORLD))
        out = []
        for index in range(count):
            case = Case("", self.rung, "null", self._world(index, worlds))
            out.append(case if index < nulls else self._with_effect(case, index))
        return out

    def _world(self, index: int, worlds: int) -> World:
        kind = "hard" if self.rung == 2 else "default"
        if self.rung == 5:
            kind = "model" if index % 2 else "sensor"
        place = index % worlds
        number = 10_000 * self.seed + 1000 * self.rung + place
        days = 1 if kind == "model" else self.size.days
        if self.rung in SHORT_RUNGS and place % 4 == 3 and days > 2 * SHORT_DAYS[1]:
            kind, days = "short", SHORT_DAYS[place // 4 % 2]
        return World(number, kind, days, self.size.aircraft, self.size.coarse)

    def _with_effect(self, case: Case, index: int) -> Case:
        if self.rung == 3:
            return self._pair(case)
        if self.rung == 4 and index % 3:
            return self._outside(case)
        deck = {4: self._removed, 5: self._injected}.get(self.rung, self._single)
        name, strength, variant = deck.deal()
        if self.rung >= 4:
            variant = "plain"
        drawn = (self._draw(name, strength, case.world, variant=variant),)
        kind, without = ("removed", (name,)) if self.rung == 4 else ("single", ())
        return replace(
            case, kind=kind, drawn=drawn, sizes=(strength,), variant=variant, without=without
        )

    def _pair(self, case: Case) -> Case:
        first, size, _ = self._paired.deal()
        second, size_2, _ = self._paired.deal()
        while second == first:
            second, size_2, _ = self._paired.deal()
        self._number += 1
        drawn = [self._draw(first, size, case.world)]
        same = self._number % 2 and self._draws[second].scope != "fleet"
        among = drawn[0].tails if same else None
        drawn.append(self._draw(second, size_2, case.world, among=among))
        variant = "apart" if among is None else "same aircraft"
        sizes = size, size_2
        return replace(case, kind="pair", drawn=tuple(drawn), sizes=sizes, variant=variant)

    def _outside(self, case: Case) -> Case:
        if not self._shapes:
            self._shapes = [str(shape) for shape in self.rng.permutation(OUTSIDE_SHAPES)]
        shape = self._shapes.pop()
        self._number += 1
        strength = self._sizes[self._number // 2 % len(self._sizes)]
        draws = tuple(
            Drawn("outside", (draw_outside(self.rng, case.world, shape=shape, size=strength),))
            for _ in range(_MOST_DRAWS)
        )
        return replace(
            case,
            kind="outside",
            drawn=draws[:1],
            sizes=(strength,),
            variant=shape,
            instead=draws[1:],
            worth=bool(self._number % 3),
        )

    def _draw(
        self,
        name: str,
        strength: float,
        world: World,
        *,
        variant: str = "plain",
        among: Sequence[str] | None = None,
    ) -> Drawn:
        step = SIZES.index(strength) if strength in SIZES else 1
        draw = self._draws[name]
        return draw_effect(name, draw, self.rng, world, step=step, among=among, variant=variant)


def draw_outside(rng: np.random.Generator, world: World, *, shape: str, size: float) -> Injected:
    """Draw one outside effect of a shape (`OUTSIDE_SHAPES`) and root mean square ``size``, m/s."""
    scope = str(rng.choice(("one", "some", "all")))
    affected = None
    if scope != "all":
        tails = world.tails
        number = 1 if scope == "one" else int(rng.integers(2, max(3, len(tails) // 2) + 1))
        affected = sorted(str(tail) for tail in rng.choice(tails, number, replace=False))
    parameters = _draw_scatter(rng, size) if shape == "scatter" else _draw_mean(rng, shape, size)
    period = None
    if world.days > 14 and rng.uniform() < _LAST_WEEK:
        period = [(START + timedelta(days=world.days - 7)).isoformat(), None]
    return {"name": "outside", "tails": affected, "parameters": parameters, "period": period}


def _draw_mean(rng: np.random.Generator, shape: str, size: float) -> dict[str, object]:
    component = str(rng.choice(COMPONENTS))
    first = _draw_variable(rng, component, shape)
    if shape == "product":
        second = _draw_variable(rng, component, shape, excluded=first)
        parts = [_draw_part(rng, first, "linear"), _draw_part(rng, second, "linear")]
    elif shape == "threshold":
        second = _draw_variable(rng, component, shape, excluded=first, flags=True)
        acting = str(rng.choice(["hinge", "bump", "saw"]))
        opened = str(rng.choice(["step", "sector"]))
        parts = [_draw_part(rng, first, acting), _draw_part(rng, second, opened)]
    else:
        parts = [_draw_part(rng, first, shape)]
    return {
        "component": component,
        "parts": parts,
        "shape": shape,
        "size_m_s": float(size),
        "sign": float(rng.choice([-1.0, 1.0])),
    }


def _draw_variable(
    rng: np.random.Generator,
    component: str,
    shape: str,
    *,
    excluded: str | None = None,
    flags: bool = False,
) -> str:
    able = [name for name in VARIABLES if name not in FLAGS or flags or shape == "step"]
    if component == "across_heading":
        # In the catalogue such a function of the date is a step or a drift.
        dated = shape in ("step", "hinge", "sector")
        able = [name for name in able if name != "icing" and not (dated and name == "date")]
    for group in ALIKE:
        if excluded in group:
            able = [name for name in able if name not in group]
    return str(rng.choice([name for name in able if name != excluded]))


def _draw_part(rng: np.random.Generator, variable: str, shape: str) -> dict[str, object]:
    if variable in FLAGS:
        value = 1.0 if variable == "icing" else float(rng.choice(_PHASES))
        return {"variable": variable, "shape": "flag", "equals": value}
    span = (0.0, 1.0) if variable in CYCLIC else _SPANS.get(shape, (0.25, 0.75))
    low, high = _SPREAD.get(shape, (0.1, 0.1))
    return {
        "variable": variable,
        "shape": shape,
        "at": round(float(rng.uniform(*span)), 3),
        "width": round(float(rng.uniform(low, high)), 3),
    }


def _draw_scatter(rng: np.random.Generator, size: float) -> dict[str, object]:
    kind = str(rng.choice(SCATTER))
    values: dict[str, object] = {"kind": kind, "shape": "scatter", "component": "scatter"}
    values["parts"] = []
    if kind == "floor":
        values["limit_kt"] = float(rng.integers(6, 16))
    elif kind == "ceiling":
        values["limit_kt"] = float(rng.integers(38, 56))
    elif kind == "hole":
        low = float(rng.integers(8, 26))
        values["between_kt"] = [low, low + float(rng.integers(6, 13))]
    elif kind == "lattice":
        values["limit_kt"] = float(rng.integers(15, 31))
        values["direction_step_deg"] = float(rng.choice([30.0, 45.0, 90.0]))
    else:
        variable = _draw_variable(rng, "scatter", "step")
        values["parts"] = [_draw_part(rng, variable, str(rng.choice(["step", "sector"])))]
        values |= {"size_m_s": 2.0 * size} if kind == "jitter" else {"fraction": 0.02 * (1 + size)}
    return values
