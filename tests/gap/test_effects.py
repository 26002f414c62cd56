"""Effects of the catalogue and tables over variables against hand-worked values."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import ppigrf
import pytest
from tests.gap import frames
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.effects import CATALOGUE, ActiveEffect, effect_named
from airswing.gap.effects.base import HeadingEffect
from airswing.gap.effects.declination_error import declination_change
from airswing.gap.effects.empirical import Table, change_of
from airswing.gap.effects.reference_speed_bias import LEVELS
from airswing.gap.simulation.forward import simulate
from airswing.physics.atmosphere import altitude_from_pressure, pressure_from_altitude
from airswing.units import KNOT

#: The binding names, with parameters that files use.
NAMES = {
    "acceleration_error": "amplitude_deg by_phase",
    "altitude_offset": "offset_ft",
    "compass_drift": "rate_deg_per_day",
    "compass_offset": "offset_deg",
    "compass_step": "offset_deg amplitude_deg phase_deg",
    "declination_error": "epoch_year factor mean_deg",
    "hard_iron": "amplitude_deg phase_deg",
    "heading_coding": "step_deg true_north",
    "heater_current": "offset_deg amplitude_deg between_degC",
    "outliers": "fraction",
    "position_coding": "step",
    "reference_grid_relative": "fraction",
    "reference_speed_bias": "bias_percent above_hPa below_hPa",
    "reference_time_offset": "offset_h",
    "soft_iron": "amplitude_deg phase_deg",
    "tail_swap": "pair",
    "tas_offset": "offset_m_s",
    "tas_scale": "scale_percent",
    "time_lag": "offset_s",
    "turn_error": "amplitude_deg",
    "wind_coding": "step",
}
LINEAR = [name for name, effect in CATALOGUE.items() if effect.column_scales.size]


@pytest.fixture(scope="module")
def perfect():
    return simulate(frames.frame())


def old_table(frame, year):
    """Coefficients of a declination table of an epoch."""
    pattern = np.nan_to_num(CATALOGUE["declination_error"].basis(frame)[[0, 2]])
    change = np.nan_to_num(declination_change(frame, epoch_year=year))
    years, bend = np.linalg.lstsq(pattern.T, change, rcond=1e-6)[0]
    return np.array([years, 0.0, bend])


def difference(frame, name, values, **options):
    """Reported wind with an effect minus without, (n, 2)."""
    there = simulate(frame, effects=[ActiveEffect(name, values, **options)])
    return there.residual - simulate(frame).residual


def test_catalogue_holds_the_binding_names():
    assert set(CATALOGUE) == set(NAMES)
    for name, parameters in NAMES.items():
        effect = CATALOGUE[name]
        assert set(parameters.split()) <= {p.name for p in effect.parameters}
        assert effect.physics and effect.source and effect.confused_with
        assert all(p.description for p in effect.parameters)


@pytest.mark.parametrize("name", LINEAR)
def test_columns_are_the_derivative_of_the_simulation(perfect, name):
    effect = CATALOGUE[name]
    columns = effect.columns(perfect)
    assert columns.shape == (effect.column_scales.size, perfect.size, 2)
    for k, scale in enumerate(effect.column_scales):
        if (name, k) == ("declination_error", 2):
            continue  # zero without the years: see the test of old declination tables
        # an old declination table is linear in its age only as far as IGRF is
        years = (name, k) == ("declination_error", 0)
        small = np.zeros(len(columns))
        small[k] = 10.0 if years else 1e-4 * scale
        values, _ = effect.to_parameters(small, np.zeros((small.size,) * 2), perfect)
        back, _ = effect.to_parameters(-small, np.zeros((small.size,) * 2), perfect)
        up, down = difference(perfect, name, values), difference(perfect, name, back)
        slope = up / small[k] if years else (up - down) / (2.0 * small[k])
        size = np.sqrt(np.mean(columns[k] ** 2))
        # the frame has no report above 425 hPa
        assert size > 0.0 or (name == "reference_speed_bias" and LEVELS[k - 1] <= 425)
        tolerance = (0.05 if years else 1e-6) * (size or 1.0)
        np.testing.assert_allclose(slope, columns[k], atol=tolerance)


@pytest.mark.parametrize("name", [n for n in LINEAR if CATALOGUE[n].stage != "sensor"])
def test_effects_that_reverse_with_the_direction_of_flight(perfect, name):
    level = replace(perfect, climb_rate=0 * perfect.climb_rate, dudt=0 * perfect.dudt)
    level = replace(level, dvdt=0 * level.dvdt)
    back = replace(level, ground_u=-level.ground_u, ground_v=-level.ground_v)
    there, returning = (CATALOGUE[name].columns(frame) for frame in (level, back))
    sign = -1 if CATALOGUE[name].reverses else 1
    np.testing.assert_allclose(returning, sign * there)


@pytest.mark.parametrize("name", LINEAR)
def test_parameters_have_the_error_of_their_coefficients(perfect, name):
    effect = CATALOGUE[name]
    rng = np.random.default_rng(3)
    for subset in effect.alternatives or [tuple(range(effect.column_scales.size))]:
        coefficients, used = np.zeros(effect.column_scales.size), list(subset)
        coefficients[used] = effect.column_scales[used] * rng.normal(size=len(subset))
        if name == "heater_current" and len(subset) in (2, 6) and subset[0] >= 3:
            # a band is the difference of two columns
            half = len(subset) // 2
            coefficients[list(subset[half:])] = -coefficients[list(subset[:half])]
        if name == "declination_error" and subset == (0, 2):
            coefficients = old_table(perfect, 1974.3)
        covariance = np.diag((0.1 * effect.column_scales) ** 2)
        values, errors = effect.to_parameters(coefficients, covariance, perfect)
        if isinstance(effect, HeadingEffect):
            error = effect.error(perfect, effect.complete(values))
            expected = coefficients @ np.nan_to_num(effect.basis(perfect))
            # of a declination table of an epoch the columns hold most
            shares = {(0,): 0.2, (0, 2): 0.02} if name == "declination_error" else {}
            misfit = np.sqrt(((error - expected) ** 2).mean() / (expected**2).mean())
            assert misfit < shares.get(subset, 1e-9)
        assert set(errors) <= set(values)
        assert errors
        assert all(error > 0.0 for error in errors.values())


def test_one_degree_at_250_knots_is_4_36_knots_across(perfect):
    north = replace(
        perfect.take(slice(0, 1)),
        u_ref=np.zeros(1),
        v_ref=np.zeros(1),
        ground_u=np.zeros(1),
        ground_v=np.array([250.0 * KNOT]),
    )
    ((across, along),) = difference(north, "compass_offset", {"offset_deg": 1.0}) / KNOT
    # indicated 1 degree right of north: the apparent air vector is eastward, the wind westward
    assert across == pytest.approx(-4.363, abs=1e-3)
    assert along == pytest.approx(0.038, abs=1e-3)
    ((across, along),) = difference(north, "tas_scale", {"scale_percent": 2.0}) / KNOT
    assert (across, along) == pytest.approx((0.0, -5.0))
    ((across, along),) = difference(north, "tas_offset", {"offset_m_s": 1.0})
    assert (across, along) == pytest.approx((0.0, -1.0))


@pytest.mark.parametrize(("field", "iron"), [(19369.0, 3.0), (16494.0, 3.523), (24717.0, 2.351)])
def test_phase_convention_and_growth_of_hard_iron_in_a_weaker_field(perfect, field, iron):
    m = np.radians([0.0, 60.0, 135.0])
    frame = perfect.take(slice(0, 3))
    frame = replace(frame, magnetic_heading=m, horizontal_field=np.full(3, field))
    at_field = {"at_horizontal_field_nT": 19369.0}
    for name, cycles, amplitude in (("hard_iron", 1, iron), ("soft_iron", 2, 3.0)):
        effect, values = CATALOGUE[name], {"amplitude_deg": 3.0, "phase_deg": 30.0}
        values |= at_field if name == "hard_iron" else {}
        error = effect.from_parameters(values, frame) @ effect.basis(frame)
        expected = amplitude * np.sin(cycles * m + np.radians(30.0))
        np.testing.assert_allclose(np.degrees(error), expected, rtol=2e-4)


def test_heater_acts_where_icing_is_on_and_is_untestable_without_flag_and_temperature(perfect):
    effect = CATALOGUE["heater_current"]
    change = np.hypot(*difference(perfect, "heater_current", {"offset_deg": 2.0}).T)
    np.testing.assert_array_equal(change > 1.0, perfect.icing == 1)
    assert (change[perfect.icing != 1] == 0.0).all()
    warm = np.full(perfect.size, 300.0)
    never = replace(perfect, icing=np.zeros_like(perfect.icing), temperature=warm)
    assert "no icing flag that changes" in effect.testable(never)
    assert effect.testable(replace(perfect, temperature=warm)) is None


def test_a_heater_by_temperature_acts_between_two_edges(perfect):
    effect = CATALOGUE["heater_current"]
    celsius = np.linspace(-40.0, 20.0, perfect.size)
    frame = replace(perfect, temperature=celsius + 273.15)
    values = {"offset_deg": -4.7, "amplitude_deg": 2.0, "phase_deg": 30.0}
    for low, high in ((-10.0, 0.0), (-20.0, -5.0), (-100.0, -15.0)):
        band = values | {"between_degC": [low, high]}
        inside = (celsius > low + 1) & (celsius < high - 1)
        error = np.degrees(effect.error(frame, effect.complete(band)))
        expected = -4.7 + 2.0 * np.sin(frame.magnetic_heading + np.radians(30.0))
        np.testing.assert_allclose(error[inside], expected[inside], atol=1e-9)
        outside = (celsius < low - 1) | (celsius > high + 1)
        np.testing.assert_allclose(error[outside], 0.0, atol=1e-9)
    for wrong in ([0.0], [0.0, -10.0], "cold"):
        with pytest.raises(InputError, match="band of temperatures"):
            effect.error(frame, effect.complete({"offset_deg": 1.0, "between_degC": wrong}))


def test_acceleration_and_turn_error_by_hand(perfect):
    effect = CATALOGUE["acceleration_error"]
    three = replace(
        perfect.take(slice(0, 3)),
        phase=np.array([1, 2, 3]),
        magnetic_heading=np.full(3, np.pi / 2),
        dip=np.full(3, np.arctan(2.0)),
        acceleration=9.80665 * np.array([0.05, 0.001, -0.05]),
    )
    error = effect.from_parameters({"amplitude_deg": -20.0}, three) @ effect.basis(three)
    np.testing.assert_allclose(np.degrees(error), [-2.0, 0.0, 2.0])
    levelling = replace(three, phase=np.full(3, 2))
    np.testing.assert_allclose(effect.basis(levelling)[0], [0.1, 0.0, -0.1])
    turn = replace(three, magnetic_heading=np.radians([0.0, 60.0, 90.0]), bank=np.full(3, 0.2))
    np.testing.assert_allclose(CATALOGUE["turn_error"].basis(turn)[0], [0.4, 0.2, 0.0], atol=1e-12)
    # by phase: as at 0.03 g
    coefficients = effect.from_parameters({"amplitude_deg": 50.0, "by_phase": True}, three)
    np.testing.assert_allclose(np.degrees(coefficients @ effect.basis(three)), [3.0, 0.0, -3.0])
    values, errors = effect.to_parameters(coefficients, np.eye(2) * np.radians(1.0) ** 2, three)
    assert values == {"amplitude_deg": pytest.approx(50.0), "by_phase": True}
    assert errors == {"amplitude_deg": pytest.approx(1.0)}


def test_declination_of_an_old_epoch_is_igrf_itself(perfect):
    few = perfect.take(slice(0, None, 40))
    change = difference(few, "declination_error", {"epoch_year": 1995.0})
    dates = datetime(1995, 1, 1), datetime(2009, 7, 18)
    fields = (ppigrf.igrf(few.longitude, few.latitude, 3.0, date) for date in dates)
    then, now = (np.arctan2(east[0], north[0]) for east, north, _ in fields)
    error = then - now
    chord = 2.0 * few.airspeed * np.abs(np.sin(error / 2.0))
    np.testing.assert_allclose(np.hypot(*change.T), chord, atol=0.05)
    assert chord.mean() > 1.0


@pytest.mark.parametrize("year", [1965.0, 1985.0, 2004.0])
def test_columns_represent_an_old_declination_table(perfect, year):
    """Ten years' change alone leaves a sixth of a table of 1965."""
    effect = CATALOGUE["declination_error"]
    coefficients = old_table(perfect, year)
    true = declination_change(perfect, epoch_year=year)
    error = coefficients @ effect.basis(perfect) - true
    assert (error**2).mean() < 0.02**2 * (true**2).mean()
    values, errors = effect.to_parameters(coefficients, np.diag([1.0, 1e-4, 1e-12]), perfect)
    assert values["epoch_year"] == pytest.approx(year, abs=0.1 + 0.01 * (2009.6 - year))
    assert values["factor"] is None and errors["epoch_year"] == pytest.approx(1.0)
    assert values["mean_deg"] == pytest.approx(np.degrees(true.mean()), rel=0.05)
    by_mean = effect.from_parameters({"mean_deg": values["mean_deg"]}, perfect)
    mean = np.degrees(np.mean(by_mean @ effect.basis(perfect)))
    assert mean == pytest.approx(values["mean_deg"], rel=1e-6)


