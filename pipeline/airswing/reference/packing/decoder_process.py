"""The process that decodes what ecCodes may not survive, for `airswing.reference.packing.decoder`.

Run as a script, it reads requests from standard input and answers on standard output until the
input ends, which it does when the process that started it does, however that ends. It imports
nothing of this package, so that it starts quickly.

A request is :data:`REQUEST` (number of the job, octets of the message, octets of what is asked of
it, points of the grid, seconds allowed), the message and what is asked. An answer is
:data:`ANSWER` (0 or 1, octets that follow, processor seconds used so far) and the job's octets, or
a text that says why there are none. Jobs: values at points (int64 places; float64 values), the
values of keys (JSON both ways), one key as an array (its name; float64), and the reports of BUFR
messages (JSON both ways).
"""

from __future__ import annotations

import contextlib
import json
import signal
import struct
import sys
import time
from collections.abc import Iterator
from types import ModuleType

REQUEST = struct.Struct("<qqqqq")
ANSWER = struct.Struct("<qqd")
ABSENT = 1e300
"""What ecCodes is asked to put where a point is missing; no field holds it."""
VALUES, KEYS, ARRAY, REPORTS = range(4)
_TYPES = {"": None, "int": int, "float": float, "str": str}
# Octets for the libraries themselves; a lying message asks for far more and is refused.
_MEMORY = 2 << 30
_PER_POINT = 96  # Octets of memory allowed beside `_MEMORY` for each point of the grid


def _serve() -> None:
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
        # A decoder that dies is expected: no core file.
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _decoded(message: bytes, points: bytes, size: int) -> bytes:
    """Values (float64) of a message at some points (int64 places), or all where none are given."""
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


def _keys_of(message: bytes, asked: bytes, size: int) -> bytes:
    """Values of some keys of a message, JSON both ways; those it has not are left out.

    Names have a type after a colon where not the key's own is wanted.
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


def _value(eccodes: ModuleType, handle: int, name: str) -> object:
    key, _, kind = name.partition(":")
    if eccodes.codes_get_size(handle, key) > 1:
        return [float(value) for value in eccodes.codes_get_array(handle, key, _TYPES[kind])]
    return eccodes.codes_get(handle, key, _TYPES[kind])


def _array_of(message: bytes, asked: bytes, size: int) -> bytes:
    """A key of a message as an array of float64."""
    import eccodes
    import numpy as np

    handle = eccodes.codes_new_from_message(message)
    try:
        return np.asarray(eccodes.codes_get_array(handle, asked.decode(), float)).tobytes()
    finally:
        eccodes.codes_release(handle)


def _reports_of(messages: bytes, asked: bytes, size: int) -> bytes:
    """Reports of BUFR messages by pdbufr, each unpacked by its own tables or by current ones.

    Asked for are the columns wanted, numbers of current master and local tables, and of the
    oldest master table that is at hand; the answer is a list of reports and how many messages
    gave none, JSON both ways.
    """
    import pdbufr

    columns, *tables, oldest = json.loads(asked)
    failed: list[int] = []
    found = pdbufr.read_bufr(
        _unpackable(messages, tables, oldest, failed), columns=columns, required_columns=False
    )
    return json.dumps([found.to_dict("records"), len(failed)]).encode()


def _unpackable(
    messages: bytes, tables: list[int], oldest: int, failed: list[int]
) -> Iterator[object]:
    """Messages as pdbufr takes them; places of those that no tables unpack go into `failed`."""
    import eccodes
    from pdbufr.high_level_bufr.bufr import BufrMessage

    at = 0
    while at < len(messages):
        length = int.from_bytes(messages[at + 4 : at + 7], "big")
        for current in (False, True):
            # Its own constructor reads from a file.
            message = object.__new__(BufrMessage)
            message.codes_file = None
            message.codes_id = eccodes.codes_new_from_message(messages[at : at + length])
            try:
                if current or message["masterTablesVersionNumber"] < oldest:
                    message["masterTablesVersionNumber"] = tables[0]
                    message["localTablesVersionNumber"] = tables[1]
                message["skipExtraKeyAttributes"] = 1
                message["unpack"] = 1
            except Exception:  # eccodes raises many kinds, and a failed decoding stays one
                eccodes.codes_release(message.codes_id)
                continue
            yield message
            break
        else:
            failed.append(at)
        at += length


JOBS = {VALUES: _decoded, KEYS: _keys_of, ARRAY: _array_of, REPORTS: _reports_of}

if __name__ == "__main__":
    _serve()
