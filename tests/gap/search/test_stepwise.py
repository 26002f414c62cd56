"""A name that came second does not push out one that explains more."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from airswing.gap.search.candidate_ranking import CHANGE_PENALTY, ranked_by
from airswing.gap.search.stepwise import _best_name, pushes_out


def term(name, *, scope="fleet", known=True, heading=False):
    candidate = SimpleNamespace(name=name, scope=scope, known=known, heading=heading, kind="mean")
    return SimpleNamespace(candidate=candidate, key=(name, scope), tails=(0, 1), period=None)


def ranked(**raw):
    """Ranking of which every state gives the same raw evidence."""
    return lambda _: [
        SimpleNamespace(candidate=term(name).candidate, raw=value, factor=1.0)
        for name, value in raw.items()
    ]


@pytest.mark.parametrize(("shear", "kept"), [(120.0, True), (80.0, False)])
def test_of_two_names_of_the_wind_that_exclude_each_other_the_stronger_stays(shear, kept):
    first, second = term("altitude_offset"), term("reference_speed_bias")
    ranking = ranked(altitude_offset=shear, reference_speed_bias=100.0)
    assert pushes_out(ranking, [first], second, [second]) is kept
    assert not pushes_out(ranking, [first], second, [first, second])  # both have room


def test_an_error_of_the_heading_is_asked_as_before():
    first, second = term("declination_error", heading=True), term("reference_speed_bias")
    ranking = ranked(declination_error=120.0, reference_speed_bias=100.0)
    assert not pushes_out(ranking, [first], second, [second])


def score(name, raw, *, scope="fleet", kind="mean", factor=1.0, form=0):
    candidate = SimpleNamespace(name=name, scope=scope, kind=kind, subset=(form,))
    tempered = raw / factor
    return SimpleNamespace(candidate=candidate, raw=raw, factor=factor, tempered=tempered)


def test_odds_against_a_change_count_in_cluster_factors():
    steady, drift = (
        score("steady", 100.0, factor=2.5),
        score("drift", 109.0, kind="drift", factor=2.5),
    )
    assert ranked_by(drift) == pytest.approx(109.0 - 2.5 * CHANGE_PENALTY["drift"])
    assert ranked_by(steady) > ranked_by(drift)


def test_of_names_of_the_fleet_that_explain_as_much_the_surer_one_is_taken():
    offset, epoch = score("offset", 265.0, factor=2.5), score("epoch", 263.0, factor=1.8)
    assert _best_name([offset, epoch]) is epoch
    # more than the clusters leave open between them
    assert _best_name([score("offset", 275.0, factor=2.5), epoch]) is not epoch
    # forms of one name are told apart by what they explain
    factor = score("epoch", 264.0, factor=2.0, form=1)
    assert _best_name([epoch, factor]) is factor
    # single aircraft are asked as before
    alone = score("offset", 265.0, factor=2.5, scope="aircraft")
    assert _best_name([alone, epoch]) is alone
    assert _best_name([]) is None
