"""Directions of weak winds that are sent in coarse steps.

Assumptions: up to a speed, directions lie on multiples of one step or on whole degrees; chance
puts one and a half whole degrees of every step there. Of all steps and speeds that one is taken
whose reports would be the greatest surprise by chance.

Validity: some hundred reports. Steps of ten degrees and finer are a coding that has a name.

Source: likelihood ratio of two Bernoulli laws, as in docs/gap.md section 6.

Units: degrees, m/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Steps of a turn that directions may come in, degrees.
TURN_STEPS = (15.0, 20.0, 22.5, 30.0, 45.0, 60.0, 90.0)
#: Share of the reports under a speed that are on a lattice of directions beyond chance, at least.
ON_LATTICE = 0.5


@dataclass(frozen=True)
class Lattice:
    """Directions that weak winds are sent in."""

    step: float  # degrees
    below: float  # speed up to which they are, m/s
    share: float  # part of these reports that is


def lattice_of(u: Floats, v: Floats) -> Lattice | None:
    """Find the steps in which the directions of winds up to a speed are sent.

    Of every step and speed those with the largest log likelihood ratio against chance.
    """
    speed, turn = np.hypot(u, v), np.degrees(np.arctan2(u, v))
    turn, slow = turn[speed > 0], np.sort(speed[speed > 0])  # calm has no direction
    turn = turn[np.argsort(speed[speed > 0])]
    number = np.arange(1, slow.size + 1)
    found, most = None, 0.0
    for step in TURN_STEPS:
        on = np.abs(turn - step * np.round(turn / step)) < 0.75  # they come in whole degrees
        # a margin of 0.75 either way holds 1.5 of every step by chance; neither end has a logarithm
        share, chance = np.clip(np.cumsum(on) / number, 1e-9, 1 - 1e-9), 1.5 / step
        gained = share * np.log(share / chance) + (1 - share) * np.log((1 - share) / (1 - chance))
        gain = np.where(share > ON_LATTICE, number * gained, 0.0)
        if gain.size and gain.max() > most:
            last = int(np.argmax(gain))
            most, beyond = float(gain[last]), (share[last] - chance) / (1 - chance)
            found = Lattice(step, float(slow[last]), float(beyond))
    return found
