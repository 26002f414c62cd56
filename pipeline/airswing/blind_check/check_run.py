"""The blind check from end to end: plan, write, seal, diagnose by the public command, open, score.

Assumptions: the diagnosis is ``airswing gap CONFIG --output DIR --quiet`` in a process of its own;
nothing but the archive's configuration (and, for cases with an effect taken out of the catalogue,
``--without NAME``) is handed to it. A check that was interrupted goes on where it stopped: cases
already diagnosed are kept, and the seal decides whether they are of this check.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from airswing.blind_check.scores import BaselineScore, Score
from airswing.gap.result.schema import GapReport
from airswing.products.fingerprint import code_digest
from airswing.products.whole_files import write_json
from airswing.synthetic.sealed.cases import Case, Size, World, plan_cases
from airswing.synthetic.sealed.labels import Label
from airswing.synthetic.sealed.sealed_archives import Archivist
from airswing.synthetic.sealed.sealing import open_seal, seal

__all__ = ["Check", "Plan", "gap_check", "run_public_command"]

Say = Callable[[str], None]
# (configuration, output folder, effects to do without) to the content of gap.json.
Diagnoser = Callable[[Path, Path, Sequence[str]], GapReport]
# Seconds: one diagnosis that hangs must not hold up the check; they take a minute or two.
_TIMEOUT = 1800.0


@dataclass(frozen=True)
class Check:
    """A finished check."""

    digest: str  # published before the first diagnosis
    # labels, scores: truth and score of each case, in the same order
    labels: list[Label]
    scores: list[Score]
    failures: dict[str, str]  # case to the message of a diagnosis that did not end well
    baselines: dict[str, list[BaselineScore]]  # baseline to its scores
    settings: dict[str, object]  # number of cases, seed, size: what repeats it


def run_public_command(config: Path, output: Path, without: Sequence[str]) -> GapReport:
    """Diagnose one archive through the command a user has.

    Parameters
    ----------
    config, output : Path
        Configuration and folder for the products.
    without : sequence of str
        Effects to leave out of the catalogue.

    Raises
    ------
    RuntimeError
        The command failed; its last line of error output is the message.
    """
    command = [sys.executable, "-m", "airswing", "gap", str(config), "--output", str(output)]
    command += ["--quiet", *(part for name in without for part in ("--without", name))]
    # one thread a case: several run beside each other
    settings = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=_TIMEOUT, env=settings, check=False
    )
    if done.returncode != 0:
        last = done.stderr.strip().splitlines() or ["no message"]
        raise RuntimeError(f"exit status {done.returncode}: {last[-1]}")
    return GapReport.read(output / "gap.json")


@dataclass(frozen=True)
class Plan:
    """What is to be checked."""

    # cases, seed: how many; seed of every draw
    cases: int = 60
    seed: int = 1
    fast: bool = False  # small archives and effects of 0.8 and 1.6 m/s
    nulls: int | None = None  # how many of the cases hold nothing; a quarter by default
    rungs: tuple[int, ...] | None = None  # rungs to play; all by default
    names: tuple[str, ...] = ()  # catalogue effects to draw from; all by default
    real: Path | None = None  # folder with real data; rung 5 is left out where it is absent

    @property
    def size(self) -> Size:
        """Size of the archives."""
        return Size.fast() if self.fast else Size()

    @property
    def played(self) -> list[int]:
        """Rungs that can be played."""
        # rung 0 is the generator's own proof, and no case
        rungs = list(self.rungs or (1, 2, 3, 4, 5))
        there = self.real is not None and (self.real / "heading").is_dir()
        return rungs if there else [rung for rung in rungs if rung != 5]

    def settings(self) -> dict[str, object]:
        """Return what repeats the check."""
        return {
            "cases": self.cases,
            "seed": self.seed,
            "fast": self.fast,
            "rungs": self.played,
            "names": list(self.names),
            "days": self.size.days,
            "aircraft": self.size.aircraft,
            "nulls": self.nulls,
            "drawn": _fingerprint(self.drawn()),
        }

    def drawn(self) -> list[Case]:
        """Return the cases."""
        from airswing.blind_check.scoring import draws

        own = {name: how for name, how in draws().items() if not self.names or name in self.names}
        return plan_cases(
            self.cases,
            seed=self.seed,
            size=self.size,
            draws=own,
            rungs=self.played,
            nulls=self.nulls,
        )

    @property
    def command(self) -> str:
        """Return the command line that repeats the check."""
        words = [f"airswing gap-check --cases {self.cases} --seed {self.seed}"]
        words += ["--fast"] * self.fast
        words += [] if self.nulls is None else [f"--nulls {self.nulls}"]
        words += [f"--rung {rung}" for rung in self.rungs or ()]
        words += [] if self.real is None else ["--real DIR"]
        return " ".join(words)


def _fingerprint(cases: Sequence[Case]) -> str:
    """Return what tells these cases from those another version of the code would draw."""
    told = [
        [
            c.name,
            c.kind,
            c.world.seed,
            c.world.kind,
            c.variant,
            c.sizes,
            c.without,
            [part.effects for part in (*c.drawn, *c.instead)],
        ]
        for c in cases
    ]
    # sixteen digits tell plans apart; the seal itself has its whole hash
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]


def gap_check(
    output: Path,
    plan: Plan,
    *,
    workers: int = 1,
    diagnoser: Diagnoser = run_public_command,
    baselines: bool = True,
    so_far: bool = False,
    say: Say = lambda text: None,
) -> Check:
    """Run the blind check.

    Parameters
    ----------
    workers : int
        Archives written and diagnosed at a time.
    diagnoser : callable
        What is checked; the public command by default.
    baselines : bool
        Also run the simple methods beside ours.
    so_far : bool
        Diagnose nothing more: score the cases an earlier call has diagnosed.
    say : callable
        Told what goes on.
    """
    from airswing.blind_check.baselines import run_baselines
    from airswing.blind_check.scoring import score_case

    if 5 not in plan.played:
        say("no real data: rung 5 is left out")
    drawn, settings = plan.drawn(), plan.settings()
    digest = _sealed(output, drawn, settings, plan.real, workers, say)
    if not so_far:
        _of_this_code(output)
    say(f"labels sealed, sha256 {digest}")
    failures = {} if so_far else _diagnose_all(output, drawn, diagnoser, workers, say)
    labels = open_seal(output / "sealed", digest=digest)
    settings |= {"sealed": len(labels)}
    if so_far:
        labels = [label for label in labels if _gap_file(output, label["name"]).exists()]
    say("seals opened, digest verified")
    scores = [
        score_case(
            label,
            _read(output, label["name"]),
            failure=failures.get(label["name"]),
            fleet=plan.size.tails,
        )
        for label in labels
    ]
    beside = run_baselines(output, labels, say=say) if baselines else {}
    check = Check(digest, labels, scores, failures, beside, settings)
    write_json(
        output / "scores.json",
        {
            "settings": settings,
            "digest": digest,
            "labels": labels,
            "scores": scores,
            "failures": failures,
            "baselines": beside,
        },
    )
    return check


def _sealed(
    output: Path,
    plan: Sequence[Case],
    settings: dict[str, object],
    real: Path | None,
    workers: int,
    say: Say,
) -> str:
    """Write archives and labels unless this very check stands there already."""
    output.mkdir(parents=True, exist_ok=True)
    note, published = output / "settings.json", output / "sealed.sha256"
    # the same draws with the same settings: an interrupted check goes on
    if note.exists() and published.exists() and json.loads(note.read_text()) == settings:
        say("archives of this check are there: going on")
        return published.read_text(encoding="utf-8").split()[0]
    if not note.exists() or json.loads(note.read_text()) != settings:
        for name in ("cases", "winds", "sealed", "diagnosed"):
            shutil.rmtree(output / name, ignore_errors=True)
        published.unlink(missing_ok=True)
        write_json(note, settings)
    # World by world, so that the twin without effects is simulated once.
    worlds: dict[World, list[Case]] = {}
    for case in plan:
        worlds.setdefault(case.world, []).append(case)
    labels = [
        label
        for own in _written(output, list(worlds.values()), real, workers, say)
        for label in own
    ]
    # worlds end in any order, and the digest is of the whole
    labels.sort(key=lambda label: label["name"])
    return seal(labels, output / "sealed")


def _written(
    output: Path, worlds: Sequence[Sequence[Case]], real: Path | None, workers: int, say: Say
) -> Iterator[list[Label]]:
    """Write the cases of every world, several worlds at a time where asked to."""
    if workers <= 1:
        for cases in worlds:
            yield _world_labels(output, real, cases)
            say(f"{len(cases)} archives of one world written")
        return
    # spawned: threads of numerical libraries do not survive a fork
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for cases, labels in zip(
            worlds, pool.map(partial(_world_labels, output, real), worlds), strict=True
        ):
            say(f"{len(cases)} archives of one world written")
            yield labels


def _world_labels(output: Path, real: Path | None, cases: Sequence[Case]) -> list[Label]:
    """Write the archives of one world and return their labels."""
    archivist = Archivist(output, real)
    return [_label(output, archivist, case) for case in cases]


def _of_this_code(output: Path) -> None:
    """Throw away what another version of the code has diagnosed in this folder."""
    note, code = output / "diagnosed" / "code.txt", code_digest("airswing.workflow.gap_stage")
    if not note.exists() or note.read_text(encoding="utf-8") != code:
        shutil.rmtree(output / "diagnosed", ignore_errors=True)
        note.parent.mkdir(parents=True)
        note.write_text(code, encoding="utf-8")


def _label(output: Path, archivist: Archivist, case: Case) -> Label:
    """Write one case, or read its label where an interrupted check has written it."""
    path = output / "sealed" / "parts" / f"{case.name}.json"
    if path.exists():
        known: Label = json.loads(path.read_text(encoding="utf-8"))
        return known
    label = archivist.write(case)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, label)
    return label


def _diagnose_all(
    output: Path, plan: Sequence[Case], diagnoser: Diagnoser, workers: int, say: Say
) -> dict[str, str]:
    """Diagnose every case not done yet; return the messages of those that failed."""
    failures: dict[str, str] = {}

    def one(case: Case) -> None:
        target = output / "diagnosed" / case.name
        if (target / "gap.json").exists():
            return
        began = time.perf_counter()
        target.mkdir(parents=True, exist_ok=True)
        try:
            config = output / "cases" / case.name / "config.yaml"
            found = diagnoser(config, target, case.without)
        except subprocess.TimeoutExpired as err:
            failed = f"took longer than {err.timeout:g} s"
        except RuntimeError as err:
            failed = str(err)
        else:
            if not (target / "gap.json").exists():
                write_json(target / "gap.json", found.content())
            say(f"{case.name} diagnosed, {time.perf_counter() - began:.1f} s")
            return
        failures[case.name] = failed
        say(f"{case.name} failed: {failed}")

    # threads are enough: each waits for a command of its own
    with ThreadPoolExecutor(max_workers=workers) as pool:
        list(pool.map(one, plan))
    return failures


def _gap_file(output: Path, name: str) -> Path:
    return output / "diagnosed" / name / "gap.json"


def _read(output: Path, name: str) -> GapReport | None:
    path = _gap_file(output, name)
    return GapReport.read(path) if path.exists() else None
