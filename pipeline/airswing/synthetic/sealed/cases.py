"""The plan of a blind check: which cases, on which rung, with which effect, in which world.

Assumptions
-----------
Rungs: 1 the generator's ordinary world, 2 its hard world (longer-reaching error, heavy tails, bias,
1 % outliers, a little of everything everywhere), 3 two effects at once, every other time on the
same aircraft, 4 effects outside the catalogue, drawn at random, and catalogue effects taken out of
it for the diagnosis, 5 real data: the residual errors of a real flux valve, and the real error of a
real forecast, with an effect added. Every fourth world of rungs 1 and 4 has two weeks only. A
quarter of every rung holds nothing, or as many as are asked for. (Rung 0 is the proof of the
generator, `airswing.blind_check.proof`.)

Effects, their variants (on all aircraft, in another form, in the last week) and sizes are dealt
like cards, every effect as often as every other. Cases of one rung share worlds a few at a time, so
that fields need not be written for each; names are dealt last and say nothing. An outside effect is
dealt as several draws: the first that no name explains on its archive is taken, two times in three
the first of those that closes a tenth of a knot: many a one does not, and nobody would miss it.

Units: m/s for sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from airswing.synthetic.sealed.draws import SIZES, Draw, Drawn, Occasion, draw_effect
from airswing.synthetic.sealed.outside_draws import OUTSIDE_SHAPES, draw_outside

__all__ = ["RUNGS", "Case", "Size", "World", "plan_cases"]

# Share of the cases on each rung.
RUNGS: dict[int, float] = {1: 0.35, 2: 0.1, 3: 0.15, 4: 0.3, 5: 0.1}
# Winds are costly and made once a world.
_CASES_PER_WORLD = 8
# Rungs of which every fourth world is of two weeks: what seems to last is weather there.
SHORT_RUNGS, SHORT_DAYS = (1, 4), (14, 15)
# Draws an outside effect is dealt as.
_MOST_DRAWS = 24
START = datetime(2009, 3, 1)


@dataclass(frozen=True)
class Size:
    """How large the archives are."""

    # days, aircraft: length and fleet
    days: int = 45
    aircraft: int = 14
    sizes: tuple[float, ...] = SIZES  # strengths drawn, m/s
    coarse: bool = False  # see `World`

    @classmethod
    def fast(cls) -> Size:
        """A short check: three weeks, eight aircraft, effects that are there to be seen."""
        return cls(days=21, aircraft=8, sizes=(0.8, 1.6), coarse=True)

    @property
    def tails(self) -> list[str]:
        """Names of the aircraft."""
        return [f"N{401 + index}" for index in range(self.aircraft)]


@dataclass(frozen=True)
class World:
    """What several cases share."""

    seed: int  # seed of the generator
    # ``default``, ``short`` (the same for two weeks), ``hard``, ``sensor`` (a real flux valve's
    # errors) or ``model`` (a real forecast's)
    kind: str
    # days, aircraft: length and fleet
    days: int
    aircraft: int
    coarse: bool = False  # fields of 57 km every 2 hours instead of 41 km every hour


@dataclass(frozen=True)
class Case:
    """One case as drawn, at unit strength."""

    name: str  # says nothing
    rung: int  # see `RUNGS`
    kind: str  # ``null, single, pair, outside, removed``
    world: World  # where it plays
    drawn: tuple[Drawn, ...] = ()  # effects
    sizes: tuple[float, ...] = ()  # wanted strength of each, m/s
    without: tuple[str, ...] = ()  # effects the diagnosis does without
    # of the effect, see `airswing.synthetic.sealed.draws.Draw`; of a pair ``same aircraft`` or
    # ``apart``; of an outside effect its shape
    variant: str = "plain"
    instead: tuple[Drawn, ...] = ()  # outside effects to take where the first is not fit
    # take one whose truth closes a tenth of a knot and more, where one of the draws does
    worth: bool = False


class _Deck:
    """Deals (name, size, variant): every name before any comes again, the others in turn."""

    def __init__(
        self, draws: Mapping[str, Draw], sizes: Sequence[float], rng: np.random.Generator
    ) -> None:
        self._draws, self._sizes, self._rng = draws, list(sizes), rng
        self._names = list(draws)
        self._hand: list[str] = []
        self._turn = {name: int(rng.integers(len(self._sizes))) for name in self._names}
        self._variant = {name: int(rng.integers(8)) for name in self._names}

    def deal(self) -> tuple[str, float, str]:
        """Return the next card."""
        if not self._hand:
            self._hand = [str(name) for name in self._rng.permutation(self._names)]
        name = self._hand.pop()
        self._turn[name] += 1
        self._variant[name] += 1
        forms = self._draws[name].variants
        size = self._sizes[self._turn[name] % len(self._sizes)]
        return name, size, forms[self._variant[name] % len(forms)]


def plan_cases(
    number: int,
    *,
    seed: int,
    size: Size,
    draws: Mapping[str, Draw],
    rungs: Sequence[int] = tuple(RUNGS),
    nulls: int | None = None,
) -> list[Case]:
    """Draw the cases of a check.

    Parameters
    ----------
    draws : mapping
        Effects to draw from, and how each is drawn.
    rungs : sequence of int
        Rungs to play; the shares of the others are spread over them.
    nulls : int, optional
        How many of the cases hold nothing; a quarter by default.

    Returns
    -------
    list of Case
        In the order of their names, which is random.
    """
    rng = np.random.default_rng([seed, 8])
    counts = _counts(number, rungs)
    empty = {rung: round(count / 4) for rung, count in counts.items()}
    if nulls is not None:
        empty = _counts(min(nulls, number), rungs)
    drawn: list[Case] = []
    for rung, count in counts.items():
        dealer = _Dealer(rung, rng, seed, size, draws)
        drawn += dealer.cases(count, min(empty[rung], count))
    order = rng.permutation(len(drawn))
    width = max(3, len(str(len(drawn))))
    return [
        replace(drawn[int(k)], name=f"case_{place + 1:0{width}d}") for place, k in enumerate(order)
    ]


def _counts(number: int, rungs: Sequence[int]) -> dict[int, int]:
    """Share ``number`` out by largest remainder."""
    shares = {rung: RUNGS[rung] for rung in rungs}
    total = sum(shares.values())
    exact = {rung: number * share / total for rung, share in shares.items()}
    counts = {rung: int(value) for rung, value in exact.items()}
    left = sorted(exact, key=lambda rung: counts[rung] - exact[rung])
    for rung in left[: number - sum(counts.values())]:
        counts[rung] += 1
    return counts


class _Dealer:
    """Draws the cases of one rung."""

    def __init__(
        self,
        rung: int,
        rng: np.random.Generator,
        seed: int,
        size: Size,
        draws: Mapping[str, Draw],
    ) -> None:
        self.rung, self.rng, self.seed, self.size = rung, rng, seed, size
        larger = [value for value in size.sizes if value >= 0.4]
        self._draws = draws
        alone = {name: how for name, how in draws.items() if how.whose != "pair"}
        real = {name: how for name, how in draws.items() if how.on_real_data} or alone
        self._single = _Deck(draws, size.sizes, rng)
        self._removed = _Deck(alone, [0.8], rng)
        self._paired = _Deck(alone, larger, rng)
        self._injected = _Deck(real, larger, rng)
        self._sizes = larger
        self._shapes: list[str] = []
        self._number = 0

    def cases(self, count: int, nulls: int) -> list[Case]:
        """Return the cases, those that hold nothing first."""
        # Archives without effects are the same where their worlds are: each null has its own.
        worlds = max(nulls, -(-count // _CASES_PER_WORLD))
        out = []
        for index in range(count):
            world = self._world(index, worlds)
            case = Case("", self.rung, "null", world)
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
        parts = (self._draw(name, strength, case.world, variant=variant),)
        dealt = replace(case, drawn=parts, sizes=(strength,), variant=variant)
        if self.rung == 4:
            return replace(dealt, kind="removed", without=(name,))
        return replace(dealt, kind="single")

    def _pair(self, case: Case) -> Case:
        """Draw two effects, every other time on the same aircraft where they can be."""
        first, size, _ = self._paired.deal()
        second, other, _ = self._paired.deal()
        while second == first:
            second, other, _ = self._paired.deal()
        self._number += 1
        one = self._draw(first, size, case.world)
        among = one.tails if self._number % 2 else None
        if self._draws[second].whose == "fleet":
            among = None
        two = self._draw(second, other, case.world, among=among)
        variant = "apart" if among is None else "same aircraft"
        return replace(case, kind="pair", drawn=(one, two), sizes=(size, other), variant=variant)

    def _outside(self, case: Case) -> Case:
        if not self._shapes:
            self._shapes = [str(shape) for shape in self.rng.permutation(OUTSIDE_SHAPES)]
        shape = self._shapes.pop()
        self._number += 1
        strength = self._sizes[self._number // 2 % len(self._sizes)]
        draws = tuple(
            Drawn(
                "outside",
                (
                    draw_outside(
                        self.rng,
                        shape=shape,
                        tails=self.size.tails,
                        start=START,
                        days=case.world.days,
                        size=strength,
                    ),
                ),
            )
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
        occasion = Occasion(tuple(self.size.tails), START, world.days)
        return draw_effect(
            name, self._draws[name], self.rng, occasion, step=step, among=among, variant=variant
        )
