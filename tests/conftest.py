"""Shared fixtures: the real data beside the repository, and hypothesis profiles."""

from __future__ import annotations

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
def root() -> Path:
    """Top of the repository."""
    return ROOT
