"""Progress and messages on standard error; only results go to standard output.

Assumes one run at a time in a process. Quiet mode prints errors only.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import sys
import time
from collections.abc import Iterator, Mapping, Sized
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dask.callbacks import Callback

if TYPE_CHECKING:
    from rich.console import Console


@dataclass
class StageRecord:
    """One stage while it runs."""

    name: str
    note: str = ""  # result in a few words
    phase: str = ""  # current part, shown at the bar

    def enter(self, phase: str) -> None:
        """Show the current part of the stage."""
        self.phase = f": {phase}"


@dataclass
class Progress:
    """Shows the progress of the work, and the time and result of each stage."""

    quiet: bool = False

    def say(self, text: str) -> None:
        """Print one line to standard error, unless quiet."""
        if not self.quiet:
            _console().print(text, highlight=False, markup=False, soft_wrap=True)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[StageRecord]:
        """Time a stage, with a bar that follows the dask tasks run inside it.

        The block sets the ``note`` of the record to its result.
        """
        record, began = StageRecord(name), time.perf_counter()
        with self._bar(record):
            yield record
        seconds = time.perf_counter() - began
        _release_memory()
        self.say(f"{name:<18} {seconds:7.1f} s  {record.note}")

    @contextlib.contextmanager
    def _bar(self, record: StageRecord) -> Iterator[None]:
        console = _console()
        if self.quiet or not console.is_terminal:
            yield
            return
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        # newly formatted at each refresh
        title = TextColumn("{task.fields[record].name}{task.fields[record].phase}")
        columns = (title, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bar(*columns, console=console, transient=True) as bar:
            number = bar.add_task(record.name, total=None, record=record)

            def begun(_graph: object, state: Mapping[str, Sized]) -> None:
                more = len(state["ready"]) + len(state["waiting"])
                bar.update(number, total=(bar.tasks[number].total or 0) + more)  # graphs add up

            with Callback(start_state=begun, posttask=lambda *_: bar.advance(number)):
                yield


def _release_memory() -> None:
    """Return free memory that libraries keep (HDF5, glibc, Arrow, matplotlib) to the system.

    HDF5 keeps chunks of every variable that was read of an open file, 1 GB for a year of months;
    xarray opens files again when they are read. Arrow keeps 100 MB for the rest of a run after
    reading Parquet files of a million reports. Figures refer to themselves: only the collector
    frees their points, 500 MB for the cards of 60 aircraft.
    """
    gc.collect()
    if "xarray.backends.file_manager" in sys.modules:
        files = sys.modules["xarray.backends.file_manager"].FILE_CACHE
        while files:
            files.popitem()[1].close()
    if "pyarrow" in sys.modules:
        sys.modules["pyarrow"].default_memory_pool().release_unused()
    with contextlib.suppress(OSError, AttributeError):  # only glibc has it
        ctypes.CDLL(None).malloc_trim(0)


def _console() -> Console:
    from rich.console import Console

    return Console(stderr=True)
