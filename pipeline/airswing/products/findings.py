"""Result of a stage: a mapping, as its JSON file holds it, with a short ``repr``.

Assumes plain values, lists and mappings of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar, cast

Content = TypeVar("Content", bound=Mapping[str, object])
_MOST, _WIDTH = 6, 100  # entries of a list in a line; characters of a line


class Findings(dict[str, object]):
    """A mapping whose ``repr`` has one line a key and abbreviates long values."""

    def __repr__(self) -> str:
        lines = (f"{key}: {_short(value)}" for key, value in self.items())
        return "\n".join(
            line if len(line) <= _WIDTH else line[: _WIDTH - 3] + "..." for line in lines
        )


def findings(content: Content) -> Content:
    """Return a stage's result as :class:`Findings`, typed as before."""
    # a TypedDict with the same keys
    return cast(Content, Findings(content))


def _short(value: object) -> str:
    if isinstance(value, Mapping):
        if any(isinstance(entry, Mapping | list) for entry in value.values()):
            return _some(value)
        return _some(f"{key} {_short(entry)}" for key, entry in value.items()) or "none"
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
