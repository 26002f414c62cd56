"""The plan of a check and the draws: shares, balance, neutrality, strengths."""

from __future__ import annotations

from collections import Counter
from datetime import datetime

import numpy as np
import pytest

from airswing.blind_check.score import draws
from airswing.gap.effects import CATALOGUE
from airswing.synthetic.instrument import parse_faults
from airswing.synthetic.sealed.cases import RUNGS, Size
from airswing.synthetic.sealed.cases import plan_cases as plan
from airswing.synthetic.sealed.draws import START, World, draw_effect

TAILS = World(0, "default", 45, 14).tails
DRAWS = draws()


def draw(name, seed=0, days=40, **options):
    rng = np.random.default_rng(seed)
    world = World(0, "default", days, len(TAILS))
    return draw_effect(name, DRAWS[name], rng, world, step=2, **options)


def plan_cases(*args, **options):
    return plan(*args, draws=DRAWS, **options)


@pytest.fixture(scope="module")
def planned():
    return plan_cases(240, seed=3, size=Size())


def nulls_of(planned):
    return [case.world for case in planned if case.kind == "null"]


def test_plan_deals_rungs_nulls_and_effects_evenly(planned):
    rungs = Counter(case.rung for case in planned)
    assert rungs == {rung: round(240 * share) for rung, share in RUNGS.items()}
    for rung, count in rungs.items():
        assert len(nulls_of([case for case in planned if case.rung == rung])) == count // 4
    singles = Counter(case.drawn[0].name for case in planned if case.rung == 1 and case.drawn)
    assert set(singles) == set(DRAWS)
    assert max(singles.values()) - min(singles.values()) <= 1


@pytest.mark.parametrize("options", [{"rungs": (1,)}, {"rungs": (1, 2)}, {}, {"nulls": 60}])
def test_no_two_nulls_are_the_same_archive(options):
    nulls = nulls_of(plan_cases(100, seed=4, size=Size(), **options))
    assert len(set(nulls)) == len(nulls) == options.get("nulls", len(nulls)) > 20
    assert not nulls_of(plan_cases(20, seed=5, size=Size(), nulls=0))


def test_the_plan_follows_from_its_seed_and_has_short_worlds(planned):
    assert planned == plan_cases(240, seed=3, size=Size())
    assert planned != plan_cases(240, seed=6, size=Size())
    short = [case for case in planned if case.world.kind == "short"]
    assert {case.world.days for case in short} == {14, 15}
    assert {"null", "single", "outside"} <= {case.kind for case in short}


def test_kinds_and_variants_of_cases(planned):
    pairs, removed, outside = (
        [case for case in planned if case.kind == kind] for kind in ("pair", "removed", "outside")
    )
    assert removed and outside
    assert all(len({part.name for part in case.drawn}) == 2 for case in pairs)
    assert all(case.without == (case.drawn[0].name,) for case in removed)
    assert all(case.without == () and case.drawn[0].name == "outside" for case in outside)
    assert {"fleet", "form", "last week"} <= {case.variant for case in planned if case.rung == 1}
    same = [case for case in pairs if case.variant == "same aircraft"]
    assert 5 < len(same) < len(pairs) - 5
    assert all(case.drawn[0].tails == case.drawn[1].tails for case in same)


@pytest.mark.parametrize("name", DRAWS)
def test_the_generator_takes_every_draw(name):
    for seed in range(4):
        drawn = draw(name, seed)
        faults = parse_faults(list(drawn.effects), start=START, tails=TAILS)
        assert drawn.name in {fault.name for fault in faults}
        known = {p.name for p in CATALOGUE[name].parameters} if name in CATALOGUE else None
        chosen = next(effect for effect in drawn.effects if effect["name"] == name)
        assert known is None or set(chosen["parameters"]) <= known


def test_variants():
    assert set(draw("hard_iron", variant="fleet").tails) == set(TAILS)
    assert draw("heater_current", variant="form").effects[0]["parameters"]["between_degC"]
    assert draw("acceleration_error", variant="form").effects[0]["parameters"]["by_phase"] is True
    below = draw("reference_speed_bias", variant="form").effects[0]["parameters"]
    assert below["above_hPa"] is None and 600 <= below["below_hPa"] <= 800
    for name in ("compass_step", "compass_drift", "tail_swap"):
        chosen = draw(name, variant="last week").effects[-1]
        assert 2 <= 40 - (datetime.fromisoformat(chosen["period"][0]) - START).days <= 6
    assert draw("compass_offset", among=["N403"]).tails == ("N403",)
    assert draw("declination_error", among=["N403"]).tails is None


def test_a_swap_comes_with_the_opposite_deviations_that_make_it_visible():
    drawn = draw("tail_swap")
    first, second, swap = drawn.effects
    assert {first["tails"][0], second["tails"][0]} == set(swap["tails"]) == set(drawn.tails)
    turn = second["parameters"]["phase_deg"] - first["parameters"]["phase_deg"]
    assert turn == pytest.approx(180.0)
    when = datetime.fromisoformat(swap["period"][0])
    assert 0.2 * 40 <= (when - START).days <= 0.8 * 40
