"""YAML files written by people: plain values, each fault in one message with its line.

Aliases are refused, because a few lines of aliases of aliases can expand to a billion values. Also
refused are tags that construct anything but plain values, repeated keys, values that contradict
their kind (``2009-06-31``), and text that no file system accepts.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from airswing.errors import InputError, shortened

MOST_BYTES = 1_000_000
# More than any key needs; Python does not even print integers of 4,300 digits.
_MOST_BITS = 256


def load_yaml(path: Path, kind: type[InputError] = InputError) -> object:
    """Read a YAML file; an error of the class `kind` says that it is not plain YAML."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise kind("not a YAML file: not UTF-8 text", file=path) from err
    except OSError as err:
        raise kind("cannot read the file", file=path, found=err.strerror) from err
    if len(content) > MOST_BYTES:
        raise kind(f"larger than {MOST_BYTES:,} bytes: not a file that airswing reads", file=path)
    try:
        return _Loader(text).get_single_data()
    except RecursionError as err:
        raise kind("not a YAML file: nested too deeply", file=path) from err
    except yaml.YAMLError as err:
        found = " ".join(str(err).split())
        raise kind("not a YAML file that airswing can read", file=path, found=found) from err


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader without aliases, repeated keys and unusable values."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise _fault(f"aliases such as *{event.anchor} are not supported", event)
        return super().compose_node(parent, index)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, ArithmeticError, TypeError, AttributeError, LookupError) as err:
            written = shortened(getattr(node, "value", ""), 80)
            what = f"{written!r} is not a valid {node.tag.rpartition(':')[2]}"
            raise _fault(what, node) from err
        if isinstance(value, str) and not _usable(value):
            raise _fault("text that cannot be used", node)
        if isinstance(value, int) and value.bit_length() > _MOST_BITS:
            raise _fault("an integer that is too large", node)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, object]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, str | int | float):
                if key in seen:
                    raise _fault(f"the key {shortened(key, 60)!r} is given twice", key_node)
                seen.add(key)
        return super().construct_mapping(node, deep=deep)


def _fault(what: str, where: Any) -> yaml.YAMLError:
    return yaml.YAMLError(f"line {where.start_mark.line + 1}: {what}")


def _usable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def nearest(word: str, known: Sequence[str]) -> str:
    """Return the end of a message: the known word nearest to a word, or all known words."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known)}" if known else ""
