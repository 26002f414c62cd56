"""Records of fixed columns, many at a time, as Fortran formats write them.

Assumes ASCII text, and columns counted from 1 as in format documents. A batch of equal lines is an
array of bytes (line, column); a number is written digit by digit into all lines at once, so that a
million reports take seconds. A number that is not finite or too wide for its field raises
``ValueError``: Fortran would write asterisks, which no reader accepts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from airswing.physics.triangle import direction_in_degrees

Array = NDArray[np.float64]
Lines = NDArray[np.uint8]

MISSING = -888888.0
"""Missing value of the formats of WRF, OBSPROC and WRFDA."""
_ZERO, _SPACE, _MINUS, _POINT = b"0 -."


def lines_of(template: str, number: int) -> Lines:
    """Equal records (number, bytes) of an ASCII template of one or several lines."""
    characters = np.frombuffer(template.encode("ascii"), dtype=np.uint8)
    return np.tile(characters, (number, 1))


def line_starts(template: str) -> list[int]:
    """Bytes before each line of a template, to be added to a column of that line."""
    lengths = [len(line) for line in template.splitlines(keepends=True)]
    return [sum(lengths[:number]) for number in range(len(lengths))]


def put_number(
    lines: Lines,
    column: int,
    width: int,
    values: ArrayLike,
    *,
    decimals: int = 0,
    where: NDArray[np.bool_] | None = None,
) -> None:
    """Write numbers right-justified, as descriptor F or I of a Fortran format.

    Parameters
    ----------
    lines : array of uint8, shape (n, columns)
        Changed in place.
    column, width : int
        First column of the field, from 1, and its columns.
    values : array, shape (n,), or float
    decimals : int, default 0
        Digits after the point; 0 writes a whole number without a point.
    where : array of bool, shape (n,), optional
        Lines to write; the others keep their text.

    Raises
    ------
    ValueError
        If a value is not finite or too wide for the field.
    """
    numbers = np.broadcast_to(np.asarray(values, dtype=np.float64), lines.shape[:1])
    if where is not None and not where.all():
        chosen = lines[where]
        put_number(chosen, column, width, numbers[where], decimals=decimals)
        lines[where] = chosen
        return
    if not np.isfinite(numbers).all() or (np.abs(numbers) >= 10.0**width).any():
        raise ValueError(f"a number does not fit into {width} columns")
    rest = np.rint(np.abs(numbers) * 10.0**decimals).astype(np.int64)
    # A value that rounds to zero has no sign: some readers stop at -0.
    sign = (numbers < 0) & (rest > 0)
    field = np.empty((width, rest.size), dtype=np.uint8)
    place = width - 1
    for _ in range(decimals):
        rest = _put_digit(field[place], rest)
        place -= 1
    if decimals:
        field[place] = _POINT
        place -= 1
    rest = _put_digit(field[place], rest)
    # Left of the first digit comes the sign, then blanks.
    for row in field[:place][::-1]:
        if rest.any():
            digits = rest > 0
            rest = _put_digit(row, rest)
            row[~digits] = np.where(sign[~digits], _MINUS, _SPACE)
            sign &= digits
        else:
            row[:] = np.where(sign, _MINUS, _SPACE)
            sign[:] = False
    if rest.any() or sign.any():
        raise ValueError(f"a number does not fit into {width} columns")
    lines[:, column - 1 : column - 1 + width] = field.T


def _put_digit(row: Lines, rest: NDArray[np.int64]) -> NDArray[np.int64]:
    """Write the last digit of whole numbers; return the numbers without it."""
    shortened = rest // 10
    row[:] = rest - 10 * shortened + _ZERO
    return shortened


def put_text(lines: Lines, column: int, texts: Lines) -> None:
    """Write texts (n, width), rows of `text_table`, from a first column (counted from 1)."""
    lines[:, column - 1 : column - 1 + texts.shape[1]] = texts


def text_table(texts: Sequence[str], width: int) -> Lines:
    """ASCII texts as rows of bytes (texts, width), padded with blanks."""
    padded = b"".join(text.ljust(width).encode("ascii") for text in texts)
    return np.frombuffer(padded, dtype=np.uint8).reshape(len(texts), width)


def put_time(lines: Lines, column: int, seconds: NDArray[np.int64], *, pattern: str) -> None:
    """Write dates, given in seconds since 1970 (UTC), from a first column (counted from 1).

    ``pattern`` is such as ``yyyy-mm-dd_hh:mm:ss``: letters are replaced by digits, others kept.
    """
    text = np.datetime_as_string(seconds.astype("datetime64[s]")).astype("S19")
    characters = text.view(np.uint8).reshape(-1, 19)
    digits = iter([0, 1, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 17, 18])  # in yyyy-mm-ddThh:mm:ss
    for place, letter in enumerate(pattern, start=column - 1):
        lines[:, place] = characters[:, next(digits)] if letter.isalpha() else ord(letter)


def speed_and_direction(u: ArrayLike, v: ArrayLike, *, least: float = 0.0) -> tuple[Array, Array]:
    """Speed and direction of the wind as the formats want them.

    Parameters
    ----------
    u, v : array
        Components towards east and north, m/s.
    least : float, default 0
        Degrees; a direction that is no larger is written as 360, since readers take 0 as missing.

    Returns
    -------
    speed : array
        m/s.
    direction : array
        Degrees from which the wind blows, in (0, 360]; 360 for a calm.
    """
    east, north = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
    speed = np.hypot(east, north)
    direction = direction_in_degrees(east, north)
    return speed, np.where((speed == 0.0) | (direction <= least), 360.0, direction)
