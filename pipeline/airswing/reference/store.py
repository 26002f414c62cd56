"""Finished samples on disk, so that a run killed at any moment can go on.

One file a model time, named by a hash of everything its values depend on: the
identity of the files read, the messages, the reports and the code. Files are
written whole under another name, flushed to the disk and renamed: a file that
exists is complete. Samples with unreadable messages are not kept.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.reference import grids, packing, sampling, values
from airswing.reference.sampling import ModelTime, Sample

Floats = NDArray[np.float64]


@lru_cache(maxsize=1)
def _code_version() -> bytes:
    digest = hashlib.blake2b(digest_size=12)
    for module in (grids, packing, values, sampling):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.digest()


class SampleStore:
    """A folder of finished samples.

    Parameters
    ----------
    folder : Path
        Made where it is absent.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(
        self, model: ModelTime, places: tuple[Floats, Floats, Floats], derivatives: bool
    ) -> Path:
        """File of a sample; its name changes with anything its values depend on."""
        digest = hashlib.blake2b(digest_size=16)
        digest.update(_code_version())
        digest.update(repr((model.valid, model.grid, model.files, derivatives)).encode())
        for array in (model.u, model.v, model.pressure, *places):
            digest.update(np.ascontiguousarray(array).tobytes())
        return self.folder / f"{digest.hexdigest()}.npy"

    def get_or_make(
        self,
        model: ModelTime,
        places: tuple[Floats, Floats, Floats],
        derivatives: bool,
        make: Callable[[], Sample],
    ) -> Sample:
        """The stored sample where there is one, else a new one, which is stored."""
        path = self.path(model, places, derivatives)
        known = _load(path, places[0].size)
        if known is not None:
            return Sample(known, (), 0)
        sample = make()
        if not sample.problems:
            _save(path, sample.table)
        return sample


def _load(path: Path, count: int) -> Floats | None:
    try:
        table = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return table if table.ndim == 2 and table.shape[1] == count else None


def _save(path: Path, table: Floats) -> None:
    try:
        _replace(path, table)
    except OSError as error:
        raise InputError(
            "cannot keep a finished model time; those kept before are whole",
            file=path.parent,
            found=error.strerror or error,
            remedy="Free space or choose another folder with --output, then --resume",
        ) from error


def _replace(path: Path, table: Floats) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(descriptor, "wb") as file:
            np.save(file, table, allow_pickle=False)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
