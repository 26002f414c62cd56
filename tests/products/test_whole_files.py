"""Files: errors for a pattern that names no file, results with a short ``repr``."""

import json
import pickle

from airswing.products.whole_files import Findings


def test_findings_are_a_dict_with_a_line_a_key_and_none_of_them_long():
    pair = {"references": ["ruc", "rr"], "verdict": "poolable"}
    findings = Findings(reports=22991, references=["ruc", "rr"], pairs=[pair] * 500, end=None)
    lines = repr(findings).splitlines()
    assert lines[:2] == ["reports: 22991", "references: ['ruc', 'rr']"]
    assert [line.split(": ")[0] for line in lines] == list(findings)
    assert max(map(len, lines)) <= 100
    assert json.loads(json.dumps(findings)) == findings
    assert pickle.loads(pickle.dumps(findings)) == findings
