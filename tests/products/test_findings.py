"""Results of `compare`, `field_test` and `export`: a dict with a short ``repr``."""

from __future__ import annotations

import json
import pickle

from airswing.products.whole_files import Findings


def made() -> Findings:
    pair = {"references": ["ruc", "rr"], "verdict": "poolable"}
    return Findings(
        reports=22991,
        references=["ruc", "rr"],
        pairs=[pair] * 500,
        groups={f"group {k}": {"kt": 1.0} for k in range(9)},
        left_out={"no_fit": 3, "no_wind": 0},
        reduction_kt=0.123456,
        ci_kt=[0.1, 0.2],
        end=None,
        notes=[],
        remark="long " * 99,
    )


def test_a_line_a_key_and_none_of_them_long():
    lines = repr(made()).splitlines()
    assert lines[:9] == [
        "reports: 22991",
        "references: ruc, rr",
        "pairs: 500 of references, verdict",
        "groups: group 0, group 1, group 2, group 3, group 4, group 5 and 3 more",
        "left_out: no_fit 3, no_wind 0",
        "reduction_kt: 0.1235",
        "ci_kt: 0.1, 0.2",
        "end: none",
        "notes: none",
    ]
    assert len(lines[9]) == 100 and lines[9].endswith("...")


def test_it_is_the_dict_that_json_and_pickle_take():
    found = made()
    assert json.loads(json.dumps(found)) == found
    assert pickle.loads(pickle.dumps(found)) == found
