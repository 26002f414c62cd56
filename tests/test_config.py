"""Configuration, quantities and messages: defaults, units, one clear line for each fault."""

import math
import pickle
from datetime import datetime

import pytest
import yaml

from airswing.config_file import load_config
from airswing.errors import LONGEST, ConfigError, InputError, shortened
from airswing.quantities import quantity, spelt_out

SMALLEST = {
    "reports": {"files": "reports/*.csv"},
    "references": {"ruc": {"files": "ruc/*.grb"}, "nam": {"files": "nam/*.grb"}},
    "output": "results/",
}
GROUPS = {"start": 20091020, "before_start": "2009-07-20", "corrected": ["N1", "N2"]}
GROUPS |= {"controls": ["N2"]}


def write(folder, content):
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def test_defaults_are_the_documented_ones_in_si(tmp_path):
    config = load_config(write(tmp_path, SMALLEST))
    assert config.collocation.max_time_gap == 3 * 3600.0
    assert config.screening.max_turn == pytest.approx(math.radians(10))
    assert config.screening.min_ground_speed == pytest.approx(80 * 1852 / 3600)
    assert config.table.resolution == pytest.approx(math.radians(0.1))
    assert config.fit.min_reports == 200 and config.fit.harmonics == "auto"
    assert config.gap.phases == ["ascent", "cruise", "descent"]
    assert config.field_test is None
    assert config.reports.files == ["reports/*.csv"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"colocation": {}}, ["colocation", "did you mean 'collocation'"]),
        ({"screening": {"max_trun": "3 deg"}}, ["screening.max_trun", "'max_turn'"]),
        ({"collocation": {"max_time_gap": 3}}, ["collocation.max_time_gap", "needs a unit"]),
        ({"collocation": {"max_time_gap": "3 kt"}}, ["max_time_gap", "'3 kt'"]),
        ({"pool": {"x": ["ruc", "nam"]}}, ["pool.x", "never_pool"]),
        ({"pool": {"x": ["ruc", "rux"]}}, ["pool.x", "did you mean 'ruc'"]),
        ({"gap": {"reference": "ruk"}}, ["gap.reference", "'ruc'"]),
        ({"references": {}}, ["references"]),
        ({"references": {"a": {"engine": "fleet", "files": "x"}}}, ["files must name"]),
        ({"references": {"a": {"engine": "netcdf"}}}, ["files must name"]),
        ({"output": " "}, ["output", "names no folder"]),
        ({"references": {"m": {"files": "a", "lead": "shortest"}}}, ["'shortest'", ">= 1 h"]),
        ({"compute": {"workers": 0}}, ["compute.workers:", "greater than", "0"]),
        ({"postprocess": {"ratio": -1}}, ["postprocess.ratio: Input should be greater"]),
        ({"reports": {"files": "a", "columns": {"str": 5}}}, ["reports.columns.str: "]),
        ({"reports": {"only": {"tail": ["N1", 5]}}}, ["only.tail: ", "only.tail.1: "]),
        ({"table": {"resolution": "0 deg"}}, ["table.resolution", "0"]),
        ({"collocation": {"max_time_gap": "-3 h"}}, ["max_time_gap", "greater than 0"]),
        ({"pool": {"x": ["ruc", "ruc"]}}, ["pool.x: a pool needs at least two references"]),
        ({"handover": {"platform": "JET"}}, ["handover.platform", "'auto', 'TAMDAR'", "JET"]),
        ({"references": {"ruc": {"files": "a", "leed": "3 h"}}}, ["references.ruc", "'lead'"]),
        ({"observation_errors": {"covariance": 3}}, ["observation_errors", "reference_covariance"]),
        ({"postprocess": {"pairs": {"colums": {}}}}, ["postprocess.pairs.colums", "'columns'"]),
        ({"field_test": GROUPS}, ["field_test", "both groups", "N2"]),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path, change, words):
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, SMALLEST | change))
    message = str(caught.value)
    assert "config.yaml" in message
    assert all(word in message for word in words), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such configuration"),
        ("a: [", "not a YAML file"),
        ("- a list", "mapping"),
        ("reports: {files: a}\noutput: b\noutput: c\n", r"line 3: the key 'output' is given twice"),
        ("reports: {files: a}\nreferences: {m: {files: b}}\n", "output: required key"),
        ("Output: a\n", r"Output: unknown key; did you mean 'output'"),
        (
            "output: a\ncolour: red\nmetadtaa: {}\n",
            r"colour: unknown key.*; metadtaa: unknown key; did you mean 'metadata'",
        ),
    ],
)
def test_absent_or_broken_files_are_refused(tmp_path, text, says):
    path = tmp_path / "broken.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=says):
        load_config(path)


def test_quantities():
    assert quantity("0.1 arcmin", "radian") == pytest.approx(math.radians(0.1 / 60))
    assert quantity("1 kt", "meter / second") == pytest.approx(0.514444, abs=1e-6)
    for bare, unit in ((None, "second"), (3, "second"), ("3", "second"), (" 0.1", "radian")):
        with pytest.raises(ValueError, match=r"needs a unit, such as '[\d.]+ (min|deg)'"):
            quantity(bare, unit)
    wrong = "(3 h", "5 m/s/", "  ", "5..2 h", "2**2**100 s", "1e400 s", "nan s", "3 kt", "3 h )"
    for text in wrong:
        with pytest.raises(ValueError, match="is not a quantity"):
            quantity(text, "second")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        (20091020, datetime(2009, 10, 20)),
        ("20091020", datetime(2009, 10, 20)),
        ("2009102006", datetime(2009, 10, 20, 6)),
        (200910200630, datetime(2009, 10, 20, 6, 30)),
        ("20091020063015", datetime(2009, 10, 20, 6, 30, 15)),
        ("2009-10-20T06:00", "2009-10-20T06:00"),
        (None, None),
    ],
)
def test_times_of_digits_are_dates_and_not_seconds(written, meant):
    assert spelt_out(written) == meant


@pytest.mark.parametrize("written", [-1, 1, 0.5, "1256018400", "20091320", "2009", True, "1e9"])
def test_numbers_that_are_no_time_are_refused(written):
    with pytest.raises(ValueError, match="is not a time"):
        spelt_out(written)


@pytest.mark.parametrize(
    "value",
    [
        *("x" * 10**6, "a\nb\tc\x00d", [["deep"] * 50] * 50, {n: n for n in range(10**4)}),
        *(10**6000, [10**6000], b"\xff" * 10**5, "‮", object()),
    ],
    ids=range(9),
)
def test_messages_are_short_lines(value):
    parts = {"file": value, "field": "f" * 9000, "found": value, "remedy": "r" * 999}
    text = str(InputError(str(shortened(value)), **parts))
    assert len(text) <= LONGEST
    assert text.isprintable()


def test_short_text_is_unchanged():
    assert shortened("two  blanks") == "two  blanks"
    error = ConfigError("unknown key; did you mean 'pool'?", file="c.yaml", field="pol", found=3)
    assert str(error) == "c.yaml: pol: unknown key; did you mean 'pool'? (found: 3)"


def test_errors_travel_between_processes():
    error = InputError("wrong", file="f", found=[1, 2], remedy="Correct it")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.found) == (str(error), [1, 2])
