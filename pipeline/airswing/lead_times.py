"""Selection of lead times and of an ensemble member.

Assumes lead times in seconds, and members by the number in the message. A message without a number
(all of GRIB edition 1) is member 0.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.units import DAY

_OPERATORS: dict[str, Callable[[NDArray[np.float64], float], NDArray[np.bool_]]] = {
    ">=": operator.ge,
    ">": operator.gt,
    "<=": operator.le,
    "<": operator.lt,
    "==": operator.eq,
}
_TIME_UNITS = {"h": 3600.0, "hour": 3600.0, "hours": 3600.0, "min": 60.0, "s": 1.0, "d": DAY}


def lead_condition(text: str) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
    """Turn ``any``, ``analysis`` or a comparison such as ``>= 1 h`` into a function.

    Returns
    -------
    callable
        From an array of lead times (s) to booleans.

    Raises
    ------
    InputError
        If the text is none of these.
    """
    words = text.strip().lower()
    if words == "any":
        return lambda lead: np.ones(np.shape(lead), dtype=bool)
    if words == "analysis":
        return lambda lead: np.asarray(lead) == 0
    match = re.fullmatch(r"(>=|<=|==|>|<)\s*(\d+\.?\d*|\.\d+)\s*([a-z]+)", words)
    if match is None or match[3] not in _TIME_UNITS:
        raise InputError(
            "lead condition not understood",
            field="lead",
            found=text,
            remedy='Write any, analysis, or a comparison such as ">= 1 h"',
        )
    compare, limit = _OPERATORS[match[1]], float(match[2]) * _TIME_UNITS[match[3]]
    return lambda lead: np.asarray(compare(lead, limit))


class Wanted(NamedTuple):
    """Which profiles in the model files belong to a reference."""

    lead: str = "any"  # see :func:`lead_condition`
    member: int | None = None  # number of the ensemble member; None: any

    def of(self, heads: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which profiles are selected, shape (n,).

        Parameters
        ----------
        heads : structured array, shape (n,)
            With ``lead`` (s) and ``member``.
        """
        meets = lead_condition(self.lead)(heads["lead"])
        return meets if self.member is None else meets & (heads["member"] == self.member)

    def none_met(self, heads: NDArray[np.void], where: str) -> InputError:
        """Return the error for files without a selected profile.

        Parameters
        ----------
        heads : structured array, shape (n,)
            Profiles that exist.
        where : str
            Key of the configuration.
        """
        members = sorted({int(number) for number in heads["member"]})
        if self.member is not None and self.member not in members:
            return InputError(
                f"no wind of ensemble member {self.member}",
                field=where,
                found="members " + ", ".join(map(str, members)),
            )
        hours = sorted({int(s) / 3600 for s in heads["lead"]})
        return InputError(
            f"no wind meets the lead condition {self.lead!r}",
            field=where,
            found="leads " + ", ".join(f"{h:g} h" for h in hours),
        )
