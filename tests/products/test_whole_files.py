"""Files: errors for a pattern that names no file, results with a short ``repr``."""

import json
import pickle

from airswing.products.whole_files import Findings, none_found


def test_findings_are_a_dict_with_a_line_a_key_and_none_of_them_long():
    pair = {"references": ["ruc", "rr"], "verdict": "poolable"}
    found = Findings(reports=22991, references=["ruc", "rr"], pairs=[pair] * 500, end=None)
    lines = repr(found).splitlines()
    assert lines[:2] == ["reports: 22991", "references: ['ruc', 'rr']"]
    assert [line.split(": ")[0] for line in lines] == list(found)
    assert max(map(len, lines)) <= 100
    assert json.loads(json.dumps(found)) == found
    assert pickle.loads(pickle.dumps(found)) == found


def test_a_folder_without_such_a_file(tmp_path):
    (tmp_path / "a.grb2").write_bytes(b"GRIB")
    assert "no file found" in str(none_found(tmp_path / "b*.grb2", "files"))
    assert f"such as {tmp_path}/*.grb2" in str(none_found(tmp_path, "files"))
