"""Products of two variables' shapes: sums against loops, and a pair found that no curve shows."""

import numpy as np
import pytest
from scipy.stats import norm, ttest_1samp
from tests.gap.toy import make_frame
from tests.gap.witness.test_learned import setting_of

from airswing.gap.archive.other_winds import without
from airswing.gap.archive.reported_variables import Variable
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.products import deviations, products, shapes_of
from airswing.gap.witness.unknowns import LIKES


def test_deviations_are_students_t_of_the_sums_of_days():
    rng = np.random.default_rng(4)
    shapes, pulled, day = rng.normal(size=(60, 3)), rng.normal(size=60), rng.integers(0, 7, 60)
    told = deviations(shapes, pulled, day)
    for i in range(3):
        for j in range(3):
            each = [(pulled * shapes[:, i] * shapes[:, j])[day == d].sum() for d in range(7)]
            chance = ttest_1samp(each, 0.0).pvalue / 2
            assert norm.sf(told[i, j]) == pytest.approx(chance)


def test_shapes_have_no_mean_and_one_size_and_nothing_where_nothing_is_known():
    values = np.r_[np.random.default_rng(0).uniform(0, 360, 300), np.nan]
    for name, kind, count in (("track", "circular", 4), ("altitude", "linear", 3)):
        made = shapes_of(Variable(name, kind, values), values)
        assert len(made) == count
        for shape in made:
            assert shape[-1] == 0 and shape.mean() == pytest.approx(0, abs=1e-12)
            assert (shape**2).mean() == pytest.approx(1)
    flags = np.tile([0.0, 1.0, 1.0, 2.0], 9)
    assert len(shapes_of(Variable("phase", "category", flags), flags)) == 3


def test_a_product_that_neither_variable_shows_is_told_and_no_pair_on_a_null():
    frame = make_frame(seed=9, aircraft=4, days=20, noise=0.3, model_error=1.0)
    wind = np.stack([frame.u_ref, frame.v_ref], -1)
    unit = wind / np.hypot(*wind.T)[:, None]
    place = np.clip((frame.longitude - frame.longitude.mean()) / frame.longitude.std(), -2, 2)
    amount = 1.2 * place * np.sin(frame.magnetic_heading)
    struck = without(frame, frame.residual + amount[:, None] * unit)
    best = products(Bench.of(setting_of(struck), struck.residual), LIKES)[0]
    assert best[1] == "along_wind"
    assert "longitude" in best[2] and set(best[2]) & {"track", "magnetic_heading"}
    assert not products(Bench.of(setting_of(frame), frame.residual), LIKES)
