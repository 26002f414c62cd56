"""Names that are the mean of something unknown."""

from __future__ import annotations

import numpy as np

from airswing.gap.design.candidates import Candidate
from airswing.gap.evidence.terms import Term
from airswing.gap.search.absorbed_by_unknown import folded, stand_ins


def _term(name, tails, *, known=True, period=None):
    heading = name.startswith("cross") or name in ("compass_offset", "hard_iron", "soft_iron")
    candidate = Candidate(name, np.array([0]), "aircraft", np.ones(1), known, heading=heading)
    return Term(candidate, tails, period, None)


def test_a_name_that_explains_half_stands_in_for_the_unknown():
    terms = [_term("compass_offset", (1, 2)), _term("cross:hour", (1, 2, 3), known=False)]
    assert folded(terms, np.array([100.0, 100.0]), np.array([10.0, 10.0])) == {0: 1}
    # 0.95 of the energy, or 0.5 with no certainty
    assert folded(terms, np.array([950.0, 50.0]), np.array([10.0, 10.0])) == {}
    assert folded(terms, np.array([100.0, 100.0]), np.array([90.0, 90.0])) == {}


def test_names_and_curves_on_the_same_aircraft_are_judged_together():
    """A heading error in one quadrant: an offset, one cycle and two beside what is left of it."""
    names = [_term(name, (7, 8, 9)) for name in ("hard_iron", "soft_iron", "compass_offset")]
    curves = [
        _term(f"cross:{name}", (7, 8, 9), known=False)
        for name in ("phase*heading", "airspeed", "magnetic_heading 3 cycles")
    ]
    energy = np.array([2747.0, 2185.0, 1466.0, 543.0, 545.0, 400.0])
    error = np.array([160.0, 166.0, 120.0, 51.0, 62.0, 41.0])
    assert folded(names + curves, energy, error) == {0: 4, 1: 4, 2: 4}


def test_other_names_stand():
    energy, error = np.array([100.0, 100.0]), np.array([10.0, 10.0])
    unknown = _term("cross:hour", (1, 2, 3), known=False)
    for name, tails, period in (
        ("tas_scale", (1, 2), None),
        ("compass_offset", (1, 5), None),
        ("compass_offset", (1, 2), (0, 4)),
        ("hard_iron", (1,), None),
    ):
        assert folded([_term(name, tails, period=period), unknown], energy, error) == {}
    along = _term("along:altitude", (1, 2), known=False)
    assert folded([_term("tas_scale", (1, 2)), along], energy, error) == {0: 1}


def test_a_name_does_not_come_up_where_a_table_took_another():
    offset, drift = _term("compass_offset", (2, 3)), _term("compass_drift", (3,))
    assert stand_ins([offset], [drift]) == {"compass_drift"}
    # what is on other aircraft too, beside the name, or was there before stands
    assert stand_ins([offset], [_term("compass_drift", (3, 4))]) == set()
    assert stand_ins([offset], [offset, drift]) == set()
    assert stand_ins([offset, drift], [drift]) == set()
    assert stand_ins([], [drift]) == set()


def test_a_name_does_not_come_up_in_what_a_table_left_of_a_curve():
    """One cycle of four aircraft with no name; a table of all leaves a heater's of two."""
    curve = _term("cross:magnetic_heading", (1, 2, 3, 4), known=False)
    heater = _term("hard_iron", (2, 3))
    assert stand_ins([curve], [heater]) == {"hard_iron"}
    # on an aircraft without the curve, of another component, or there before it stands
    assert stand_ins([curve], [_term("hard_iron", (3, 5))]) == set()
    assert stand_ins([curve], [_term("tas_scale", (2, 3))]) == set()
    assert stand_ins([curve, heater], [heater]) == set()