def test_effects_of_time_and_height_are_the_wind_elsewhere(perfect):
    time, latitude, longitude = perfect.time, perfect.latitude, perfect.longitude
    lnp, stamped = np.log(perfect.pressure), {"offset_h": 1.0 / 3.0}
    altitude, lag = altitude_from_pressure(perfect.pressure), 60.0
    lower = np.log(pressure_from_altitude(altitude - 91.44))
    earlier = np.log(pressure_from_altitude(altitude - lag * perfect.climb_rate))
    east = frames.METRES_PER_DEGREE * np.cos(np.radians(40.0))
    south = latitude - lag * perfect.ground_v / frames.METRES_PER_DEGREE
    west = longitude - lag * perfect.ground_u / east
    wind = np.stack(frames.wind(time, latitude, longitude, lnp), -1)
    for name, values, place, size in (
        # stamped t, shows t + 20 min
        ("reference_time_offset", stamped, (time - 1200.0, latitude, longitude, lnp), 0.15),
        ("altitude_offset", {"offset_ft": 300.0}, (time, latitude, longitude, lower), 0.1),
        ("time_lag", {"offset_s": lag}, (time - lag, south, west, earlier), 0.3),
    ):
        expected = np.stack(frames.wind(*place), -1) - wind
        np.testing.assert_allclose(difference(perfect, name, values), expected, atol=0.01)
        assert np.abs(expected).max() > size


