"""Seals: what is true of the cases is put away, and its digest made public, before any diagnosis.

Assumptions: whoever diagnoses reads only the archives; the digest (SHA-256 of the file of labels,
byte for byte) proves afterwards that the labels were not touched.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from airswing.errors import InputError
from airswing.products.whole_files import plain, write_text
from airswing.synthetic.sealed.labels import Label

__all__ = ["digest_of", "open_seal", "seal"]


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def seal(labels: Sequence[Mapping[str, object]], folder: Path) -> str:
    """Write the labels into a folder of their own and publish their digest beside it.

    Parameters
    ----------
    labels : sequence of mapping
        One per case.
    folder : Path
        Folder of ``labels.json``; the digest goes to ``<folder>.sha256``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = write_text(folder / "labels.json", json.dumps(plain(list(labels)), indent=1))
    digest = digest_of(path)
    write_text(folder.with_suffix(".sha256"), f"{digest}  labels.json\n")
    return digest


def open_seal(folder: Path, *, digest: str) -> list[Label]:
    """Read the labels back, after checking that nobody changed them.

    Parameters
    ----------
    folder : Path
        Where `seal` put them.
    digest : str
        What was published.

    Raises
    ------
    InputError
        The file is gone or is not the one that was sealed.
    """
    path = folder / "labels.json"
    if not path.exists():
        raise InputError("no sealed labels", file=path)
    found = digest_of(path)
    if found != digest:
        raise InputError(
            "the sealed labels are not those whose digest was published",
            file=path,
            found=found,
            remedy=f"published: {digest}",
        )
    labels: list[Label] = json.loads(path.read_text(encoding="utf-8"))
    return labels
