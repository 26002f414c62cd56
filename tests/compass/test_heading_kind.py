"""A run on Mode-S reports: the truth of its compasses, and headings that are mapped wrong."""

import pytest
import yaml

from airswing import workflow
from airswing.config_file import load_config
from airswing.evaluation.results import Evaluation
from airswing.products.netcdf import read_product
from airswing.synthetic.mode_s import write_mode_s
from airswing.workflow.progress import Progress


def test_a_run_finds_the_offsets_and_warns_of_magnetic_headings_taken_for_true(
    tmp_path, blank_cards, monkeypatch
):
    # no cards, no evaluation and no page: what a run says comes before them
    monkeypatch.setattr("airswing.workflow.main.make_evaluation", lambda *_: Evaluation())
    monkeypatch.setattr("airswing.workflow.main.make_page", lambda *_: None)
    write_mode_s(tmp_path, flights=10)
    warnings = []
    for output, columns in (("right", {}), ("wrong", {"heading": "heading_deg"})):
        config = {
            "reports": {
                "files": str(tmp_path / "mode_s.csv"),
                "interval": "60 s",
                "columns": columns,
            },
            "references": {"era5": {"files": str(tmp_path / "era5.nc")}},
            "screening": {"phases": ["ascent", "cruise", "descent", "unknown"]},
            "fit": {"min_reports": 100},
            "output": str(tmp_path / output),
        }
        path = tmp_path / "config.yaml"
        path.write_text(yaml.safe_dump(config))
        job = workflow.Job(load_config(path), Progress(quiet=True))
        said = workflow.run_job(job).summary["warnings"]
        warnings.append([line for line in said if "declination" in line])
    assert warnings[0] == []
    assert "headings taken for true are magnetic" in warnings[1][0] and len(warnings[1]) == 1
    fits = read_product(tmp_path / "right/fits.nc").isel(reference=0)
    for name, offset in {"a00004": 2.1, "a00005": -1.4, "a00006": 0.9}.items():
        one = fits.sel(aircraft=name)
        assert float(one["offset"]) == pytest.approx(
            offset, abs=3 * float(one["offset_standard_error"])
        )
