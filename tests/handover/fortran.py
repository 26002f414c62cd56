"""Formatted reading as in Fortran: fixed columns, blanks ignored, points may be implied.

Real fields without a point or an exponent have the format's decimals implied; blank fields are 0;
text that is not a number is an error, also asterisks. A short line is filled up with blanks and
an end of line of DOS is no part of it (as gfortran reads).
"""

import re

import numpy as np


class ReadError(ValueError):
    """IOSTAT > 0, or the crash of a reader without IOSTAT."""


class FileEndError(EOFError):
    """IOSTAT < 0."""


def real(field, decimals):
    text = field.strip()
    if not text:
        return 0.0
    if text.lower() in ("nan", "inf", "+inf", "-inf", "infinity"):
        return float(text)
    match = re.fullmatch(r"([+-]?)(\d*)(\.\d*)?(?:[eEdD]?([+-]?\d+))?", text.replace(" ", ""))
    if match is None or not (match[2] or (match[3] and len(match[3]) > 1)):
        raise ReadError(f"bad real number {field!r}")
    sign, digits, point, exponent = match.groups()
    value = float(f"{sign}{digits or '0'}{point or ''}")
    if point is None:
        value /= 10.0**decimals
    return float(np.float32(value * 10.0 ** int(exponent or 0)))


def integer(field):
    text = field.strip()
    if not text:
        return 0
    if not re.fullmatch(r"[+-]?\d+", text):
        raise ReadError(f"bad integer {field!r}")
    return int(text)


def logical(field):
    text = field.strip().lstrip(".").upper()
    if text[:1] not in ("T", "F"):
        raise ReadError(f"bad logical {field!r}")
    return text[0] == "T"


def fields(line, *layout):
    """Fields of a line by name, width and kind (a text, i, l, or the decimals of a real number).

    A field without a name is skipped.
    """
    record, start = {}, 0
    for name, width, kind in layout:
        text, start = line[start : start + width], start + width
        if name:
            readers = {"a": str, "i": integer, "l": logical}
            record[name] = readers[kind](text) if kind in readers else real(text, kind)
    return record


class Lines:
    """A file read line by line; each line as wide as it is asked for."""

    def __init__(self, text):
        self._lines = text.split("\n")
        if self._lines and self._lines[-1] == "":
            self._lines.pop()
        self.at = 0

    def next(self):
        if self.at >= len(self._lines):
            raise FileEndError
        self.at += 1
        return self._lines[self.at - 1].rstrip("\r").ljust(700)
