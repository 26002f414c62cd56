"""The process that opens NetCDF-4 files which the library may not survive.

Run as a script by `airswing.products.openable`: reads a path a line from standard input, opens the
file, looks at every variable's description, and answers with a line of JSON: an empty text, or
what is wrong. It imports nothing of this package. A file that the library never ends on is ended
by the alarm's signal.
"""

from __future__ import annotations

import contextlib
import json
import signal
import sys

# The library may never come back from a damaged file.
SECONDS = 15


def look_at(group: object) -> None:
    """Touch the description of everything in a group."""
    for variable in group.variables.values():  # type: ignore[attr-defined]
        _ = (variable.shape, variable.dtype, variable.chunking(), variable.filters())
        for name in variable.ncattrs():
            variable.getncattr(name)
    for name in group.ncattrs():  # type: ignore[attr-defined]
        group.getncattr(name)  # type: ignore[attr-defined]
    for inner in group.groups.values():  # type: ignore[attr-defined]
        look_at(inner)


def main() -> None:
    """Answer until there are no more paths."""
    import netCDF4

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    for line in sys.stdin:
        if hasattr(signal, "alarm"):
            signal.alarm(SECONDS)
        wrong = ""
        try:
            with netCDF4.Dataset(json.loads(line)) as file:
                look_at(file)
        except Exception as error:
            # whatever a library raises of a damaged file is an answer; the process is there to take
            # it
            wrong = f"{type(error).__name__}: {error}"[:300] or "unreadable"
        if hasattr(signal, "alarm"):
            signal.alarm(0)
        with contextlib.suppress(BrokenPipeError):
            print(json.dumps(wrong), flush=True)


if __name__ == "__main__":
    main()
