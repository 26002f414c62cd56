"""Lines of fixed columns, many at a time, as Fortran's formats write them.

Assumes ASCII text and columns counted from 1, as format documents count them. A batch of lines is
an array of octets (line, column); numbers are set digit by digit over all lines at once, so that a
million reports take seconds. A number too wide for its field is a ``ValueError``: Fortran would
write asterisks, which no reader takes; so is one that is not finite.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Lines = NDArray[np.uint8]

MISSING = -888888.0
"""A missing value in every format of WRF and WRFDA that is read by columns."""
# Octets of ASCII: digits are written as these plus their value, a column of all lines at a time.
_ZERO, _SPACE, _MINUS, _POINT = 48, 32, 45, 46


def lines_of(template: str, count: int) -> Lines:
    """Equal lines (count, octets) of an ASCII template, of one or several lines itself."""
    octets = np.frombuffer(template.encode("ascii"), dtype=np.uint8)
    lines = np.empty((count, octets.size), dtype=np.uint8)
    lines[:] = octets
    return lines


def line_starts(template: str) -> list[int]:
    """Octets before each line of a record's template, to be added to a column."""
    lengths = [len(line) for line in template.splitlines(keepends=True)]
    return [sum(lengths[:number]) for number in range(len(lengths))]


def put_number(
    lines: Lines, column: int, width: int, values: ArrayLike, *, decimals: int = 0
) -> None:
    """Write numbers (n,) right-justified, as F or I of a Fortran format, into lines (n, columns).

    Parameters
    ----------
    column : int
        First column of the field, from 1.
    decimals : int, default 0
        Behind the point; 0 writes a whole number without a point.

    Raises
    ------
    ValueError
        If a value is not finite or too wide for the field.
    """
    numbers = np.broadcast_to(np.asarray(values, dtype=np.float64), lines.shape[:1])
    if not np.isfinite(numbers).all() or (np.abs(numbers) >= 10.0**width).any():
        raise ValueError(f"a number cannot stand in {width} columns")
    # whole numbers, whose digits are written a column of all lines at a time
    rest = np.rint(np.abs(numbers) * 10.0**decimals).astype(np.int64)
    # What rounds to zero has no sign: some readers stop at -0.
    sign = (numbers < 0) & (rest > 0)
    field = np.empty((width, rest.size), dtype=np.uint8)  # a row a column: written in one piece
    place = width - 1
    for _ in range(decimals):
        rest = _put_digit(field[place], rest)
        place -= 1
    if decimals:
        field[place] = _POINT
        place -= 1
    rest = _put_digit(field[place], rest)
    # Left of the first digit stands the sign, then blanks.
    for row in field[:place][::-1]:
        if rest.any():
            here = rest > 0
            rest = _put_digit(row, rest)
            row[~here] = np.where(sign[~here], _MINUS, _SPACE)
            sign &= here
        else:
            row[:] = np.where(sign, _MINUS, _SPACE)
            sign[:] = False
    if rest.any() or sign.any():
        raise ValueError(f"a number is wider than {width} columns")
    lines[:, column - 1 : column - 1 + width] = field.T


def _put_digit(row: NDArray[np.uint8], rest: NDArray[np.int64]) -> NDArray[np.int64]:
    """Write the last digit; what is left of the number."""
    left = rest // 10
    row[:] = rest - 10 * left + _ZERO
    return left


def put_text(lines: Lines, column: int, texts: Lines) -> None:
    """Write texts (n, width), rows of a `text_table`, from a first column (counted from 1)."""
    lines[:, column - 1 : column - 1 + texts.shape[1]] = texts


def text_table(texts: Sequence[str], width: int) -> Lines:
    """ASCII texts as rows of octets (texts, width), padded with blanks."""
    padded = b"".join(text.ljust(width).encode("ascii") for text in texts)
    return np.frombuffer(padded, dtype=np.uint8).reshape(len(texts), width)


def put_time(lines: Lines, column: int, seconds: NDArray[np.int64], *, pattern: str) -> None:
    """Write dates: seconds since 1970 (UTC) from a first column, counted from 1.

    ``pattern`` is such as ``yyyymmddhhmmss``: letters stand for digits, marks for themselves.
    """
    text = np.datetime_as_string(seconds.astype("datetime64[s]")).astype("S19")
    octets = text.view(np.uint8).reshape(-1, 19)
    # Places of the digits in yyyy-mm-ddThh:mm:ss.
    source = iter([0, 1, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 17, 18])
    for place, mark in enumerate(pattern, start=column - 1):
        lines[:, place] = octets[:, next(source)] if mark.isalpha() else ord(mark)
