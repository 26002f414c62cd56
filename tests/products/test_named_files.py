"""Errors for a pattern that names no file."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from airswing.errors import InputError
from airswing.products.whole_files import none_found
from airswing.reference.files import find_files
from airswing.reports import expand

NOBODY = 65534


@pytest.fixture
def closed() -> Iterator[Path]:
    """A folder of one file that this process, were it root or not, may neither list nor enter."""
    above = Path(tempfile.mkdtemp())  # pytest's folders are closed to other users
    above.chmod(0o755)
    folder = above / "closed"
    folder.mkdir()
    (folder / "a.grb2").write_bytes(b"GRIB")
    folder.chmod(0o000)
    root = os.geteuid() == 0
    if root:
        os.seteuid(NOBODY)
    try:
        yield folder
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)
        shutil.rmtree(above)


@pytest.mark.parametrize("pattern", ["*.grb2", "a.grb2", "**/*.grb2", ""])
@pytest.mark.parametrize("find", [lambda p: find_files(p, "ruc"), expand])
def test_a_folder_that_may_not_be_read_is_named(closed, pattern, find):
    with pytest.raises(InputError, match=f"^{closed}: .*files: .*permission denied"):
        find(str(closed / pattern) if pattern else str(closed))


def test_a_readable_folder_without_such_a_file(tmp_path):
    (tmp_path / "a.grb2").write_bytes(b"GRIB")
    assert "no file found" in str(none_found(tmp_path / "b*.grb2", "files"))
    assert f"such as {tmp_path}/*.grb2" in str(none_found(tmp_path, "files"))
