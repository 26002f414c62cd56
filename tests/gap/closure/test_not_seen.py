"""What silence leaves open: its two parts against drawn winds, its limits, and where it is told."""

from dataclasses import replace

import numpy as np
import pytest

from airswing.gap.closure.not_seen import EVERY_FLEET, TOLD_FROM, could_hide, hidden_interval
from airswing.gap.result.schema import GapReport
from airswing.gap.result.unknown_entries import with_hidden
from airswing.units import KNOT


def closes(noise, size, share, reports, seed):
    """Mean disagreement with an error across one direction, and by how much it is longer, kt."""
    rng = np.random.default_rng(seed)
    winds = noise * rng.standard_normal((reports, 2))
    error = np.where(rng.uniform(size=reports) < share, size, 0.0)
    # a sign either way halves the drawing's noise: the first order cancels
    both = [np.hypot(winds[:, 0] + sign * error, winds[:, 1]).mean() for sign in (1, -1)]
    without = np.hypot(*winds.T).mean()
    return without / KNOT, (np.mean(both) - without) / KNOT


def test_an_error_of_that_evidence_closes_as_much():
    reports, noise, share = 400_000, 2.0, 0.25
    size = np.sqrt(TOLD_FROM * 2 * noise**2 / (reports * share))
    mean, closed = closes(noise, size, share, reports, 1)
    assert closed == pytest.approx(0.5 * mean * TOLD_FROM / reports, rel=0.1)


def test_the_small_of_every_fleet_closes_as_much():
    mean, closed = closes(2.0, EVERY_FLEET, 1.0, 400_000, 2)
    small = could_hide(mean, 10**12)
    assert closed == pytest.approx(small, rel=0.1)


def test_it_shrinks_with_the_archive_and_ends_at_the_disagreement():
    told = [could_hide(5.0, n) for n in (10, 10_000, 130_000, 10_000_000)]
    assert told == sorted(told, reverse=True)
    assert told[0] == 5.0
    assert could_hide(5.2, 130_000) == pytest.approx(0.0514, abs=1e-4)
    assert could_hide(0.0, 10) == could_hide(5.0, 0) == 0.0


def test_silence_widens_the_closure_and_a_claim_does_not(gap_product):
    report = GapReport.read(gap_product / "gap.json")
    told = with_hidden(report)
    low, high = hidden_interval(report.closure.before, report.counts.reports_in_view)
    assert report.effects
    assert told.closure == report.closure
    assert told.closure.could_hide_kt == high
    closure = replace(report.closure, ci=[4.98, 5.01], reduction_ci=[-0.01, 0.02])
    silent = with_hidden(replace(report, effects=[], closure=closure)).closure
    assert silent.reduction_ci == pytest.approx([-0.01 + low, 0.02 + high])
    assert silent.ci == pytest.approx([4.98 - high, 5.01 - low])
    day = replace(report, counts=replace(report.counts, days=1))
    assert with_hidden(day) == day
