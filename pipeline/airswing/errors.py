"""Errors for invalid user input (exit status 2), each shown as one message without a traceback.

Every other exception is a defect of airswing (exit status 1). A message is one line of at most
`LONGEST` characters for any content of a file: its parts are shortened in this module only.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Sequence
from functools import partial
from typing import Self

LONGEST = 2_000  # characters of a message
# File 400, field 250, what 550, found 450 and remedy 250 together are shorter than LONGEST.
_LONGEST_PART, _MOST_BITS = 450, 512

_REPR = reprlib.Repr()
# The beginning of a large value identifies it, and the message remains readable.
_REPR.maxlevel, _REPR.maxdict, _REPR.maxlist, _REPR.maxtuple, _REPR.maxset = 3, 6, 8, 8, 8
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 120


def shortened(value: object, most: int = _LONGEST_PART) -> str:
    """Return a value as one line of at most `most` characters.

    Text is kept; numbers, lists and mappings are written as in Python, with few items. Control
    characters are replaced by blanks, omitted parts by an ellipsis.
    """
    if isinstance(value, str):
        text = value
    elif isinstance(value, int) and value.bit_length() > _MOST_BITS:
        text = f"a whole number of {value.bit_length():,} bits"
    else:
        is_container = isinstance(value, list | tuple | dict | set | frozenset | bytes)
        try:
            text = _REPR.repr(value) if is_container else str(value)
        except (ValueError, RecursionError):  # it contains a number of very many digits
            text = f"a {type(value).__name__}"
    over = len(text) - 4 * most  # before the costly part
    if over > 0:
        text = f"{text[: 2 * most]} ... {text[-most:]}"
    text = "".join(c if c.isprintable() else " " for c in text)
    text = text if len(text) <= most else " ".join(text.split())
    if len(text) <= most:
        return text
    ends = most // 4
    return f"{text[: most - ends - 5]} ... {text[-ends:]}"


class AirswingError(Exception):
    """Base class of the errors that airswing raises for invalid input."""


class InputError(AirswingError):
    """Error raised for invalid user input.

    Parameters
    ----------
    what : str
        The error, in a short phrase.
    file, field, found, remedy : optional
        The file and the column, variable or key concerned, the value found, and the remedy.
    """

    def __init__(
        self,
        what: str,
        *,
        file: object | None = None,
        field: str | None = None,
        found: object | None = None,
        remedy: str | None = None,
    ) -> None:
        self.what, self.file, self.field = what, file, field
        self.found, self.remedy = found, remedy
        places = [] if file is None else [shortened(file, 400)]
        places += [] if field is None else [shortened(field, 250)]
        message = ": ".join([*places, shortened(what, 550)])
        if found is not None:
            message += f" (found: {shortened(found)})"
        if remedy is not None:
            message += f". {shortened(remedy, 250)}"
        super().__init__(message)

    def located(self, *, file: object | None = None, field: str | None = None) -> Self:
        """Return the same error for another file or field."""
        file, field = file or self.file, field or self.field
        return type(self)(self.what, file=file, field=field, found=self.found, remedy=self.remedy)

    def __reduce__(self) -> tuple[object, ...]:
        rest = partial(type(self), file=self.file, field=self.field, found=self.found)
        return partial(rest, self.what, remedy=self.remedy), ()


class ConfigError(InputError):
    """Error raised for an invalid configuration."""


def nearest(word: str, names: Sequence[str]) -> str:
    """Return the end of a message: the name nearest to a word, or all names."""
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(names)}" if names else ""
