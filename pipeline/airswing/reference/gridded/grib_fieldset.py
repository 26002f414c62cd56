"""The fields of a GRIB file as cfgrib takes them, with ecCodes in another process.

cfgrib opens any mapping of fields whose items are the keys of ecCodes. Here a field asks a process
that may die of it (`airswing.reference.packing.decoder`): a message that ends it is left out and
counted, or its values are missing; neither ends the run.

Assumptions and validity
------------------------
* Messages are framed and split by their octets; values are read from the file when asked for.
* Header keys of all fields are kept, some 30 a field; coordinates are asked for as needed.
* Grids of at most `MAX_POINTS` points: a count that lies would take the memory.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from airswing.reference.grib.fields import GarbageError, Window
from airswing.reference.grib.gridsections import MAX_POINTS
from airswing.reference.grib.messages import whole_messages
from airswing.reference.grib.single_fields import single_fields
from airswing.reference.packing.decoder import KeyValue, array_beside, decode_beside, keys_beside
from airswing.reference.packing.decoder_process import ABSENT
from airswing.reference.packing.simple_packing import UnreadableMessageError

_PLACES = ("latitudes", "longitudes", "distinctLatitudes", "distinctLongitudes")
Skipped = Counter[tuple[str, str]]


class GribField(Mapping[str, object]):
    """One field: the keys of its header, its coordinates and its values.

    Parameters
    ----------
    place : (int, int, int, int)
        Offset, length and edition of its message, and its number in it.
    keys : dict
        What is known already.
    grid : bytes
        Octets of its grid section.
    """

    def __init__(
        self, path: str, place: tuple[int, int, int, int], keys: dict[str, KeyValue], grid: bytes
    ) -> None:
        self.path, self.place, self.grid = path, place, grid
        self._keys = keys

    def __getitem__(self, name: str) -> KeyValue | NDArray[np.float64]:
        if name == "values":
            return self._values()
        if name in _PLACES:
            return self._asked(name)
        if name not in self._keys:
            self._keys[name] = keys_beside(self._message(), [name]).get(name)
        if self._keys[name] is None:
            raise KeyError(name)
        return self._keys[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def edition(self) -> int:
        """Edition of GRIB."""
        return self.place[2]

    def _message(self) -> bytes:
        start, length, edition, number = self.place
        with open(self.path, "rb") as file:
            message = os.pread(file.fileno(), length, start)
        try:
            return [single for single, _ in single_fields(message, edition)][number]
        except (GarbageError, LookupError) as error:
            # the file was written anew since: what stands at the place is another message or none
            raise UnreadableMessageError("not the message the catalogue saw") from error

    def _asked(self, name: str) -> NDArray[np.float64]:
        return array_beside(self._message(), name, _points(self._keys))

    def _values(self) -> NDArray[np.float64]:
        from cfgrib.messages import MISSING_VAUE_INDICATOR

        values = decode_beside(self._message(), _points(self._keys))
        values[values == ABSENT] = MISSING_VAUE_INDICATOR
        return values


def fields_of(
    path: str, wanted: Callable[[Mapping[str, object]], bool], skipped: Skipped
) -> dict[int, GribField]:
    """Fields of a file by their number.

    Parameters
    ----------
    wanted : function of (dict) to bool
        Whether a field is needed, by its header keys.
    skipped : Counter
        Takes what cannot be read, by reason.
    """
    names = _header_keys()
    found: dict[int, GribField] = {}
    descriptor = os.open(path, os.O_RDONLY)
    try:
        for start, edition, length in whole_messages(Window(descriptor), skipped):
            message = os.pread(descriptor, length, start)
            try:
                for number, (single, sections) in enumerate(single_fields(message, edition)):
                    keys = keys_beside(single, names)
                    # ecCodes gives every message a name, be it unknown: one
                    # without was not read.
                    if "shortName" not in keys:
                        raise UnreadableMessageError("garbage: nothing says what it is")
                    if wanted(keys) and _is_possible(keys):
                        place = (start, length, edition, number)
                        grid = sections.get(2 if edition == 1 else 3, b"")
                        found[len(found)] = GribField(path, place, keys, grid)
            except (GarbageError, IndexError):
                skipped["message", "garbage: section lengths do not add up"] += 1
            except UnreadableMessageError as reason:
                skipped["message", str(reason)] += 1
    finally:
        os.close(descriptor)
    return found


def _points(keys: Mapping[str, KeyValue]) -> int:
    points = keys.get("numberOfPoints")
    return points if isinstance(points, int) else 0


def _is_possible(keys: Mapping[str, KeyValue]) -> bool:
    """Whether a grid can be; counted where not."""
    points = _points(keys)
    if not 0 < points <= MAX_POINTS:
        raise UnreadableMessageError(f"damaged: a grid of {points:,} points")
    return True


def _header_keys() -> list[str]:
    from cfgrib import dataset

    names = {*dataset.INDEX_KEYS, *dataset.EXTRA_DATA_ATTRIBUTES_KEYS, *dataset.DATA_TIME_KEYS}
    return sorted(
        names | {"shortName", "stepType", "typeOfLevel", "pv", "Nx", "Ny", "time", "step"}
    )
