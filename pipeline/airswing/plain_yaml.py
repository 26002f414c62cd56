"""YAML written by people: plain values only, and every fault of it in one message naming the key.

Assumptions and validity
------------------------
* Files of at most a megabyte, 40 levels deep, 20,000 values with every alias written out: far more
  than a configuration needs, far less than what fills a memory.
* Tags that make anything but plain values are refused (PyYAML's safe loader), as are a key given
  twice, a value that is none of its kind (``2009-06-31``), whole numbers of more than 256 bits,
  and text that no file system or terminal takes (octet 0, halves of surrogate pairs).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from airswing.errors import InputError, shortened

# A configuration has thousands: a model file named by mistake is not read whole.
MOST_OCTETS = 1_000_000
# Deeper, Python's own recursion would end the reading, with a traceback.
_DEEPEST = 40
# With aliases written out: ten lines of aliases of aliases stand for a billion values.
_MOST_VALUES = 20_000
# More than any key takes; of 4,300 digits Python prints none, not even in a message.
_MOST_BITS = 256


def load_yaml(path: Path, kind: type[InputError] = InputError) -> object:
    """Read a YAML file.

    Parameters
    ----------
    kind : type, optional
        Of the error raised.

    Returns
    -------
    object
        Mappings, lists, text, numbers, dates, None.

    Raises
    ------
    InputError
        It cannot be read, or is no plain YAML.
    """
    try:
        with path.open("rb") as file:
            octets = file.read(MOST_OCTETS + 1)
        if len(octets) > MOST_OCTETS:
            raise kind(f"is larger than {MOST_OCTETS:,} octets: no YAML of airswing's", file=path)
        text = octets.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise kind("not a YAML file airswing can read: not UTF-8 text", file=path) from err
    except OSError as err:
        raise kind("cannot read the file", file=path, found=err.strerror) from err
    try:
        return _Loader(text).get_single_data()
    except _ValueFault as err:
        raise kind(err.problem or "", file=path, field=err.key or None, found=err.found) from err
    except yaml.YAMLError as err:
        told = " ".join(str(err).split())
        raise kind("not a YAML file airswing can read", file=path, found=told) from err


class _ValueFault(yaml.constructor.ConstructorError):
    """A value that cannot be had: at which key, and what stands there."""

    def __init__(self, problem: str, key: str = "", found: object | None = None) -> None:
        super().__init__(None, None, problem, None)
        self.key, self.found = key, found


class _Loader(yaml.SafeLoader):
    """Safe YAML with bounds, which names keys."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._root: yaml.Node | None = None

    # the loader hands over places, keys and None, of which its stubs know the places alone
    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise _ValueFault(f"nested more than {_DEEPEST} levels deep")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def get_single_data(self) -> object:
        self._root = self.get_single_node()
        if self._root is None:
            return None
        _require_few(self._root)
        return self.construct_document(self._root)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, ArithmeticError, TypeError, AttributeError, LookupError) as err:
            kind = node.tag.rpartition(":")[2]
            written = getattr(node, "value", None)
            raise _ValueFault(
                f"is no {kind} ({shortened(err)}, line {node.start_mark.line + 1})",
                self._key(node),
                shortened(written),
            ) from err
        if isinstance(value, str) and not _sayable(value):
            raise _ValueFault("text that cannot be used", self._key(node), ascii(value)[:80])
        if isinstance(value, int) and value.bit_length() > _MOST_BITS:
            raise _ValueFault("a number that nothing takes", self._key(node), value)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[object, object]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, str | int | float) and key in seen:
                line = key_node.start_mark.line + 1
                raise _ValueFault(
                    f"the key {shortened(key, 60)!r} stands twice (line {line})", self._key(node)
                )
            seen.add(key if isinstance(key, str | int | float) else None)
        return super().construct_mapping(node, deep=deep)

    def _key(self, node: yaml.Node) -> str:
        """Keys that lead to a node, joined by points."""
        return _path_to(self._root, node, "") or ""


def _joined(path: str, key: object) -> str:
    return f"{path}.{shortened(key, 60)}" if path else shortened(key, 60)


def _path_to(here: yaml.Node | None, node: yaml.Node, path: str) -> str | None:
    """Keys from one node to another, None where it does not lead there."""
    if here is node:
        return path
    if isinstance(here, yaml.MappingNode):
        below = [(value, _joined(path, getattr(key, "value", "?"))) for key, value in here.value]
        below += [(key, _joined(path, getattr(key, "value", "?"))) for key, _ in here.value]
    elif isinstance(here, yaml.SequenceNode):
        below = [(item, _joined(path, place)) for place, item in enumerate(here.value)]
    else:
        return None
    return next((found for child, name in below if (found := _path_to(child, node, name))), None)


def _sayable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def _require_few(root: yaml.Node) -> None:
    """Refuse a file whose aliases, written out, are too many values, or lead into themselves."""
    sizes: dict[int, int] = {}

    def count(node: yaml.Node) -> int:
        known = sizes.get(id(node))
        if known is not None:
            if known < 0:
                raise _ValueFault("an alias that holds itself")
            return known
        sizes[id(node)] = -1
        total = 1
        if isinstance(node, yaml.MappingNode):
            total += sum(count(key) + count(value) for key, value in node.value)
        elif isinstance(node, yaml.SequenceNode):
            total += sum(count(item) for item in node.value)
        if total > _MOST_VALUES:
            raise _ValueFault(f"holds more than {_MOST_VALUES:,} values, aliases written out")
        sizes[id(node)] = total
        return total

    count(root)
