"""Whether a NetCDF-4 file can be opened at all, found where its library may hang or die of it.

The HDF5 library follows whatever the octets of a damaged file say: it may never end, or end the
process. A process of its own opens each file first; it is started once, used again, and started
anew where it ended.

Assumptions and validity
------------------------
* What a process that lives on has described without fault, this one can open.
* A file this process wrote itself, and has not been changed since, is sound.
* Data are not read: each packed chunk carries a checksum that the library holds it against.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from airswing.errors import InputError
from airswing.products import netcdf_opener

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_LOCK = threading.Lock()
_SOUND: set[tuple[str, int, int]] = set()
_HELPER: list[subprocess.Popen[str]] = []


def written_here(path: Path) -> None:
    """Note that a file was written by this process, whole."""
    with _LOCK:
        _SOUND.add(_identity(path))


def require_openable(path: Path) -> None:
    """Refuse a NetCDF-4 file that its library cannot open, or would not survive; pass other kinds.

    Raises
    ------
    InputError
        Saying what the process that tried it ended of.
    """
    with path.open("rb") as file:
        if file.read(len(_SIGNATURE)) != _SIGNATURE:
            return
    own = _identity(path)
    with _LOCK:
        if own in _SOUND:
            return
        wrong = _asked(str(path.absolute()))
        if not wrong:
            _SOUND.add(own)
            return
    raise InputError("cannot be opened: a damaged NetCDF file", file=path, found=wrong)


def _identity(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.absolute()), status.st_size, status.st_mtime_ns


def _asked(path: str) -> str:
    """What the helper says of a file; empty where it is sound."""
    if not _HELPER or _HELPER[0].poll() is not None:
        _HELPER[:] = [_started()]
    helper = _HELPER[0]
    assert helper.stdin is not None and helper.stdout is not None
    try:
        helper.stdin.write(json.dumps(path) + "\n")
        helper.stdin.flush()
        answer = helper.stdout.readline()
    except OSError:
        answer = ""
    if answer:
        return str(json.loads(answer))
    ended_by = -helper.wait()
    if ended_by == signal.SIGALRM:
        return "opening it does not end"
    return f"opening it ends the process (signal {ended_by})"


def _started() -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(netcdf_opener.__file__)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        # The helper outlives a run's folders: it must not stand in one that is to be removed.
        cwd=os.path.abspath(os.sep),
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )


def _forget() -> None:
    """Begin without a helper: that of the process this one was forked from is not its own."""
    global _LOCK
    _LOCK = threading.Lock()
    _HELPER.clear()


def _end() -> None:
    for helper in _HELPER:
        helper.kill()
        helper.wait()


atexit.register(_end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
