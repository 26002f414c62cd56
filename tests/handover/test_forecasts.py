"""Forecasts corrected after the fact: real stations, real GRIB, and nothing from the future."""

import json
import math

import numpy as np
import pandas as pd
import pytest
import xarray as xr
import yaml
from pyproj import Proj

from airswing.config_file import load_postprocess
from airswing.errors import ConfigError, InputError
from airswing.handover.forecasts.correcting import (
    DIMS,
    TIME,
    correct_forecasts,
    kalman_bias,
    running_mean,
    score_forecasts,
    station_distribution,
)
from airswing.handover.forecasts.forecast_pairs import flight_level_pairs, pairs_from_tables
from airswing.handover.forecasts.stations import forecasts_at_stations, pairs_at_stations
from airswing.products.netcdf import read_product
from airswing.report.forecast_page import write_forecast_page
from tests.command import airswing
from tests.handover.archives import corrected
from tests.ragged import ragged


def pairs(errors, *, first="2009-01-01", step="1D", leads=(12.0,), variable="air_temperature"):
    """Pairs of one variable from errors (station, start, lead), the observation 280 throughout."""
    errors = np.asarray(errors, dtype=float)[None]
    starts = pd.date_range(first, periods=errors.shape[2], freq=step).to_numpy("datetime64[ns]")
    observation = np.full_like(errors, 280.0)
    return xr.Dataset(
        {
            "forecast": (DIMS, observation + errors),
            "observation": (DIMS, observation),
            "variable_units": ("variable", ["K"]),
        },
        coords={
            "variable": [variable],
            "station": [f"S{i}" for i in range(errors.shape[1])],
            TIME: starts,
            "lead": list(leads),
        },
    )


def test_as_good_as_a_published_filter(real):
    raw = pairs_from_tables([real("stations/verif_raw.txt")])
    public = pairs_from_tables([real("stations/verif_kf.txt")])
    ours = correct_forecasts(raw)
    spread = {
        "raw": float((raw["forecast"] - raw["observation"]).std()),
        "public": float((public["forecast"] - public["observation"]).std()),
        "here": float((ours["corrected_forecast"] - ours["observation"]).std()),
    }
    assert (raw.sizes["lead"], raw.sizes[TIME]) == (25, 61)
    assert spread["raw"] == pytest.approx(2.67, abs=0.005)
    assert spread["public"] == pytest.approx(1.17, abs=0.005)
    assert spread["here"] < 1.03 * spread["public"]
    assert int(ours["ratio_chosen"][0]) == 1
    assert int(ours["held_out"].sum()) in (30, 31)


def test_command_writes_product_and_page(real, tmp_path):
    config = tmp_path / "config.yaml"
    section = {"pairs": {"files": str(real("stations/verif_raw.txt"))}}
    config.write_text(yaml.safe_dump({"postprocess": section, "output": str(tmp_path / "out")}))
    done = airswing("postprocess", config, "--json", "--quiet")
    output = json.loads(done.stdout)["variables"]["air_temperature"]
    assert output["kalman"]["rms"]["value"] < output["running_mean"]["rms"]["value"] < 1.3
    low, high = output["kalman"]["skill"]["ci"]
    assert 0.0 < low < output["kalman"]["skill"]["value"] < high < 1.0
    product = read_product(tmp_path / "out" / "postprocessed.nc")
    assert str(product["variable_units"].item()) == "degC"
    valid = product["valid_time"].isel({TIME: 0}).sel(lead=12.0).item()
    assert pd.Timestamp(valid) == pd.Timestamp("2012-01-01T12:00")
    for name in ("forecast", "corrected_forecast", "observation"):
        assert product[name].dims == DIMS
        assert bool(product[name].notnull().all())
    page = (tmp_path / "out" / "postprocess" / "index.html").read_text()
    assert page.count("<figure>") == 1 and "running mean" in page
    single = correct_forecasts(pairs(np.ones((1, 60, 1))))
    page = write_forecast_page(tmp_path, single.merge(score_forecasts(single))).read_text()
    assert 'id="scores"' in page and 'id="figures"' not in page


