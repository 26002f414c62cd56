"""A day flown through a real model run: the truth is the run plus its real error."""

from __future__ import annotations

import json
from pathlib import Path

import eccodes
import numpy as np
import pytest

import airswing
from airswing.synthetic import real_winds

GRIB = "grib/wrf_ruc13_g212"


def test_the_run_is_read_as_eccodes_reads_it(real) -> None:
    folder = real(GRIB)
    run, error, start = real_winds.read_run(folder)
    assert start.isoformat() == "2005-08-07T00:00:00"
    assert run.hours.tolist() == list(range(0, 25, 3))
    assert run.wind.shape[3:] == (129, 185)
    with (folder / "2005080700_wrfprs_ruc13_12.tm00_G212").open("rb") as source:
        while (handle := eccodes.codes_grib_new_from_file(source)) is not None:
            if (eccodes.codes_get(handle, "shortName"), eccodes.codes_get(handle, "level")) == (
                "v",
                500,
            ):
                break
            eccodes.codes_release(handle)
    values = eccodes.codes_get_values(handle).reshape(129, 185)
    values[values == eccodes.codes_get(handle, "missingValue")] = np.nan
    latitude = eccodes.codes_get_array(handle, "latitudes").reshape(129, 185)
    eccodes.codes_release(handle)
    level = run.levels.tolist().index(500.0)
    np.testing.assert_allclose(run.wind[4, 1, level], values, atol=1e-4)
    np.testing.assert_allclose(run.grid.coordinates[0], latitude, atol=1e-4)
    assert np.isnan(values).mean() == pytest.approx(0.41, abs=0.01)
    assert 2.0 < np.nanstd(error.wind[0, 0, level]) < 3.0


def test_flights_see_independent_draws_of_the_error(real) -> None:
    run, error, _ = real_winds.read_run(real(GRIB))
    air = real_winds.RealAir(run, error, seed=3)
    flights = np.repeat(np.arange(60), 20)
    latitude = np.tile(np.linspace(37.0, 39.0, 20), 60)
    longitude = np.tile(np.linspace(-98.0, -95.0, 20), 60)
    pressure, hours = np.full(1200, 55000.0), np.full(1200, 12.0)
    air.draw(flights, latitude, longitude, pressure)
    seen = air.wind(flights, latitude, longitude, pressure, hours)
    plain = real_winds.sample_reference(run, latitude, longitude, pressure / 100, hours)
    drawn = (seen[0] - plain[0]).reshape(60, 20)
    assert np.isfinite(drawn).all()
    assert 1.5 < drawn.std() < 3.5
    assert np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1] > 0.8
    assert abs(np.corrcoef(drawn[:-1, 0], drawn[1:, 0])[0, 1]) < 0.35


@pytest.mark.slow
def test_the_whole_job_recovers_the_deviations(
    real, tmp_path: Path, blank_cards, monkeypatch
) -> None:
    """Every stage on real winds but the page, through two references of different leads."""
    real_winds.write_archive(tmp_path, real(GRIB), aircraft=6, seed=2)
    monkeypatch.setattr("airswing.workflow.main.make_page", lambda *_: None)
    fits = airswing.run(tmp_path / "config.yaml").fits
    truth = json.loads((tmp_path / "truth" / "truth.json").read_text())["aircraft"]
    tails = fits["aircraft"].values.astype(str)
    expected = np.array([[truth[tail]["deviation"][k] for k in "ABC"] for tail in tails])
    for reference in ("cycle_00", "cycle_12"):
        fit = fits.sel(reference=reference)
        assert (fit["status"] == 0).all()
        error = fit["deviation"].values[:, :3] - expected
        spread = np.sqrt(np.diagonal(fit["deviation_covariance"].values, 0, 1, 2))[:, :3]
        assert np.mean(np.abs(error) < 1.96 * spread) >= 0.75
        assert np.sqrt(np.mean(error**2)) < 0.6
