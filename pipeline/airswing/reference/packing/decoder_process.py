"""The process that decodes what ecCodes may not survive, for `airswing.reference.packing.decoder`.

Run as a script, it reads requests from standard input and answers on standard output until the
input ends, which it does when the process that started it does, however that ends. It imports
nothing of this package, so that it starts quickly.

A request is :data:`REQUEST` (octets of the message, wanted points, points of the grid, seconds
allowed), the message and the points (int64). An answer is :data:`ANSWER` (0 or 1, octets that
follow, processor seconds used so far) and float64 values, or a text that says why there are none.
"""

from __future__ import annotations

import contextlib
import signal
import struct
import sys
import time

REQUEST = struct.Struct("<qqqq")
ANSWER = struct.Struct("<qqd")
ABSENT = 1e300
"""What ecCodes is asked to put where a point is missing; no field holds it."""
_MEMORY = 2 << 30
_PER_POINT = 96
"""Octets of memory allowed beside `_MEMORY` for each point of the grid."""


def serve() -> None:
    """Answer requests until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    given, answers = sys.stdin.buffer, sys.stdout.buffer
    while len(head := given.read(REQUEST.size)) == REQUEST.size:
        octets, wanted, size, seconds = REQUEST.unpack(head)
        message, points = given.read(octets), given.read(8 * wanted)
        if len(message) + len(points) < octets + 8 * wanted:
            return
        _limit(size, seconds)
        try:
            status, answer = 0, decoded(message, points, size)
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
        int64 places in the message's list of values.
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
    return values[np.frombuffer(points, dtype=np.int64)].tobytes()


if __name__ == "__main__":
    serve()
