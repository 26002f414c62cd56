"""The plan of a blind check: which cases, on which rung, with which effect, in which world.

Assumptions
-----------
Rungs: 1 the generator's ordinary world, 2 its hard world (longer-reaching error, heavy tails, bias,
1 % outliers, a little of everything everywhere), 3 two effects at once, 4 effects outside the
catalogue and catalogue effects taken out of it for the diagnosis, 5 real data: the residual errors
of a real flux valve, and the real error of a real forecast, with an effect added. A quarter of
every rung holds nothing. (Rung 0 is the proof of the generator, `airswing.blind_check.proof`.)

Effects and sizes are dealt like cards, every effect as often as every other. Cases of one rung
share worlds a few at a time, so that fields need not be written for each; names are dealt last and
say nothing.

Units: m/s for sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np

from airswing.synthetic.sealed.draws import (
    CATALOGUE_NAMES,
    OUTSIDE_NAMES,
    SIZES,
    Drawn,
    draw_effect,
)

__all__ = ["RUNGS", "Case", "Size", "World", "plan_cases"]

RUNGS: dict[int, float] = {1: 0.4, 2: 0.15, 3: 0.15, 4: 0.2, 5: 0.1}
"""Share of the cases on each rung."""
CASES_PER_WORLD = 8
START = datetime(2009, 3, 1)
SENSOR_NAMES = ("compass_offset", "hard_iron", "soft_iron", "tas_scale", "tas_offset")
"""Effects injected into real data: seen in a day, independent of what a G1000 does not record."""


@dataclass(frozen=True)
class Size:
    """How large the archives are.

    Parameters
    ----------
    days, aircraft : int
        Length and fleet.
    sizes : tuple of float
        Strengths drawn, m/s.
    coarse : bool
        See `World`.
    """

    days: int = 45
    aircraft: int = 14
    sizes: tuple[float, ...] = SIZES
    coarse: bool = False

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
    """What several cases share.

    Parameters
    ----------
    seed : int
        Seed of the generator.
    kind : str
        ``default``, ``hard``, ``sensor`` (a real flux valve's errors) or ``model`` (a real
        forecast's).
    days, aircraft : int
        Length and fleet.
    coarse : bool
        Fields of 57 km every 2 hours instead of 41 km every hour.
    """

    seed: int
    kind: str
    days: int
    aircraft: int
    coarse: bool = False


@dataclass(frozen=True)
class Case:
    """One case as drawn, at unit strength.

    Parameters
    ----------
    name : str
        Says nothing.
    rung : int
        See `RUNGS`.
    kind : str
        ``null, single, pair, outside, removed``.
    world : World
        Where it plays.
    drawn : tuple of Drawn
        Effects.
    sizes : tuple of float
        Wanted strength of each, m/s.
    without : tuple of str
        Effects the diagnosis does without.
    """

    name: str
    rung: int
    kind: str
    world: World
    drawn: tuple[Drawn, ...] = ()
    sizes: tuple[float, ...] = ()
    without: tuple[str, ...] = field(default=())


class _Deck:
    """Deals (name, size) pairs: every name before any comes again, sizes in turn."""

    def __init__(
        self, names: Sequence[str], sizes: Sequence[float], rng: np.random.Generator
    ) -> None:
        self._names, self._sizes, self._rng = list(names), list(sizes), rng
        self._hand: list[str] = []
        self._turn = {name: int(rng.integers(len(self._sizes))) for name in self._names}

    def deal(self) -> tuple[str, float]:
        """Return the next pair."""
        if not self._hand:
            self._hand = [str(name) for name in self._rng.permutation(self._names)]
        name = self._hand.pop()
        self._turn[name] += 1
        return name, self._sizes[self._turn[name] % len(self._sizes)]


def plan_cases(
    number: int,
    *,
    seed: int,
    size: Size,
    rungs: Sequence[int] = tuple(RUNGS),
    names: Sequence[str] | None = None,
) -> list[Case]:
    """Draw the cases of a check.

    Parameters
    ----------
    number : int
        How many.
    seed : int
        Of every draw.
    size : Size
        Of the archives.
    rungs : sequence of int
        Rungs to play; the shares of the others are spread over them.
    names : sequence of str, optional
        Catalogue effects to draw from; all by default.

    Returns
    -------
    list of Case
        In the order of their names, which is random.
    """
    rng = np.random.default_rng([seed, 8])
    counts = _counts(number, rungs)
    drawn: list[Case] = []
    for rung, count in counts.items():
        drawn += _rung(rung, count, rng, seed, size, list(names or CATALOGUE_NAMES))
    order = rng.permutation(len(drawn))
    width = max(3, len(str(len(drawn))))
    named = [
        Case(f"case_{place + 1:0{width}d}", *_fields(drawn[int(k)]))
        for place, k in enumerate(order)
    ]
    return named


def _fields(
    case: Case,
) -> tuple[int, str, World, tuple[Drawn, ...], tuple[float, ...], tuple[str, ...]]:
    return case.rung, case.kind, case.world, case.drawn, case.sizes, case.without


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


def _rung(
    rung: int, count: int, rng: np.random.Generator, seed: int, size: Size, names: list[str]
) -> list[Case]:
    """Draw the cases of one rung."""
    nulls = round(count / 4)
    larger = [value for value in size.sizes if value >= 0.4]
    outside = _Deck(OUTSIDE_NAMES, larger, rng)
    removed = _Deck([n for n in names if n != "tail_swap"], [0.8], rng)
    paired = _Deck([n for n in names if n != "tail_swap"], larger, rng)
    injected = _Deck([n for n in SENSOR_NAMES if n in names] or SENSOR_NAMES, larger, rng)
    single = _Deck(names, size.sizes, rng)
    out: list[Case] = []
    # Archives without effects are the same where their worlds are: each null has its own.
    worlds = max(nulls, -(-count // CASES_PER_WORLD))
    for index in range(count):
        world = _world(rung, index, worlds, seed, size)
        if index < nulls:
            out.append(Case("", rung, "null", world))
            continue
        kind = {3: "pair", 4: "removed" if index % 2 else "outside"}.get(rung, "single")
        deck = {"pair": paired, "outside": outside, "removed": removed}.get(kind, single)
        dealt = [(injected if rung == 5 else deck).deal()]
        while kind == "pair" and len({name for name, _ in dealt}) < 2:
            dealt = [dealt[0], deck.deal()]
        parts = tuple(_draw(name, strength, rng, world, size) for name, strength in dealt)
        out.append(
            Case(
                "", rung, kind, world, parts, tuple(strength for _, strength in dealt),
                (dealt[0][0],) if kind == "removed" else (),
            )
        )  # fmt: skip
    return out


def _world(rung: int, index: int, worlds: int, seed: int, size: Size) -> World:
    kind = "hard" if rung == 2 else "default"
    if rung == 5:
        kind = "model" if index % 2 else "sensor"
    number = 10_000 * seed + 1000 * rung + index % worlds
    days = 1 if kind == "model" else size.days
    return World(number, kind, days, size.aircraft, size.coarse)


def _draw(name: str, strength: float, rng: np.random.Generator, world: World, size: Size) -> Drawn:
    step = SIZES.index(strength) if strength in SIZES else 1
    return draw_effect(
        name, rng, tails=size.tails, start=START, days=world.days, step=step,
    )  # fmt: skip
