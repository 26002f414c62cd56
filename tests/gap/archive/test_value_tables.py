"""Cells, what a value does to the wind, and the empirical effect against its exact likes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.archive.reported_variables import Variable, record
from airswing.gap.archive.value_tables import Axis, Grid, axis_of, change_of
from airswing.gap.effects import ActiveEffect, effect_named
from airswing.gap.simulation.effects_file import read_effects, write_effects
from airswing.gap.simulation.forward import simulate


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=3, aircraft=3, days=3)


def test_cells_are_quantiles_sectors_or_categories():
    linear = axis_of(Variable("airspeed", "linear", np.arange(100.0)), 4)
    np.testing.assert_allclose(linear.edges, [0, 24.75, 49.5, 74.25, 99])
    sector = axis_of(Variable("track", "circular", np.array([10.0, 350.0])), 12)
    grid = Grid((sector, linear))
    values = np.array([29.9, 30.0, 359.0, np.nan]), np.array([0.0, 30.0, 99.0, 3.0])
    assert grid.cells(values).tolist() == [0, 5, 47, -1]
    assert grid.size == 48
    assert Axis("icing", "category", np.array([-0.5, 0.5, 1.5])).labels == ("off", "on")


def test_values_that_nearly_all_share_leave_cells_to_the_others():
    """Of turns and banks nine of ten are none: quantiles of all would make two cells."""
    rng = np.random.default_rng(4)
    level = rng.normal(0.0, 0.01, 9_000)
    turning = rng.choice([-1.0, 1.0], 1_000) * rng.gamma(2.0, 8.0, 1_000)
    bank = Variable("bank", "linear", np.r_[level, np.zeros(9_000), turning])
    for count in (6, 12):
        edges = bank.edges(count)
        assert 0.75 * count <= edges.size - 1 <= 2 * count
        held = np.bincount(bank.cells(edges), minlength=edges.size - 1)
        # of those that turn no cell has more than half
        assert np.sort(held)[:-1].max() < 500
        assert held.min() > 0


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
    cells = variable.cells(edges)
    assert cells.min() >= 0 and cells.max() <= edges.size - 2


def test_a_circle_has_no_end():
    likeness = Axis("track", "circular", np.linspace(0, 360, 13)).likeness()
    assert likeness[0, 11] == likeness[0, 1] > likeness[0, 2]
    prior = Grid((Axis("track", "circular", np.linspace(0, 360, 13)),)).prior()
    np.testing.assert_allclose(np.diag(prior), 1.0)
    assert np.linalg.eigvalsh(prior)[0] > 0


def test_values_that_do_not_vary_make_no_variable(frame):
    same = replace(frame, icing=np.zeros(frame.size, np.int64))
    assert "icing" not in record(same, same)
    assert {"track", "airspeed", "hour", "wind_direction"} <= set(record(frame, frame))


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
    made = change_of(
        component,
        heading=np.zeros(1),
        airspeed=np.full(1, 100.0),
        u=np.full(1, 20.0),
        v=np.zeros(1),
    )
    np.testing.assert_allclose(made[0], change, atol=1e-12)


def table(component, values, edges=((-1e4, 0.0, 1e4),), variables=("longitude",)):
    parameters = {
        "component": component,
        "variables": list(variables),
        "edges": [list(map(float, own)) for own in edges],
        "values": list(values),
    }
    return ActiveEffect("empirical", parameters, None)


def test_a_constant_angle_is_a_compass_offset(frame):
    one = simulate(frame, effects=[table("heading_angle", [2.0, 2.0])])
    other = simulate(frame, effects=[ActiveEffect("compass_offset", {"offset_deg": 2.0}, None)])
    np.testing.assert_allclose(one.u_rep, other.u_rep, atol=1e-9)
    np.testing.assert_allclose(one.v_rep, other.v_rep, atol=1e-9)


def test_a_constant_factor_is_an_airspeed_scale(frame):
    one = simulate(frame, effects=[table("airspeed_factor", [1.5, 1.5])])
    other = simulate(frame, effects=[ActiveEffect("tas_scale", {"scale_percent": 1.5}, None)])
    np.testing.assert_allclose(one.u_rep, other.u_rep, atol=1e-9)


def test_a_table_acts_where_its_cells_say(frame):
    middle = float(np.median(frame.longitude))
    effect = table("along_heading", [0.0, 3.0], edges=[(-500.0, middle, 500.0)])
    bare, made = simulate(frame), simulate(frame, effects=[effect])
    moved = np.hypot(made.u_rep - bare.u_rep, made.v_rep - bare.v_rep)
    np.testing.assert_allclose(moved, np.where(frame.longitude >= middle, 3.0, 0.0), atol=1e-9)


def test_a_table_goes_into_a_file_and_comes_back(tmp_path):
    effect = table(
        "wind_angle",
        [1.0, -2.5, 0.0, 4.0],
        variables=["track", "hour"],
        edges=[(0, 180, 360), (0, 12, 24)],
    )
    path = write_effects([effect], tmp_path / "effects.yaml")
    assert read_effects(path) == [effect]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"component": "sideways"}, "no such component"),
        ({"variables": ["moon"]}, "unknown variable"),
        ({"edges": [[0.0, 0.0, 1.0]]}, "edges must increase"),
        ({"edges": []}, "needs its edges"),
        ({"values": [1.0]}, "one number per cell"),
        ({"variables": "longitude"}, "one or two variables"),
    ],
)
def test_a_table_that_cannot_be_is_refused(change, said):
    parameters = table("along_heading", [0.0, 3.0]).parameters | change
    with pytest.raises(InputError, match=said):
        effect_named("empirical").complete(parameters)
