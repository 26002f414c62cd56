"""Finished samples on disk, so that a run killed at any moment can go on.

One file a model time, named by a hash of everything its values depend on: the
identity of the files read, the messages, the reports and the code. Files are
written whole under another name, flushed to the disk and renamed
(`airswing.products.whole_files`); one that is cut short all the same is said and made again.
Each ends with its checksum: one damaged in keeping is said and made again, too. Samples with
unreadable messages are not kept. A sample that is used again is
marked as of now, so that those no run uses any more can be told.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import os
import re
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.products.checked import SEAL, digest
from airswing.products.whole_files import replacing
from airswing.reference import sampling
from airswing.reference.geometry import grids, interpolation, winds
from airswing.reference.geometry.model_time import ModelTime, Sample
from airswing.reference.grib import consistency, credible, values
from airswing.reference.gridded import chunk_reading, gridded_sampling
from airswing.reference.gridded.cf import axes_grid, curvilinear, projection
from airswing.reference.packing import (
    complex_packing,
    decoder_process,
    image_packing,
    simple_packing,
)

Floats = NDArray[np.float64]

# What the values of a sample depend on.
_MODULES = (
    grids,
    simple_packing,
    complex_packing,
    image_packing,
    decoder_process,
    consistency,
    credible,
    values,
    interpolation,
    winds,
    sampling,
    axes_grid,
    curvilinear,
    projection,
    chunk_reading,
    gridded_sampling,
)
_BEGUN = "begun"
# numpy pads headers to multiples of 64 octets: that of a table of doubles ends well before.
_HEADER_BYTES = 256
# What `numpy.save` writes before a table of doubles.
_HEADER = re.compile(
    rb"\x93NUMPY.{4}\{'descr': '<f8', 'fortran_order': False, 'shape': \((\d+), (\d+)\), \} *\n",
    re.S,
)
_LOG = logging.getLogger("airswing.reference")


@lru_cache(maxsize=1)
def _code_version() -> bytes:
    digest = hashlib.blake2b(digest_size=12)
    for module in _MODULES:
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.digest()


class SampleStore:
    """A folder of finished samples; made where it is absent."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(
        self, model: ModelTime, places: tuple[Floats, Floats, Floats], derivatives: bool
    ) -> Path:
        """File of a sample; its name changes with anything its values depend on."""
        digest = hashlib.blake2b(digest_size=16)
        digest.update(_code_version())
        known = (model.valid, model.grid, model.files, model.storage, derivatives)
        digest.update(repr(known).encode())
        for array in (model.u, model.v, model.pressure, *places):
            digest.update(np.ascontiguousarray(array).tobytes())
        return self.folder / f"{digest.hexdigest()}.npy"

    def holds(
        self, model: ModelTime, places: tuple[Floats, Floats, Floats], derivatives: bool
    ) -> bool:
        """Whether the sample is there; that it is whole shows when it is taken."""
        return self.path(model, places, derivatives).is_file()

    def get(
        self, model: ModelTime, places: tuple[Floats, Floats, Floats], derivatives: bool
    ) -> Sample | None:
        """The stored sample, None where there is none that is whole."""
        path = self.path(model, places, derivatives)
        known = _load(path, places[0].size)
        if known is None:
            return None
        with contextlib.suppress(OSError):  # another user's: forgotten at the end of this run
            os.utime(path)
        return Sample(known, (), 0)

    def put(
        self,
        model: ModelTime,
        places: tuple[Floats, Floats, Floats],
        derivatives: bool,
        sample: Sample,
    ) -> None:
        """Store a sample, unless something of it could not be read."""
        if not sample.problems:
            _save(self.path(model, places, derivatives), sample.table)

    def begin(self) -> None:
        """Note the beginning of a run that uses the folder."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / _BEGUN).touch()

    def forget_unused(self) -> None:
        """Remove the samples that were neither made nor used since :meth:`begin`."""
        begun = (self.folder / _BEGUN).stat().st_mtime_ns
        for path in self.folder.glob("*.npy"):
            if path.stat().st_mtime_ns < begun:
                path.unlink(missing_ok=True)
        (self.folder / _BEGUN).unlink()


def _load(path: Path, count: int) -> Floats | None:
    try:
        with path.open("rb") as file:
            table = _read_table(file)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        _LOG.warning("%s: a kept model time is not whole (%s), read again", path, error)
        return None
    return table if table.shape[1] == count else None


def _read_table(file: BinaryIO) -> Floats:
    """Table that `numpy.save` wrote.

    numpy takes the header for Python and has it parsed, which in several threads at a time fails
    now and then (CPython 3.11, issue 106905).
    """
    found = _HEADER.match(file.read(_HEADER_BYTES))
    if found is None:
        raise ValueError("no header of a table")
    shape = int(found[1]), int(found[2])
    file.seek(0)
    octets = file.read()
    values, seal = octets[found.end() : -SEAL], octets[-SEAL:]
    if len(values) != 8 * shape[0] * shape[1]:
        raise ValueError(f"{len(values) // 8} of {shape[0] * shape[1]} values")
    if digest(octets[:-SEAL]) != seal:
        raise ValueError("its checksum is another")
    return np.frombuffer(values, np.float64).reshape(shape).copy()


def _save(path: Path, table: Floats) -> None:
    whole = io.BytesIO()
    # In memory first: to a file numpy does not say why it cannot be written.
    np.save(whole, np.ascontiguousarray(table, np.float64))
    try:
        with replacing(path, lasting=False) as temporary:
            temporary.write_bytes(b"".join([whole.getvalue(), digest(whole.getbuffer())]))
    except OSError as error:
        raise InputError(
            "cannot keep a finished model time; those kept before are whole",
            file=path.parent,
            found=error.strerror or error,
            remedy="Free space or choose another folder with --output, then --resume",
        ) from error
