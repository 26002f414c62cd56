"""What something nobody thought of could close unseen: how much of a gap silence leaves open.

Assumptions: an error outside the catalogue shows by its evidence. One of root mean square s on a
share f of n reports has E = n f s^2 / (2 sigma^2) nats, sigma the noise of a component, and closes
m f s^2 / (4 sigma^2) = m E / (2 n) of a mean disagreement m (that of two normal components,
m = sigma sqrt(pi / 2), to second order in s). What is asked of a table nobody had in mind, with
errors that last for days and all that was searched, comes to two thousand such nats. Beside it
stands what is told of no archive because every fleet has it: errors under a practical size.

Validity: two days and more. The two thousand nats are from the blind checks (docs/gap_check.md): of
some twenty errors from outside that they left untold in six weeks all close 0.00 to 0.05 kt but two
(0.12 and 0.17, told since), most those by the date, for what lasts for days is the reference's; of
two in two weeks one 0.01 and one 0.14 kt. Every check counts how often it holds.

Source: docs/gap.md section 7.
"""

from __future__ import annotations

import numpy as np

from airswing.units import KNOT

#: Evidence of single reports, nats, from which an error that nobody thought of is told.
TOLD_FROM = 2000.0
#: Size, m/s on all reports, that is left to what every fleet has a little of.
EVERY_FLEET = 0.2
#: An error can lie against the model's own on these very reports: part that closes less than
#: nothing. Twins of small errors (0.4 m/s) closed -0.02 kt at the least, in two weeks.
AGAINST = 0.25


def could_hide(disagreement: float, reports: int) -> float:
    """Reduction by an error outside the catalogue that would not have been told.

    Parameters
    ----------
    disagreement : float
        Mean vector disagreement, kt.
    reports : int
        All that unknowns were looked for on.

    Returns
    -------
    float
        kt; never more than the disagreement.
    """
    if disagreement <= 0.0 or reports <= 0:
        return 0.0
    unseen = 0.5 * disagreement * TOLD_FROM / reports
    # m s^2 / (4 sigma^2) with sigma = m / sqrt(pi / 2)
    small = np.pi / 8.0 * (EVERY_FLEET / KNOT) ** 2 / disagreement
    return float(min(unseen + small, disagreement))


def hidden_interval(disagreement: float, reports: int) -> tuple[float, float]:
    """Return the limits of what could close unseen, kt."""
    most = could_hide(disagreement, reports)
    return -AGAINST * most, most
