"""Archives: exact without noise, of the size requested, ready to run; the shipped sample."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from tests.compass.flown import wrap
from tests.gap.toy import EXACT

from airswing.config_file import load_config
from airswing.synthetic import simulate_arrays, write_archive
from airswing.synthetic.quickstart import write_quickstart
from airswing.synthetic.truth import fleet_deviations

SMALL = {"days": 2, "aircraft": 3, "seed": 5}
MONTH = {"days": 8, "aircraft": 5, "seed": 4, "columns": 30, "rows": 23, "spacing_km": 62.0}


@pytest.fixture(scope="module")
def month():
    return simulate_arrays(**MONTH)


def disagreement(frame, name):
    """Mean vector disagreement with a model, kt."""
    u, v = (frame[component] - frame[f"{component}_{name}"] for component in "uv")
    return float(np.nanmean(np.hypot(u, v)) * 3600 / 1852)


def test_without_faults_and_noise_the_true_wind_is_reported():
    frame = simulate_arrays(**SMALL, coding=EXACT)
    assert np.abs(frame["u"] - frame["true_u"]).max() < 1e-6
    assert np.abs(frame["v"] - frame["true_v"]).max() < 1e-6


def test_the_disagreement_agrees_with_the_published_one(month):
    """6 kt with perfect compasses; one degree of heading on all of it adds a knot or so."""
    assert 5.0 < disagreement(month, "ruc") < 7.0 and 5.0 < disagreement(month, "rtfdaa") < 7.0
    effects = [{"name": "hard_iron", "tails": None, "parameters": {"amplitude_deg": 2.2}}]
    assert 7.0 < disagreement(simulate_arrays(**MONTH, effects=effects), "ruc") < 9.0


def test_density_coverage_and_flags(month):
    per_day = len(month) / 8 / 5
    assert 150 < per_day < 260
    heading = np.degrees(month["true_heading"]) % 360
    octants = np.bincount((np.round(heading / 45) % 8).astype(int), minlength=8) / len(month)
    assert octants.min() > 0.02
    assert 0.02 < month["icing"].mean() < 0.2
    assert 0.002 < (month["roll_flag"] == "B").mean() < 0.1
    assert month["u_ruc"].notna().mean() > 0.97
    assert set(month["phase"]) == {1, 2, 3}


def test_a_shuttle_flies_one_route_and_leaves_the_others_as_they_were():
    frame = simulate_arrays(**SMALL)
    shuttled = simulate_arrays(**SMALL, shuttles=1)
    for tail in ("N401", "N402"):
        old, new = (archive[archive["tail"] == tail] for archive in (frame, shuttled))
        np.testing.assert_allclose(old["true_heading"], new["true_heading"], atol=1e-6)
    cruise = shuttled[(shuttled["tail"] == "N403") & (shuttled["phase"] == 2)]
    points = np.round(np.degrees(cruise["true_heading"]) / 45.0).to_numpy() % 8
    assert np.unique(points).size <= 4


def test_written_archive_is_the_simulated_one_and_ready_to_run(tmp_path):
    options = SMALL | {"columns": 24, "rows": 20, "spacing_km": 75.0}
    config = write_archive(tmp_path, **options)
    frame = simulate_arrays(**options, effects=fleet_deviations(["N401", "N402", "N403"], 5))
    files = sorted((tmp_path / "reports").glob("*.csv"))
    table = pd.concat([pd.read_csv(path) for path in files], ignore_index=True)
    assert len(table) == len(frame)
    np.testing.assert_array_equal(table["wind_direction_deg"], frame["direction"])
    np.testing.assert_array_equal(table["wind_speed_kt"], frame["speed"])
    np.testing.assert_allclose(table["latitude"], frame["latitude"], atol=5.1e-5)
    assert (pd.to_datetime(table["time"]).dt.tz_localize(None) == frame["time"]).all()
    settings = load_config(config)
    assert set(settings.references) == {"ruc", "rtfdaa"}
    assert all(Path(pattern).parent.is_dir() for pattern in settings.references["ruc"].files)
    truth = json.loads((tmp_path / "truth" / "truth.json").read_text())
    mine = (effect for effect in truth["effects"] if effect["tails"] == ["N402"])
    asked = {effect["name"]: effect["parameters"] for effect in mine}
    curve = truth["aircraft"]["N402"]["deviation"]
    assert curve["A"] == pytest.approx(asked["compass_offset"]["offset_deg"], abs=0.01)
    size = np.hypot(curve["B"], curve["C"])
    assert size == pytest.approx(asked["hard_iron"]["amplitude_deg"], rel=0.05)
    assert "truth" not in config.read_text()


def test_field_test_units_apply_their_tables(tmp_path):
    options = {"aircraft": 2, "seed": 6}
    options["effects"] = [{"name": "hard_iron", "parameters": {"amplitude_deg": 5.0}}]
    frame = simulate_arrays(**options, days=4, coding=EXACT, field_test=(2, ("N401",)))
    error = wrap(np.degrees(frame["heading"] - frame["true_heading"]))
    after = frame["time"] >= "2009-03-03"
    treated = frame["tail"] == "N401"
    assert error[treated & after].std() < 0.6
    assert error[treated & ~after].std() > 2.0
    assert error[~treated & after].std() > 2.0
    options |= {"columns": 20, "rows": 16, "spacing_km": 90.0}
    config = write_archive(tmp_path, **options, days=1, field_test=(0, ("N401",)))
    section = yaml.safe_load(config.read_text())["field_test"]
    assert (section["corrected"], section["controls"]) == (["N401"], ["N402"])


def test_the_command_writes_the_committed_files(root, tmp_path):
    """The same files; a value in a thousand may round the other way on another machine."""
    sample = root / "data_samples"
    assert sum(path.stat().st_size for path in sample.rglob("*") if path.is_file()) < 8_000_000
    written = write_quickstart(tmp_path)
    names, rewritten_names = (
        {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
        for folder in (sample, written)
    )
    assert names - {Path("README.md")} == rewritten_names
    for folder in ("reports", "field_test"):
        for path in sorted((sample / folder).glob("*.csv")):
            committed, rewritten = pd.read_csv(path), pd.read_csv(written / folder / path.name)
            assert len(committed) == len(rewritten)
            for column in ("time", "flight", "wind_speed_kt", "wind_direction_deg"):
                assert (committed[column] == rewritten[column]).mean() > 0.999
    truths = (folder / "truth" / "truth.json" for folder in (sample, written))
    committed, rewritten = (json.loads(path.read_text()) for path in truths)
    assert committed["effects"] == rewritten["effects"]
    for tail, values in committed["aircraft"].items():
        for name, value in values["deviation"].items():
            assert rewritten["aircraft"][tail]["deviation"][name] == pytest.approx(value, abs=1e-3)
