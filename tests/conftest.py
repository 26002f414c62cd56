"""Shared fixtures: the real data beside the repository, and hypothesis profiles."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

import airswing  # noqa: F401  (imports pyproj before anything imports eccodes)

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "real"

settings.register_profile("default", max_examples=30, deadline=None)
settings.register_profile("ci", max_examples=60, deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


LONGEST = (
    "blind_check/test_short_check.py",
    "gap/test_diagnose.py",
    "test_fuzz.py",
    "blind_check/test_check_run.py",
    "test_cli.py",
    "test_workflow.py",
    "gap/witness/test_unknowns.py",
    "test_batch.py",
    "blind_check/test_adding_an_effect.py",
    "workflow/test_gap_start.py",
    "test_resume.py",
    "test_blocks.py",
)
"""Files whose tests take longest, first: at the end one worker would wait for them."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; workers take whole files, for what their fixtures make."""
    folder = Path(__file__).parent
    places = {folder / name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


@pytest.fixture(scope="session")
def real() -> Callable[[str], Path]:
    """Path of a real file by its name below ``../shared/real``; skips by name where absent."""

    def find(name: str) -> Path:
        path = REAL / name
        if not path.exists():
            pytest.skip(f"real data absent: ../shared/real/{name}")
        return path

    return find


@pytest.fixture(scope="session")
def gap_product(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output folder of ``airswing gap`` on a small archive: iron on N401, airspeed of N403."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # the run's own: made by the first worker that asks
    with (shared / "gap_product.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        folder = shared / "gap_product"
        if not (folder / "out" / "gap.json").is_file():
            _make_gap_product(folder)
    return folder / "out"


def _make_gap_product(folder: Path) -> None:
    from airswing.config import load_config
    from airswing.synthetic.sealed.cases import Case, World
    from airswing.synthetic.sealed.draws import Drawn
    from airswing.synthetic.sealed.sealed_archives import Archivist
    from airswing.workflow import Job, gap_stage
    from airswing.workflow.progress import Progress

    class AsDrawn(Archivist):
        """Effects at the strength they are given here."""

        def _strengthened(self, drawn, size, world):  # type: ignore[no-untyped-def]
            return drawn

    struck = (
        ("hard_iron", "N401", {"amplitude_deg": 6.0, "phase_deg": 40.0}),
        ("tas_scale", "N403", {"scale_percent": 3.0}),
    )
    drawn = tuple(
        Drawn(name, ({"name": name, "tails": [tail], "period": None, "parameters": values},))
        for name, tail, values in struck
    )
    world = World(11, "default", 14, 6, coarse=True)
    AsDrawn(folder).write(Case("case", 3, "pair", world, drawn, (1.0, 1.0)))
    config = load_config(folder / "cases" / "case" / "config.yaml", output=folder / "out")
    gap_stage.diagnosis(Job(config, Progress(quiet=True)))


@pytest.fixture(scope="session")
def root() -> Path:
    """Top of the repository."""
    return ROOT
