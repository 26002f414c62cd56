"""Files: errors for a pattern that names no file, results with a short ``repr``."""

import json
import os
import pickle
import shutil
import tempfile
from pathlib import Path

import pytest

from airswing.errors import InputError
from airswing.products.whole_files import Findings, none_found
from airswing.reference.files import find_files
from airswing.reports import expand

NOBODY = 65534


def test_findings_are_a_dict_with_a_line_a_key_and_none_of_them_long():
    pair = {"references": ["ruc", "rr"], "verdict": "poolable"}
    found = Findings(reports=22991, references=["ruc", "rr"], pairs=[pair] * 500, end=None)
    lines = repr(found).splitlines()
    assert lines[:2] == ["reports: 22991", "references: ['ruc', 'rr']"]
    assert [line.split(": ")[0] for line in lines] == list(found)
    assert max(map(len, lines)) <= 100
    assert json.loads(json.dumps(found)) == found
    assert pickle.loads(pickle.dumps(found)) == found


@pytest.fixture
def closed():
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
