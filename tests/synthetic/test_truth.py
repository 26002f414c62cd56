"""The stated truth against the units' errors, and the fit's equation against the generator.

The generator has no formula of a deviation curve, only fields, iron and a sensing plane; the fit
has no iron. With the true wind as reference and without rounding, their difference is the error of
the fit.
"""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest
import xarray as xr

from airswing.compass.fit.deviation import fit_deviation
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.instrument import deviation_curve, parse_faults
from airswing.synthetic.observe import Coding
from airswing.synthetic.truth import fleet_deviations, truth_record, unit_of

START = datetime(2009, 3, 1)
TAILS = [f"N{401 + k}" for k in range(6)]


def wrapped(degrees):
    return (degrees + 180.0) % 360.0 - 180.0


def headings(frame) -> xr.Dataset:
    """Headings of cruise, as indicated, against the true wind."""
    east = (frame["ground_u"] - frame["true_u"]).to_numpy()
    north = (frame["ground_v"] - frame["true_v"]).to_numpy()
    heading = np.degrees(frame["heading"].to_numpy())
    airspeed = frame["airspeed"].to_numpy()
    columns = {
        "time": frame["time"].to_numpy(),
        "flight": frame["flight"].to_numpy(),
        "latitude": frame["latitude"].to_numpy(),
        "longitude": frame["longitude"].to_numpy(),
        "pressure": frame["pressure"].to_numpy(),
        "heading": heading % 360.0,
        "magnetic_heading": (heading - np.degrees(frame["declination"].to_numpy())) % 360.0,
        "airspeed": airspeed,
        "horizontal_field": frame["horizontal"].to_numpy(),
        "screening": np.zeros(len(frame), np.int32),
    }
    errors = {
        "heading_error": wrapped(heading - np.degrees(np.arctan2(east, north))),
        "airspeed_error": airspeed - np.hypot(east, north),
        "heading_error_standard_error": np.full(len(frame), 0.1),
    }
    size = frame.groupby("tail").size().reindex(TAILS).to_numpy()
    return xr.Dataset(
        {name: ("report", values) for name, values in columns.items()}
        | {name: (("reference", "report"), values[np.newaxis]) for name, values in errors.items()}
        | {"row_size": ("aircraft", size)},
        coords={"aircraft": TAILS, "reference": ["truth"]},
    )


@pytest.mark.slow
def test_against_the_true_wind_amplitudes_are_right_to_a_hundredth_of_a_degree():
    effects = fleet_deviations(TAILS, 12)
    frame = simulate_arrays(
        days=20,
        aircraft=6,
        seed=12,
        effects=effects,
        references=("ruc",),
        start=START,
    )
    faults = parse_faults(effects, start=START, tails=TAILS)
    cruise = frame[frame["phase"] == 2]
    fits = fit_deviation(headings(cruise), min_compass_points=5).isel(reference=0)
    usual, judged = float(frame["horizontal"].median()), 0
    for k, tail in enumerate(TAILS):
        chosen = cruise[cruise["tail"] == tail]
        field = float(chosen["horizontal"].mean())
        down = float((chosen["horizontal"] * np.tan(chosen["dip"])).mean())
        unit = unit_of(k, faults, TAILS, field, down, usual_field=usual)
        curve = deviation_curve(field, down, unit)
        amplitude = float(np.hypot(curve["B"], curve["C"]))
        one = fits.isel(aircraft=k)
        if np.isnan(one["amplitude"]):
            continue
        judged += 1
        error = float(one["amplitude_standard_error"])
        assert error < 0.05
        assert abs(float(one["amplitude"]) - amplitude) < 0.01 + 3 * error
        assert abs(float(one["offset"]) - curve["A"]) < 0.01 + 3 * float(
            one["offset_standard_error"]
        )
    assert judged >= 4


@pytest.mark.parametrize("seed", [7, 8])
def test_every_unit_errs_by_its_stated_coefficients_at_the_field_it_flies_in(seed: int) -> None:
    """Aircraft fly where the field is weaker or stronger than the fleet's, by several per cent."""
    tails = [f"N{401 + index}" for index in range(8)]
    effects = fleet_deviations(tails, seed)
    options = {"days": 6, "aircraft": 8, "seed": seed, "effects": effects}
    frame = simulate_arrays(coding=Coding(heading_noise=0.0), **options)
    faults = parse_faults(effects, start=START, tails=tails)
    truth = truth_record(frame, faults, tails, effects)["aircraft"]
    for tail in tails:
        chosen = frame[(frame["tail"] == tail) & (frame["phase"] == 2)]
        error = np.degrees(
            (chosen["heading"] - chosen["true_heading"] + np.pi) % (2 * np.pi) - np.pi
        )
        m = chosen["heading"] - chosen["declination"]
        gain = truth[tail]["mean_horizontal_field"] / chosen["horizontal"]
        a, b, c, d, e = (truth[tail]["deviation"][name] for name in "ABCDE")
        stated = a + gain * (b * np.sin(m) + c * np.cos(m)) + d * np.sin(2 * m) + e * np.cos(2 * m)
        bound = 0.01 + 3.0 * truth[tail]["deviation_residual_rms"]
        assert np.abs(error - stated).max() < bound, tail
