"""Sealed archives: plan, draws, effects outside the catalogue, true closures, sensor errors."""

from collections import Counter
from datetime import datetime

import numpy as np
import pytest

from airswing.blind_check.score import draws
from airswing.gap.effects import CATALOGUE
from airswing.synthetic.archive import simulate_arrays
from airswing.synthetic.instrument import parse_faults
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
from airswing.synthetic.sealed import sealed_archives as archives
from airswing.synthetic.sealed.cases import ALIKE, OUTSIDE_SHAPES, RUNGS, Case, Size, draw_outside
from airswing.synthetic.sealed.cases import plan_cases as plan
from airswing.synthetic.sealed.draws import START, Drawn, World, draw_effect
from airswing.synthetic.sealed.sealed_archives import Archivist, write_model_case
from airswing.units import KNOT

TAILS = World(0, "default", 45, 14).tails
DRAWS = draws()


def draw(name, seed=0, days=40, **options):
    rng = np.random.default_rng(seed)
    world = World(0, "default", days, len(TAILS))
    return draw_effect(name, DRAWS[name], rng, world, step=2, **options)


def plan_cases(*args, **options):
    return plan(*args, draws=DRAWS, **options)


def nulls_of(planned):
    return [case.world for case in planned if case.kind == "null"]


def test_the_plan_deals_rungs_nulls_and_effects_evenly_and_follows_from_its_seed():
    planned = plan_cases(240, seed=3, size=Size())
    rungs = Counter(case.rung for case in planned)
    assert rungs == {rung: round(240 * share) for rung, share in RUNGS.items()}
    for rung, count in rungs.items():
        assert len(nulls_of([case for case in planned if case.rung == rung])) == count // 4
    singles = Counter(case.drawn[0].name for case in planned if case.rung == 1 and case.drawn)
    assert set(singles) == set(DRAWS)
    assert max(singles.values()) - min(singles.values()) <= 1
    short = [case for case in planned if case.world.kind == "short"]
    assert {case.world.days for case in short} == {14, 15}
    assert {"null", "single", "outside"} <= {case.kind for case in short}
    assert planned == plan_cases(240, seed=3, size=Size())
    assert planned != plan_cases(240, seed=6, size=Size())


@pytest.mark.parametrize("options", [{"rungs": (1,)}, {"rungs": (1, 2)}, {}, {"nulls": 60}])
def test_no_two_nulls_are_the_same_archive(options):
    nulls = nulls_of(plan_cases(100, seed=4, size=Size(), **options))
    assert len(set(nulls)) == len(nulls) == options.get("nulls", len(nulls)) > 20
    assert not nulls_of(plan_cases(20, seed=5, size=Size(), nulls=0))


@pytest.mark.parametrize("name", DRAWS)
def test_the_generator_takes_every_draw(name):
    for seed in range(4):
        drawn = draw(name, seed)
        faults = parse_faults(list(drawn.effects), start=START, tails=TAILS)
        assert drawn.name in {fault.name for fault in faults}
        parameters = {p.name for p in CATALOGUE[name].parameters} if name in CATALOGUE else None
        entry = next(effect for effect in drawn.effects if effect["name"] == name)
        assert parameters is None or set(entry["parameters"]) <= parameters


RNG = np.random.default_rng(0)


def shape_of(variable, shape, at, width):
    return {"variable": variable, "shape": shape, "at": at, "width": width}


def test_shapes_of_a_variable_that_turns_by_hand():
    def values(hours, *shape):
        return part_values(shape_of("hour", *shape), {"hour": np.array(hours)})

    hours = [0.0, 3.5, 4.0, 6.0, 8.0, 8.5, 23.0]
    assert values(hours, "sector", 0.25, 0.1).tolist() == [0, 0, 1, 1, 1, 0, 0]  # 6 h +- 2.4 h
    assert values(hours, "sector", 0.0, 0.05).tolist() == [1, 0, 0, 0, 0, 0, 1]
    bump = values([6.0, 8.0], "bump", 0.25, 1 / 12)  # sd of 2 h
    assert bump == pytest.approx([1.0, np.exp(-0.5)])
    assert values([0.0, 6.0, 11.999], "saw", 0.0, 0.5) == pytest.approx([-1.0, 0.0, 1.0], abs=1e-3)


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
    affected = np.arange(u.size) % 2 == 0
    effect = {"parts": [shape_of("hour", "sector", 0.3, 0.2)], "component": component}
    change = effect_change(effect | {"size_m_s": 0.4, "sign": 1.0}, u, v, variables, affected, RNG)
    acts = np.any(change != 0, axis=1)
    assert not acts[~affected].any() and acts.any()
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
    everywhere, rng = np.ones(4, bool), np.random.default_rng(0)

    def speeds(**values):
        change = effect_change({"parts": [], **values}, u, v, variables, everywhere, rng)
        return np.hypot(u + change[:, 0], v + change[:, 1]) / KNOT

    assert speeds(kind="floor", limit_kt=8.0)[:3] == pytest.approx([8, 10, 40])
    assert speeds(kind="ceiling", limit_kt=30.0)[:3] == pytest.approx([2, 10, 30])
    assert speeds(kind="hole", between_kt=[9.0, 20.0])[:3] == pytest.approx([2, 9, 40])
    turned = KNOT * 10 * np.stack([np.sin(np.radians([20.0, 50.0])), np.cos(np.radians([20, 50]))])
    lattice = {"kind": "lattice", "parts": [], "limit_kt": 20.0, "direction_step_deg": 45.0}
    change = effect_change(lattice, *turned, {}, np.ones(2, bool), rng)
    directions = np.degrees(np.arctan2(turned[0] + change[:, 0], turned[1] + change[:, 1]))
    assert directions == pytest.approx([0.0, 45.0], abs=1e-9)


