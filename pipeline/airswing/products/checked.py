"""Kept work with a checksum: what is read back is what was written, or it is made again.

Assumes damage, not malice: a BLAKE2b digest of 16 octets stands beside the content.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

SEAL = 16
"""Octets of a digest."""


def digest(*octets: bytes | memoryview) -> bytes:
    """Checksum of some octets: `SEAL` of them."""
    found = hashlib.blake2b(digest_size=SEAL)
    for part in octets:
        found.update(part)
    return found.digest()


def note(content: object) -> str:
    """Plain content (what JSON can hold) as text that carries its own checksum."""
    text = json.dumps(content)
    return json.dumps({"checksum": digest(text.encode()).hex(), "content": text})


def noted(text: str) -> Any:
    """Undo :func:`note`: whatever JSON holds, of a shape that its writer knows.

    Raises
    ------
    ValueError
        If it is not what was written.
    """
    told = json.loads(text)
    if not isinstance(told, dict) or not isinstance(told.get("content"), str):
        raise ValueError("no note of kept work")
    if digest(told["content"].encode()).hex() != told.get("checksum"):
        raise ValueError("its checksum is another")
    return json.loads(told["content"])
