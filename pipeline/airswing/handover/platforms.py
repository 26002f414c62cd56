"""Identifiers and platforms of the aircraft in the target systems.

The platform comes from the configuration (``handover: {aircraft: {AMDAR: ["EU*"]}}``, then
``platform``), else from the reports (FSL/MADIS files name the data stream of each report, BUFR
files are AMDAR), else it is TAMDAR.

The code after ``FM-`` decides how a reader treats a report: OBSPROC and WRFDA take 101 as
``tamdar`` and 42, 96, 97 as ``airep`` (WRF 4.7, var/obsproc/src/fm_decoder.F90), each with its
error table and rules.
"""

from __future__ import annotations

import fnmatch
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
"""Platform in LITTLE_R and ob.ascii."""
LONGEST_IDENTIFIER = 40
"""Columns for the identifier in LITTLE_R, ob.ascii and OBS_DOMAIN."""
LARGEST_NUMBER = 99_999
"""WRFDA's bias correction reads identifiers as five-digit numbers, and stops at ``N751A``."""


def names_of(corrected: xr.Dataset) -> list[str]:
    """Names of all aircraft, in the order of the product."""
    return [str(name) for name in corrected["aircraft"].to_numpy()]


def identifiers(corrected: xr.Dataset, settings: Handover) -> list[str]:
    """Identifier of every aircraft in the files: its name, or a number of five digits.

    An aircraft whose name is a number keeps it; the others get the numbers that are free.

    Raises
    ------
    InputError
        If a name is longer than 40 characters or not printable ASCII: cut or changed it could be
        the name of another aircraft.
    """
    names = names_of(corrected)
    for name in names:
        if len(name) > LONGEST_IDENTIFIER or not (name.isascii() and name.isprintable() and name):
            raise InputError(
                f"the format takes an aircraft identifier of 1 to {LONGEST_IDENTIFIER} characters "
                "of printable ASCII",
                field="aircraft",
                found=ascii(name[:120]),
                remedy="Give the aircraft a shorter name in the reports and run again",
            )
    if settings.identifiers == "tail":
        return names
    if len(names) > LARGEST_NUMBER:
        raise InputError("more aircraft than numbers of five digits", found=len(names))
    holder: dict[int, str] = {}
    for name in names:
        if name.isdigit() and 0 < int(name) <= LARGEST_NUMBER:
            holder.setdefault(int(name), name)
    number_of = {name: number for number, name in holder.items()}
    free = (number for number in range(1, LARGEST_NUMBER + 1) if number not in holder)
    return [f"{number_of.get(name) or next(free):05d}" for name in names]


def platforms(corrected: xr.Dataset, settings: Handover) -> NDArray[np.int8]:
    """Platform of every aircraft, as index (aircraft,) of `PLATFORMS`."""
    names = names_of(corrected)
    reported = [PLATFORM["unknown"]] * len(names)
    if "platform" in corrected:
        reported = corrected["platform"].to_numpy().tolist()
    words = {code: name for name, code in PLATFORM.items()} | {PLATFORM["unknown"]: "TAMDAR"}
    found = []
    for name, code in zip(names, reported, strict=True):
        default = words[code] if settings.platform == "auto" else str(settings.platform)
        matched = (
            platform
            for platform, patterns in settings.aircraft.items()
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
        )
        found.append(PLATFORMS.index(next(matched, default)))
    return np.array(found, dtype=np.int8)
