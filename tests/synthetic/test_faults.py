"""Faults: every one acts, on whom and when it should, by as much as was asked."""

from datetime import datetime

import numpy as np
import pandas as pd
import pytest
from tests.compass.flown import wrap
from tests.gap.toy import EXACT

from airswing.errors import InputError
from airswing.synthetic import simulate_arrays
from airswing.synthetic.instrument import UNIT_FAULTS, parse_faults

SIZES = {"offset_deg": 1.0, "amplitude_deg": 4.0, "phase_deg": 50.0, "offset_m_s": 1.0}
SIZES |= {"rate_deg_per_day": 0.5, "scale_percent": 2.0, "fraction": 0.2, "epoch_year": 1995.0}
FAULTS = dict.fromkeys(UNIT_FAULTS, SIZES)
FAULTS |= {name: SIZES | {"amplitude_deg": 10.0} for name in ("acceleration_error", "turn_error")}
FAULTS |= {
    "time_lag": {"offset_s": 120.0},
    "altitude_offset": {"offset_ft": 500.0},
    "wind_coding": {"step": 5.0},
    "position_coding": {"step": 1.0},
    "heading_coding": {"step_deg": 5.0},
    "outliers": {"fraction": 0.2},
}
"""Each on another aircraft."""
TAILS = {name: f"N{401 + number}" for number, name in enumerate(FAULTS)}
PAIR = [f"N{401 + len(FAULTS)}", f"N{402 + len(FAULTS)}"]


@pytest.fixture(scope="module")
def archives():
    """One day without faults and with all of them."""
    swap = {"name": "tail_swap", "tails": PAIR, "period": ["2009-03-01T18", None]}
    faults = FAULTS.items()
    effects = [{"name": n, "tails": [TAILS[n]], "parameters": values} for n, values in faults]
    common = {"days": 1, "aircraft": len(FAULTS) + 2, "seed": 3, "coding": EXACT}
    common |= {"references": ("ruc",), "columns": 20, "rows": 16, "spacing_km": 85.0}
    common |= {"levels": (950, 700, 500, 350)}
    return [simulate_arrays(effects=active, **common) for active in ([], [*effects, swap])]


def of_aircraft(frame, tail):
    return frame[frame["tail"] == tail]


@pytest.fixture
def of(archives):
    """Reports of one fault's aircraft: without it and with it."""
    return lambda name: [of_aircraft(frame, TAILS[name]).reset_index() for frame in archives]


def heading_error(frame):
    return wrap(np.degrees(frame["heading"] - frame["true_heading"])).to_numpy()


@pytest.mark.parametrize("name", sorted({*UNIT_FAULTS} - {"heater_current"}))
def test_every_unit_fault_changes_the_wind_and_nothing_else(of, name):
    sound, faulty = of(name)
    change = np.hypot(faulty["u"] - sound["u"], faulty["v"] - sound["v"])
    assert np.isfinite(change).all()
    assert 0.05 < np.sqrt(np.mean(change**2)) < 12.0
    for column in ("latitude", "altitude", "true_u", "ground_u", "u_ruc", "celsius"):
        np.testing.assert_array_equal(faulty[column], sound[column])
    assert (np.abs(heading_error(faulty)) < 1e-6).all() == name.startswith("tas")


def test_hard_iron_and_heater_are_the_cycle_asked_for(archives, of):
    sound, faulty = of("hard_iron")
    magnetic = (faulty["heading"] - faulty["declination"]).to_numpy()
    strength = np.median(archives[0]["horizontal"]) / faulty["horizontal"].to_numpy()
    expected = 4.0 * np.sin(magnetic + np.radians(50.0)) * strength
    np.testing.assert_allclose(heading_error(faulty), expected, atol=0.005)
    assert np.abs(heading_error(sound)).max() < 1e-6
    _, faulty = of("heater_current")
    np.testing.assert_array_equal(np.abs(heading_error(faulty)) > 1e-6, faulty["icing"] == 1)


def test_acceleration_and_turn_follow_their_stated_scale(of):
    for name, tolerance in (("acceleration_error", 0.03), ("turn_error", 0.1)):
        sound, faulty = of(name)
        magnetic, steep = sound["true_heading"] - sound["declination"], np.tan(sound["dip"])
        pull = np.sin(magnetic) * sound["acceleration"] / 9.80665
        expected = 10 * steep * (pull if name[0] == "a" else np.cos(magnetic) * sound["bank"])
        relative = 0.12 if name == "turn_error" else 0.0
        np.testing.assert_allclose(heading_error(faulty), expected, rtol=relative, atol=tolerance)
        assert np.abs(expected).max() > 0.5


def test_lag_sends_the_wind_of_an_earlier_place(of):
    """Where the lag is the interval between reports, a report shows its predecessor's wind."""
    sound, faulty = of("time_lag")
    same = (sound["flight"].diff() == 0) & (sound["time"].diff() == pd.Timedelta(120, "s"))
    assert same.sum() > 50
    for column in ("u", "v"):
        earlier = sound[column].shift()[same]
        np.testing.assert_allclose(faulty[column][same], earlier, atol=1e-3)


def test_reporting_faults(of):
    sound, high = of("altitude_offset")
    np.testing.assert_allclose((high["altitude"] - sound["altitude"]) / 0.3048, 500.0, atol=1e-6)
    _, coarse = of("wind_coding")
    assert (coarse["speed"] % 5 == 0).all() and (coarse["direction"] % 10 == 0).all()
    minutes = of("position_coding")[1]["latitude"] * 60
    np.testing.assert_allclose(minutes, np.round(minutes), atol=1e-9)
    _, stepped = of("heading_coding")
    indicated = np.degrees(stepped["heading"] - stepped["declination"])
    np.testing.assert_allclose(indicated / 5, np.round(indicated / 5), atol=1e-6)
    sound, wild = of("outliers")
    gross = np.hypot(wild["u"] - sound["u"], wild["v"] - sound["v"]) > 5
    assert 0.05 < gross.mean() < 0.3


def test_swapped_aircraft_exchange_their_reports(archives):
    early, late = (
        [frame[(frame["time"] < "2009-03-01T18") != swapped] for frame in archives]
        for swapped in (False, True)
    )
    sound, faulty = ([set(of_aircraft(frame, tail)["flight"]) for tail in PAIR] for frame in late)
    assert faulty == sound[::-1] and all(faulty)
    sound, faulty = (frame.groupby("tail")["flight"].agg(set) for frame in early)
    assert faulty.equals(sound)


def test_unknown_names_are_refused_and_one_aircraft_may_be_text():
    archive = {"start": datetime(2009, 3, 1), "tails": [*TAILS.values()]}
    for effect in ({"name": "hard_irony"}, {"name": "hard_iron", "tails": ["N999"]}):
        with pytest.raises(InputError):
            parse_faults([effect], **archive)
    (fault,) = parse_faults([{"name": "hard_iron", "tails": "N401"}], **archive)
    assert fault.tails == ("N401",)
