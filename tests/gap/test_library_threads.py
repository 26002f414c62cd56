"""One thread of linear algebra and trees inside, and as many as before outside."""

from __future__ import annotations

import pytest
import sklearn.ensemble  # noqa: F401 - its threads are there before any are held
from threadpoolctl import threadpool_info, threadpool_limits

from airswing.gap.library_threads import one_library_thread


def _threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]


def test_every_library_is_held_to_one_thread_and_let_go_again() -> None:
    with threadpool_limits(limits=2):
        with one_library_thread():
            inside = _threads()
        after = _threads()
    assert len(inside) >= 2  # the linear algebra's and the trees'
    assert set(inside) == {1}
    assert set(after) == {2}


def test_an_error_inside_lets_go_as_well() -> None:
    with threadpool_limits(limits=2):
        with pytest.raises(ValueError, match="within"), one_library_thread():
            raise ValueError("within")
        assert set(_threads()) == {2}
