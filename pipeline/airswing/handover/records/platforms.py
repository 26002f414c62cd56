"""Aircraft as the readers know them: identifier, and platform by the source of the reports.

Assumes that the reports tell (``platform``: FSL/MADIS files by the data stream of each report,
BUFR files are AMDAR), and that those which do not are of the units this package is about, TAMDAR.
The configuration and the command go first (``handover: {aircraft: {AMDAR: ["EU*"]}}``).

Identifiers are written as they are, or as numbers of five digits for those who let WRFDA correct
biases by aircraft (VarBC reads ``00751``, and stops at ``N751A``): an aircraft that is called by a
number keeps it, the others get those that are free, in their order.

The code behind ``FM-`` decides what a reader does: OBSPROC and WRFDA take 101 as ``tamdar``, 42, 96
and 97 as ``airep`` (var/obsproc/src/fm_decoder.F90), each with error tables and rules of its own.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import PLATFORM

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Handover

PLATFORMS = tuple(name for name in PLATFORM if name != "unknown")
CODES = {
    "TAMDAR": "FM-101 TAMDAR",
    "AMDAR": "FM-42 AMDAR",
    "ACARS": "FM-97 ACARS",
    "AIREP": "FM-97 AIREP",
}
"""What stands in LITTLE_R and ob.ascii."""
# Columns that LITTLE_R and ob.ascii have for it.
LONGEST_IDENTIFIER = 40
LARGEST_NUMBER = 99_999
_WORDS = {code: name for name, code in PLATFORM.items()} | {PLATFORM["unknown"]: "TAMDAR"}


def identifiers(corrected: xr.Dataset, settings: Handover) -> list[str]:
    """Identifiers of all aircraft, in their order, as every format holds them: up to 40 characters.

    Raises
    ------
    InputError
        If one is longer, or not plain text: cut or changed it could be another aircraft's.
    """
    names = _names(corrected)
    for name in names:
        if len(name) > LONGEST_IDENTIFIER or not (name.isascii() and name.isprintable() and name):
            raise InputError(
                f"an aircraft's identifier is not 1 to {LONGEST_IDENTIFIER} characters of plain "
                "text, and the format has no room for it",
                field="aircraft",
                # whatever is in it, on one line
                found=ascii(name[:120]),
                remedy="Give the aircraft a shorter name in the reports and run again",
            )
    return list(names) if settings.identifiers == "tail" else _numbers(names)


def _numbers(names: Sequence[str]) -> list[str]:
    if len(names) > LARGEST_NUMBER:
        raise InputError("more aircraft than numbers of five digits", found=len(names))
    own: dict[int, str] = {}
    for name in names:
        if name.isdigit() and 0 < int(name) <= LARGEST_NUMBER:
            own.setdefault(int(name), name)
    number_of = {name: number for number, name in own.items()}
    free = (number for number in range(1, LARGEST_NUMBER + 1) if number not in own)
    return [f"{number_of.get(name) or next(free):05d}" for name in names]


def platforms(corrected: xr.Dataset, settings: Handover) -> NDArray[np.int8]:
    """Platform of every aircraft, as numbers (aircraft,) of `PLATFORMS`.

    Patterns of the configuration's ``aircraft`` go before its ``platform``, that before the
    reports.
    """
    names = _names(corrected)
    told = np.full(len(names), PLATFORM["unknown"])
    if "platform" in corrected:
        told = corrected["platform"].to_numpy()
    found = []
    for name, own in zip(names, told.tolist(), strict=True):
        default = _WORDS[own] if settings.platform == "auto" else str(settings.platform)
        matched = (
            platform
            for platform, patterns in settings.aircraft.items()
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
        )
        found.append(PLATFORMS.index(next(matched, default)))
    return np.array(found, dtype=np.int8)


def _names(corrected: xr.Dataset) -> Sequence[str]:
    return [str(name) for name in corrected["aircraft"].to_numpy()]
