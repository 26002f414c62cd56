"""Progress, messages and accounts on standard error; only results go to standard output.

Assumes one run at a time in a process. Quiet mode prints errors only.
"""

from __future__ import annotations

import contextlib
import ctypes
import sys
import time
from collections.abc import Iterator, Mapping, Sized
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from dask.callbacks import Callback

if TYPE_CHECKING:
    from rich.console import Console


@dataclass
class StageRecord:
    """Work and cost of one stage."""

    name: str
    seconds: float = 0.0  # wall time
    note: str = ""  # result in a few words
    bytes_read: int = 0
    messages: int = 0  # decoded
    reports: int = 0  # matched or handled
    decoding: float = 0.0  # time spent reading and decoding messages, summed over threads, s

    def __post_init__(self) -> None:
        self.title = self.name  # shown at the bar

    def enter(self, phase: str) -> None:
        """Show the current part of the stage."""
        self.title = f"{self.name}: {phase}"


@dataclass
class Progress:
    """Shows the progress of the work, and records the cost of each stage."""

    quiet: bool = False
    records: list[StageRecord] = field(default_factory=list)  # of the finished stages
    threads: int = 1  # working at a time, on all workers

    def say(self, text: str) -> None:
        """Print one line to standard error, unless quiet."""
        if not self.quiet:
            _console().print(text, highlight=False, markup=False, soft_wrap=True)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[StageRecord]:
        """Time a stage, with a bar that follows the dask tasks run inside it.

        The block sets the ``note`` of the record to its result, and its counts.
        """
        record, began = StageRecord(name), time.perf_counter()
        with self._bar(record):
            yield record
        record.seconds = time.perf_counter() - began
        _release_memory()
        self.records.append(record)
        self.say(f"{name:<18} {record.seconds:7.1f} s  {record.note}")

    def accounts(self) -> dict[str, Any]:
        """Cost of the run so far, times in seconds.

        ``decoding_seconds`` are summed over threads, ``decoding_share`` is of the time these had;
        ``stages`` has the records.
        """
        seconds = sum(record.seconds for record in self.records)
        decoding = sum(record.decoding for record in self.records)
        return {
            "seconds": seconds,
            "threads": self.threads,
            "decoding_seconds": decoding,
            "decoding_share": decoding / (seconds * self.threads) if seconds else 0.0,
            "stages": [asdict(record) for record in self.records],
        }

    def accounts_text(self) -> str:
        """The accounts of all stages together, in a line like that of a stage."""
        found = self.accounts()
        return (
            f"{'together':<18} {found['seconds']:7.1f} s  decoding "
            f"{found['decoding_seconds']:,.1f} s on {self.threads} threads: "
            f"{found['decoding_share']:.1%} of the wall time"
        )

    @contextlib.contextmanager
    def _bar(self, record: StageRecord) -> Iterator[None]:
        console = _console()
        if self.quiet or not console.is_terminal:
            yield
            return
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        title = TextColumn("{task.fields[record].title:<18}")  # newly formatted at each refresh
        columns = (title, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bar(*columns, console=console, transient=True) as bar:
            number = bar.add_task(record.name, total=None, record=record)

            def begun(_graph: object, state: Mapping[str, Sized]) -> None:
                more = len(state["ready"]) + len(state["waiting"])
                bar.update(number, total=(bar.tasks[number].total or 0) + more)  # graphs add up

            with Callback(start_state=begun, posttask=lambda *_: bar.advance(number)):
                yield


def _release_memory() -> None:
    """Return free memory that libraries keep (HDF5, glibc, Arrow) to the system.

    HDF5 keeps chunks of every variable that was read of an open file, 1 GB for a year of months;
    xarray opens files again when they are read. Arrow keeps 100 MB for the rest of a run after
    reading Parquet files of a million reports.
    """
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
