"""Parts of the generator: waves, magnetic field, flights, vector instrument and stated truth."""

from datetime import datetime

import numpy as np
import pyproj
from tests.compass.flown import wrap

from airswing.physics.compass_deviation import deviation_basis
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.flights import NETWORKS, STEP, fly, timetable
from airswing.synthetic.instrument import EarthField, declination_of_year, parse_faults
from airswing.synthetic.observe import Coding
from airswing.synthetic.truth import fleet_deviations, truth_record

BOX = (25.0, 48.0, -124.0, -75.0)


def test_the_lattice_is_close_to_igrf_and_older_tables_differ_by_the_secular_variation():
    import ppigrf

    earth = EarthField(datetime(2009, 7, 1), 30.0, BOX)
    rng = np.random.default_rng(1)
    lat, lon = rng.uniform(26, 47, 20), rng.uniform(-123, -76, 20)
    east, north, up = (field[0] for field in ppigrf.igrf(lon, lat, 4.0, datetime(2009, 7, 16)))
    declination, horizontal, down = earth.at(lat, lon, np.full(20, 15 * 24.0))
    np.testing.assert_allclose(declination, np.arctan2(east, north), atol=np.radians(0.03))
    np.testing.assert_allclose(horizontal, np.hypot(east, north), rtol=2e-3)
    np.testing.assert_allclose(down, -up, rtol=2e-3)
    lat, lon = np.array([44.9]), np.array([-93.2])
    old = declination_of_year(lat, lon, 1995.0, BOX) - earth.at(lat, lon, np.zeros(1))[0]
    assert 1.0 < np.degrees(old[0]) < 2.5


def test_ground_velocity_is_the_velocity_of_the_positions():
    """Centred geodesic chord over two steps against the stored velocity, in cruise."""

    def wind(lat, lon, alt, hours):
        return np.stack([10.0 + 0.002 * alt, -3.0 + 0 * alt])

    table = timetable(NETWORKS["great_lakes"], aircraft=4, days=6, seed=5, legs_per_day=4.0)
    flown = fly(table, wind, seed=5)
    lat, lon = flown.latitude, flown.longitude
    azimuth, _, length = pyproj.Geod(ellps="WGS84").inv(lon[:-2], lat[:-2], lon[2:], lat[2:])
    steady = (flown.phase[:-2] == 2) & (flown.phase[2:] == 2) & (np.abs(flown.bank[1:-1]) < 0.01)
    turn = np.radians(azimuth)
    for name, share in (("east", np.sin(turn)), ("north", np.cos(turn))):
        error = length / (2 * STEP) * share - getattr(flown, name)[1:-1]
        assert np.sqrt(np.mean(error[steady] ** 2)) < 0.1


START = datetime(2009, 3, 1)
TAILS = [f"N{401 + k}" for k in range(6)]


def test_every_unit_errs_by_its_stated_coefficients_at_the_field_it_flies_in():
    """Aircraft fly where the field is weaker or stronger than the fleet's, by several per cent."""
    effects = fleet_deviations(TAILS, 7)
    options = {"days": 6, "aircraft": 6, "seed": 7, "coding": Coding(heading_noise=0.0)}
    frame = simulate_arrays(**options, effects=effects)
    faults = parse_faults(effects, start=START, tails=TAILS)
    truth = truth_record(frame, faults, TAILS, effects)["aircraft"]
    for tail in TAILS:
        cruise = frame[(frame["tail"] == tail) & (frame["phase"] == 2)]
        error = wrap(np.degrees(cruise["heading"] - cruise["true_heading"]))
        m = cruise["heading"] - cruise["declination"]
        gain = truth[tail]["mean_horizontal_field"] / cruise["horizontal"]
        basis = deviation_basis(m, gain)
        stated = [truth[tail]["deviation"][name] for name in "ABCDE"] @ basis
        bound = 0.01 + 3.0 * truth[tail]["deviation_residual_rms"]
        assert np.abs(error - stated).max() < bound, tail
