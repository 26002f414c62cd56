"""Decoding beside this process: ecCodes ends the process it runs in where an assertion fails.

Messages whose octets do not prove that no assertion can fail (`airswing.reference.grib.values`) are
decoded by a process that is started once, used again, and may die: then the message is tried once
more in a new one, and what a new one dies of by a fault of its own cannot be read.

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
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

from airswing.reference.packing import decoder_process
from airswing.reference.packing.decoder_process import ANSWER, REQUEST
from airswing.reference.packing.simple_packing import UnreadableMessageError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TRIALS = 2
_FAULTS = (signal.SIGABRT, signal.SIGSEGV, signal.SIGFPE, signal.SIGILL)
_SECONDS, _POINTS_A_SECOND = 20, 200_000
"""Time a message may take; the slowest packing decodes ten times as many points."""


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

    def ask(self, message: bytes, size: int, points: Ints) -> Floats:
        """Have a message decoded."""
        seconds = _SECONDS + size // _POINTS_A_SECOND
        try:
            self._input.write(REQUEST.pack(len(message), points.size, size, seconds))
            self._input.write(message)
            self._input.write(np.ascontiguousarray(points, dtype=np.int64).tobytes())
            self._input.flush()
            status, octets, used = ANSWER.unpack(self._read(ANSWER.size))
            answer = self._read(octets)
        except (OSError, _DiedError) as error:
            raise self._end() from error
        self.processor_seconds = used
        self.answers += 1
        if status:
            raise UnreadableMessageError(f"not decodable: {answer.decode(errors='replace')}")
        return np.frombuffer(answer, dtype=np.float64).reshape(points.shape).copy()

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

    def decode(self, message: bytes, size: int, points: Ints) -> Floats:
        """Have a message decoded, by a second process where the first dies."""
        how = ""
        for trial in range(_TRIALS):
            decoder = self._take() if trial == 0 else _Decoder()
            try:
                values = decoder.ask(message, size, points)
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
            return values
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


def decode_beside(message: bytes, size: int, points: Ints) -> Floats:
    """Values of a message at some points, decoded in another process.

    Parameters
    ----------
    message : bytes
        One field.
    size : int
        Points of its grid.
    points : int array
        Places in the message's list of values.

    Returns
    -------
    values : float array of the shape of `points`
        `decoder_process.ABSENT` at missing points.

    Raises
    ------
    UnreadableMessageError
        Where it cannot be decoded, or the decoder dies of it.
    """
    return _POOL.decode(message, size, points)


def processor_seconds() -> float:
    """Processor time the decoders of this process have used, s; for benchmarks."""
    return _POOL.processor_seconds()
