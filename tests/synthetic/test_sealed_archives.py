"""Sealed archives: strengths, true closures, and errors of real sensors."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from airswing.gap.effects import CATALOGUE
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.sealed import sealed_archives as archives
from airswing.synthetic.sealed.cases import Case
from airswing.synthetic.sealed.draws import Drawn, World
from airswing.synthetic.sealed.sealed_archives import (
    Archivist,
    sensor_record,
    write_model_case,
)

TINY = World(3, "default", 3, 3, coarse=True)
KNOT = 1852.0 / 3600.0


def drawn(name, tails, **parameters):
    one = {"name": name, "tails": tails, "parameters": parameters, "period": None}
    return Drawn(name, (one,), CATALOGUE[name].draw)


def test_the_true_closure_is_that_of_the_twin_without_the_effect(tmp_path):
    archivist = Archivist(tmp_path)
    effect = drawn("tas_offset", None, offset_m_s=1.0)
    label = archivist.write(Case("case_1", 1, "single", TINY, (effect,), (3.0,)))
    options = archives.generator_options(TINY)
    with_it = simulate_arrays(effects=label["effects"], **options)
    without = simulate_arrays(effects=[], **options)
    for name, frame in (("before", with_it), ("after", without)):
        u, v = (frame[c] - (frame[f"{c}_ruc"] + frame[f"{c}_rtfdaa"]) / 2 for c in "uv")
        used = (frame["temperature_qc"] == "pass") & u.notna()
        assert label["closure"][name] == pytest.approx(np.hypot(u, v)[used].mean() / KNOT, rel=1e-9)
    assert label["closure"]["before"] > label["closure"]["after"] + 0.3


def record(seconds=3000, noise=0.5, seed=0):
    """A made-up G1000 record: circles in a steady wind, a deviation curve, known noise."""
    rng = np.random.default_rng(seed)
    heading = np.radians(np.arange(seconds) * 0.7 % 360)
    error = np.radians(2.0 + 3.0 * np.sin(heading) + noise * rng.normal(size=seconds))
    true = heading - error
    east = 60.0 * np.sin(true) + 5.0
    north = 60.0 * np.cos(true) - 8.0
    return pd.DataFrame(
        {
            "HDG": np.degrees(heading),
            "TRK": np.degrees(np.arctan2(east, north)) % 360,
            "TAS": np.full(seconds, 60.0 / KNOT),
            "GndSpd": np.hypot(east, north) / KNOT,
            "AltMSL": np.full(seconds, 3000.0) + np.arange(seconds) % 7,
            "Roll": np.zeros(seconds),
        }
    )


def test_residuals_of_a_record_are_its_noise_without_its_deviation():
    noisy, silent = sensor_record(record(noise=0.5)), sensor_record(record(noise=0.0))
    assert np.degrees(noisy.heading_error).std() == pytest.approx(0.5, rel=0.06)
    assert np.degrees(np.abs(silent.heading_error)).max() < 0.06
    bins = (np.mod(noisy.magnetic, 2 * np.pi) / (2 * np.pi) * 36).astype(int)
    for error in (noisy.heading_error, noisy.airspeed_error):
        means = np.bincount(bins, error) / np.bincount(bins)
        assert np.abs(means).max() < 1e-12


def test_an_outside_case_takes_the_first_draw_that_no_name_explains(tmp_path):
    def one(part, component="across_heading"):
        parameters = {
            "component": component,
            "parts": [part],
            "shape": part["shape"],
            "size_m_s": 1.5,
            "sign": 1.0,
        }
        effect = {"name": "outside", "tails": None, "parameters": parameters, "period": None}
        return Drawn("outside", (effect,))

    always = {"variable": "airspeed", "shape": "hinge", "at": 0.0, "width": 0.1}
    cycle = {"variable": "magnetic_heading", "shape": "linear", "at": 0.3, "width": 0.1}
    saw = {"variable": "hour", "shape": "saw", "at": 0.1, "width": 0.26}
    case = Case(
        "case_1",
        4,
        "outside",
        TINY,
        (one(cycle),),
        (1.5,),
        (),
        "saw",
        (one(always, "along_heading"), one(saw)),
    )
    label = Archivist(tmp_path).write(case)
    truth = label["outside"]
    assert truth["variables"] == ["hour"] and truth["named_share"] < 0.35
    assert label["size"] == truth["size_m_s"] == pytest.approx(1.5, rel=0.02)
    assert truth["carried"]["hour"] > 0.6  # bins smooth its edges
    closed = label["closure"]["before"] - label["closure"]["after"]
    assert truth["closes_kt"] == pytest.approx(closed, abs=0.02)
    assert label["closure"]["before"] > label["closure"]["after"]


def test_closure_of_a_case_on_a_real_run(real, tmp_path):
    """Six degrees at some 135 m/s are 27 kt across every wind; the run adds its error."""
    data = real("grib/wrf_ruc13_g212").parents[1]
    effect = {"name": "compass_offset", "parameters": {"offset_deg": 6.0}, "tails": None}
    closure = write_model_case(tmp_path, data, [effect], World(4, "model", 1, 2))
    assert closure["before"] > 27.0 > 10.0 > closure["after"] > 0.5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.yaml", "reports"]
