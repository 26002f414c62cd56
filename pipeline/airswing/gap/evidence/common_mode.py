"""What the aircraft of a fleet share of an effect, and therefore cannot each be blamed for.

Assumptions: where the weather of the day, or an effect of the reference already found, takes up
what all aircraft have in common, an effect of a few shows in all the others with the opposite sign:
three of fourteen with an altitude 700 ft too high leave the rest 150 ft too low. The coupling of
the aircraft is of rank one: the information about coefficients t is ``D - r d d' / sum(d)`` with
D = diag(d) and r the share of the common part taken up. Then exactly (Gaussian integral)

    exp(-t'Dt/2 + s't + r (sum d t)^2 / (2 sum d))
        = E_c exp(sum_a -d_a t_a^2 / 2 + (s_a + c d_a) t_a),   c ~ N(0, r / sum(d))

so that, given the shift c of all estimates, aircraft are independent. The shift is averaged over.

Where nothing is taken up, what all aircraft's estimates have in common is in them whole: a lasting
error of the reference, or what the scatter of real compasses makes of every airspeed. An aircraft
is struck as it parts from the others, so that a common part of plausible size is averaged over too,
with a Gaussian prior.

Validity: effects of one coefficient; r from the sums of the fleet against those of its aircraft.

Source: the augmentation is that of Hubbard (1959, Phys. Rev. Lett. 3, 77) and Stratonovich.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Share of the common part taken up from which the shift is averaged over.
LEAST_SHARED = 0.3
#: Shifts between the largest estimates either way, beside those that bring an aircraft to zero.
EVEN = 25
#: Size of what all aircraft's estimates have in common, m/s: airspeeds of fleets under the record
#: of a real flux valve are off by as much, by what its scatter makes of winds.
COMMON = 0.1
#: Standard errors of their mean from which it is asked about: less changes nothing.
CLEAR = 2.0


@dataclass(frozen=True)
class Shifts:
    """Shifts that are averaged over (C of them)."""

    own: Floats  # (A,): information about each aircraft's coefficient with the shift known
    values: Floats  # (C,): in units of the coefficient
    # (C,): of each, with its part of the aircraft's likelihood that no hypothesis changes
    log_weight: Floats


def shared_part(information: Floats, fleet: float) -> tuple[Floats, float]:
    """Information with the common part known, and the share of the common part taken up.

    Parameters
    ----------
    information : (A,) float
        About each aircraft's own coefficient.
    fleet : float
        About one coefficient of all.

    Returns
    -------
    own : (A,) float
    share : float
        0 to just under 1.
    """
    own, share = information.copy(), 0.0
    for _ in range(8):
        total = float(own.sum())
        if total <= 0.0:
            return information, 0.0
        # all of it shared would leave the fleet no information, and the next round nothing to
        # divide by
        share = float(np.clip(1 - fleet / total, 0.0, 1 - 1e-6))
        # the correction of one that is nearly the whole fleet would divide by nothing
        own = information / (1 - np.minimum(share * own / total, 0.9))
    return own, share


def no_shift(information: Floats) -> Shifts:
    """Nothing to average over: aircraft are independent as they are, (A,) information."""
    return Shifts(information, np.zeros(1), np.zeros(1))


def shifts(information: Floats, score: Floats, fleet: float, factor: float) -> Shifts:
    """Shifts to average over.

    Parameters
    ----------
    information, score : (A,) float
        Of each aircraft's own coefficient.
    fleet : float
        Information about one coefficient of all.
    factor : float
        Cluster factor.

    Returns
    -------
    Shifts
        Only none where aircraft share too little of it to matter.
    """
    # aircraft that never flew where the effect acts have no say in what is common
    live = information > 1e-9 * information.max(initial=1e-30)
    if live.sum() < 3:
        return no_shift(information)
    own, share = shared_part(np.where(live, information, 0.0), fleet)
    if share < LEAST_SHARED:
        return no_shift(information)
    d, estimate = own[live] / factor, score[live] / own[live]
    reach = max(float(np.abs(estimate).max()), float(d.max()) ** -0.5)
    even = np.linspace(-reach, reach, EVEN)
    values = np.unique(np.r_[0.0, -estimate, even])
    spacing = np.gradient(values)
    log = np.log(spacing) - 0.5 * values**2 * d.sum() / share
    log += 0.5 * (d * (estimate + values[:, None]) ** 2).sum(axis=1)
    return Shifts(own, values, np.asarray(log - log.max()))


def common_part(information: Floats, score: Floats, spread: float, factor: float) -> Shifts:
    """Shifts by what all aircraft's estimates have in common, where nothing of it is taken up.

    Parameters
    ----------
    information, score : (A,) float
        Of each aircraft's own coefficient.
    spread : float
        Standard deviation of the common part, in units of the coefficient.
    factor : float
        Cluster factor.

    Returns
    -------
    Shifts
        Only none where the mean of the estimates is not clearly other than nothing.
    """
    total = float(information.sum())
    live = information > 1e-9 * information.max(initial=1e-30)
    if live.sum() < 3 or abs(score.sum()) < CLEAR * np.sqrt(factor * total):
        return no_shift(information)
    values = np.linspace(-3.0, 3.0, EVEN) * spread
    log = -0.5 * (values / spread) ** 2
    return Shifts(information, values, np.asarray(log - np.logaddexp.reduce(log)))