def test_nothing_observed_after_the_start_is_used():
    rng = np.random.default_rng(0)
    leads = (0.0, 24.0, 25.0, 48.0, 60.0)
    errors = rng.normal(size=(1, 40, len(leads)))
    reference = correct_forecasts(pairs(errors, leads=leads), ratio=0.1)
    start = 30
    for index, lead in enumerate(leads):
        later = errors.copy()
        valid = np.arange(40) * 24.0 + lead
        unknown = valid > start * 24.0
        later[0, unknown, index] += 100.0
        changed = correct_forecasts(pairs(later, leads=leads), ratio=0.1)
        bias = [ds["forecast"] - ds["corrected_forecast"] for ds in (reference, changed)]
        at = {"lead": index, TIME: slice(None, start + 1)}
        np.testing.assert_array_equal(bias[0].isel(at), bias[1].isel(at))
        # And the last error that is known is used.
        complete = errors.copy()
        complete[0, np.flatnonzero(~unknown & (np.arange(40) < start))[-1], index] += 100.0
        changed = correct_forecasts(pairs(complete, leads=leads), ratio=0.1)
        bias_change = changed["forecast"] - changed["corrected_forecast"]
        assert float(bias_change.isel({"lead": index, TIME: start}).squeeze()) > 5.0


def test_a_variable_the_filter_would_make_worse_is_unchanged(tmp_path):
    rng = np.random.default_rng(4)
    noise = pairs(rng.normal(size=(1, 60, 1)))
    biased = pairs(rng.normal(size=(1, 60, 1)) + 2.0, variable="wind_speed")
    result = correct_forecasts(xr.concat([noise, biased], "variable"))
    assert result["ratio"].to_numpy()[0] == 0.0 < result["ratio"].to_numpy()[1]
    assert result["ratio_chosen"].to_numpy().tolist() == [1, 1]
    uncorrected, corrected_variable = (result.isel(variable=k) for k in (0, 1))
    np.testing.assert_array_equal(uncorrected["corrected_forecast"], uncorrected["forecast"])
    judged = corrected_variable.isel({TIME: slice(30, None)})
    error = judged["corrected_forecast"] - judged["observation"]
    assert abs(float(error.mean())) < 0.5
    forced = correct_forecasts(noise, ratio=0.06)
    assert not np.allclose(forced["corrected_forecast"], forced["forecast"])


def test_scores_by_hand():
    ds = pairs(np.array([[[1.0], [3.0]]])).assign(
        corrected_forecast=(DIMS, 280.0 + np.array([[[[1.0], [-1.0]]]])),
        running_mean_forecast=(DIMS, 280.0 + np.array([[[[0.0], [2.0]]]])),
        held_out=(TIME, np.array([1, 1], dtype=np.int8)),
    )
    scored = score_forecasts(ds).isel(variable=0).sel(period="held_out")
    np.testing.assert_allclose(scored["forecast_error_mean"], [2.0, 0.0, 1.0])
    np.testing.assert_allclose(scored["forecast_error_centred_rms"], [1.0, 1.0, 1.0])
    np.testing.assert_allclose(scored["forecast_error_rms"], np.sqrt([5.0, 1.0, 2.0]))
    np.testing.assert_allclose(scored["skill"], [0.0, 1 - 1 / 5, 1 - 2 / 5])
    assert int(scored["pair_count"]) == 2


def test_scores_of_stations_have_intervals_by_days():
    """One station helped, one harmed, one with nothing to correct and one without pairs."""
    rng = np.random.default_rng(3)
    errors = 0.3 * rng.normal(size=(4, 60, 2))
    errors[0] += 2.0
    errors[1] += np.where(np.arange(60) % 2 < 1, 1.0, -1.0)[:, None] * 3.0
    errors[3] = np.nan
    forecasts = correct_forecasts(pairs(errors, leads=(12.0, 36.0)), ratio=0.4)
    scored = score_forecasts(forecasts)
    dims = ("variable", "correction", "station", "bound")
    assert scored["skill_by_station_interval"].dims == dims
    kalman = scored.isel(variable=0).sel(correction="kalman")
    low, high = kalman["skill_by_station_interval"].to_numpy().T
    skill = kalman["skill_by_station"].to_numpy()
    assert ((low <= skill) & (skill <= high))[:3].all() and np.isnan(low[3])
    assert low[0] > 0.9 and high[1] < 0.0
    stations = station_distribution(scored, "air_temperature", "kalman")
    assert stations["stations"] == 3 and stations["worst_station"] == f"S{skill[:3].argmin()}"
    assert stations["surely_better"] == pytest.approx(1 / 3) and stations["surely_worse"] >= 1 / 3
    assert stations["rms_ratio_quantiles"][-1] == pytest.approx(np.sqrt(1.0 - skill[:3].min()))
    # The interval of a single station is that of all pairs where there is one station.
    single = score_forecasts(forecasts.isel(station=[0]))
    interval = single["skill_interval"].sel(period="held_out", correction="kalman")[0]
    np.testing.assert_allclose(interval, kalman["skill_by_station_interval"][0], rtol=1e-12)


@pytest.fixture
def wrf(real):
    """Files of a real run."""
    return sorted(real("grib/wrf_ruc13_g212").iterdir())


