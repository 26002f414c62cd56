"""Labels of sealed cases: their keys, and their seal.

The digest (SHA-256 of the file of labels), published before any diagnosis, proves afterwards that
the labels were not changed. Sizes in m/s root mean square where an effect acts.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from airswing.errors import InputError
from airswing.products.whole_files import plain, write_text


class Injected(TypedDict):
    """One effect as the generator takes it; ``tails`` None is the whole fleet."""

    name: str
    tails: Sequence[str] | None
    parameters: Mapping[str, Any]  # for an outside effect also text and lists of parts
    period: Sequence[str | None] | None


class TwinClosure(TypedDict):
    """Mean vector disagreement of an archive and of its twin without the effect, kt."""

    before: float
    after: float


class OutsideTruth(TypedDict):
    """An outside effect as measured on its archive."""

    component: str
    shape: str
    variables: list[str]
    scope: str
    reports: int
    size_m_s: float
    named_share: float  # share of its energy that named effects explain
    closes_kt: float
    carried: dict[str, float]  # share of its energy that a curve of each single variable explains


class Label(TypedDict):
    """Truth of one case."""

    name: str
    rung: int
    kind: str
    variant: str
    world: str
    size: float  # the largest of ``sizes``
    sizes: list[float]
    focus: list[str]  # effects the case is about
    names: list[str]  # all active effects
    effects: list[Injected]
    without: list[str]  # effects withheld from the diagnosis
    background: list[str]  # names of errors of the world itself
    background_components: NotRequired[list[str]]  # and their components
    closure: TwinClosure
    outside: OutsideTruth | None


def seal(labels: Sequence[Mapping[str, object]], folder: Path) -> str:
    """Write ``labels.json`` into a folder and its digest to ``<folder>.sha256``; the digest."""
    folder.mkdir(parents=True, exist_ok=True)
    path = write_text(folder / "labels.json", json.dumps(plain(list(labels)), indent=1))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    write_text(folder.with_suffix(".sha256"), f"{digest}  labels.json\n")
    return digest


def open_seal(folder: Path, *, digest: str) -> list[Label]:
    """Read the labels of `seal`; InputError if they are absent or not those of the digest."""
    path = folder / "labels.json"
    if not path.exists():
        raise InputError("no sealed labels", file=path)
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != digest:
        raise InputError(
            "the sealed labels are not those whose digest was published",
            file=path,
            found=found,
            remedy=f"published: {digest}",
        )
    labels: list[Label] = json.loads(path.read_text(encoding="utf-8"))
    return labels
