"""Decoding beside this process: ecCodes ends the process it runs in where an assertion fails.

Messages whose octets do not prove that no assertion can fail (`airswing.reference.grib.values`),
and all of those that only ecCodes understands, are decoded by a process that is started once, used
again, and may die: then the message is tried once more in a new one, and what a new one dies of by
a fault of its own cannot be read.

Assumptions and validity
------------------------
* One process serves one thread at a time; there are as many as threads ever decoded at once. They
  end with this process, however it ends: their input is closed then.
* A death is not always the message's doing: an earlier message may have done harm, the system ends
  processes when memory is short, an operator by hand. Hence the second trial.
* A process made by fork starts decoders of its own.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

from airswing.reference.packing import decoder_process
from airswing.reference.packing.decoder_process import ANSWER, ARRAY, KEYS, REPORTS, REQUEST, VALUES
from airswing.reference.packing.simple_packing import UnreadableMessageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A process may die of what earlier messages left in it: a fresh one tells whether this one did it.
_TRIALS = 2
_FAULTS = (signal.SIGABRT, signal.SIGSEGV, signal.SIGFPE, signal.SIGILL)
# Time a message may take; the slowest packing decodes ten times as many points.
_SECONDS, _POINTS_A_SECOND = 20, 200_000


class _DiedError(Exception):
    """The decoder ended while it was asked: how, and whether the message alone can be blamed."""

    def __init__(self, how: str = "", *, certain: bool = False) -> None:
        super().__init__(how)
        self.certain = certain


class _Decoder:
    """One process that decodes."""

    def __init__(self) -> None:
        self.processor_seconds, self.answers = 0.0, 0
        script = str(Path(str(decoder_process.__file__)))
        try:
            self._process = subprocess.Popen(
                [sys.executable, script],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=os.path.abspath(os.sep),
                env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        except OSError as error:
            raise UnreadableMessageError(f"no process to decode it: {error.strerror}") from error
        self._input = cast(IO[bytes], self._process.stdin)
        self._output = cast(IO[bytes], self._process.stdout)

    def ask(self, job: int, message: bytes, size: int, asked: bytes) -> bytes:
        """Have a job of `decoder_process` done on a message."""
        seconds = _SECONDS + size // _POINTS_A_SECOND
        try:
            self._input.write(REQUEST.pack(job, len(message), len(asked), size, seconds))
            self._input.write(message)
            self._input.write(asked)
            self._input.flush()
            status, octets, used = ANSWER.unpack(self._read(ANSWER.size))
            answer = self._read(octets)
        except (OSError, _DiedError) as error:
            raise self._end() from error
        self.processor_seconds = used
        self.answers += 1
        if status:
            raise UnreadableMessageError(f"not decodable: {answer.decode(errors='replace')}")
        return answer

    def _read(self, octets: int) -> bytes:
        found = self._output.read(octets)
        if len(found) < octets:
            raise _DiedError
        return found

    def _end(self) -> _DiedError:
        """End the process; how it ended."""
        self.close()
        ended_by = -self._process.returncode
        if ended_by == signal.SIGALRM:
            return _DiedError("its decoding does not end", certain=True)
        own_fault = ended_by in _FAULTS and not self.answers
        return _DiedError(f"its decoding ends the decoder (signal {ended_by})", certain=own_fault)

    def close(self) -> None:
        """Let the process end."""
        for pipe in (self._input, self._output):
            with contextlib.suppress(OSError):
                pipe.close()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class _Pool:
    """Decoders that wait for work."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin without any: those of the process this one was forked from are not its own."""
        self._lock, self._idle = threading.Lock(), list[_Decoder]()

    def ask(self, job: int, message: bytes, size: int, asked: bytes) -> bytes:
        """Have a job done, by a second process where the first dies."""
        how = ""
        for trial in range(_TRIALS):
            decoder = self._take() if trial == 0 else _Decoder()
            try:
                answer = decoder.ask(job, message, size, asked)
            except _DiedError as error:
                how = str(error)
                if error.certain:
                    break
                continue
            except UnreadableMessageError:
                self._give_back(decoder)
                raise
            except BaseException:  # interrupted between question and answer
                decoder.close()
                raise
            self._give_back(decoder)
            return answer
        raise UnreadableMessageError(f"not decodable: {how}")

    def _take(self) -> _Decoder:
        with self._lock:
            if self._idle:
                return self._idle.pop()
        return _Decoder()

    def _give_back(self, decoder: _Decoder) -> None:
        with self._lock:
            self._idle.append(decoder)

    def processor_seconds(self) -> float:
        """Processor time of the decoders that wait."""
        with self._lock:
            return sum(decoder.processor_seconds for decoder in self._idle)

    def close(self) -> None:
        """End all that wait."""
        with self._lock:
            idle, self._idle = self._idle, []
        for decoder in idle:
            decoder.close()


_POOL = _Pool()
atexit.register(_POOL.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_POOL.forget)


def decode_beside(message: bytes, size: int, points: Ints | None = None) -> Floats:
    """Values of a message of one field, decoded in another process.

    All (size,), or those at places in its list of values; `decoder_process.ABSENT` where missing.

    Raises
    ------
    UnreadableMessageError
        Where there is none, or the decoder dies of it.
    """
    if points is None:
        return np.frombuffer(_POOL.ask(VALUES, message, size, b""), dtype=np.float64).copy()
    if not points.size:
        return np.empty(points.shape)
    asked = np.ascontiguousarray(points, dtype=np.int64).tobytes()
    values = np.frombuffer(_POOL.ask(VALUES, message, size, asked), dtype=np.float64)
    return values.reshape(points.shape).copy()


KeyValue = int | float | str | list[float] | None  # as JSON brings it


def keys_beside(message: bytes, names: Sequence[str]) -> dict[str, KeyValue]:
    """Values that ecCodes gives keys of a message of one field, without those it has not.

    Names as cfgrib writes them: with ``:int``, ``:float`` or ``:str`` for another type.

    Raises
    ------
    UnreadableMessageError
        Where there is none, or the decoder dies of it.
    """
    found: dict[str, KeyValue] = json.loads(
        _POOL.ask(KEYS, message, 0, json.dumps(list(names)).encode())
    )
    return found


def array_beside(message: bytes, name: str, size: int) -> Floats:
    """A key of a message of one field as an array, such as its latitudes, from another process.

    Raises
    ------
    UnreadableMessageError
        Where there is none, or the decoder dies of it.
    """
    return np.frombuffer(_POOL.ask(ARRAY, message, size, name.encode()), dtype=np.float64)


def reports_beside(
    messages: Sequence[bytes], columns: Sequence[str], tables: tuple[int, int, int]
) -> tuple[list[dict[str, object]], int]:
    """Reports of framed BUFR messages, read by pdbufr in another process; how many give none.

    Where the process does not survive a message it is found by asking for each alone. ``tables``
    are versions of master and local tables to try where a message's own are not known, and the
    oldest master table that is.
    """
    asked = json.dumps([list(columns), *tables]).encode()
    try:
        together = b"".join(messages)
        rows, failed = json.loads(_POOL.ask(REPORTS, together, len(together), asked))
    except UnreadableMessageError:
        if len(messages) == 1:
            return [], 1
        parts = [reports_beside([message], columns, tables) for message in messages]
        return [row for rows, _ in parts for row in rows], sum(failed for _, failed in parts)
    return rows, failed


def processor_seconds() -> float:
    """Processor time the decoders of this process have used, s; for benchmarks."""
    return _POOL.processor_seconds()
