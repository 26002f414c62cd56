"""Effects outside the catalogue: shapes, components, draws, share of named effects."""

from __future__ import annotations

from collections import Counter
from datetime import datetime

import numpy as np
import pytest

from airswing.synthetic.outside_effects import (
    COMPONENTS,
    MOST_NAMED,
    SCATTER,
    VARIABLES,
    effect_change,
    named_share,
    part_values,
    report_variables,
)
from airswing.synthetic.sealed.cases import ALIKE, OUTSIDE_SHAPES, draw_outside
from airswing.synthetic.sealed.draws import START, World

KNOT = 1852.0 / 3600.0
RNG = np.random.default_rng(0)


def part(variable="hour", shape="sector", at=0.25, width=0.1):
    return {"variable": variable, "shape": shape, "at": at, "width": width}


def effect(parts, component="across_wind", size=1.0, sign=1.0):
    return {"parts": parts, "component": component, "size_m_s": size, "sign": sign}


def test_shapes_of_a_variable_that_turns_by_hand():
    hours = {"hour": np.array([0.0, 3.5, 4.0, 6.0, 8.0, 8.5, 23.0])}
    sector = part_values(part("hour", "sector", at=0.25, width=0.1), hours)  # 6 h +- 2.4 h
    assert sector.tolist() == [0, 0, 1, 1, 1, 0, 0]
    round_midnight = part_values(part("hour", "sector", at=0.0, width=0.05), hours)
    assert round_midnight.tolist() == [1, 0, 0, 0, 0, 0, 1]
    bump = part_values(part("hour", "bump", at=0.25, width=1 / 12), hours)  # sd of 2 h
    assert bump[3] == 1.0 and bump[4] == pytest.approx(np.exp(-0.5))
    saw = part_values(
        part("hour", "saw", at=0.0, width=0.5), {"hour": np.array([0.0, 6.0, 11.999])}
    )
    assert saw == pytest.approx([-1.0, 0.0, 1.0], abs=1e-3)


def surroundings(n=4000, seed=0):
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-np.pi, np.pi, n)
    frame = {
        "heading": heading,
        "declination": np.full(n, -0.1),
        "airspeed": rng.normal(120, 10, n),
        "ground_u": 120 * np.sin(heading) + 5,
        "ground_v": 120 * np.cos(heading) - 3,
        "true_latitude": rng.uniform(38, 46, n),
        "true_longitude": rng.uniform(-95, -80, n),
        "true_altitude": rng.uniform(500, 7000, n),
        "temperature": rng.uniform(240, 290, n),
        "icing": rng.integers(0, 2, n),
        "phase": rng.integers(1, 4, n),
        "bank": rng.normal(0, 0.1, n),
        "acceleration": rng.normal(0, 0.3, n),
        "flight": rng.integers(0, 40, n),
    }
    u, v = rng.normal(5, 8, n), rng.normal(0, 8, n)
    return report_variables(frame, u, v, rng.uniform(0, 240, n)), u, v


@pytest.mark.parametrize("component", COMPONENTS)
def test_every_component_has_the_stated_size_where_it_acts_and_its_direction(component):
    variables, u, v = surroundings()
    chosen = np.arange(u.size) % 2 == 0
    one = effect([part("hour", "sector", at=0.3, width=0.2)], component, size=0.4)
    change = effect_change(one, u, v, variables, chosen, RNG)
    acts = np.any(change != 0, axis=1)
    assert not acts[~chosen].any() and acts.any()
    assert np.sqrt((change[acts] ** 2).sum(1).mean()) == pytest.approx(0.4, rel=0.02)
    heading = np.stack([np.sin(variables["heading"]), np.cos(variables["heading"])], -1)
    wind = np.stack([u, v], -1) / np.hypot(u, v)[:, None]
    axis = heading if component.endswith("heading") else wind
    along = (change * axis).sum(1)[acts]
    length = np.hypot(*change[acts].T)
    if component in ("along_heading", "along_wind", "speed"):
        assert np.abs(along) == pytest.approx(length, rel=1e-9)
    elif component == "direction":
        speeds = np.hypot(u + change[:, 0], v + change[:, 1])
        assert speeds == pytest.approx(np.hypot(u, v), rel=1e-9)
    else:
        assert along == pytest.approx(np.zeros(acts.sum()), abs=1e-9)


