"""A case on a real forecast run: what its truth closes, and what it leaves behind."""

from __future__ import annotations

import yaml

from airswing.synthetic.sealed.cases import World
from airswing.synthetic.sealed.injection import write_model_case


def test_a_case_on_a_real_run_knows_what_its_effects_close(real, tmp_path):
    data = real("grib/wrf_ruc13_g212").parents[1]
    effect = {"name": "compass_offset", "parameters": {"offset_deg": 6.0}, "tails": None}
    closure = write_model_case(tmp_path, data, [effect], World(4, "model", 1, 2))
    # Six degrees at some 135 m/s are 27 kt across every wind, beside the run's own error.
    assert closure["before"] > 27.0 > 10.0 > closure["after"] > 0.5
    assert not (tmp_path / "truth").exists()
    config = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert config["output"] == str(tmp_path / "results")
    assert len(list((tmp_path / "reports").glob("*.csv"))) == 2
