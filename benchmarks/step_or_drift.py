"""Whether the odds of a step against a drift come true: small changes of some compasses.

    python -m benchmarks.step_or_drift [--archives N] [--seed S]

Archives of 5 to 8 aircraft and 16 to 31 days, of which some have a step of 0.2 to 0.5 degrees at
any date between a fifth and four fifths of the archive, or a drift of the same mean square: from
the archive's first day on, or setting in at such a date. Printed are, by the probability that
``airswing gap`` gives the step against either drift, how many were steps and how many that
probability says. Exit status 1 where these differ by more than :data:`MOST`
standard deviations of the count.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import dataclass

import numpy as np
from airswing.gap.design.candidates import candidates
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.passes import Search, run_pass
from airswing.gap.search.candidate_ranking import evaluate_named
from airswing.gap.search.step_or_drift import as_it_goes
from airswing.gap.search.stepwise import Rules
from airswing.gap.sums.whole_archive import held_archive
from tests.gap.toy import make_frame

from airswing.gap.diagnose import usable_effects
from airswing.gap.effects import CATALOGUE

CHANGING = {n: CATALOGUE[n] for n in ("compass_offset", "compass_step", "compass_drift")}
#: A drift has the mean square of a step at this multiple of its size: from the first day that of a
#: step half-way, from a date that of a step there.
AS_LARGE = {"drift": np.sqrt(1.5), "onset": np.sqrt(3.0)}
#: Half go at a date; most drifts have no beginning in the archive.
KINDS = {"step": 0.5, "drift": 0.35, "onset": 0.15}
#: Standard deviations by which steps may differ from what is said.
MOST = 3.0
BINS = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class Change:
    """What some compasses do."""

    kind: str  # of `KINDS`
    days: int
    aircraft: int
    struck: int
    size: float  # degrees
    at: float  # part of the archive before the step, or before the drift sets in
    seed: int

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Change:
        """Draw one."""
        aircraft = int(rng.integers(5, 9))
        return cls(
            str(rng.choice(list(KINDS), p=list(KINDS.values()))),
            int(rng.integers(16, 32)),
            aircraft,
            int(rng.integers(1, aircraft)),
            float(rng.uniform(0.2, 0.5)),
            float(rng.uniform(0.2, 0.8)),
            int(rng.integers(1_000_000)),
        )

    def __call__(self, context: dict[str, np.ndarray]) -> np.ndarray:
        """Heading error of reports, rad."""
        part = (context["time"] - context["time"].min()) / 86400 / self.days
        if self.kind == "step":
            course = part > self.at
        elif self.kind == "drift":
            course = AS_LARGE["drift"] * part
        else:
            course = AS_LARGE["onset"] * np.maximum(part - self.at, 0.0) / (1.0 - self.at)
        return np.where(context["aircraft"] < self.struck, np.radians(self.size) * course, 0.0)


def chance_of_step(change: Change) -> float:
    """Probability of the step against either drift, its aircraft known."""
    frame = make_frame(
        seed=change.seed,
        aircraft=change.aircraft,
        days=change.days,
        noise=1.0,
        heading_error=change,
    )
    archive = held_archive(frame)
    effects, _ = usable_effects(archive.view, CHANGING)
    made = run_pass(archive, Search(effects, Rules(), False, 0, lambda *a: None))
    base = made.problem.base
    pool = candidates(base.stats.layout, effects, dictionary=False)
    (step,) = [c for c in pool if c.kind == "step" and c.subset == (0,)]
    own = np.arange(change.aircraft) < change.struck
    score = evaluate_named(base, given_terms(base, []), step, own, None)
    term = Term(step, tuple(range(change.struck)), score.period, score)
    return float(as_it_goes(base, pool, [term])[0])


def main() -> int:
    """Print the table; 1 where what is said does not come true."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--archives", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    drawn = [Change.drawn(rng) for _ in range(asked.archives)]
    chance = np.array([chance_of_step(one) for one in drawn])
    step = np.array([one.kind == "step" for one in drawn])
    missed = False
    print("probability of a step   archives   steps   as many as it says")
    for low, high in itertools.pairwise(BINS):
        own = (chance >= low) & ((chance < high) | (high == BINS[-1]))
        if own.any():
            print(
                f"{low:8.2f} to {high:4.2f} {own.sum():14d} {step[own].sum():7d}"
                f" {chance[own].sum():16.1f}"
            )
            # a count of at least one: where all are said to be one kind none may yet be the other
            spread = max(float(np.sqrt((chance[own] * (1 - chance[own])).sum())), 1.0 / MOST)
            missed |= bool(abs(step[own].sum() - chance[own].sum()) > MOST * spread)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
