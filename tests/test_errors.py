"""Messages: one line of at most 2,000 characters, whatever is put into them."""

from __future__ import annotations

import pickle

import pytest

from airswing.errors import LONGEST, ConfigError, InputError, shortened


@pytest.mark.parametrize(
    "value",
    [
        "x" * 10**6,
        "a\nb\tc\x00d",
        [["deep"] * 50] * 50,
        {n: n for n in range(10**4)},
        10**6000,
        [10**6000],
        b"\xff" * 10**5,
        "‮",
        object(),
    ],
    ids=range(9),
)
def test_messages_are_short_lines(value: object):
    error = InputError(
        str(shortened(value)), file=value, field="f" * 9000, found=value, remedy="r" * 999
    )
    text = str(error)
    assert len(text) <= LONGEST
    assert text.isprintable()


def test_short_text_stays_as_it_is():
    assert shortened("two  blanks") == "two  blanks"
    error = ConfigError("unknown key; did you mean 'pool'?", file="c.yaml", field="pol", found=3)
    assert str(error) == "c.yaml: pol: unknown key; did you mean 'pool'? (found: 3)"


def test_errors_travel_between_processes():
    error = InputError("wrong", file="f", found=[1, 2], remedy="Mend it")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.found) == (str(error), [1, 2])
