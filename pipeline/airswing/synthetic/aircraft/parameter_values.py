"""Parameters of faults as numbers and lists: mappings from a file or a draw may hold anything.

Assumes what the published catalogue of effects states of each parameter; units are in the names.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import SupportsFloat


def number(value: object) -> float:
    """Return one parameter as a number.

    Raises
    ------
    TypeError
        If it is none.
    ValueError
        If it is text that is none.
    """
    if isinstance(value, str | SupportsFloat):
        return float(value)
    raise TypeError(f"{value!r} is no number")


def listed(value: object) -> list[object]:
    """Return a parameter of several values.

    Raises
    ------
    TypeError
        If it is one value alone.
    """
    if isinstance(value, Iterable):
        return list(value)
    raise TypeError(f"{value!r} is no list")
