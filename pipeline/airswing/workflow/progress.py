"""Progress, messages and accounts on standard error, so that standard output carries results alone.

Assumes one run at a time in a process. Quiet mode says nothing but errors. The remaining time is
what the stage under way needs at the rate of its finished tasks, plus what the later stages are
expected to take (:func:`airswing.workflow.cost.stage_seconds`), scaled by how the expectation held
so far.
"""

from __future__ import annotations

import contextlib
import ctypes
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sized
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypedDict

from dask.callbacks import Callback

if TYPE_CHECKING:
    from distributed import Client, Scheduler
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

# Seconds between two looks at how far the tasks are.
_REFRESH = 0.5


@dataclass
class StageRecord:
    """What one stage cost."""

    name: str
    seconds: float  # wall time
    note: str = ""  # what it did, in a few words
    # octets, messages, reports: bytes read, messages decoded, reports matched or handled
    octets: int = 0
    messages: int = 0
    reports: int = 0
    decoding: float = 0.0  # time spent reading and decoding messages, summed over threads, s
    tasks: int = 0  # tasks foreseen, where they are handed over in portions
    phase: str = ""  # what is under way inside the stage, and the fraction of it that is done
    # processor time of each phase that is over, s
    phases: dict[str, float] = field(default_factory=dict)
    _began: tuple[str, float] = ("", 0.0)

    def tell(self, phase: str, done: float) -> None:
        """Take down what is under way; the time since the last call is the phase's before.

        Parameters
        ----------
        phase : str
            Empty at the end.
        done : float
            Fraction of it.
        """
        before, since = self._began
        now = time.process_time()
        if before:
            self.phases[before] = self.phases.get(before, 0.0) + now - since
        self._began = phase, now
        self.phase = f"{phase} {done:.0%}" if done else phase

    def account(self) -> StageAccount:
        """What is kept of a stage that is over."""
        return {
            "name": self.name,
            "seconds": self.seconds,
            "note": self.note,
            "octets": self.octets,
            "messages": self.messages,
            "reports": self.reports,
            "decoding": self.decoding,
            "tasks": self.tasks,
            "phases": dict(self.phases),
        }


class StageAccount(TypedDict):
    """What is kept of a stage that is over, as :class:`StageRecord` has it."""

    name: str
    seconds: float
    note: str
    octets: int
    messages: int
    reports: int
    decoding: float
    tasks: int
    phases: dict[str, float]


class Accounts(TypedDict):
    """What a run cost; times in seconds."""

    seconds: float
    threads: int
    decoding_seconds: float
    decoding_share: float
    stages: list[StageAccount]


@dataclass
class Tasks:
    """How many of the tasks under way are done."""

    done: int = 0
    total: int = 0


