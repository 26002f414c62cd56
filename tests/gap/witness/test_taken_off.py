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

    whole = []
    monkeypatch.setattr(taken_off, "from_nothing", lambda table: bool(whole))

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
    # nothing but the names, a third larger; and twice as large
    assert not leads(truth, 0.75 * truth)
    assert leads(truth, 0.5 * truth)
    assert leads(truth, 0.65 * (truth + 0.4 * other))
    # its like, and it begins at nothing: the name was its mean
    whole.append(True)
    assert leads(truth, truth + 0.4 * other)


def test_where_names_leave_nothing_a_table_must_explain_half_as_much_again(monkeypatch):
    """Names that stand in for an unknown may leave nothing that changes along flights."""
    rng = np.random.default_rng(2)
    truth, other = rng.normal(size=(2, 4000, 2))
    monkeypatch.setattr(taken_off, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(taken_off, "from_nothing", lambda table: False)
    monkeypatch.setattr(
        taken_off, "explained", lambda bench, error: ((2 * truth - error) * error).sum()
    )
    names = 0.4 * truth + 0.5 * other  # unlike it, and they explain a third of it
    assert taken_off._leads(None, truth, (names,), None, left=False)
    more = 0.6 * truth + 0.45 * other  # they explain two thirds of it, and are mostly it
    assert taken_off._leads(None, truth, (more,), None)
    assert not taken_off._leads(None, truth, (more,), None, left=False)
    near = 0.5 * truth + 0.2 * other  # they explain seven tenths
    assert taken_off._leads(None, truth, (near,), None)
    assert not taken_off._leads(None, truth, (near,), None, left=False)


def test_names_are_borne_out_where_the_residual_holds_their_size():
    rng = np.random.default_rng(3)
    errors, noise = rng.normal(size=(2, 6000, 2))
    day = np.arange(6000) // 200

    def borne_out(share, scatter=1.0):
        frame = SimpleNamespace(residual=share * errors + scatter * noise)
        return taken_off.borne_out(SimpleNamespace(frame=frame, day=day), errors)

    assert borne_out(1.0)
    assert borne_out(0.9)
    assert not borne_out(0.6)
    assert not borne_out(1.5)
    assert not borne_out(1.0, scatter=40.0)  # the residual does not tell


def test_a_table_begins_at_nothing_where_its_first_cell_or_its_last_is_next_to_none():
    def table(*values, kind="linear", axes=1):
        axis = SimpleNamespace(kind=kind)
        return SimpleNamespace(
            values=np.array([values, np.zeros(len(values)), values], float),
            tails=(0, 2),
            grid=SimpleNamespace(axes=(axis,) * axes),
        )

    assert taken_off.from_nothing(table(0.1, 0.5, -1.0))
    assert taken_off.from_nothing(table(1.0, 0.5, -0.1))
    assert not taken_off.from_nothing(table(1.0, 0.0, 1.0))
    assert not taken_off.from_nothing(table(2.0, 2.5, 3.0))
    for other in (table(0.0, 1.0, kind="circular"), table(0.0, 1.0, axes=2)):
        assert not taken_off.from_nothing(other)


def test_what_is_no_likelier_than_not_beside_an_unknown_is_its_remainder():
    def term(name, probability, size=0.5, tails=(0, 1, 2)):
        candidate = SimpleNamespace(name=name, known=True)
        score = SimpleNamespace(size=np.full(3, size), probability=probability)
        return SimpleNamespace(candidate=candidate, tails=tails, score=score)

    unknown = SimpleNamespace(unknown=SimpleNamespace(tails=(0, 1, 2), size=0.6))
    terms = [term("doubted", 0.4987), term("likely", 0.9), term("small", 0.9, size=0.2)]
    assert taken_off.remainder_names(terms, [unknown]) == {"doubted", "small"}
    assert taken_off.remainder_names(terms, []) == set()