def test_scatter_by_hand():
    variables, _, _ = surroundings(4)
    u, v = KNOT * np.array([2.0, 10.0, 40.0, 0.0]), np.zeros(4)
    here, rng = np.ones(4, bool), np.random.default_rng(0)

    def speeds(**values):
        change = effect_change({"parts": [], **values}, u, v, variables, here, rng)
        return np.hypot(u + change[:, 0], v + change[:, 1]) / KNOT

    assert speeds(kind="floor", limit_kt=8.0)[:3] == pytest.approx([8, 10, 40])
    assert speeds(kind="ceiling", limit_kt=30.0)[:3] == pytest.approx([2, 10, 30])
    assert speeds(kind="hole", between_kt=[9.0, 20.0])[:3] == pytest.approx([2, 9, 40])
    turned = KNOT * 10 * np.stack([np.sin(np.radians([20.0, 50.0])), np.cos(np.radians([20, 50]))])
    lattice = {"kind": "lattice", "parts": [], "limit_kt": 20.0, "direction_step_deg": 45.0}
    change = effect_change(lattice, *turned, {}, np.ones(2, bool), rng)
    moved = np.degrees(np.arctan2(turned[0] + change[:, 0], turned[1] + change[:, 1]))
    assert moved == pytest.approx([0.0, 45.0], abs=1e-9)


def test_draws_have_the_stated_shape_and_cover_components_and_variables():
    variables, u, v = surroundings()
    seen = Counter()
    for seed in range(600):
        rng, shape = np.random.default_rng(seed), OUTSIDE_SHAPES[seed % len(OUTSIDE_SHAPES)]
        one = draw_outside(rng, World(0, "default", 45, 14), shape=shape, size=0.8)
        chosen = one["parameters"]
        names = [p["variable"] for p in chosen["parts"]]
        assert set(names) <= set(VARIABLES) and len(set(names)) == len(names)
        assert not any(len(set(names) & group) > 1 for group in ALIKE)
        if shape != "scatter":
            assert len(names) == (2 if shape in ("product", "threshold") else 1)
        change = effect_change(chosen, u, v, variables, np.ones(u.size, bool), rng)
        assert np.isfinite(change).all()
        seen.update([chosen["component"], chosen.get("kind", ""), *names])
        seen["all" if one["tails"] is None else "one" if len(one["tails"]) == 1 else "some"] += 1
        if one["period"] is not None:
            seen["late"] += 1
            assert (datetime.fromisoformat(one["period"][0]) - START).days == 38
    assert {*COMPONENTS, *SCATTER, *VARIABLES, "one", "some", "all"} <= set(seen)
    assert 30 < seen["late"] < 100


def test_named_effects_explain_iron_and_not_a_sector_of_wind():
    variables, u, v = surroundings(8000)
    aircraft = np.arange(u.size) % 4
    across = np.stack([np.cos(variables["heading"]), -np.sin(variables["heading"])], -1)
    iron = (variables["airspeed"] * 0.01 * np.sin(variables["magnetic_heading"] + 0.7))[:, None]
    assert named_share(iron * across, variables, u, v, aircraft) == pytest.approx(1.0, abs=1e-9)
    turned = effect([part("wind_direction", "sector", at=0.7, width=0.05)], "direction")
    change = effect_change(turned, u, v, variables, aircraft < 2, RNG)
    assert named_share(change, variables, u, v, aircraft) < MOST_NAMED
    assert named_share(np.zeros_like(change), variables, u, v, aircraft) == 0.0
