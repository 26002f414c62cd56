"""The learned witness on small archives: it hears a product of two variables, and no silence."""

import dataclasses

import numpy as np
import pytest
from tests.gap.toy import make_frame, noise_of

from airswing.gap.design.basis import plan_dictionary
from airswing.gap.design.weather import climatology_columns, day_field_columns
from airswing.gap.sums.variance_components import Variances
from airswing.gap.witness.bench import Bench, Setting
from airswing.gap.witness.learned import LEAST, Heard, LearnedWitness, Sample
from airswing.gap.witness.null import drawn_errors, small_scale_slope
from airswing.gap.witness.sent_winds import sent_winds
from airswing.gap.witness.unknowns import pairs_of


def setting_of(frame):
    noise, plan = noise_of(frame), plan_dictionary(frame, {})
    _, day = np.unique(frame.day, return_inverse=True)
    fields = day_field_columns(frame, plan).shape[-1]
    lasting = climatology_columns(frame, plan).shape[-1]
    variances = Variances(np.full(fields, 0.3), np.full(lasting, 0.05))
    errors = drawn_errors(
        frame,
        3,
        noise=noise,
        plan=plan,
        variances=variances,
        day=day,
        rng=np.random.default_rng(0),
    )
    return Setting(
        frame, frame, noise, plan, variances, day, errors, np.zeros((frame.size, 2)), 0.0
    )


def product(context):
    """Heading error that grows with longitude at one height and falls with it at another."""
    east = (context["longitude"] + 90) / 8
    high = np.log(6e4 / context["pressure"]) / 0.5
    return np.radians(2.0) * np.clip(east, -2, 2) * np.clip(high, -1.5, 1.5)


@pytest.fixture(scope="module")
def heard():
    setting = setting_of(make_frame(seed=3, aircraft=6, days=14, noise=0.3, heading_error=product))
    bench = Bench.of(setting, setting.frame.residual)
    return bench, LearnedWitness().hear(bench)


def test_a_product_without_marginals_is_heard_and_its_pair_named(heard):
    bench, told = heard
    assert told.components[0] == "across_heading"
    first = {name for name, _ in told.telling[:3]}
    assert "longitude" in first and first & {"altitude", "temperature"}
    best = pairs_of(bench, told)[0]
    assert "longitude" in best.grid.variables
    assert best.nats > 50


def test_an_empty_archive_is_not_heard():
    setting = setting_of(make_frame(seed=4, aircraft=6, days=14, noise=0.3))
    told = LearnedWitness().hear(Bench.of(setting, setting.frame.residual))
    assert told.components == () and told.pairs == []


def test_of_a_single_day_nothing_is_heard_and_nothing_breaks():
    frame = make_frame(seed=3, aircraft=14, days=1, noise=0.3, heading_error=product)
    setting = setting_of(frame)
    bench = Bench.of(setting, frame.residual)
    assert Sample.of(setting).too_short
    assert LearnedWitness().hear(bench) == Heard((), ())
    assert sent_winds(bench, np.zeros(1, int)) is None


def test_day_fields_are_cleared_away():
    frame = make_frame(seed=2, aircraft=2, days=3)
    setting = setting_of(frame)
    fields = day_field_columns(frame, setting.plan)
    size = np.random.default_rng(1).normal(0, 0.5, (setting.day.max() + 1, fields.shape[-1]))
    error = np.einsum("nck,nk->nc", fields, size[setting.day])[None]
    rows = np.arange(frame.size)
    left = setting.ground.cleared(frame, error, plan=setting.plan, day=setting.day, rows=rows)
    assert (left**2).mean() < 0.05 * (error**2).mean()


def test_the_slope_of_the_small_scales_is_found():
    frame = make_frame(seed=2, aircraft=2, days=2)
    quiet = make_frame(seed=2, aircraft=2, days=2)
    object.__setattr__(quiet, "u_ref", np.zeros(frame.size))
    object.__setattr__(quiet, "v_ref", np.zeros(frame.size))
    wind = np.stack([frame.u_ref, frame.v_ref], -1)
    followed, share = small_scale_slope(frame, quiet, -0.4 * wind, np.ones(frame.size, bool))
    np.testing.assert_allclose(followed, -0.4 * wind)
    assert share == pytest.approx(0.9)  # bounded: all of it


def test_simulated_reports_follow_what_the_real_ones_do():
    setting = setting_of(make_frame(seed=2, aircraft=2, days=2))
    followed = np.full((setting.frame.size, 2), 0.3)
    alike = dataclasses.replace(setting, followed=followed, share=0.36).alike
    np.testing.assert_allclose(alike.errors, 0.3 + 0.8 * setting.errors)
    np.testing.assert_allclose(alike.alike.errors, alike.errors)


def test_a_claim_needs_the_least_size_and_four_standard_errors():
    from airswing.gap.witness.learned import Explained

    def one(covariance, error):
        return Explained("across_wind", "level", covariance, 0.05, error)

    assert one(0.05 + 1.01 * LEAST["level"], 0.001).strength > 1
    assert one(0.05 + 1.01 * LEAST["level"], 0.03).strength < 1
    told = Heard((one(0.5, 0.01),), (("track", 2.0), ("magnetic_heading", 1.5), ("hour", 1.0)))
    assert told.pairs == [("track", "hour"), ("magnetic_heading", "hour")]