def test_unrotated_winds_are_rotated(perfect):
    angle = perfect.grid_convergence
    along_grid = replace(
        perfect,
        u_ref=np.cos(angle) * perfect.u_ref - np.sin(angle) * perfect.v_ref,
        v_ref=np.sin(angle) * perfect.u_ref + np.cos(angle) * perfect.v_ref,
    )
    effect = [ActiveEffect("reference_grid_relative", {"fraction": 1.0})]
    met = simulate(along_grid, effects=effect)
    np.testing.assert_allclose(met.u_rep, perfect.u_ref, atol=1e-9)
    np.testing.assert_allclose(met.v_rep, perfect.v_ref, atol=1e-9)


@pytest.mark.parametrize(
    ("limits", "inside"),
    [
        ({}, lambda p: p > 0),
        ({"above_hPa": 500.0}, lambda p: p < 5e4),
        ({"below_hPa": 700.0}, lambda p: p >= 7e4),
    ],
)
def test_speed_bias_recovers_the_wind_met(perfect, limits, inside):
    factor = np.where(inside(perfect.pressure), 1.1, 1.0)
    strong = replace(perfect, u_ref=perfect.u_ref * factor, v_ref=perfect.v_ref * factor)
    effect = ActiveEffect("reference_speed_bias", {"bias_percent": 10.0, **limits})
    np.testing.assert_allclose(simulate(strong, effects=[effect]).u_rep, perfect.u_ref, atol=1e-9)
    assert 0.0 < np.mean(factor > 1.0) <= 1.0


