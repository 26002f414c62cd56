"""What a file holds, told in plain types."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from airswing.errors import InputError
from airswing.reports import reports_summary
from tests.reports.tables import flight, write


def test_of_a_table(tmp_path: Path):
    path = write(tmp_path / "a.csv", flight(longitude=-87.0, roll_flag=["G"] * 9 + [""]))
    found = reports_summary(path)
    assert (found["format"], found["reports"], found["aircraft"]) == ("csv", 10, 1)
    assert (found["first"], found["last"]) == ("2009-01-05T12:00:00Z", "2009-01-05T12:27:00Z")
    assert found["bounding_box"]["south"] == found["bounding_box"]["north"] == 41.5
    assert found["bounding_box"]["west"] == -87.0
    assert found["columns"] == {"pressure": 10, "eastward_wind": 10, "roll_flag": 9}
    assert found["flags"] == {"roll_flag": {"G": 9, "blank": 1}}
    assert "flags" not in found["audit"]  # once is enough
    json.dumps(found)


def test_of_the_real_acars_file(real: Callable[[str], Path]):
    found = reports_summary(real("reports/acars_19990209_14z.nc"))
    assert (found["format"], found["reports"], found["aircraft"]) == ("madis", 2304, 298)
    assert found["first"].startswith("1999-02-09T14:00:00")
    assert found["flags"]["rollFlag"] == {"B": 120, "G": 388, "N": 1796}
    json.dumps(found)


def test_of_a_file_that_is_none(tmp_path: Path):
    (tmp_path / "a.csv").write_bytes(b"")
    with pytest.raises(InputError, match="is empty"):
        reports_summary(tmp_path / "a.csv")
