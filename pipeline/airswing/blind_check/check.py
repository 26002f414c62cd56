"""The blind check: plan cases, write and seal them, diagnose them, open the seal, score.

The diagnosis is ``airswing gap CONFIG --output DIR --quiet`` in a separate process, which receives
nothing but the configuration of an archive, and ``--without NAME`` for withheld effects. The
SHA-256 of the labels is published before the first diagnosis. An interrupted check continues.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from airswing.blind_check.score import Score, draws, score_case
from airswing.products.whole_files import code_digest, write_json
from airswing.synthetic.sealed.cases import RUNGS, Case, Size, plan_cases
from airswing.synthetic.sealed.draws import World
from airswing.synthetic.sealed.labels import Label, open_seal, seal
from airswing.synthetic.sealed.sealed_archives import Archivist

Say = Callable[[str], None]
# Content of gap.json from the configuration, output folder and withheld effects.
Diagnoser = Callable[[Path, Path, Sequence[str]], Mapping[str, Any]]
# Seconds; a diagnosis takes a minute or two, and one that hangs must not stop the check.
_TIMEOUT = 1800.0


@dataclass(frozen=True)
class Plan:
    """Cases of a check and the data they need."""

    cases: int = 60
    seed: int = 1  # of every draw
    fast: bool = False  # small archives and effects of 0.8 and 1.6 m/s
    nulls: int | None = None  # cases without an effect; a quarter by default
    rungs: tuple[int, ...] | None = None  # see `airswing.synthetic.sealed.cases`; all by default
    names: tuple[str, ...] = ()  # effects to draw from; all of the catalogue by default
    real: Path | None = None  # records of real sensors and forecasts; rung 5 needs it

    @property
    def size(self) -> Size:
        """Size of the archives."""
        return Size.fast() if self.fast else Size()

    @property
    def asked(self) -> list[int]:
        """Rungs to run, each once."""
        return list(dict.fromkeys(self.rungs or RUNGS))

    @property
    def played(self) -> list[int]:
        """Rungs whose data are available."""
        available = self.real is not None and (self.real / "heading").is_dir()
        return [rung for rung in self.asked if rung != 5 or available]

    def drawn(self) -> list[Case]:
        """Return the cases."""
        return plan_cases(
            self.cases,
            seed=self.seed,
            size=self.size,
            draws={k: draw for k, draw in draws().items() if not self.names or k in self.names},
            rungs=self.played,
            nulls=self.nulls,
        )

    def settings(self) -> dict[str, object]:
        """Return the settings that identify the check, with a digest of the drawn cases."""
        cases = [
            (
                case.name,
                case.kind,
                (case.world.seed, case.world.kind),
                case.variant,
                case.sizes,
                case.without,
                [item.effects for item in (*case.drawn, *case.instead)],
            )
            for case in self.drawn()
        ]
        return {
            "cases": self.cases,
            "seed": self.seed,
            "fast": self.fast,
            "rungs": self.played,
            "names": list(self.names),
            "days": self.size.days,
            "aircraft": self.size.aircraft,
            "nulls": self.nulls,
            "drawn": hashlib.sha256(json.dumps(cases).encode()).hexdigest(),
        }

    @property
    def command(self) -> str:
        """The command line that repeats the check."""
        words = [f"airswing gap-check --cases {self.cases} --seed {self.seed}"]
        words += ["--fast"] * self.fast
        words += [] if self.nulls is None else [f"--nulls {self.nulls}"]
        words += [f"--rung {rung}" for rung in self.rungs or ()]
        words += [] if self.real is None else ["--real DIR"]
        return " ".join(words)


@dataclass(frozen=True)
class Check:
    """A finished check: labels and scores in the same order.

    ``digest`` is the SHA-256 of the labels that was published before the first diagnosis;
    ``settings`` repeats the check.
    """

    digest: str
    labels: list[Label]
    scores: list[Score]
    settings: dict[str, object]


def run_command(config: Path, output: Path, without: Sequence[str]) -> Mapping[str, Any]:
    """Content of ``gap.json`` by the public command; RuntimeError if the command fails."""
    command = [sys.executable, "-m", "airswing", "gap", str(config), "--output", str(output)]
    command += ["--quiet", *(word for name in without for word in ("--without", name))]
    # Several commands run at a time, each in one thread.
    settings = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=_TIMEOUT, env=settings, check=False
    )
    if done.returncode != 0:
        last = done.stderr.strip().splitlines() or ["no message"]
        raise RuntimeError(f"exit status {done.returncode}: {last[-1]}")
    content: Mapping[str, Any] = json.loads((output / "gap.json").read_text())
    return content


def gap_check(
    output: Path,
    plan: Plan,
    *,
    workers: int = 1,
    diagnoser: Diagnoser = run_command,
    so_far: bool = False,
    say: Say = lambda text: None,
) -> Check:
    """Run the blind check.

    ``output`` gets the archives, sealed labels, diagnoses and ``scores.json``; ``workers`` archives
    are written and diagnosed at a time, by ``diagnoser``. With ``so_far`` only the cases that an
    earlier call diagnosed are scored.
    """
    if plan.played != plan.asked:
        say("no real data: rung 5 is left out")
    cases, settings = plan.drawn(), plan.settings()
    digest = _sealed(output, cases, settings, plan.real, workers, say)
    say(f"labels sealed, sha256 {digest}")
    failures: dict[str, str] = {}
    if not so_far:
        note, code = output / "diagnosed" / "code.txt", code_digest()
        if not note.exists() or note.read_text(encoding="utf-8") != code:
            shutil.rmtree(output / "diagnosed", ignore_errors=True)
            note.parent.mkdir(parents=True)
            note.write_text(code, encoding="utf-8")
        failures = _diagnose_all(output, cases, diagnoser, workers, say)
    labels = open_seal(output / "sealed", digest=digest)
    if so_far:
        labels = [label for label in labels if _gap_file(output, label["name"]).exists()]
    say("seal opened, digest verified")
    scores = []
    for label in labels:
        path = _gap_file(output, label["name"])
        gap = json.loads(path.read_text()) if path.exists() else None
        failure = failures.get(label["name"])
        scores.append(score_case(label, gap, failure=failure, fleet=cases[0].world.tails))
    check = Check(digest, labels, scores, settings | {"sealed": len(labels)})
    content = {"settings": check.settings, "digest": digest, "labels": labels, "scores": scores}
    write_json(output / "scores.json", content)
    return check


def _gap_file(output: Path, name: str) -> Path:
    return output / "diagnosed" / name / "gap.json"


def _sealed(
    output: Path,
    cases: Sequence[Case],
    settings: dict[str, object],
    real: Path | None,
    workers: int,
    say: Say,
) -> str:
    output.mkdir(parents=True, exist_ok=True)
    note, published = output / "settings.json", output / "sealed.sha256"
    same = note.exists() and json.loads(note.read_text()) == settings
    if same and published.exists():
        say("archives of this check exist: continuing")
        return published.read_text(encoding="utf-8").split()[0]
    if not same:
        for name in ("cases", "winds", "sealed", "diagnosed"):
            shutil.rmtree(output / name, ignore_errors=True)
        published.unlink(missing_ok=True)
        write_json(note, settings)
    # Cases of one world share its winds and the twin archive without effects.
    worlds: dict[World, list[Case]] = {}
    for case in cases:
        worlds.setdefault(case.world, []).append(case)
    write, labels = partial(_write_world, output, real), []
    with contextlib.ExitStack() as stack:
        written: Iterable[list[Label]] = map(write, worlds.values())
        if workers > 1:
            # Spawned, because threads of numerical libraries do not survive a fork.
            context = multiprocessing.get_context("spawn")
            pool = stack.enter_context(ProcessPoolExecutor(workers, mp_context=context))
            written = pool.map(write, worlds.values())
        for group in written:
            say(f"{len(group)} archives of one world written")
            labels += group
    labels.sort(key=lambda label: label["name"])
    return seal(labels, output / "sealed")


def _write_world(output: Path, real: Path | None, cases: Sequence[Case]) -> list[Label]:
    """Write the archives of one world; labels of an interrupted check are read."""
    archivist, labels = Archivist(output, real), []
    for case in cases:
        path = output / "sealed" / "parts" / f"{case.name}.json"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, archivist.write(case))
        labels.append(json.loads(path.read_text(encoding="utf-8")))
    return labels


def _diagnose_all(
    output: Path, cases: Sequence[Case], diagnoser: Diagnoser, workers: int, say: Say
) -> dict[str, str]:
    failures: dict[str, str] = {}

    def diagnose(case: Case) -> None:
        path = _gap_file(output, case.name)
        if path.exists():
            return
        began = time.perf_counter()
        path.parent.mkdir(parents=True, exist_ok=True)
        config = output / "cases" / case.name / "config.yaml"
        try:
            content = diagnoser(config, path.parent, case.without)
        except (subprocess.TimeoutExpired, RuntimeError) as err:
            failures[case.name] = str(err)
            say(f"{case.name} failed: {err}")
            return
        if not path.exists():
            write_json(path, content)
        say(f"{case.name} diagnosed, {time.perf_counter() - began:.1f} s")

    # Threads are sufficient, because each waits for a separate process.
    with ThreadPoolExecutor(max_workers=workers) as pool:
        list(pool.map(diagnose, cases))
    return failures