def test_swapped_aircraft_show_each_others_errors_from_the_date_on(perfect):
    date = float(np.median(perfect.time))
    sent = simulate(
        perfect,
        effects=[
            ActiveEffect("compass_offset", {"offset_deg": 3.0}, tails=("N401",)),
            ActiveEffect("tail_swap", {"pair": ["N401", "N403"]}, period=(date, None)),
        ],
    )
    wrong = np.hypot(*(sent.residual - perfect.residual).T) > 1.0
    late = perfect.time >= date
    expected = np.where(late, perfect.aircraft == 2, perfect.aircraft == 0)
    np.testing.assert_array_equal(wrong, expected)
    with pytest.raises(InputError, match="N999"):
        difference(perfect, "tail_swap", {"pair": ["N401", "N999"]})
    with pytest.raises(InputError, match="two aircraft"):
        difference(perfect, "tail_swap", {"pair": "N401"})
    reason = CATALOGUE["tail_swap"].testable(perfect.take(perfect.aircraft_mask("N401")))
    assert reason == "only one aircraft in these reports"


@pytest.mark.parametrize(
    ("name", "values", "step"),
    [
        ("wind_coding", {"step": 5.0, "direction_step_deg": 10.0}, 10.0),
        ("position_coding", {"step": 2.0}, 1.0 / 30.0),
        ("heading_coding", {"step_deg": 5.0}, 5.0),
        ("heading_coding", {"step_deg": 5.0, "true_north": True}, 5.0),
    ],
)
def test_coarse_values_are_on_their_lattice_and_the_others_stay(perfect, name, values, step):
    sent = simulate(perfect, effects=[ActiveEffect(name, values)])
    speed = np.hypot(sent.u_rep, sent.v_rep) / KNOT
    heading = sent.heading if "true_north" in values else sent.magnetic_heading
    rounded = {
        "wind_coding": (2.0 * speed, np.degrees(np.arctan2(-sent.u_rep, -sent.v_rep))),
        "position_coding": (sent.latitude, sent.longitude),
        "heading_coding": (np.degrees(heading),),
    }
    for coded in rounded[name]:
        np.testing.assert_allclose(coded / step, np.round(coded / step), atol=1e-6)
        assert np.unique(np.round(coded / step)).size > 3
    unchanged = {"position_coding": "u_rep v_rep", "heading_coding": "airspeed latitude"}
    for field in unchanged.get(name, "latitude").split():
        np.testing.assert_allclose(getattr(sent, field), getattr(perfect, field), atol=1e-9)


