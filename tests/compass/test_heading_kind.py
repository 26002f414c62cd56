"""Offsets of a whole fleet that are the declination: headings of the other kind."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from airswing import workflow
from airswing.compass.plausibility import taken_for
from airswing.config_file import load_config
from airswing.evaluation.results import Evaluation
from airswing.products.netcdf import read_product
from airswing.synthetic.mode_s import write_mode_s
from airswing.workflow.progress import Progress


@pytest.mark.parametrize(
    ("sign", "expected"), [(-1.0, "magnetic_for_true"), (1.0, "true_for_magnetic"), (0.0, "")]
)
def test_offsets_equal_to_the_declination_are_recognised(sign, expected):
    rng = np.random.default_rng(4)
    for _ in range(50):
        declination = rng.uniform(-14, -7) + rng.normal(0, 1, 8)
        offset = rng.normal(0, 0.7) + rng.normal(0, 0.7, 8) + sign * declination
        assert taken_for(offset, np.full(8, 0.3), declination) == expected


def test_a_small_declination_or_one_aircraft_shows_nothing():
    # Netherlands 2017, 0.9 degrees east: offsets of Mode-S aircraft are as large
    rng = np.random.default_rng(5)
    for _ in range(50):
        offset = rng.normal(0, 1.0) + rng.normal(0, 0.7, 50)
        assert not taken_for(offset, np.full(50, 0.2), np.full(50, 0.9))
    assert taken_for([12.0], [0.1], [-12.0]) == "magnetic_for_true"
    assert not taken_for([3.0], [0.1], [-3.0])


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mode_s")
    write_mode_s(folder, flights=10)
    return folder


@pytest.fixture
def numbers_only(blank_cards, monkeypatch):
    """No cards, no evaluation and no page: what a run says comes before them."""
    monkeypatch.setattr("airswing.workflow.main.make_evaluation", lambda *_: Evaluation())
    monkeypatch.setattr("airswing.workflow.main.make_page", lambda *_: None)


def summary_of(folder: Path, table: Path, columns: dict) -> tuple[dict, Path]:
    output = folder / f"results_{table.stem}_{len(columns)}"
    config = {
        "reports": {"files": str(table), "interval": "60 s", "columns": columns},
        "references": {"era5": {"files": str(folder / "era5.nc")}},
        "screening": {"phases": ["ascent", "cruise", "descent", "unknown"]},
        "fit": {"min_reports": 100},
        "output": str(output),
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(config))
    return workflow.run_job(workflow.Job(load_config(path), Progress(quiet=True))).summary, output


def test_headings_as_they_are_give_the_truth_and_no_warning(archive, numbers_only):
    right, output = summary_of(archive, archive / "mode_s.csv", {})
    assert not any("declination" in line for line in right["warnings"])
    fits = read_product(output / "fits.nc").isel(reference=0)
    truth = {"a00004": 2.1, "a00005": -1.4, "a00006": 0.9}
    for name, offset in truth.items():
        one = fits.sel(aircraft=name)
        assert float(one["offset"]) == pytest.approx(
            offset, abs=3 * float(one["offset_standard_error"])
        )


def test_a_run_warns_of_magnetic_headings_taken_for_true(archive, blank_cards, monkeypatch):
    monkeypatch.setattr("airswing.workflow.main.make_evaluation", lambda *_: Evaluation())
    wrong, output = summary_of(archive, archive / "mode_s.csv", {"heading": "heading_deg"})
    (line,) = [line for line in wrong["warnings"] if "declination" in line]
    assert "headings taken for true are magnetic" in line
    assert "magnetic_heading_deg" in (output / "report" / "index.html").read_text()
