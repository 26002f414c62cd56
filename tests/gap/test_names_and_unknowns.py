"""An exchange of identifiers beside an unknown of one of the two stands where both are found."""

from types import SimpleNamespace

import pytest

from airswing.gap import names_and_unknowns as module
from airswing.gap.search.tail_swaps import Swap

SWAP = Swap((0, 3), 9, 11.0, 14.0)


def told(swap, *tails):
    archive = SimpleNamespace(tails=tuple("ABCDEF"))
    final = SimpleNamespace(problem=SimpleNamespace(archive=archive))
    taken = [SimpleNamespace(unknown=SimpleNamespace(tails=own)) for own in tails]
    return SimpleNamespace(swap=swap, taken=taken, final=final)


@pytest.mark.parametrize(
    ("tails", "found_beside", "stands", "asked"),
    [
        ((), None, True, False),
        ([(1, 2)], None, True, False),  # of others
        ([(0, 1, 2, 3, 4, 5)], None, True, False),  # of all alike
        ([(1, 2), (2, 3)], None, False, True),
        ([(0,)], SWAP, True, True),
    ],
)
def test_an_exchange_is_asked_again_beside_an_unknown_of_one_of_the_two(
    monkeypatch, tails, found_beside, stands, asked
):
    first, without = told(SWAP, *tails), told(None, (0, 3))
    calls = []

    def made(archive, search, *, swaps):
        calls.append(swaps)
        return first if swaps else without

    monkeypatch.setattr(module, "_told", made)
    monkeypatch.setattr(module, "swap_in", lambda final, search: found_beside)
    found = module.names_and_unknowns(None, None, swaps=True)
    assert found is (first if stands else without)
    assert calls == ([True, False] if asked else [True])
