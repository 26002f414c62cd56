"""Tables over variables of the report: change of the wind, and agreement with exact effects."""

from dataclasses import replace

import numpy as np
import pytest
from tests.gap.toy import make_frame

from airswing.errors import InputError
from airswing.gap.effects import ActiveEffect, effect_named
from airswing.gap.effects.empirical import Table, change_of
from airswing.gap.simulation.forward import simulate


@pytest.fixture(scope="module")
def frame():
    return make_frame(seed=3, aircraft=3, days=3)


def test_table_of_two_variables_and_an_unknown_value(frame):
    table = Table(
        "along_wind",
        ("track", "temperature"),
        (np.array([0.0, 180.0, 360.0]), np.array([-100.0, 0.0, 100.0])),
        np.array([1.0, 2.0, 3.0, 4.0]),
    )
    some = frame.take([0, 1, 2])
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
        "edges": [list(map(float, cut)) for cut in edges],
        "values": list(values),
    }
    return ActiveEffect("empirical", parameters, None)


def test_an_angle_equals_a_compass_offset_in_its_cells(frame):
    middle = float(np.median(frame.longitude))
    effect = table("heading_angle", [0.0, 2.0], edges=[(-500.0, middle, 500.0)])
    made = simulate(frame, effects=[effect]).residual
    offset = ActiveEffect("compass_offset", {"offset_deg": 2.0}, None)
    everywhere, nowhere = simulate(frame, effects=[offset]).residual, simulate(frame).residual
    inside = (frame.longitude >= middle)[:, None]
    np.testing.assert_allclose(made, np.where(inside, everywhere, nowhere), atol=1e-9)


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
