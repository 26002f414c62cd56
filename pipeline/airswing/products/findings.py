"""What a stage found, as its JSON file holds it, and how a notebook shows it.

Assumes plain values, lists and mappings of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar, cast

Content = TypeVar("Content", bound=Mapping[str, object])
_MOST, _WIDTH = 6, 100  # of a list named in a line, and letters of the line


class Findings(dict[str, object]):
    """A mapping that shows what is in it, a line a key, and not all of it."""

    def __repr__(self) -> str:
        # Judgements by pair, level and season of two references are tens of thousands of letters.
        lines = (f"{key}: {_short(value)}" for key, value in self.items())
        return "\n".join(
            line if len(line) <= _WIDTH else line[: _WIDTH - 3] + "..." for line in lines
        )


def findings(content: Content) -> Content:
    """What a stage found, with the names it has in its file, shown as :class:`Findings` are."""
    # A TypedDict is a dict with certain keys, and this is one with the very same.
    return cast(Content, Findings(content))


def _short(value: object) -> str:
    if isinstance(value, Mapping):
        if any(isinstance(one, Mapping | list) for one in value.values()):
            return _some(value)
        return _some(f"{key} {_short(one)}" for key, one in value.items()) or "none"
    if isinstance(value, Sequence) and not isinstance(value, str):
        first = value[0] if value else None
        if isinstance(first, Mapping):
            return f"{len(value):,} of {_some(first)}"
        return _some(map(_short, value)) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    return "none" if value is None else str(value)


def _some(values: Iterable[object]) -> str:
    words = [str(value) for value in values]
    return ", ".join(words[:_MOST]) + (f" and {len(words) - _MOST:,} more" * (len(words) > _MOST))