def test_grib_at_grid_points_is_the_grids_value_turned_to_true_north(wrf):
    """Against cfgrib's values and pyproj's meridian convergence, both independent."""
    rows, columns, value = np.array([40, 64, 100]), np.array([30, 92, 160]), {}
    for name in ("2t", "10u", "10v"):
        keys = {"typeOfLevel": "heightAboveGround", "shortName": name}
        options = {"indexpath": "", "filter_by_keys": keys}
        ds = xr.open_dataset(wrf[0], engine="cfgrib", backend_kwargs=options)
        value[name] = next(iter(ds.data_vars.values())).to_numpy()[rows, columns]
    lat, lon = (ds[name].to_numpy()[rows, columns] for name in ("latitude", "longitude"))
    stations = pd.DataFrame({"station": list("abc"), "latitude": lat, "longitude": lon})
    table, skipped = forecasts_at_stations(wrf[:1], stations)
    forecasts = table.pivot(index="variable", columns="station", values="forecast")
    projected = Proj("+proj=lcc +lat_1=25 +lat_2=25 +lat_0=25 +lon_0=-95 +R=6367470")
    # pyproj counts the convergence from true to grid north, clockwise.
    angle = np.radians(projected.get_factors(lon, lat).meridian_convergence)
    u, v = value["10u"], value["10v"]
    expected = {
        "air_temperature": value["2t"],
        "eastward_wind": np.cos(angle) * u + np.sin(angle) * v,
        "northward_wind": -np.sin(angle) * u + np.cos(angle) * v,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(forecasts.loc[name], values, atol=0.02)
    assert abs(angle).max() > 0.05 and skipped == {}


def test_grib_forecasts_meet_observations(wrf, tmp_path):
    stations = tmp_path / "stations.csv"
    stations.write_text(
        "id,lat,lon,time,temperature_degC,wind_speed_kt,wind_direction_deg\n"
        "ORD,41.98,-87.9,2005-08-07T12:10:00Z,20,10,210\n"
        "ORD,41.98,-87.9,2005-08-07T18:00:00Z,-999,0,0\n"
        "ORD,41.98,-87.9,2005-08-07T20:00:00Z,20,900,10\n"
        "NRT,35.76,140.4,2005-08-07T12:00:00Z,25,3,90\n"
    )
    ds = pairs_at_stations(wrf, [stations])
    at = ds["observation"].sel(station="ORD")
    for expected, variable, lead, start in (
        (293.15, "air_temperature", 12.0, 0),
        (5 * 1852 / 3600, "eastward_wind", 12.0, 0),
        (75**0.5 * 1852 / 3600, "northward_wind", 12.0, 0),
        (0.0, "wind_speed", 18.0, 0),
        (np.nan, "air_temperature", 18.0, 0),
        (np.nan, "wind_speed", 21.0, 0),
        (293.15, "air_temperature", 0.0, 1),
    ):
        observation = at.isel({TIME: start}).sel(variable=variable, lead=lead).item()
        assert observation == pytest.approx(expected, nan_ok=True), (variable, lead)
    output = ds.attrs["lines_left_out"]
    assert output["stations without a forecast: NRT"] == 1
    assert output["wind_speed out of range"] == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a table without lines"),
        ("station,start,lead,forecast\nA,2009-01-01,3,1\n", "no column observation"),
        ("station,start,lead,forecast,observation\nA,bad,3,1,2\n", "no pair of forecast"),
        ("station,start,lead,forecast,observation\nA,2009-01-01,3,-999,2\n", "no pair"),
        ("station,start,lead,forecast,observation,lead\nA,2009-01-01,3,1,2,3\n", "two columns of"),
        ("just some words\nthat are no table at all\n", "not a table"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, message):
    file = tmp_path / "pairs.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=f"{file}.*{message}"):
        pairs_from_tables([file])


def test_bad_lines_are_counted_and_others_kept(tmp_path):
    file = tmp_path / "pairs.csv"
    file.write_text(
        "id;valid_time;lead;fcst;obs;variable;units\n"
        "A;2009-01-01 12:00;12;281;280;T;K\n"
        "A;2009010112;12;282;280;T;K\n"
        "A;never;12;282;280;T;K\n"
        "A;2009-01-02 12:00;12\n"
        "A;20090104;24;283;nan;T;K\n"
    )
    ds = pairs_from_tables([file])
    days = ds[TIME].to_numpy().astype("datetime64[D]").astype(str)
    assert days.tolist() == ["2009-01-01", "2009-01-03"]
    assert ds["forecast"].isel({TIME: 0, "lead": 0}).item() == 282.0
    assert sum(ds.attrs["lines_left_out"].values()) == 3


def test_a_configuration_needs_a_source(tmp_path):
    config = tmp_path / "config.yaml"
    for section, message in (
        ({}, "no forecasts to correct"),
        ({"postprocess": {}}, "one of pairs, forecasts with"),
        ({"postprocess": {"forecasts": {"files": "x"}}}, "stations is missing"),
        ({"postprocess": {"pair": {"files": "x"}}}, "did you mean 'pairs'"),
        ({"postprocess": {"pairs": {"files": "x", "colums": {}}}}, "did you mean 'columns'"),
    ):
        config.write_text(yaml.safe_dump({"output": "x"} | section))
        with pytest.raises(ConfigError, match=message):
            load_postprocess(config)


def by_hand(errors, ratio):
    """The equations of Delle Monache et al. (2006) for one series, with scalars and a list."""
    first = (4 + ratio) / (5 + ratio)
    x, noise, p, last = 0.0, None, None, None
    p_s, bias, wait = 1.0, [], 0
    for error in errors:
        wait += 1
        if math.isnan(error):
            if p is not None:
                p += ratio * noise
            bias.append(x)
            continue
        if last is None:
            x = first * error
        else:
            z = (error - last) ** 2 / (2 + wait * ratio)
            if noise is None:
                noise, p = z, z * (first + ratio * (wait - 1))
            else:
                b_s = (p_s + 0.0005) / (p_s + 0.0005 + 1.0)
                p_s = (p_s + 0.0005) * (1 - b_s)
                noise += b_s * (z - noise)
            gain = (p + ratio * noise) / (p + ratio * noise + noise)
            p = (p + ratio * noise) * (1 - gain)
            x += gain * (error - x)
        last, wait = error, 0
        bias.append(x)
    return np.array(bias)


def test_series_one_by_one():
    rng = np.random.default_rng(3)
    errors = rng.normal(1.0, 2.0, (5, 3, 40))
    errors[rng.uniform(size=errors.shape) < 0.2] = np.nan
    errors[0, 0] = np.nan
    ratio = np.array([0.02, 0.06, 0.4])
    bias = kalman_bias(errors, ratio)
    for place in np.ndindex(5, 3):
        wanted = by_hand(errors[place].tolist(), ratio[place[1]])
        np.testing.assert_allclose(bias[place], wanted, rtol=1e-12)


def test_running_mean_by_hand():
    mean = running_mean(np.array([1.0, np.nan, 3.0, 5.0, np.nan, np.nan, np.nan]), 3)
    np.testing.assert_allclose(mean, [1.0, 1.0, 2.0, 4.0, 4.0, 5.0, np.nan])


def in_two_places(longitudes, latitudes):
    """Winds of one aircraft; the model's eastward wind is too strong at the first place."""
    ds = corrected({"A": 36})
    west = np.arange(36) % 2 == 0
    ds["longitude"] = ("report", np.where(west, *longitudes))
    ds["latitude"] = ("report", np.where(west, *latitudes))
    hours = 24 * np.repeat(np.arange(3), 12) + np.tile(np.arange(12), 3)
    start = np.datetime64("2008-07-01T03:00", "ns")
    ds["time"] = ("report", start + hours * np.timedelta64(1, "h"))
    u = ds["corrected_eastward_wind"].to_numpy() + np.where(west, 2.0, 0.0)
    v = ds["corrected_northward_wind"].to_numpy()
    references = {"reference_eastward_wind": u[None], "reference_northward_wind": v[None]}
    return ds.assign(ragged(references, reference=["ruc"])), ds


def test_neighbouring_narrow_boxes_have_different_names():
    winds = in_two_places((179.02, 179.13), (42.0, 42.0))
    result = flight_level_pairs(*winds, ["ruc"], region=0.11, fewest=6)
    names = [f"0450_hPa_41.965N_{east}E" for east in (179.025, 179.135)]
    assert result["station"].values.tolist() == names


def test_boxes_by_hand():
    winds = in_two_places((-93.0, 179.0), (42.0, -3.0))
    result = flight_level_pairs(*winds, ["ruc"], region=5.0, fewest=6)
    assert result.sizes == {"variable": 2, "station": 2, TIME: 3, "lead": 1}
    east = result.sel(station="0450_hPa_42.5N_92.5W", variable="eastward_wind")
    np.testing.assert_allclose(east["forecast"] - east["observation"], 2.0)
    assert east["pressure"].item() == 45_000.0
    assert (east["latitude"].item(), east["longitude"].item()) == (42.5, -92.5)
    eastern = result.sel(station="0450_hPa_2.5S_177.5E", variable="eastward_wind")
    np.testing.assert_allclose(eastern["forecast"], eastern["observation"])
