"""The process that decodes what ecCodes may not survive, for `airswing.reference.packing.decoder`.

Run as a script, it reads requests from standard input and answers on standard output until the
input ends, which it does when the process that started it does, however that ends. It imports
nothing of this package, so that it starts quickly.

A request is :data:`REQUEST` (number of the job, octets of the message, octets of what is asked of
it, points of the grid, seconds allowed), the message and what is asked. An answer is
:data:`ANSWER` (0 or 1, octets that follow, processor seconds used so far) and the job's octets, or
a text that says why there are none. Jobs: values at points (int64 places; float64 values), the
values of keys (JSON both ways), one key as an array (its name; float64), and whether a BUFR message
can be unpacked (nothing asked, nothing answered; its expansion is only tried here).
"""

from __future__ import annotations

import contextlib
import json
import signal
import struct
import sys
import time
from typing import Any

REQUEST = struct.Struct("<qqqqq")
ANSWER = struct.Struct("<qqd")
ABSENT = 1e300
"""What ecCodes is asked to put where a point is missing; no field holds it."""
VALUES, KEYS, ARRAY, UNPACK = range(4)
_TYPES = {"": None, "int": int, "float": float, "str": str}
_MEMORY = 2 << 30
_PER_POINT = 96
"""Octets of memory allowed beside `_MEMORY` for each point of the grid."""


def serve() -> None:
    """Answer requests until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    given, answers = sys.stdin.buffer, sys.stdout.buffer
    while len(head := given.read(REQUEST.size)) == REQUEST.size:
        job, octets, more, size, seconds = REQUEST.unpack(head)
        message, asked = given.read(octets), given.read(more)
        if len(message) + len(asked) < octets + more:
            return
        _limit(size, seconds)
        try:
            status, answer = 0, JOBS[job](message, asked, size)
        except Exception as error:
            status, answer = 1, f"{type(error).__name__}: {error}"[:300].encode()
        _limit(size, 0)
        answers.write(ANSWER.pack(status, len(answer), time.process_time()))
        answers.write(answer)
        answers.flush()


def _limit(size: int, seconds: int) -> None:
    """Bound time and memory; a decoder that never ends is ended by the alarm's signal."""
    if not hasattr(signal, "alarm"):
        return
    import resource

    signal.alarm(seconds)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = _MEMORY + _PER_POINT * size
    if hard != resource.RLIM_INFINITY:
        most = min(most, hard)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def decoded(message: bytes, points: bytes, size: int) -> bytes:
    """Values of a message at some points.

    Parameters
    ----------
    message : bytes
    points : bytes
        int64 places in the message's list of values; all where empty.
    size : int
        Points of its grid.

    Returns
    -------
    bytes
        float64 values.
    """
    import eccodes
    import numpy as np

    handle = eccodes.codes_new_from_message(message)
    try:
        eccodes.codes_set(handle, "missingValue", ABSENT)
        if (stated := eccodes.codes_get_size(handle, "values")) != size:
            raise ValueError(f"{stated} values on a grid of {size} points")
        values = np.asarray(eccodes.codes_get_values(handle), dtype=np.float64)
    finally:
        eccodes.codes_release(handle)
    if values.size != size:
        raise ValueError(f"{values.size} values on a grid of {size} points")
    return (values[np.frombuffer(points, dtype=np.int64)] if points else values).tobytes()


def keys_of(message: bytes, asked: bytes, size: int) -> bytes:
    """Values of some keys of a message, JSON; those it has not are left out.

    Parameters
    ----------
    message : bytes
    asked : bytes
        JSON list of names, each with a type after a colon where not the key's own is wanted.
    size : int
        Of no meaning.

    Returns
    -------
    bytes
        JSON.
    """
    import eccodes

    handle = eccodes.codes_new_from_message(message)
    try:
        found = {}
        for name in json.loads(asked):
            with contextlib.suppress(eccodes.CodesInternalError, ValueError, TypeError):
                found[name] = _value(eccodes, handle, name)
    finally:
        eccodes.codes_release(handle)
    return json.dumps(found).encode()


def _value(eccodes: Any, handle: int, name: str) -> Any:
    key, _, kind = name.partition(":")
    if eccodes.codes_get_size(handle, key) > 1:
        return [float(value) for value in eccodes.codes_get_array(handle, key, _TYPES[kind])]
    return eccodes.codes_get(handle, key, _TYPES[kind])


def array_of(message: bytes, asked: bytes, size: int) -> bytes:
    """A key of a message as an array.

    Parameters
    ----------
    message, asked : bytes
        The message, the name of the key.
    size : int
        Of no meaning.

    Returns
    -------
    bytes
        float64 values.
    """
    import eccodes
    import numpy as np

    handle = eccodes.codes_new_from_message(message)
    try:
        return np.asarray(eccodes.codes_get_array(handle, asked.decode(), float)).tobytes()
    finally:
        eccodes.codes_release(handle)


def unpacked(message: bytes, asked: bytes, size: int) -> bytes:
    """Unpack a BUFR message, by its own tables or by current ones, and ask for all it holds.

    Parameters
    ----------
    message, asked : bytes
        The message; numbers of current master and local tables, and of the oldest master table
        that is at hand, JSON.
    size : int
        Of no meaning.

    Returns
    -------
    bytes
        None.
    """
    import eccodes

    *current, oldest = json.loads(asked)
    for tables in (None, current):
        handle = eccodes.codes_new_from_message(message)
        try:
            if tables is not None:
                eccodes.codes_set(handle, "masterTablesVersionNumber", tables[0])
                eccodes.codes_set(handle, "localTablesVersionNumber", tables[1])
            eccodes.codes_set(handle, "unpack", 1)
            keys = eccodes.codes_bufr_keys_iterator_new(handle)
            while eccodes.codes_bufr_keys_iterator_next(keys):
                pass
            eccodes.codes_bufr_keys_iterator_delete(keys)
            if eccodes.codes_get(handle, "masterTablesVersionNumber") >= oldest:
                break  # as in the process that asks: current tables are for what fails, or is older
        except eccodes.CodesInternalError:
            if tables is not None:
                raise
        finally:
            eccodes.codes_release(handle)
    return b""


JOBS = {VALUES: decoded, KEYS: keys_of, ARRAY: array_of, UNPACK: unpacked}

if __name__ == "__main__":
    serve()
