"""Labels of sealed cases: their keys, and their seal.

The digest (SHA-256 of the file of labels), published before any diagnosis, proves afterwards that
the labels were not changed. Sizes in m/s root mean square where an effect acts.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from airswing.errors import InputError
from airswing.products.whole_files import json_types, write_text

Injected = Mapping[str, Any]
"""One effect as the generator takes it.

``name``; ``tails``, None for the whole fleet; ``parameters``, for an outside effect also text and
lists of parts; ``period``, None or two dates of which either may be None.
"""
Label = dict[str, Any]
"""Truth of one case.

``name, rung, kind, variant, world``; ``sizes`` and the largest, ``size``; ``focus``, the effects
the case is about; ``names`` of all active effects; ``effects`` (`Injected`); ``without``, those
withheld from the diagnosis; ``background`` and ``background_components``, errors of the world
itself; ``closure``, the mean vector disagreement ``before`` and ``after`` (without the effects),
kt; ``outside``, None or the result of `airswing.synthetic.outside_effects.outside_truth`.
"""


def seal(labels: Sequence[Mapping[str, object]], folder: Path) -> str:
    """Write ``labels.json`` into a folder and its digest to ``<folder>.sha256``; the digest."""
    folder.mkdir(parents=True, exist_ok=True)
    path = write_text(folder / "labels.json", json.dumps(json_types(list(labels)), indent=1))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    write_text(folder.with_suffix(".sha256"), f"{digest}  labels.json\n")
    return digest


def open_seal(folder: Path, *, digest: str) -> list[Label]:
    """Read the labels of `seal`; InputError if they are absent or not those of the digest."""
    path = folder / "labels.json"
    if not path.exists():
        raise InputError("no sealed labels", file=path)
    actual = hashlib.sha256(path.read_bytes()).hexdigest()
    if actual != digest:
        raise InputError(
            "the sealed labels are not those whose digest was published",
            file=path,
            found=actual,
            remedy=f"published: {digest}",
        )
    labels: list[Label] = json.loads(path.read_text(encoding="utf-8"))
    return labels