def test_missing_context_is_named(perfect):
    course, magnetic = np.full((2, perfect.size), [[1.0], [1.05]])
    same = replace(perfect, heading=course, magnetic_heading=magnetic)
    for name in ("compass_offset", "hard_iron", "soft_iron", "tas_scale"):
        assert CATALOGUE[name].testable(same) == "all reports on one heading"
        assert CATALOGUE[name].testable(perfect) is None
    untestable = CATALOGUE["acceleration_error"].testable(perfect.take(perfect.phase == 2))
    assert untestable == "no climb or descent in these reports"
    flat = replace(perfect, dudlnp=np.full(perfect.size, np.nan))
    assert "vertical derivative" in CATALOGUE["altitude_offset"].testable(flat)
    regular = replace(perfect, grid_convergence=np.zeros(perfect.size))
    assert "true north" in CATALOGUE["reference_grid_relative"].testable(regular)
    assert (np.isfinite(CATALOGUE["altitude_offset"].columns(flat))).all()


@pytest.fixture(scope="module")
def toy():
    return make_frame(seed=3, aircraft=3, days=3)


def test_table_of_two_variables_and_an_unknown_value(toy):
    table = Table(
        "along_wind",
        ("track", "temperature"),
        (np.array([0.0, 180.0, 360.0]), np.array([-100.0, 0.0, 100.0])),
        np.array([1.0, 2.0, 3.0, 4.0]),
    )
    some = toy.take([0, 1, 2])
    temperature = np.array([263.15, 293.15, np.nan])
    ground_u = np.array([100.0, -100.0, 100.0])  # eastward, westward
    some = replace(some, temperature=temperature, ground_u=ground_u, ground_v=np.zeros(3))
    values = table.at(some, (some.u_rep, some.v_rep), some.heading)
    np.testing.assert_array_equal(values, [1.0, 4.0, 0.0])


