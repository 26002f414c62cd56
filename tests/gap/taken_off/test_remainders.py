"""What is but a rest of what was told before."""

from types import SimpleNamespace

import numpy as np

from airswing.gap.taken_off import remainders


def test_what_is_no_likelier_than_not_beside_an_unknown_is_its_remainder():
    def term(name, probability, size=0.5, tails=(0, 1, 2)):
        candidate = SimpleNamespace(name=name, known=True)
        score = SimpleNamespace(size=np.full(3, size), probability=probability)
        return SimpleNamespace(candidate=candidate, tails=tails, score=score)

    unknown = SimpleNamespace(tails=(0, 1, 2), size=0.6)
    terms = [term("doubted", 0.4987), term("likely", 0.9), term("small", 0.9, size=0.2)]
    assert remainders.remainder_names(terms, [unknown]) == {"doubted", "small"}
    assert remainders.remainder_names(terms, []) == set()
