"""Progress and messages on standard error, so that standard output carries results alone.

Assumes one run at a time in a process. Quiet mode says nothing but errors.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from dask.callbacks import Callback


@dataclass
class StageRecord:
    """What one stage cost.

    Parameters
    ----------
    name : str
    seconds : float
        Wall time.
    note : str
        What it did, in a few words.
    """

    name: str
    seconds: float
    note: str = ""


@dataclass
class Progress:
    """Tells a person how far the work is, and keeps what each stage cost.

    Parameters
    ----------
    quiet : bool, default False
        Say nothing.
    """

    quiet: bool = False
    records: list[StageRecord] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Print one line to standard error, unless quiet.

        Parameters
        ----------
        text : str
        """
        if not self.quiet:
            _console().print(text, highlight=False, markup=False, soft_wrap=True)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[StageRecord]:
        """Time a stage, with a bar that follows the dask tasks run inside it.

        Parameters
        ----------
        name : str
            What a person reads beside the bar.

        Yields
        ------
        StageRecord
            Set its ``note`` to say what the stage did.
        """
        record, began = StageRecord(name, 0.0), time.perf_counter()
        with self._bar(name):
            yield record
        record.seconds = time.perf_counter() - began
        self.records.append(record)
        self.say(f"{name:<12} {record.seconds:7.1f} s  {record.note}")

    @contextlib.contextmanager
    def _bar(self, name: str) -> Iterator[None]:
        if self.quiet:
            yield
            return
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        console = _console()
        with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task(name, total=None)
            with _FollowTasks(bar, task):
                yield


class _FollowTasks(Callback):
    """Moves a bar as dask's local schedulers finish tasks; graphs run in turn add up."""

    def __init__(self, bar: Any, task: Any) -> None:
        self._bar, self._task, self._total = bar, task, 0
        super().__init__(start_state=self._begin, posttask=self._finished)

    def _begin(self, dsk: Any, state: Any) -> None:
        self._total += len(state["ready"]) + len(state["waiting"])
        self._bar.update(self._task, total=self._total)

    def _finished(self, key: Any, result: Any, dsk: Any, state: Any, worker_id: Any) -> None:
        self._bar.advance(self._task)


def _console() -> Any:
    from rich.console import Console

    return Console(stderr=True)
