"""Which tables take the place of names."""

from types import SimpleNamespace

import numpy as np

from airswing.gap.taken_off import table_or_names


def test_a_table_that_is_the_names_over_again_must_explain_half_as_much_again(monkeypatch):
    rng = np.random.default_rng(0)
    truth, other = rng.normal(size=(2, 4000, 2))
    residual = truth + rng.normal(size=truth.shape)
    monkeypatch.setattr(table_or_names, "field_of", lambda bench, table, fold: table.field)
    monkeypatch.setattr(
        table_or_names, "explained", lambda bench, error: ((2 * residual - error) * error).sum()
    )

    whole = []
    monkeypatch.setattr(table_or_names, "from_nothing", lambda table: 0 if whole else None)

    cells = np.arange(4000) % 8
    bench = SimpleNamespace(cells=lambda grid: cells)

    def leads(table, names):
        told = SimpleNamespace(field=table, grid=None)
        return table_or_names.leads(bench, told, (0.1 * names, names), None)

    # the same with a little of everything: explains 1.2 of it
    assert not leads(truth, truth + 0.4 * other)
    # a name that is but a corner of the truth
    corner = np.where(np.arange(4000)[:, None] < 1200, truth, 0.0)
    assert leads(truth, corner)
    # in part like the table, which explains more
    assert leads(truth, 0.6 * truth + 0.9 * other)
    # with nothing in common: both are told
    assert not leads(truth, other)
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
    # so does the name: a bias of the model's winds below a level
    above = (cells > 0)[:, None]
    assert not leads(truth, above * (truth + 0.4 * other))


def test_where_names_leave_nothing_a_table_must_explain_half_as_much_again(monkeypatch):
    """Names that stand in for an unknown may leave nothing that changes along flights."""
    rng = np.random.default_rng(2)
    truth, other = rng.normal(size=(2, 4000, 2))
    monkeypatch.setattr(table_or_names, "field_of", lambda bench, table, fold: table)
    monkeypatch.setattr(table_or_names, "from_nothing", lambda table: None)
    monkeypatch.setattr(
        table_or_names, "explained", lambda bench, error: ((2 * truth - error) * error).sum()
    )
    names = 0.4 * truth + 0.5 * other  # unlike it, and they explain a third of it
    assert table_or_names.leads(None, truth, (names,), None, left=False)
    more = 0.6 * truth + 0.45 * other  # they explain two thirds of it, and are mostly it
    assert table_or_names.leads(None, truth, (more,), None)
    assert not table_or_names.leads(None, truth, (more,), None, left=False)
    near = 0.5 * truth + 0.2 * other  # they explain seven tenths
    assert table_or_names.leads(None, truth, (near,), None)
    assert not table_or_names.leads(None, truth, (near,), None, left=False)


def test_names_are_borne_out_where_the_residual_holds_their_size():
    rng = np.random.default_rng(3)
    errors, noise = rng.normal(size=(2, 6000, 2))
    day = np.arange(6000) // 200

    def borne_out(share, scatter=1.0):
        frame = SimpleNamespace(residual=share * errors + scatter * noise)
        return table_or_names.borne_out(SimpleNamespace(frame=frame, day=day), errors)

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

    assert table_or_names.from_nothing(table(0.1, 0.5, -1.0)) == 0
    assert table_or_names.from_nothing(table(1.0, 0.5, -0.1)) == 2
    assert table_or_names.from_nothing(table(1.0, 0.0, 1.0)) is None
    assert table_or_names.from_nothing(table(2.0, 2.5, 3.0)) is None
    for other in (table(0.0, 1.0, kind="circular"), table(0.0, 1.0, axes=2)):
        assert table_or_names.from_nothing(other) is None
