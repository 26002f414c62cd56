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
from airswing.physics.compass_deviation import deviation_basis
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.instrument import parse_faults
from airswing.synthetic.observe import Coding
from airswing.synthetic.truth import fleet_deviations, truth_record

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
def test_against_the_true_wind_the_fit_is_right_to_a_hundredth_of_a_degree():
    effects = fleet_deviations(TAILS, 12)
    frame = simulate_arrays(
        days=20, aircraft=6, seed=12, effects=effects, references=("ruc",), start=START
    )
    faults = parse_faults(effects, start=START, tails=TAILS)
    truth = truth_record(frame, faults, TAILS, effects)["aircraft"]
    fits = fit_deviation(headings(frame[frame["phase"] == 2]), min_compass_points=5)
    fitted = fits.isel(reference=0).dropna("aircraft", subset=["amplitude"])
    assert fitted.sizes["aircraft"] >= 4
    for tail in fitted["aircraft"].to_numpy():
        one = fitted.sel(aircraft=tail)
        for name in ("amplitude", "offset"):
            error = float(one[f"{name}_standard_error"])
            assert error < 0.05
            assert abs(float(one[name]) - truth[tail][name]) < 0.01 + 3 * error


def test_every_unit_errs_by_its_stated_coefficients_at_the_field_it_flies_in() -> None:
    """Aircraft fly where the field is weaker or stronger than the fleet's, by several per cent."""
    effects = fleet_deviations(TAILS, 7)
    frame = simulate_arrays(
        coding=Coding(heading_noise=0.0), days=6, aircraft=6, seed=7, effects=effects
    )
    faults = parse_faults(effects, start=START, tails=TAILS)
    truth = truth_record(frame, faults, TAILS, effects)["aircraft"]
    for tail in TAILS:
        chosen = frame[(frame["tail"] == tail) & (frame["phase"] == 2)]
        error = wrapped(np.degrees(chosen["heading"] - chosen["true_heading"]))
        m = chosen["heading"] - chosen["declination"]
        gain = truth[tail]["mean_horizontal_field"] / chosen["horizontal"]
        basis = deviation_basis(m, gain)
        stated = [truth[tail]["deviation"][name] for name in "ABCDE"] @ basis
        bound = 0.01 + 3.0 * truth[tail]["deviation_residual_rms"]
        assert np.abs(error - stated).max() < bound, tail
