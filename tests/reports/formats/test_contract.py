"""What holds for every format: recognition, compression, columns, counts, damaged files."""

import bz2
import gzip
import json

import numpy as np
import pandas as pd
import pytest
from benchmarks.fuzz.seeds import bufr_file
from tests.reports.formats import test_other_formats as others
from tests.reports.formats.test_madis import write_madis
from tests.reports.tables import flight, write

from airswing.errors import InputError
from airswing.reports import read_file
from airswing.reports.formats import formats

WRITERS = {
    "csv": lambda path: write(path, flight()),
    "parquet": lambda path: flight().to_parquet(path),
    "madis": write_madis,
    "ioda": others.ioda,
    "bufr": bufr_file,
    "g1000": others.g1000_log,
    "readsb": lambda path: path.write_text(json.dumps(others.trace())),
    "mode_s": lambda path: others.saved(path.parent, "jsonl").rename(path),
}
NUMBERS = [
    *("latitude", "longitude", "pressure", "pressure_altitude", "wind_speed", "wind_direction"),
    *("eastward_wind", "northward_wind", "air_temperature", "reported_airspeed"),
    "reported_heading",
]
FLAGS = ["roll_flag", "temperature_qc", "wind_qc", "phase", "icing", "wind_source", "platform"]


def test_every_format_has_a_writer():
    assert set(WRITERS) == set(formats())


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_each_format(tmp_path, name):
    path = tmp_path / "file"
    WRITERS[name](path)
    frame, audit = read_file(path)
    assert dict(audit.formats) == {name: 1}
    assert len(frame) == audit.usable == audit.read - sum(audit.dropped.values()) > 0
    assert frame.columns.tolist() == ["tail", "flight", "time", *NUMBERS, *FLAGS]
    assert frame["time"].dtype == "datetime64[ns]" and frame["time"].notna().all()
    assert {str(frame[flag].dtype) for flag in FLAGS} == {"int8"}
    assert frame["latitude"].between(-90, 90).all() and frame["longitude"].between(-180, 180).all()
    assert np.isfinite(frame["pressure"]).all() and (frame["tail"] != "").all()
    again, _ = read_file(path, format=name)
    pd.testing.assert_frame_equal(again, frame)
    named, audit = read_file(path, columns={"tail": {"value": "N510"}})
    assert set(named["tail"]) == {"N510"} and not audit.remarks
    content = path.read_bytes()
    if name != "parquet":
        for packed in (gzip.compress, bz2.compress):
            path.write_bytes(packed(content))
            pd.testing.assert_frame_equal(read_file(path)[0], frame)
    for damaged in (content[: len(content) // 2], content[:100], content[:-20] + bytes(20)):
        path.write_bytes(damaged)
        try:
            cut, _ = read_file(path)
        except InputError as error:
            assert str(path) in str(error)
        else:
            assert len(cut) <= len(frame)


@pytest.mark.parametrize("name", sorted(set(WRITERS) - {"csv"}))
def test_a_format_that_is_not_the_files_ends_in_one_message(tmp_path, name):
    (tmp_path / "table.csv").write_text("tail,time\nN1,2009-01-05T12:00:00Z\n")
    with pytest.raises(InputError, match=r"table\.csv"):
        read_file(tmp_path / "table.csv", format=name)
