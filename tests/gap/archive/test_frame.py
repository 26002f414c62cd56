"""Frames of an archive, what is derived for their reports, and steps of coded headings."""

from dataclasses import replace

import dask
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from tests.gap.frames import TAILS, headings_dataset
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.archive.acceleration import (
    expected_acceleration,
    fit_levelling,
    time_since_levelling,
)
from airswing.gap.archive.frame import REPORT_FIELDS, Frame, end_of_day, sampled
from airswing.gap.archive.lattices import direction_lattice, heading_lattices
from airswing.gap.archive.reported_variables import (
    Variable,
    cells_of,
    flight_time,
    last_turn,
    recent_turn,
    record,
)
from airswing.gap.design import exogenous
from airswing.gap.diagnose import diagnose
from airswing.gap.distribution.gross_errors import outliers
from airswing.gap.effects import CATALOGUE
from airswing.gap.noise import fit_noise, gross_errors
from airswing.gap.simulation.forward import Coding
from airswing.units import KNOT


@pytest.fixture(scope="module")
def archive():
    return headings_dataset(flights=4)


def test_values_are_si_and_radians(archive):
    frame = Frame.from_headings(archive, reference="ruc")
    assert frame.size == archive.sizes["report"]
    np.testing.assert_allclose(np.degrees(frame.heading), archive.heading)
    np.testing.assert_allclose(np.degrees(frame.dip), archive.dip)
    np.testing.assert_allclose(np.degrees(frame.bank), archive.bank)
    np.testing.assert_allclose(frame.horizontal_field, archive.horizontal_field)
    assert frame.time[0] == archive.time.values[0].astype(np.int64) / 1e9
    assert frame.epoch == frame.time.min()
    assert frame.reference_field == np.median(archive.horizontal_field)
    names = np.array(frame.tails)[frame.aircraft]
    np.testing.assert_array_equal(names, np.repeat(TAILS, archive.row_size.values))


def test_longitudes_are_continuous_across_the_antimeridian(archive):
    """Shifted to the antimeridian, an archive has the same differences of longitude."""
    shifted = archive.copy(deep=True)
    turn = 180.0 - float(archive.longitude.mean())
    shifted["longitude"].values[:] = np.mod(archive.longitude + turn + 180.0, 360.0) - 180.0
    assert shifted.longitude.min() < -90 < 90 < shifted.longitude.max()
    frames = (Frame.from_headings(ds, reference="ruc") for ds in (archive, shifted))
    base, there = (frame.longitude - frame.longitude.mean() for frame in frames)
    np.testing.assert_allclose(there, base, atol=1e-9)


def test_pool_is_the_mean_of_the_members_that_exist(archive):
    holed = archive.copy(deep=True)
    holed["reference_eastward_wind"][1, :3] = np.nan
    pool = Frame.from_headings(holed, reference=["ruc", "rtfdaa"])
    by_name = Frame.from_headings(holed, reference="ruc+rtfdaa")
    expected = archive.reference_eastward_wind.values[0] + 0.5
    expected[:3] -= 0.5
    np.testing.assert_allclose(pool.u_ref, expected)
    np.testing.assert_array_equal(by_name.u_ref, pool.u_ref)


def test_reports_without_a_wind_or_with_bad_flags_are_left_out(archive):
    bad = archive.copy(deep=True)
    bad["eastward_wind"][0] = np.nan
    bad["reference_northward_wind"][0, 1] = np.nan
    bad["ground_eastward_velocity"][2] = np.nan
    bad["screening"][3] = 256  # wind_qc
    bad["screening"][4] = 512  # gross error: kept, or every effect would be attenuated
    frame = Frame.from_headings(bad, reference="ruc")
    np.testing.assert_array_equal(frame.report[:2], [4, 5])
    assert Frame.from_headings(bad, reference="ruc", excluded=()).report[0] == 3


