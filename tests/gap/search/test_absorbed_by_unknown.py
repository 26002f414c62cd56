"""Names that are the mean of something unknown."""

from __future__ import annotations

import numpy as np

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term
from airswing.gap.search.absorbed_by_unknown import folded


def _term(name, tails, *, known=True, period=None):
    candidate = Candidate(name, np.array([0]), "aircraft", np.ones(1), known)
    return Term(candidate, tails, period, None)


def test_a_name_that_explains_half_is_the_mean_of_the_unknown():
    terms = [_term("compass_offset", (1, 2)), _term("cross:hour", (1, 2, 3), known=False)]
    assert folded(terms, np.array([100.0, 100.0]), np.array([10.0, 10.0])) == {0: 1}
    # 0.9 of the energy, or 0.5 with no certainty
    assert folded(terms, np.array([900.0, 100.0]), np.array([10.0, 10.0])) == {}
    assert folded(terms, np.array([100.0, 100.0]), np.array([90.0, 90.0])) == {}


def test_other_names_stand():
    energy, error = np.array([100.0, 100.0]), np.array([10.0, 10.0])
    unknown = _term("cross:hour", (1, 2), known=False)
    for name, tails, period in (
        ("tas_scale", (1,), None), ("compass_offset", (1, 5), None),
        ("compass_offset", (1,), (0, 4)), ("hard_iron", (1,), None),
    ):  # fmt: skip
        assert folded([_term(name, tails, period=period), unknown], energy, error) == {}
    cycle = _term("cross:hour*heading", (1, 2), known=False)
    assert folded([_term("hard_iron", (1,)), cycle], energy, error) == {0: 1}
