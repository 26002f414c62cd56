"""Effects that are simulated, written and read are recovered, and their simulation agrees."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from pyproj import Geod
from tests.gap import frames
from tests.gap.frames import linear_residual

from airswing.compass.headings import derive_headings
from airswing.gap.archive.frame import Frame
from airswing.gap.effects import CATALOGUE, ActiveEffect
from airswing.gap.simulation.report_table import simulate_reports, write_reports
from airswing.reports.read import read_reports

KNOT = 1852.0 / 3600.0
PRESSURE = 46563.0  # of 20,000 ft in the standard atmosphere, Pa
EFFECTS = [
    ActiveEffect("hard_iron", {"amplitude_deg": 3.0, "phase_deg": 50.0}, ("N401",)),
    ActiveEffect("tas_scale", {"scale_percent": 2.0}, ("N401",)),
]


def flown(flights=40, reports=12, step=180.0):
    """Canonical table of two aircraft on straight legs in all directions; winds as the model's."""
    geod, rows, start = Geod(ellps="WGS84"), [], frames.START.astype("datetime64[s]")
    rng = np.random.default_rng(6)
    for tail in frames.TAILS[:2]:
        for leg in range(flights):
            speed = 130.0 + rng.normal(0.0, 5.0)
            track = 360.0 * leg / flights + rng.uniform(0.0, 9.0)
            lon, lat, seconds = -92.0, 41.0, leg * 7200
            for _ in range(reports):
                rows.append((tail, f"{tail}-{leg}", start + seconds, lat, lon))
                lon, lat, _ = geod.fwd(lon, lat, track, speed * step)
                seconds += int(step)
    table = pd.DataFrame(rows, columns=["tail", "flight", "time", "latitude", "longitude"])
    seconds = table["time"].to_numpy().astype("M8[ns]").astype(np.int64) / 1e9
    level = np.full(len(table), np.log(PRESSURE))
    u, v = frames.wind(seconds, table["latitude"].to_numpy(), table["longitude"].to_numpy(), level)
    return table.assign(
        pressure_altitude_ft=20000.0,
        wind_direction_deg=np.round(np.degrees(np.arctan2(-u, -v)) % 360.0),
        wind_speed_kt=np.round(np.hypot(u, v) / KNOT),
        phase="cruise",
    ).round({"latitude": 5, "longitude": 5})


def model(reports):
    """Analytic field as collocated winds."""
    seconds = reports.time.values.astype("datetime64[ns]").astype(np.int64) / 1e9
    place = (
        seconds,
        reports.latitude.values,
        reports.longitude.values,
        np.log(reports.pressure.values),
    )
    u, v = frames.wind(*place)
    pair = ("reference", "report")
    return xr.Dataset(
        {
            "reference_eastward_wind": (pair, u[None]),
            "reference_northward_wind": (pair, v[None]),
            "lead_time": (pair, np.full((1, u.size), 2.0)),
        },
        coords={"reference": ["ruc"]},
    )


def headings_of(path):
    reports = read_reports(path)
    return derive_headings(reports, model(reports))


@pytest.fixture(scope="module")
def sent(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loop")
    first = headings_of(write_reports(flown(), folder / "paths.csv"))
    table = simulate_reports(first, reference="ruc", effects=EFFECTS, seed=1)
    headings = headings_of(write_reports(table, folder / "sent.csv"))
    return Frame.from_headings(headings, reference="ruc")


def test_effects_are_found_in_the_archive_that_was_written(sent):
    assert sent.size > 900
    one = sent.take(sent.aircraft_mask("N401"))
    iron, scale = (CATALOGUE[a.name] for a in EFFECTS)
    design = np.concatenate([iron.columns(one), scale.columns(one)]).reshape(3, -1).T
    fit = np.linalg.lstsq(design, linear_residual(one).ravel(), rcond=None)[0]
    found, _ = iron.to_parameters(fit[:2], np.zeros((2, 2)), one)
    assert found["amplitude_deg"] == pytest.approx(3.0, abs=0.03)
    assert found["phase_deg"] == pytest.approx(50.0, abs=0.6)
    found, _ = scale.to_parameters(fit[2:], np.zeros((1, 1)), one)
    assert found["scale_percent"] == pytest.approx(2.0, abs=0.03)