def test_requested_phases_are_kept(archive):
    assert set(Frame.from_headings(archive, reference="ruc", phases=["ascent"]).phase) == {1}
    unknown = archive.assign(phase=archive.phase * 0)
    assert Frame.from_headings(unknown, reference="ruc", phases=["cruise"]).size > 0
    with pytest.raises(InputError, match="unknown phase"):
        Frame.from_headings(archive, reference="ruc", phases=["taxi"])


def test_errors_for_no_report_and_unknown_reference(archive):
    with pytest.raises(InputError, match="overlap"):
        Frame.from_headings(archive.assign(eastward_wind=archive.heading * np.nan), reference="ruc")
    with pytest.raises(InputError, match="one of ruc, rtfdaa"):
        Frame.from_headings(archive, reference="nam")


def test_absent_variables_are_unknown_not_zero(archive):
    names = ["icing", "bank", "air_temperature", "wind_speed_resolution"]
    frame = Frame.from_headings(archive.drop_vars(names), reference="ruc")
    assert set(frame.icing) == {-1}
    assert np.isnan(frame.bank).all()
    assert np.isnan(frame.temperature).all()
    assert np.isnan(frame.wind_speed_resolution).all()


def test_take_keeps_the_constants_of_the_archive(archive):
    frame = Frame.from_headings(archive, reference="ruc")
    later = frame.take(frame.time > np.median(frame.time))
    assert later.epoch == frame.epoch
    assert later.reference_field == frame.reference_field
    assert {getattr(later, name).shape for name in REPORT_FIELDS} == {(later.size,)}
    np.testing.assert_array_equal(frame.take([5, 2]).time, frame.time[[5, 2]])
    assert set(frame.take(frame.aircraft_mask("N402")).aircraft) == {1}
    with pytest.raises(InputError, match="N999"):
        frame.take(frame.aircraft_mask(["N401", "N999"]))


def test_lazy_headings_are_computed_once(archive):
    computed = []

    def scheduler(graph, keys, **options):
        computed.append(len(keys))
        return dask.threaded.get(graph, keys, **options)

    with dask.config.set(scheduler=scheduler):
        lazy = Frame.from_headings(archive.chunk(report=50), reference="ruc")
    assert len(computed) == 1
    np.testing.assert_array_equal(lazy.dudy, Frame.from_headings(archive, reference="ruc").dudy)


def test_time_of_levelling_off_is_extrapolated_from_the_climb():
    # 10 m/s up to 3000 m, reached 30 s after the report at 2700 m; then cruise
    time = np.array([0.0, 60, 120, 180, 300, 420, 540, 660])
    altitude = np.array([1500.0, 2100, 2700, 3000, 3000, 3000, 3000, 3000])
    phase = np.array([1, 1, 1, 2, 2, 2, 2, 2])
    since = time_since_levelling(time, altitude, phase, np.zeros(8, int))
    np.testing.assert_allclose(since[3:], [30, 150, 270, 390, 510])
    assert np.isnan(since[:3]).all()


def _flights(number, rng):
    """Start, end and mean speed of four chords of flights whose acceleration is known."""
    fine = np.arange(0.0, 1200.0, 0.5)
    gain = np.where(fine < 30, 0.3, 0.3 * np.exp(-(fine - 30) / 45))
    path = np.cumsum(np.cumsum(gain) * 0.5) * 0.5
    first = rng.uniform(0, 60, number)
    edges = first[:, None] + 120.0 * np.arange(5)
    distance = np.interp(edges, fine, path)
    mean = np.diff(distance, axis=1) / 120 + rng.normal(120, 8, (number, 1))
    mean += rng.normal(0, 1.0, mean.shape)
    flight = np.repeat(np.arange(number), 4)
    return edges[:, :-1].ravel(), edges[:, 1:].ravel(), mean.ravel(), flight


