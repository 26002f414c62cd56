"""A name that came second does not push out one that explains more."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from airswing.gap.search.stepwise import pushes_out


def term(name, *, scope="fleet", known=True, heading=False):
    candidate = SimpleNamespace(name=name, scope=scope, known=known, heading=heading, kind="mean")
    return SimpleNamespace(candidate=candidate, key=(name, scope), tails=(0, 1), period=None)


def ranked(**raw):
    """Ranking of which every state gives the same raw evidence."""
    return lambda _: [
        SimpleNamespace(candidate=term(name).candidate, raw=value) for name, value in raw.items()
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
