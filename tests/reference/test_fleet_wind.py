"""The wind of the fleet as a reference: an hour of Mode-S gives one offset an aircraft."""

import numpy as np
import pandas as pd
import pytest

import airswing
from airswing import workflow
from airswing.compass.fit.deviation import fit_deviation
from airswing.config_file import load_config
from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.reference.fleet_wind import fleet_wind
from airswing.workflow.progress import Progress
from tests.command import configured
from tests.compass.flown import wrap
from tests.ragged import ragged

START = np.datetime64("2017-01-11T12:00", "ns")


def wind_at(lat, lon, log_p, second):
    """Bent in height, so that a plane would not do."""
    height = 11.5 - log_p
    return np.stack(
        [
            20 + 2 * (lat - 52) + 10 * height + second / 900 + 2 * np.sin(3 * height),
            -15 + 3 * (lon - 5) - 6 * height + 0 * second,
        ]
    )


def an_hour(offset, seed=1):
    """Straight legs through the same air, one an aircraft, on headings of all directions."""
    rng = np.random.default_rng(seed)
    size, aircraft, speed = 120, offset.size, 220.0

    def per_report(values):
        return np.repeat(values, size)

    true = np.radians(per_report(np.linspace(0, 360, aircraft, endpoint=False) * 3.0))
    second = np.tile(np.arange(size) * 10.0, aircraft) + per_report(rng.uniform(0, 2000, aircraft))
    along = np.tile(np.linspace(-1, 1, size), aircraft)
    lat = 52.0 + per_report(rng.uniform(-0.4, 0.4, aircraft)) + along * np.cos(true)
    lon = 5.0 + per_report(rng.uniform(-0.6, 0.6, aircraft)) + 1.6 * along * np.sin(true)
    log_p = np.log(per_report(rng.uniform(20000, 40000, aircraft)))
    truth, shown = wind_at(lat, lon, log_p, second), true + np.radians(per_report(offset))
    air = np.stack([np.sin(true) - np.sin(shown), np.cos(true) - np.cos(shown)])
    reported = truth + speed * air + rng.normal(0, 1.0, truth.shape)
    columns = {
        "time": START + (second * 1e9).astype("timedelta64[ns]"),
        "latitude": lat,
        "longitude": lon,
        "pressure": np.exp(log_p),
        "eastward_wind": reported[0],
        "northward_wind": reported[1],
        "reported_heading": np.degrees(shown) % 360,
        "reported_airspeed": np.full(shown.size, speed),
    }
    return ragged(columns, np.full(aircraft, size)), truth


@pytest.mark.parametrize("east", [0.0, 175.0])
def test_the_fleet_wind_is_not_biased_by_single_offsets(east):
    rng = np.random.default_rng(3)
    offset = rng.normal(0.0, 1.5, 24)
    reports, truth = an_hour(offset)
    reports["longitude"] = wrap(reports["longitude"] + east)
    field = fleet_wind(reports)
    assert np.ptp(field["longitude"].to_numpy()) < 6.0
    ds = airswing.collocate(reports, {"fleet": field}).compute()
    wind = np.stack([ds[f"reference_{way}ward_wind"].to_numpy()[0] for way in ("east", "north")])
    inside = np.isfinite(wind[0])
    assert inside.mean() > 0.99
    error = (wind - truth)[:, inside]
    # an offset of 1.5 degrees is 5.8 m/s; the field is that of all, within a fifth of it
    assert np.sqrt((error**2).mean()) < 1.2
    assert np.abs(error.mean(axis=1)).max() < 0.5


def test_too_few_aircraft_are_refused():
    reports, _ = an_hour(np.zeros(4))
    with pytest.raises(InputError, match="too few aircraft"):
        fleet_wind(reports)


@pytest.mark.slow
def test_an_hour_of_mode_s_gives_an_offset_with_interval_an_aircraft(real, tmp_path):
    modes = real("modes/mpm_20170111_12z_aggregated.csv")
    phases = {"phases": ["ascent", "cruise", "descent", "unknown"]}
    reports, fleet = {"files": str(modes), "interval": "10 s"}, {"fleet": {"engine": "fleet"}}
    path = configured(tmp_path, reports, fleet, screening=phases)
    headings = workflow.make_headings(workflow.Job(load_config(path), Progress(quiet=True)))
    fits = fit_deviation(headings, min_reports=30).isel(reference=0)
    only = fits["status"].to_numpy() == STATUS["offset_only"]
    rows = pd.read_csv(modes).dropna(subset=["hdg", "gs_adsb"])["icao"].value_counts()
    named = fits["aircraft"].to_numpy()[only]
    often = set(rows.index[rows > 200]) & set(named)
    assert len(often) >= 45  # of the 51 that the file has; the rest turn or stand still
    offset = fits["offset"].to_numpy()[only]
    # by aircraft type 1.0 degree in the mean and 0.7 of scatter (de Haan 2016)
    assert 0.5 < np.median(offset) < 2.0
    assert 0.4 < np.median(np.abs(offset - np.median(offset))) / 0.6745 < 1.4
    wide = fits["offset_standard_error"].to_numpy()[only]
    assert 0.2 < np.median(wide) < 1.0
    assert np.isnan(fits["amplitude"].to_numpy()).all()