def test_acceleration_after_levelling_off_from_longer_chords():
    gain = fit_levelling(*_flights(1500, np.random.default_rng(3)))
    assert gain is not None
    assert fit_levelling(*_flights(20, np.random.default_rng(3))) is None  # too few
    fitted = np.interp([10.0, 50.0, 90.0, 200.0], [0, 20, 40, 65, 100, 150, 210], gain)
    truth = 0.3 * np.exp(-np.maximum(np.array([10.0, 50.0, 90.0, 200.0]) - 30, 0) / 45)
    np.testing.assert_allclose(fitted, truth, atol=0.06)


def test_acceleration_is_the_fleets_profile_and_not_the_reports_noise():
    rng = np.random.default_rng(2)
    phase = np.tile(np.repeat([1, 2, 3], 20), 400)
    flight = np.repeat(np.arange(400), 60)
    climb = np.linspace(11.5, 10.6, 20)
    level = np.tile(np.concatenate([climb, np.full(20, 10.6), climb[::-1]]), 400)
    true = np.choose(phase, [0.0, 0.06 - 0.02 * (11.5 - level), 0.0, -0.05])
    estimate = expected_acceleration(true + rng.normal(0, 0.05, phase.size), level, phase, flight)
    steady = phase != 2
    np.testing.assert_allclose(estimate[steady], true[steady], atol=0.006)


@pytest.fixture(scope="module")
def three_days():
    return make_frame(seed=3, aircraft=3, days=3)


def test_cells_are_quantiles_sectors_or_categories():
    linear = Variable("airspeed", "linear", np.arange(100.0)).edges(4)
    np.testing.assert_allclose(linear, [0, 24.75, 49.5, 74.25, 99])
    sectors = Variable("track", "circular", np.array([10.0, 350.0])).edges(12)
    np.testing.assert_allclose(sectors, 30.0 * np.arange(13))
    assert cells_of(np.array([29.9, 30.0, 359.0, np.nan]), sectors).tolist() == [0, 1, 11, -1]
    assert Variable("icing", "category", np.zeros(2)).edges(2).tolist() == [-0.5, 0.5, 1.5]


@given(
    values=st.lists(st.sampled_from([0.0, 0.0, 0.0, 1.0, 2.5, -40.0, 7.0]) | st.floats(-50, 50)),
    count=st.integers(2, 40),
)
def test_every_value_has_a_cell_and_edges_ascend(values, count):
    values = np.array([*values, -60.0, 60.0])
    variable = Variable("bank", "linear", values)
    edges = variable.edges(count)
    assert (np.diff(edges) > 0).all()
    assert (edges[0], edges[-1]) == (-60.0, 60.0)
    cells = cells_of(variable.values, edges)
    assert cells.min() >= 0 and cells.max() <= edges.size - 2


def test_constant_values_are_no_variable(three_days):
    same = replace(three_days, icing=np.zeros(three_days.size, np.int64))
    assert "icing" not in record(same, same)
    assert {"track", "airspeed", "hour", "wind_direction"} <= set(record(three_days, three_days))


@pytest.fixture(scope="module")
def turning():
    """Two flights of a report a minute: north, then east, then north-west."""
    frame = make_frame(seed=1, aircraft=1, days=2).take(np.arange(20))
    course = np.radians([0.0, 0, 0, 90, 90, 90, -30, -30, -30])
    east, north = 0.05 * np.cumsum([np.sin(course), np.cos(course)], axis=1)
    flight = np.repeat([1, 2], 10)
    return replace(
        frame,
        flight=flight,
        time=60.0 * np.arange(20) + 7200.0 * flight,
        longitude=np.tile(np.r_[0.0, east], 2),
        latitude=np.tile(np.r_[0.0, north], 2),
    )


