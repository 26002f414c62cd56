"""The blind check from end to end: plan, write, seal, diagnose by the public command, open, score.

Assumptions: the diagnosis is ``airswing gap CONFIG --output DIR --quiet`` in a process of its own;
nothing but the archive's configuration (and, for cases with an effect taken out of the catalogue,
``--without NAME``) is handed to it. A check that was interrupted goes on where it stopped: cases
already diagnosed are kept, and the seal decides whether they are of this check.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airswing.products.fingerprint import code_digest
from airswing.products.netcdf import write_json
from airswing.synthetic.sealed.cases import Case, Size, plan_cases
from airswing.synthetic.sealed.sealed_archives import Archivist
from airswing.synthetic.sealed.sealing import open_seal, seal

__all__ = ["Check", "gap_check", "run_public_command"]

Say = Callable[[str], None]
Diagnoser = Callable[[Path, Path, Sequence[str]], dict[str, Any]]
"""(configuration, output folder, effects to do without) to the content of gap.json."""
TIMEOUT = 1800.0


@dataclass(frozen=True)
class Check:
    """A finished check.

    Parameters
    ----------
    digest : str
        Published before the first diagnosis.
    labels, scores : list of dict
        Truth and score of each case, in the same order.
    failures : dict
        Case to the message of a diagnosis that did not end well.
    baselines : dict
        Baseline to its scores.
    settings : dict
        Number of cases, seed, size: what repeats it.
    """

    digest: str
    labels: list[dict[str, Any]]
    scores: list[dict[str, Any]]
    failures: dict[str, str]
    baselines: dict[str, list[dict[str, Any]]]
    settings: dict[str, Any]


def run_public_command(config: Path, output: Path, without: Sequence[str]) -> dict[str, Any]:
    """Diagnose one archive through the command a user has.

    Parameters
    ----------
    config, output : Path
        Configuration and folder for the products.
    without : sequence of str
        Effects to leave out of the catalogue.

    Returns
    -------
    dict
        The content of gap.json.

    Raises
    ------
    RuntimeError
        The command failed; its last line of error output is the message.
    """
    command = [sys.executable, "-m", "airswing", "gap", str(config), "--output", str(output)]
    command += ["--quiet", *(part for name in without for part in ("--without", name))]
    settings = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=TIMEOUT, env=settings, check=False
    )
    if done.returncode != 0:
        last = done.stderr.strip().splitlines() or ["no message"]
        raise RuntimeError(f"exit status {done.returncode}: {last[-1]}")
    content: dict[str, Any] = json.loads((output / "gap.json").read_text(encoding="utf-8"))
    return content


def gap_check(
    output: Path,
    *,
    cases: int = 60,
    seed: int = 1,
    fast: bool = False,
    workers: int = 1,
    real: Path | None = None,
    rungs: Sequence[int] | None = None,
    names: Sequence[str] | None = None,
    diagnoser: Diagnoser = run_public_command,
    baselines: bool = True,
    say: Say = lambda text: None,
) -> Check:
    """Run the blind check.

    Parameters
    ----------
    output : Path
        Folder of the check.
    cases, seed : int
        How many; seed of every draw.
    fast : bool
        Small archives and effects of 0.8 and 1.6 m/s.
    workers : int
        Diagnoses at a time.
    real : Path, optional
        Folder with real data; rung 5 is left out where it is absent.
    rungs : sequence of int, optional
        Rungs to play; all by default.
    names : sequence of str, optional
        Catalogue effects to draw from.
    diagnoser : callable
        What is checked; the public command by default.
    baselines : bool
        Also run the simple methods beside ours.
    say : callable
        Told what goes on.

    Returns
    -------
    Check
    """
    size = Size.fast() if fast else Size()
    played = list(rungs or (1, 2, 3, 4, 5))
    if real is None or not (real / "heading").is_dir():
        say("no real data: rung 5 is left out")
        played = [rung for rung in played if rung != 5]
    plan = plan_cases(cases, seed=seed, size=size, rungs=played, names=names)
    settings = {
        "cases": cases, "seed": seed, "fast": fast, "rungs": played, "names": list(names or ()),
        "days": size.days, "aircraft": size.aircraft,
    }  # fmt: skip
    digest = _sealed(output, plan, settings, real, say)
    _of_this_code(output)
    say(f"labels sealed, sha256 {digest}")
    failures = _diagnose_all(output, plan, diagnoser, workers, say)
    labels = open_seal(output / "sealed", digest=digest)
    say("seals opened, digest verified")
    from airswing.blind_check.baselines import run_baselines
    from airswing.blind_check.scoring import score_case

    scores = [
        score_case(label, _read(output, label["name"]), failure=failures.get(label["name"]))
        for label in labels
    ]
    beside = run_baselines(output, labels, say=say) if baselines else {}
    check = Check(digest, labels, scores, failures, beside, settings)
    write_json(
        output / "scores.json",
        {"settings": settings, "digest": digest, "labels": labels, "scores": scores,
         "failures": failures, "baselines": beside},
    )  # fmt: skip
    return check


def _sealed(
    output: Path, plan: Sequence[Case], settings: dict[str, Any], real: Path | None, say: Say
) -> str:
    """Write archives and labels unless this very check stands there already."""
    output.mkdir(parents=True, exist_ok=True)
    note, published = output / "settings.json", output / "sealed.sha256"
    if note.exists() and published.exists() and json.loads(note.read_text()) == settings:
        say("archives of this check are there: going on")
        return published.read_text(encoding="utf-8").split()[0]
    if not note.exists() or json.loads(note.read_text()) != settings:
        for name in ("cases", "winds", "sealed", "diagnosed"):
            shutil.rmtree(output / name, ignore_errors=True)
        published.unlink(missing_ok=True)
        write_json(note, settings)
    archivist, labels = Archivist(output, real), []
    # World by world, so that the twin without effects is simulated once.
    for case in sorted(plan, key=lambda case: (case.world.seed, case.world.kind)):
        labels.append(_label(output, archivist, case, say))
    labels.sort(key=lambda label: str(label["name"]))
    return seal(labels, output / "sealed")


def _of_this_code(output: Path) -> None:
    """Throw away what another version of the code has diagnosed in this folder."""
    note, code = output / "diagnosed" / "code.txt", code_digest("airswing.workflow.gap_stage")
    if not note.exists() or note.read_text(encoding="utf-8") != code:
        shutil.rmtree(output / "diagnosed", ignore_errors=True)
        note.parent.mkdir(parents=True)
        note.write_text(code, encoding="utf-8")


def _label(output: Path, archivist: Archivist, case: Case, say: Say) -> dict[str, Any]:
    """Write one case, or read its label where an interrupted check has written it."""
    path = output / "sealed" / "parts" / f"{case.name}.json"
    if path.exists():
        known: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return known
    began = time.perf_counter()
    label = archivist.write(case)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, label)
    say(f"{case.name} written, {time.perf_counter() - began:.1f} s")
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
                write_json(target / "gap.json", found)
            say(f"{case.name} diagnosed, {time.perf_counter() - began:.1f} s")
            return
        failures[case.name] = failed
        say(f"{case.name} failed: {failed}")

    with ThreadPoolExecutor(max_workers=workers) as pool:
        list(pool.map(one, plan))
    return failures


def _read(output: Path, name: str) -> dict[str, Any] | None:
    path = output / "diagnosed" / name / "gap.json"
    if not path.exists():
        return None
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
