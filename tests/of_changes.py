"""Tests that mirror what changed since main, for ``make quick``; the kernels without a change.

Run as ``python tests/of_changes.py``: prints their names.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pipeline/airswing/"
#: What is run where nothing changed: the kernels everything rests on.
KERNELS = ("tests/physics", "tests/compass/test_table.py")
#: Tests of whole runs, minutes long: ``make test`` has them.
WHOLE_RUNS = {
    "test_workflow.py",
    "test_resume.py",
    "test_adding.py",
    "test_end_to_end.py",
    "test_diagnose.py",
    "test_loop.py",
    "test_check_run.py",
    "test_short_check.py",
}


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


def tests_of(names: list[str]) -> list[str]:
    """Tests among the names, and those that mirror the package's modules among them."""
    found = set()
    for name in names:
        path = Path(name)
        if name.startswith("tests/") and path.name.startswith("test_"):
            found.add(name)
        elif name.startswith(PACKAGE) and path.suffix == ".py":
            room = Path("tests") / path.relative_to(PACKAGE).parent
            found.add(str(room / f"test_{path.stem}.py"))
    kept = {name for name in found if (ROOT / name).exists()}
    return sorted(name for name in kept if Path(name).name not in WHOLE_RUNS)


if __name__ == "__main__":
    print(" ".join(tests_of(changed()) or KERNELS))