def test_turn_of_the_last_two_minutes_last_turn_and_flight_time(turning):
    # half of a turn is at the fix between two courses; the ends have the track of the next fix
    recent = [0, 0, 0, 45, 90, 45, -60, -120, -60, 0]
    np.testing.assert_allclose(recent_turn(turning), [*recent, *recent], atol=0.05)
    last = [0, 0, 0, 45, 45, 45, -60, -60, -60, -60]
    np.testing.assert_allclose(last_turn(turning), [*last, *last], atol=0.05)
    minutes = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    np.testing.assert_allclose(flight_time(turning), [*minutes, *minutes])
    days = flight_time(replace(turning, time=np.where(turning.time > 15000, 1e6, turning.time)))
    assert np.isnan(days[turning.time > 15000]).all()
    order = np.random.default_rng(0).permutation(turning.size)
    for function in (recent_turn, last_turn, flight_time):
        shuffled = function(turning.take(order))
        np.testing.assert_allclose(shuffled, function(turning)[order], atol=1e-9)
        assert function(turning.take(slice(0, 0))).size == 0


@pytest.fixture(scope="module")
def exact():
    return make_frame(seed=4, aircraft=4, days=14, noise=1.5)


def stepped(frame, step, tails, *, true_north=False, spread=0.0, seed=0):
    """The frame with headings rounded to steps, with an error of some tenths of a degree."""
    rng = np.random.default_rng(seed)
    north = 0.0 if true_north else frame.heading - frame.magnetic_heading
    width = np.radians(step)
    heading = width * np.round((frame.heading - north) / width) + north
    heading += np.radians(spread) * rng.standard_normal(frame.size)
    heading = np.where(np.isin(frame.aircraft, tails), heading, frame.heading)
    return replace(
        frame,
        u_rep=frame.ground_u - frame.airspeed * np.sin(heading),
        v_rep=frame.ground_v - frame.airspeed * np.cos(heading),
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(heading - frame.declination, 2 * np.pi),
    )


@pytest.mark.parametrize("true_north", [False, True])
@pytest.mark.parametrize(("step", "spread"), [(2.0, 0.2), (10.0, 1.0), (30.0, 1.0)])
def test_steps_and_their_north_are_found(exact, step, spread, true_north):
    frame = stepped(exact, step, [1], true_north=true_north, spread=spread)
    lattice = heading_lattices(frame)[1]
    assert lattice is not None
    assert (lattice.step, lattice.true_north) == (step, true_north)
    assert lattice.evidence > 100.0
    assert heading_lattices(frame)[0] is None


def test_a_few_courses_are_no_lattice(exact):
    """Six flights on one course each, on whole tens by chance, are too few."""
    few = exact.take(np.flatnonzero(np.isin(exact.flight, np.unique(exact.flight)[:6])))
    straight = replace(few, magnetic_heading=np.radians(10.0 * (few.flight % 6)))
    assert not any(heading_lattices(straight))


def test_diagnosis_states_step_and_closure(exact):
    frame = stepped(exact, 5.0, [0, 2], spread=0.3)
    catalogue = {"heading_coding": CATALOGUE["heading_coding"]}
    report = diagnose(frame, catalogue=catalogue, dictionary=False).report
    (effect,) = report.effects
    assert effect.name == "heading_coding"
    assert effect.tails == [exact.tails[0], exact.tails[2]]
    assert effect.parameters == {"step_deg": 5.0, "true_north": None}
    true = (np.hypot(*frame.residual.T).mean() - np.hypot(*exact.residual.T).mean()) / KNOT
    low, high = report.closure.reduction_ci
    assert low < true < high
    assert report.closure.reduction == pytest.approx(true, rel=0.25)


@pytest.mark.parametrize("true_north", [False, True])
def test_simulated_winds_have_the_steps_found(exact, true_north):
    frame = stepped(exact, 15.0, [1], true_north=true_north)
    assert [x is not None for x in heading_lattices(frame)] == [False, True, False, False]
    u, v = Coding.as_found(frame).apply(exact.u_rep, exact.v_rep)
    affected = frame.aircraft == 1
    flown = np.hypot(exact.ground_u - exact.u_rep, exact.ground_v - exact.v_rep)
    sent = np.hypot(frame.ground_u - u, frame.ground_v - v)
    np.testing.assert_allclose(sent, flown, atol=1e-9)
    heading = np.arctan2(frame.ground_u - u, frame.ground_v - v)
    north = 0.0 if true_north else frame.declination
    steps = np.degrees(heading - north)[affected] / 15.0
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    without_steps = Coding.of_archive(frame).apply(exact.u_rep, exact.v_rep)
    for component, expected in zip((u, v), without_steps, strict=True):
        np.testing.assert_allclose(component[~affected], expected[~affected], atol=1e-9)


