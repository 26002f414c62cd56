"""Fingerprints of files and of the package's code."""

from __future__ import annotations

from pathlib import Path

from airswing.products.whole_files import file_identities, fingerprint


def test_a_file_counts_by_size_and_time(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("one")
    before = fingerprint(file_identities([str(path)]))
    assert fingerprint(file_identities([str(tmp_path / "*.csv")])) == before
    path.write_text("longer")
    assert fingerprint(file_identities([str(path)])) != before


def test_a_zarr_store_counts_by_its_chunks_and_other_folders_do_not(tmp_path: Path):
    store = tmp_path / "winds.zarr"
    (store / "u").mkdir(parents=True)
    (store / "u" / "0.0").write_bytes(b"chunk")
    assert file_identities([str(store)]) == []
    (store / ".zgroup").write_text("{}")
    ((name, size, _),) = file_identities([str(store)])
    assert name == str(store) and size == 5 + 2 + 2  # bytes, and one for each file
    (store / "u" / "0.1").write_bytes(b"")
    assert file_identities([str(store)])[0][1] == 10
