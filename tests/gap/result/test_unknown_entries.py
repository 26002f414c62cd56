"""Which places of the nonparametric basis are told beside tables."""

from types import SimpleNamespace

from airswing.gap.result.unknown_entries import _stands


def place(reduction, size, tails=(), component="cross", mean=None):
    closure = None if reduction is None else SimpleNamespace(reduction=reduction)
    return SimpleNamespace(
        closure=closure, size_m_s=size, tails=list(tails), component=component, mean=mean
    )


def test_what_closes_nothing_is_not_told():
    assert _stands(place(0.01, 0.2), [])
    assert not _stands(place(-0.01, 0.2), [])
    assert _stands(place(-0.01, 0.2, mean="offset"), [])
    assert _stands(place(None, 0.2, component="reported_direction"), [])


def test_what_the_cells_of_a_table_leave_is_no_unknown_of_its_own():
    table = place(0.3, 1.0, ["a", "b"], "across_heading")
    assert not _stands(place(0.01, 0.2, ["a", "b"]), [table])
    assert _stands(place(0.01, 0.5, ["a", "b"]), [table])
    assert _stands(place(0.01, 0.2, ["b", "c", "d"]), [table])
    assert _stands(place(0.01, 0.2, ["a", "b"], "scatter"), [table])
    assert not _stands(place(0.01, 0.2, ["d"]), [place(0.3, 1.0)])
