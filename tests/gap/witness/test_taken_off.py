"""Which tables are tried on weeks left out, and which take the place of names."""

from types import SimpleNamespace

import numpy as np

from airswing.gap.witness import taken_off


def test_a_table_far_behind_the_strongest_is_not_tried(monkeypatch):
    def strongest(bench, ranked, component, fold):
        return next(one for one in ranked if one.component == component)

    monkeypatch.setattr(taken_off, "_of_component", strongest)
    strong = SimpleNamespace(strength=200.0, component="cross")
    near = SimpleNamespace(strength=180.0, component="along")
    far = SimpleNamespace(strength=taken_off.LEAST_EVIDENCE + 1.0, component="along")
    assert taken_off._best(None, [strong, far], None) is strong
    monkeypatch.setattr(taken_off, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(taken_off, "explained", lambda bench, table: -table.strength)
    assert taken_off._best(None, [strong, near], None) is near


def test_a_table_that_is_the_names_over_again_must_explain_half_as_much_again(monkeypatch):
    rng = np.random.default_rng(0)
    truth, other = rng.normal(size=(2, 4000, 2))
    residual = truth + rng.normal(size=truth.shape)
    monkeypatch.setattr(taken_off, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(
        taken_off, "explained", lambda bench, error: ((2 * residual - error) * error).sum()
    )

    def leads(table, names):
        return taken_off._leads(None, table, (0.1 * names, names), None)

    # the same with a little of everything: explains 1.2 of it
    assert not leads(truth, truth + 0.4 * other)
    # a name that is but a corner of the truth
    corner = np.where(np.arange(4000)[:, None] < 1200, truth, 0.0)
    assert leads(truth, corner)
    # unlike the table, which explains a little more
    assert leads(truth, other + 0.0 * truth)
    assert not leads(other, truth)
    # its like, but half as much again
    assert leads(truth, truth + 0.75 * other)
