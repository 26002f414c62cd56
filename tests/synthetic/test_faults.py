"""Faults: every one acts, on whom and when it should, by as much as was asked."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pandas as pd
import pytest

from airswing.errors import InputError
from airswing.synthetic import simulate_arrays
from airswing.synthetic.instrument import UNIT_FAULTS, parse_faults
from airswing.synthetic.observe import Coding

FINE = Coding(
    direction_deg=1e-5, speed_kt=1e-5, position_arcmin=1e-4, airspeed_noise=0.0, heading_noise=0.0
)
COMMON = {"days": 2, "aircraft": 4, "seed": 3, "references": ("ruc",), "coding": FINE}
COMMON |= {"columns": 20, "rows": 16, "spacing_km": 85.0, "levels": (950, 700, 500, 350)}
TAILS = ["N401", "N402", "N403", "N404"]


def simulated(name: str = "", tails: object = None, period: object = None, **parameters: object):
    effect = {"name": name, "tails": tails, "parameters": parameters, "period": period}
    return simulate_arrays(effects=[effect] if name else [], **COMMON)


@pytest.fixture(scope="module")
def plain() -> pd.DataFrame:
    return simulated()


def heading_error(frame: pd.DataFrame) -> np.ndarray:
    error = frame["heading"] - frame["true_heading"]
    return np.degrees((error + np.pi) % (2 * np.pi) - np.pi).to_numpy()


@pytest.mark.parametrize("name", sorted(UNIT_FAULTS))
def test_every_unit_fault_changes_the_wind_and_nothing_else(plain: pd.DataFrame, name: str) -> None:
    sizes = {"offset_deg": 1.0, "amplitude_deg": 4.0, "phase_deg": 30.0, "offset_m_s": 1.0}
    sizes |= {"rate_deg_per_day": 0.5, "scale_percent": 1.0, "fraction": 0.2, "epoch_year": 1995.0}
    found = simulated(name, **sizes)
    change = np.hypot(found["u"] - plain["u"], found["v"] - plain["v"])
    assert np.isfinite(change).all()
    assert 0.05 < np.sqrt(np.mean(change**2)) < 12.0
    for column in ("latitude", "altitude", "true_u", "ground_u", "u_ruc", "celsius"):
        np.testing.assert_array_equal(found[column], plain[column])


def test_hard_iron_is_the_cycle_asked_for(plain: pd.DataFrame) -> None:
    found = simulated("hard_iron", ["N402"], amplitude_deg=4.0, phase_deg=50.0)
    chosen = (found["tail"] == "N402").to_numpy()
    error = heading_error(found)
    assert np.abs(error[~chosen]).max() < 1e-6
    magnetic = (found["heading"] - found["declination"]).to_numpy()
    strength = np.median(plain["horizontal"]) / found["horizontal"].to_numpy()
    expected = 4.0 * np.sin(magnetic + np.radians(50.0)) * strength
    np.testing.assert_allclose(error[chosen], expected[chosen], atol=0.005)


def test_airspeed_errors_lie_along_the_heading(plain: pd.DataFrame) -> None:
    found = simulated("tas_scale", scale_percent=2.0)
    du, dv = found["u"] - plain["u"], found["v"] - plain["v"]
    heading = plain["true_heading"]
    along = du * np.sin(heading) + dv * np.cos(heading)
    across = du * np.cos(heading) - dv * np.sin(heading)
    np.testing.assert_allclose(along, -0.02 * plain["true_airspeed"], atol=1e-3)
    np.testing.assert_allclose(across, 0.0, atol=1e-3)


def test_acceleration_and_turn_follow_their_stated_scale(plain: pd.DataFrame) -> None:
    magnetic = (plain["true_heading"] - plain["declination"]).to_numpy()
    steep = np.tan(plain["dip"].to_numpy())
    pull = plain["acceleration"].to_numpy() / 9.80665
    error = heading_error(simulated("acceleration_error", amplitude_deg=10.0))
    np.testing.assert_allclose(error, 10 * np.sin(magnetic) * steep * pull, atol=0.03)
    error = heading_error(simulated("turn_error", amplitude_deg=10.0))
    expected = 10 * np.cos(magnetic) * steep * plain["bank"].to_numpy()
    np.testing.assert_allclose(error, expected, rtol=0.12, atol=0.1)
    assert np.abs(expected).max() > 2.0


def test_lag_sends_the_wind_of_an_earlier_place(plain: pd.DataFrame) -> None:
    """Where the lag is the interval between reports, a report shows its predecessor's wind."""
    found = simulated("time_lag", offset_s=120.0)
    same = (plain["flight"].diff() == 0) & (plain["time"].diff() == pd.Timedelta(120, "s"))
    assert same.sum() > 200
    for column in ("u", "v"):
        earlier = plain[column].shift()[same]
        np.testing.assert_allclose(found[column][same], earlier, atol=1e-3)


def test_reporting_faults(plain: pd.DataFrame) -> None:
    high = simulated("altitude_offset", ["N403"], offset_ft=500.0)
    chosen = high["tail"] == "N403"
    rise = (high["altitude"] - plain["altitude"]) / 0.3048
    np.testing.assert_allclose(rise[chosen], 500.0, atol=1e-6)
    assert (rise[~chosen] == 0).all()
    coarse = simulated("wind_coding", step=5.0)
    assert (coarse["speed"] % 5 == 0).all()
    assert (coarse["direction"] % 10 == 0).all()
    places = simulated("position_coding", step=1.0)
    minutes = places["latitude"] * 60
    np.testing.assert_allclose(minutes, np.round(minutes), atol=1e-9)
    stepped = simulated("heading_coding", step_deg=5.0)
    indicated = np.degrees(stepped["heading"] - stepped["declination"])
    np.testing.assert_allclose(indicated / 5, np.round(indicated / 5), atol=1e-6)
    minute = simulated("time_lag", to_minute=True)
    assert (minute["time"].dt.second == 0).all()
    wild = simulated("outliers", fraction=0.02)
    assert 0.005 < np.mean(np.hypot(wild["u"] - plain["u"], wild["v"] - plain["v"]) > 5) < 0.03


def test_swapped_aircraft_exchange_their_reports(plain: pd.DataFrame) -> None:
    found = simulated("tail_swap", ["N401", "N402"], ["2009-03-02", None])
    late, true = (
        one[one["time"] >= "2009-03-02"].groupby("tail")["flight"].agg(set)
        for one in (found, plain)
    )
    assert (late["N401"], late["N402"]) == (true["N402"], true["N401"])
    assert late["N403"] == true["N403"]
    early = [one[one["time"] < "2009-03-02"]["flight"].tolist() for one in (found, plain)]
    assert early[0] == early[1]


@pytest.mark.parametrize(
    "effect",
    [{"name": "hard_irony"}, {"name": "hard_iron", "tails": ["N999"]}],
)
def test_unknown_names_are_refused(effect: dict) -> None:
    with pytest.raises(InputError):
        parse_faults([effect], start=datetime(2009, 3, 1), tails=TAILS)