@pytest.mark.parametrize(
    ("component", "change"),
    [
        ("across_heading", (1.0, 0.0)),
        ("along_heading", (0.0, 1.0)),
        ("heading_angle", (-100 * np.pi / 180, 0.0)),
        ("airspeed_factor", (0.0, -1.0)),
        ("across_wind", (0.0, -1.0)),
        ("along_wind", (1.0, 0.0)),
        ("wind_angle", (0.0, -20 * np.pi / 180)),
        ("wind_factor", (0.2, 0.0)),
    ],
)
def test_flying_north_at_100_in_a_westerly_of_20(component, change):
    flight = {"heading": np.zeros(1), "airspeed": np.full(1, 100.0)}
    vector = change_of(component, u=np.full(1, 20.0), v=np.zeros(1), **flight)
    np.testing.assert_allclose(vector[0], change, atol=1e-12)


def table(component, values, edges=((-1e4, 0.0, 1e4),), variables=("longitude",)):
    parameters = {
        "component": component,
        "variables": list(variables),
        "edges": [list(map(float, cut)) for cut in edges],
        "values": list(values),
    }
    return ActiveEffect("empirical", parameters, None)


def test_an_angle_equals_a_compass_offset_in_its_cells(toy):
    middle = float(np.median(toy.longitude))
    effect = table("heading_angle", [0.0, 2.0], edges=[(-500.0, middle, 500.0)])
    residual = simulate(toy, effects=[effect]).residual
    offset = ActiveEffect("compass_offset", {"offset_deg": 2.0}, None)
    everywhere, nowhere = simulate(toy, effects=[offset]).residual, simulate(toy).residual
    inside = (toy.longitude >= middle)[:, None]
    np.testing.assert_allclose(residual, np.where(inside, everywhere, nowhere), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"component": "sideways"}, "no such component"),
        ({"variables": ["moon"]}, "unknown variable"),
        ({"edges": [[0.0, 0.0, 1.0]]}, "edges must increase"),
        ({"edges": []}, "needs its edges"),
        ({"values": [1.0]}, "one number per cell"),
        ({"variables": "longitude"}, "one or two variables"),
    ],
)
def test_invalid_tables_are_refused(change, message):
    parameters = table("along_heading", [0.0, 3.0]).parameters | change
    with pytest.raises(InputError, match=message):
        effect_named("empirical").complete(parameters)
