"""Energy in common: by hand, against least squares, and what is an alias on flights that are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gap.toy import make_frame

import airswing.gap.diagnose as stages
from airswing.gap.checks.aliases import alias_table, explained, hidden_shares, project
from airswing.gap.checks.assumptions import with_aliases
from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import EffectEntry, RivalEntry

NAMES = ("compass_offset", "hard_iron", "soft_iron", "compass_step", "tas_scale", "tas_offset")


@pytest.fixture(scope="module")
def searched():
    """Sums and found terms of an archive with an offset on one aircraft, airspeed on another."""
    frame = make_frame(
        seed=9,
        aircraft=5,
        days=16,
        noise=0.3,
        heading_error=lambda c: np.where(c["aircraft"] == 1, np.radians(1.5), 0.0),
        airspeed_factor=lambda c: np.where(c["aircraft"] == 3, 1.02, 1.0),
    )
    held = {}
    whole = stages.assemble

    def spy(problem, findings):
        held.update(base=problem.base, effects=problem.effects, found=findings.found)
        return whole(problem, findings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stages, "assemble", spy)
        catalogue = {n: CATALOGUE[n] for n in NAMES}
        stages.diagnose(frame, catalogue=catalogue, dictionary=False)
    return held


def test_aliases_of_airspeed_and_offset(searched):
    listed, shares = alias_table(searched["base"], searched["found"].terms, searched["effects"])
    assert {"compass_offset"} <= set(shares)
    assert shares["compass_offset"]["hard_iron"] < 0.8
    assert shares["compass_offset"]["tas_scale"] < 0.3
    speed = next(name for name in shares if name.startswith("tas_"))
    other = "tas_offset" if speed == "tas_scale" else "tas_scale"
    assert shares[speed][other] > 0.9
    assert (speed, other) in [(pair.effect, pair.other) for pair in listed]
    assert all(0.8 < pair.alias_share <= 1 for pair in listed)
    assert all(0 <= share <= 1 for own in shares.values() for share in own.values())


def test_explained_agrees_with_least_squares():
    rng = np.random.default_rng(0)
    one, two = rng.normal(size=(50, 2)), rng.normal(size=(50, 3))
    one[:, 0] += two[:, 1]
    fitted = two @ np.linalg.lstsq(two, one, rcond=None)[0]
    assert explained(one.T @ two, two.T @ two) == pytest.approx((fitted**2).sum())
    assert explained(one.T @ one, one.T @ one) == pytest.approx((one**2).sum())
    assert explained(np.zeros((1, 2)), np.zeros((2, 2))) == 0.0


def test_projection_leaves_what_is_beside():
    columns = np.array([[1.0, 1.0], [0.0, 1.0]])
    left = project(columns.T @ columns, 1, np.zeros(1))
    np.testing.assert_allclose(left, [[1.0]])
    np.testing.assert_allclose(project(columns.T @ columns, 1, np.array([1e12])), [[2.0]])


def rival(name, alias_share=None):
    return RivalEntry(name, 1.0, "x", alias_share)


def found(name, *rivals):
    names = [one.name for one in rivals]
    made = EffectEntry(name, 1.0, [], {}, {}, None, "aircraft", 9.0)
    return replace(made, ambiguity=list(rivals), ambiguous_with=names)


def test_rivals_get_their_share():
    (entry,) = with_aliases([found("a", rival("b"), rival("c"))], {"a": {"b": 0.9}})
    assert entry.ambiguity == [rival("b", alias_share=0.9), rival("c")]


def test_an_alias_is_a_rival_whatever_the_evidence_says():
    entries = [found("tas_scale", rival("hard_iron")), found("outliers")]
    shares = {"tas_scale": {"tas_offset": 0.95, "hard_iron": 0.3, "soft_iron": 0.85}}
    first, second = with_aliases(entries, shares)
    assert first.ambiguous_with == ["hard_iron", "tas_offset"]
    assert [r.alias_share for r in first.ambiguity] == [0.3, 0.95]
    assert first.ambiguity[1].separated_by == "reports over a wider range of airspeeds"
    assert second.ambiguous_with == []


def test_what_weather_takes_up_is_not_excluded_by_its_silence():
    columns = {"bias": np.array([0]), "shear": np.array([1]), "turn": np.array([2])}
    one = np.array([[4.0, 3.0, 0.2], [3.0, 3.0, 0.0], [0.2, 0.0, 1.0]])
    stats = SimpleNamespace(
        whole_gram=np.stack([one, one]), layout=SimpleNamespace(columns=columns.__getitem__)
    )
    what = SimpleNamespace(
        name="bias", known=True, scope="fleet", columns=np.array([0]), scales=np.array([0.1])
    )
    terms = [SimpleNamespace(candidate=what)]
    shares = hidden_shares(stats, terms, ["shear", "turn"])
    assert shares["bias"]["shear"] == pytest.approx(0.75)  # 3 * 3 / (4 * 3)
    assert shares["bias"]["turn"] == pytest.approx(0.01)
    (entry,) = with_aliases([found("bias")], {}, shares)
    assert entry.ambiguous_with == ["shear"]
    assert entry.ambiguity[0].alias_share == pytest.approx(0.75)
    what.scope = "aircraft"
    assert hidden_shares(stats, terms, ["shear"]) == {}
