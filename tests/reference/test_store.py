"""Finished samples on disk: what cannot be kept says why."""

from __future__ import annotations

import resource
from concurrent.futures import ThreadPoolExecutor
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


@pytest.mark.parametrize("shape", [(1, 1), (4, 7), (12, 100_003), (3, 0)])
def test_it_is_read_as_numpy_reads_it(tmp_path: Path, shape: tuple[int, int]) -> None:
    table = np.asfortranarray(np.random.default_rng(1).normal(size=shape))
    _save(tmp_path / "a.npy", table)
    found = _load(tmp_path / "a.npy", shape[1])
    assert found is not None and found.tobytes() == np.load(tmp_path / "a.npy").tobytes()
    found[...] = 0.0  # may be worked on in place


@pytest.mark.parametrize("left", [0, 5, 90, 128, 136, -1])
def test_a_file_that_is_cut_is_said_and_made_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, left: int
) -> None:
    path = tmp_path / "a.npy"
    _save(path, np.ones((3, 4)))
    path.write_bytes(path.read_bytes()[:left])
    assert _load(path, 4) is None
    assert "not whole" in caplog.text


def test_many_threads_read_at_a_time(tmp_path: Path) -> None:
    _save(tmp_path / "a.npy", np.ones((8, 50)))
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: _load(tmp_path / "a.npy", 50), range(4000)))
    assert all(table is not None and table.sum() == 400 for table in found)


def test_a_disk_that_takes_no_more_is_told_by_its_own_words(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**12, before[1]))
    try:
        with pytest.raises(InputError, match=r"File too large.*--resume"):
            _save(tmp_path / "a.npy", np.zeros((2, 2**12)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not any(tmp_path.iterdir())


def test_an_octet_changed_in_keeping_is_said_and_made_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, table = tmp_path / "a.npy", np.arange(600.0).reshape(2, 300)
    _save(path, table)
    whole = path.read_bytes()
    for place in (130, len(whole) // 2, len(whole) - 20, len(whole) - 1):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        assert _load(path, 300) is None
        path.write_bytes(whole[:place] + b"\0" + whole[place:])
        assert _load(path, 300) is None
    assert "not whole" in caplog.text
    path.write_bytes(whole)
    assert np.array_equal(_load(path, 300), table)