def test_jumps_between_steps_are_no_gross_errors_and_no_scatter(exact):
    report = diagnose(stepped(exact, 15.0, [1])).report
    assert [effect.name for effect in report.effects] == ["heading_coding"]
    assert not [place for place in report.unknown.where if place.component == "scatter"]


@pytest.mark.parametrize(("step", "share"), [(2.0, 0.02), (2.0, 0.05), (5.0, 0.0), (15.0, 0.0)])
def test_gross_errors_are_distinguished_from_steps(exact, step, share):
    rng = np.random.default_rng(3)
    frame = stepped(exact, step, [1])
    hit = (rng.random(frame.size) < share) & (frame.aircraft == 1)
    error = hit[:, None] * rng.normal(0, 15, (frame.size, 2))
    frame = replace(frame, u_rep=frame.u_rep + error[:, 0], v_rep=frame.v_rep + error[:, 1])
    noise = fit_noise(exact.residual, exogenous(exact))
    gross = gross_errors(frame.residual, noise.order)
    effect = outliers(frame, frame.residual, replace(noise, gross=gross))
    assert (effect is not None) == (share > 0)
    if effect is not None:
        assert effect.tails == [frame.tails[1]]
        assert effect.parameters["fraction"] == pytest.approx(share, rel=0.4)


def test_directions_of_weak_winds_in_steps():
    rng = np.random.default_rng(0)
    speed, direction = rng.uniform(0, 20, 2000), np.round(rng.uniform(0, 360, 2000))
    direction = np.where(speed < 3.0, 30.0 * np.round(direction / 30.0), direction)
    angle = np.radians(direction)
    lattice = direction_lattice(speed * np.sin(angle), speed * np.cos(angle))
    assert (lattice.step, lattice.share) == (30.0, pytest.approx(1.0, abs=0.02))
    assert lattice.below == pytest.approx(3.0, abs=0.1)
    direction = np.radians(rng.uniform(0, 360, 2000))  # the weakest report may lie on any lattice
    for first in range(0, 2000, 100):
        rows = slice(first, first + 100)
        u, v = speed[rows] * np.sin(direction[rows]), speed[rows] * np.cos(direction[rows])
        assert direction_lattice(u, v) is None


@pytest.mark.parametrize(("days", "kept_days"), [(20, 20), (400, 100)])
def test_long_archives_are_represented_by_whole_flights_of_dense_days(days, kept_days):
    """Four aircraft, 60,000 reports in flights of five, of which a quarter is kept."""
    flight = np.repeat(np.arange(12_000), 5)
    hour = 24.0 * days * np.arange(3_000) / 3_000
    seconds = np.tile(np.repeat(hour * 3600.0, 5), 4) + 60.0 * np.tile(np.arange(5), 12_000)
    archive = xr.Dataset(
        {
            "flight": ("report", flight),
            "time": ("report", np.datetime64("2009-01-01") + seconds.astype("timedelta64[s]")),
            "row_size": ("aircraft", np.full(4, 15_000)),
        }
    )
    drawn = sampled(archive, 15_000)
    assert drawn.sizes["report"] == pytest.approx(15_000, rel=0.1)
    assert drawn["row_size"].sum() == drawn.sizes["report"]
    assert (np.unique(drawn["flight"], return_counts=True)[1] == 5).all()
    ends = np.timedelta64(int(end_of_day(seconds)), "s")
    used = np.unique((drawn["time"].to_numpy() - ends).astype("datetime64[D]"))
    assert used.size == pytest.approx(kept_days, rel=0.1, abs=2)
    assert np.ptp(used) > np.timedelta64(int(0.95 * days), "D") - np.timedelta64(2, "D")
    assert sampled(archive, 60_000) is archive