@dataclass
class Progress:
    """Tells a person how far the work is, and keeps what each stage cost."""

    quiet: bool = False  # say nothing
    records: list[StageRecord] = field(default_factory=list)  # one for each finished stage
    threads: int = 1  # threads that work at a time, on all workers
    # what each stage is expected to take, s; empty before anything is known
    expected: Mapping[str, float] = field(default_factory=dict)

    def say(self, text: str) -> None:
        """Print one line to standard error, unless quiet."""
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
            Set its ``note`` to say what the stage did, and its counts.
        """
        record, began = StageRecord(name, 0.0), time.perf_counter()
        with self._bar(record):
            yield record
        record.seconds = time.perf_counter() - began
        record.tell("", 0.0)
        _release_memory()
        self.records.append(record)
        self.say(f"{name:<18} {record.seconds:7.1f} s  {record.note}")
        if record.phases:
            parts = (f"{phase} {seconds:.1f} s" for phase, seconds in record.phases.items())
            self.say(f"  processor time: {', '.join(parts)}")

    def remaining(self, name: str, elapsed: float, tasks: Tasks) -> float | None:
        """Estimate what is left of the whole run.

        Parameters
        ----------
        elapsed : float
            Seconds since its start.

        Returns
        -------
        float or None
            Seconds; None while nothing is known.
        """
        own = self.expected.get(name)
        if tasks.done:
            left = elapsed * (tasks.total - tasks.done) / tasks.done
        elif own is not None:
            left = max(own - elapsed, 0.0)
        else:
            return None
        past = {record.name: record.seconds for record in self.records}
        foreseen = sum(self.expected[stage] for stage in past if stage in self.expected)
        spent = sum(seconds for stage, seconds in past.items() if stage in self.expected)
        scale = spent / foreseen if foreseen else 1.0
        later = [stage for stage in self.expected if stage not in past and stage != name]
        return left + scale * sum(self.expected[stage] for stage in later)

    def accounts(self) -> Accounts:
        """What the run cost so far.

        Returns
        -------
        Accounts
            ``seconds``, ``threads``, ``decoding_seconds`` (summed over threads),
            ``decoding_share`` of the time those threads had, and ``stages``.
        """
        seconds = sum(record.seconds for record in self.records)
        decoding = sum(record.decoding for record in self.records)
        return {
            "seconds": seconds,
            "threads": self.threads,
            "decoding_seconds": decoding,
            "decoding_share": decoding / (seconds * self.threads) if seconds else 0.0,
            "stages": [record.account() for record in self.records],
        }

    def accounts_text(self) -> str:
        """The accounts as a table for a terminal."""
        found = self.accounts()
        lines = ["stage              time (s)  share   MB read  messages     reports"]
        for stage in found["stages"]:
            counts = (stage["octets"] / 1e6, stage["messages"], stage["reports"])
            shown = [
                f"{n:,.1f}" if n and i == 0 else f"{n:,}" if n else "" for i, n in enumerate(counts)
            ]
            share = stage["seconds"] / found["seconds"] if found["seconds"] else 0.0
            lines.append(
                f"{stage['name']:<18} {stage['seconds']:8.1f} {share:6.1%} "
                f"{shown[0]:>9} {shown[1]:>9} {shown[2]:>11}"
            )
        lines.append(
            f"{'together':<18} {found['seconds']:8.1f}         decoding "
            f"{found['decoding_seconds']:,.1f} s on {self.threads} threads: "
            f"{found['decoding_share']:.1%} of the wall time"
        )
        return "\n".join(lines)

    @contextlib.contextmanager
    def _bar(self, record: StageRecord) -> Iterator[None]:
        console = _console()
        if self.quiet or not console.is_terminal:
            yield
            return
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        columns = (
            TextColumn("{task.description:<18}"),
            BarColumn(),
            TextColumn("{task.fields[tasks]}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
        )
        with Bar(*columns, console=console, transient=True) as bar:
            task = bar.add_task(record.name, total=None, tasks="", left="")
            with follow_tasks() as tasks, _repeated(lambda: self._show(bar, task, record, tasks)):
                yield

    def _show(self, bar: Bar, task: TaskID, record: StageRecord, tasks: Tasks) -> None:
        tasks = Tasks(tasks.done, max(tasks.total, record.tasks))
        left = self.remaining(record.name, bar.tasks[0].elapsed or 0.0, tasks)
        bar.update(
            task,
            description=f"{record.name}: {record.phase}" if record.phase else record.name,
            completed=tasks.done,
            total=tasks.total or None,
            tasks=f"{tasks.done:,}/{tasks.total:,}" if tasks.total else "",
            left=""
            if left is None
            else f"about {left / 60:.0f} min left in all"
            if left > 90
            else f"about {left:.0f} s left in all",
        )


def _release_memory() -> None:
    """Give memory that is free again back to the system, where the libraries can (glibc, Arrow).

    They keep it otherwise, and what one stage left in pieces adds to the next one's peak: Arrow
    100 MB for the rest of a run after reading Parquet files of a million reports.
    """
    if "pyarrow" in sys.modules:
        sys.modules["pyarrow"].default_memory_pool().release_unused()
    # only glibc has it
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


@contextlib.contextmanager
def follow_tasks() -> Iterator[Tasks]:
    """Count the dask tasks run inside the block, wherever they run.

    Yields
    ------
    Tasks
        Kept up to date by local schedulers' calls, or by asking a distributed scheduler.
    """
    tasks, client = Tasks(), _client()
    if client is None:
        with _FollowTasks(tasks):
            yield tasks
        return
    with _repeated(lambda: _ask(client, tasks)):
        yield tasks


class _FollowTasks(Callback):
    """Counts as dask's local schedulers finish tasks; graphs run in turn add up."""

    def __init__(self, tasks: Tasks) -> None:
        self._tasks = tasks
        super().__init__(start_state=self._begin, posttask=self._finished)

    def _begin(self, dsk: object, state: Mapping[str, Sized]) -> None:
        self._tasks.total += len(state["ready"]) + len(state["waiting"])

    def _finished(
        self, key: object, result: object, dsk: object, state: object, worker_id: object
    ) -> None:
        self._tasks.done += 1


def _client() -> Client | None:
    """Client of a distributed scheduler, where one is in use."""
    if "distributed" not in sys.modules:
        return None
    from distributed import default_client

    try:
        found: Client = default_client()
    except ValueError:
        return None
    return found


def _ask(client: Client, tasks: Tasks) -> None:
    done, total = client.run_on_scheduler(count_tasks)
    # The scheduler forgets tasks whose results nobody waits for any more: no count goes back.
    tasks.done, tasks.total = max(done, tasks.done), max(total, tasks.total)


def count_tasks(dask_scheduler: Scheduler) -> tuple[int, int]:
    """Tasks a scheduler finished and tasks it knows; runs on the scheduler."""
    states = [task.state for task in dask_scheduler.tasks.values()]
    return sum(state in ("memory", "erred") for state in states), len(states)


@contextlib.contextmanager
def _repeated(act: Callable[[], object]) -> Iterator[None]:
    """Act every so often, from another thread, while the block runs; a failed act is let go."""
    ended = threading.Event()

    def loop() -> None:
        while not ended.wait(_REFRESH):
            # it draws a line of progress: no job ends for that
            with contextlib.suppress(Exception):
                act()

    # daemon: it must not keep an interrupted job alive
    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(timeout=5.0)


def _console() -> Console:
    from rich.console import Console

    return Console(stderr=True)
