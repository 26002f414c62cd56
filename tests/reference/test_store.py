"""Finished samples on disk: what cannot be kept says why."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.reference.store import _load, _save


def test_a_sample_comes_back_as_it_was(tmp_path: Path) -> None:
    table = np.array([[1.5, np.nan, -0.0], [3.0, 4.0, 5.0]])
    _save(tmp_path / "a.npy", table)
    found = _load(tmp_path / "a.npy", 3)
    assert found is not None and found.tobytes() == table.tobytes()
    assert _load(tmp_path / "a.npy", 4) is None and _load(tmp_path / "b.npy", 3) is None


def test_a_disk_that_takes_no_more_is_told_by_its_own_words(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**12, before[1]))
    try:
        with pytest.raises(InputError, match=r"File too large.*--resume"):
            _save(tmp_path / "a.npy", np.zeros((2, 2**12)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not any(tmp_path.iterdir())
