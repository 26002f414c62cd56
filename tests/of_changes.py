"""Tests of what changed since main, for ``make quick``; the kernels' without a change.

Run as ``python tests/of_changes.py``: prints their names. Of a module these are the tests that
mirror it, else some that import it, its own room's first.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pipeline/airswing/"
#: What is run where nothing changed: the kernels everything rests on.
KERNELS = ("tests/physics", "tests/compass/test_table.py")
#: Seconds of the slow ones on an idle core; whole runs take minutes and are left to ``make test``.
SECONDS = {
    "test_batch.py": 16,
    "test_blocks.py": 16,
    "test_bufr.py": 14,
    "test_check_run.py": 19,
    "test_cli.py": 17,
    "test_compute.py": 15,
    "test_gap_page.py": 18,
    "test_gap_start.py": 11,
    "test_learned.py": 10,
    "test_unknowns.py": 22,
}
OTHERS = 4
WHOLE_RUNS = {
    "test_adding.py",
    "test_atomic.py",
    "test_diagnose.py",
    "test_end_to_end.py",
    "test_fuzz.py",
    "test_loop.py",
    "test_resume.py",
    "test_short_check.py",
    "test_update.py",
    "test_workflow.py",
}
#: What two workers do in half a minute, beside lint and the start of pytest.
MOST_SECONDS = 56
#: Tests of a module that none mirrors.
IMPORTERS = 2


def changed(base: str = "main") -> list[str]:
    """Names of files that differ from where this branch left ``base``, or are not committed."""
    git = ["git", "-C", str(ROOT)]
    found: set[str] = set()
    for question in (
        ["diff", "--name-only", f"{base}...HEAD"],
        ["diff", "--name-only", "HEAD"],
        ["ls-files", "--others", "--exclude-standard"],
    ):
        answer = subprocess.run([*git, *question], capture_output=True, text=True, check=False)
        found |= set(answer.stdout.split())
    return sorted(found)


def tests_around(module: Path) -> list[str]:
    """Tests that import a module of the package, its own room's first; else the room's, or above.

    An effect, say, is reached through the catalogue: no test names its file.
    """
    dotted = ".".join(("airswing", *module.with_suffix("").parts))
    room, _, name = dotted.rpartition(".")
    wanted = re.compile(rf"from {dotted} import|from {room} import .*\b{name}\b")
    tests = sorted((ROOT / "tests").rglob("test_*.py"))
    tests = [path for path in tests if path.name not in WHOLE_RUNS]
    found = [path for path in tests if wanted.search(path.read_text())]
    own = ROOT / "tests" / module.parent
    found.sort(key=lambda path: not path.is_relative_to(own))
    for folder in module.parents[:-1]:
        inside = [path for path in tests if path.is_relative_to(ROOT / "tests" / folder)]
        # tests/gap/test_effects.py is of gap/effects, and nearer than what lies deeper
        inside.sort(key=lambda path: (path.stem != f"test_{own.name}", len(path.parts)))
        found = found or inside
    return [str(path.relative_to(ROOT)) for path in found[:IMPORTERS]]


def tests_of(names: list[str]) -> list[str]:
    """Tests among the names, then those of the package's modules among them, as time allows."""
    found = [name for name in names if name.startswith("tests/") and "/test_" in name]
    for name in names:
        if name.startswith(PACKAGE) and name.endswith(".py"):
            module = Path(name).relative_to(PACKAGE)
            mirror = Path("tests") / module.parent / f"test_{module.name}"
            found += [str(mirror)] if (ROOT / mirror).exists() else tests_around(module)
    kept, spent = [], 0
    for name in dict.fromkeys(found):
        path = ROOT / name
        spent += SECONDS.get(path.name, OTHERS)
        if path.exists() and path.name not in WHOLE_RUNS and (spent <= MOST_SECONDS or not kept):
            kept.append(name)
    return kept


if __name__ == "__main__":
    print(" ".join(tests_of(changed()) or KERNELS))