def test_draws_have_the_stated_shape_and_cover_components_and_variables():
    variables, u, v = surroundings()
    seen = Counter()
    for seed in range(600):
        rng, shape = np.random.default_rng(seed), OUTSIDE_SHAPES[seed % len(OUTSIDE_SHAPES)]
        effect = draw_outside(rng, World(0, "default", 45, 14), shape=shape, size=0.8)
        parameters = effect["parameters"]
        names = [p["variable"] for p in parameters["parts"]]
        assert set(names) <= set(VARIABLES) and len(set(names)) == len(names)
        assert not any(len(set(names) & group) > 1 for group in ALIKE)
        if shape != "scatter":
            assert len(names) == (2 if shape in ("product", "threshold") else 1)
        change = effect_change(parameters, u, v, variables, np.ones(u.size, bool), rng)
        assert np.isfinite(change).all()
        seen.update([parameters["component"], parameters.get("kind", ""), *names])
        tails = effect["tails"]
        seen["all" if tails is None else "one" if len(tails) == 1 else "some"] += 1
        if effect["period"] is not None:
            seen["late"] += 1
            assert (datetime.fromisoformat(effect["period"][0]) - START).days == 38
    assert {*COMPONENTS, *SCATTER, *VARIABLES, "one", "some", "all"} <= set(seen)
    assert 30 < seen["late"] < 100


def test_named_effects_explain_iron_and_not_a_sector_of_wind():
    variables, u, v = surroundings(8000)
    aircraft = np.arange(u.size) % 4
    across = np.stack([np.cos(variables["heading"]), -np.sin(variables["heading"])], -1)
    iron = (variables["airspeed"] * 0.01 * np.sin(variables["magnetic_heading"] + 0.7))[:, None]
    assert named_share(iron * across, variables, u, v, aircraft) == pytest.approx(1.0, abs=1e-9)
    turned = {"parts": [shape_of("wind_direction", "sector", 0.7, 0.05)], "component": "direction"}
    turned |= {"size_m_s": 1.0, "sign": 1.0}
    change = effect_change(turned, u, v, variables, aircraft < 2, RNG)
    assert named_share(change, variables, u, v, aircraft) < MOST_NAMED
    assert named_share(np.zeros_like(change), variables, u, v, aircraft) == 0.0


TINY = World(3, "default", 3, 3, coarse=True)


def drawn(name, **parameters):
    """A drawn effect of the whole fleet."""
    effect = {"name": name, "tails": None, "parameters": parameters, "period": None}
    return Drawn(name, (effect,), *([CATALOGUE[name].draw] if name in CATALOGUE else []))


def test_the_true_closure_is_that_of_the_twin_without_the_effect(tmp_path):
    archivist = Archivist(tmp_path)
    effect = drawn("tas_offset", offset_m_s=1.0)
    label = archivist.write(Case("case_1", 1, "single", TINY, (effect,), (3.0,)))
    options = archives.generator_options(TINY)
    with_it = simulate_arrays(effects=label["effects"], **options)
    without = simulate_arrays(effects=[], **options)
    for name, frame in (("before", with_it), ("after", without)):
        u, v = (frame[c] - (frame[f"{c}_ruc"] + frame[f"{c}_rtfdaa"]) / 2 for c in "uv")
        used = (frame["temperature_qc"] == "pass") & u.notna()
        assert label["closure"][name] == pytest.approx(np.hypot(u, v)[used].mean() / KNOT, rel=1e-9)
    assert label["closure"]["before"] > label["closure"]["after"] + 0.3


def test_an_outside_case_takes_the_first_draw_that_no_name_explains(tmp_path):
    def candidate(*shape, component="across_heading"):
        parts = {"parts": [shape_of(*shape)], "shape": shape[1]}
        return drawn("outside", component=component, size_m_s=1.5, sign=1.0, **parts)

    always = candidate("airspeed", "hinge", 0.0, 0.1, component="along_heading")
    cycle = candidate("magnetic_heading", "linear", 0.3, 0.1)
    saw = candidate("hour", "saw", 0.1, 0.26)
    case = Case("case_1", 4, "outside", TINY, (cycle,), (1.5,), (), "saw", (always, saw))
    label = Archivist(tmp_path).write(case)
    truth = label["outside"]
    assert truth["variables"] == ["hour"] and truth["named_share"] < 0.35
    assert label["size"] == truth["size_m_s"] == pytest.approx(1.5, rel=0.02)
    assert truth["carried"]["hour"] > 0.6  # bins smooth its edges
    closed = label["closure"]["before"] - label["closure"]["after"]
    assert truth["closes_kt"] == pytest.approx(closed, abs=0.02)
    assert label["closure"]["before"] > label["closure"]["after"]


def test_closure_of_a_case_on_a_real_run(real, tmp_path):
    """Six degrees at some 135 m/s are 27 kt across every wind; the run adds its error."""
    data = real("grib/wrf_ruc13_g212").parents[1]
    effect = {"name": "compass_offset", "parameters": {"offset_deg": 6.0}, "tails": None}
    closure = write_model_case(tmp_path, data, [effect], World(4, "model", 1, 2))
    assert closure["before"] > 27.0 > 10.0 > closure["after"] > 0.5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["config.yaml", "reports"]
