"""Gross errors: reports that differ from their neighbours, more often than by chance.

The share by chance is that of a simulated archive of the same paths, noise and coding. At
least 100 reports an aircraft. Units: m/s; shares of reports.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import gammaln

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import Variable, cells_of
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.distribution.entries import against_chance, closes, effect_of, place_of
from airswing.gap.distribution.scatter import NATURAL
from airswing.gap.effects.base import Stated, number
from airswing.gap.model.candidates import OF_WIND
from airswing.gap.model.sums import GATE
from airswing.gap.noise import NoiseFit, gross_errors
from airswing.gap.result.schema import ClosesEntry, EffectEntry, PlaceEntry
from airswing.gap.result.statement import curve_over
from airswing.gap.simulation.forward import Coding, draw_noise
from airswing.physics.robust_spread import robust_sd
from airswing.units import KNOT


def outliers(frame: Frame, residual: Floats, noise: NoiseFit) -> EffectEntry | None:
    """Find aircraft with more gross errors than a simulated archive of the same paths has.

    ``residual`` (n, 2) is without the effects that move means; ``noise`` holds the gross errors.
    """
    fleet = len(frame.tails)
    count = np.bincount(frame.aircraft, minlength=fleet).astype(float)
    hits = np.bincount(frame.aircraft, noise.gross, minlength=fleet).astype(float)
    used = count >= 100
    # a handful of errors determines neither a rate nor the affected aircraft
    if not used.any() or hits[used].sum() < 5:
        return None
    # real noise has tails that a simulated one lacks
    chance = np.maximum(simulated_rate(frame, noise), 5e-4)
    rate, gain = shared_rate(hits[used], count[used], chance[used])
    affected = np.flatnonzero(used)[gain > 0]
    if affected.size == 0 or rate < 0.002:  # 0.1 kt at the usual size
        return None
    # standard deviation per component; at least 5 m/s: gross errors differ from their neighbours by
    # five standard deviations of about 1 m/s
    values = residual[noise.gross & np.isin(frame.aircraft, affected)]
    ordinary = robust_sd(residual, 0.0)
    size = float(np.sqrt(max(float(np.mean(values**2)) - ordinary**2, 25.0)))
    size = 20.0 if values.shape[0] < 5 else size
    if size < 6.0:
        return None  # an effect that is switched on and off, not an error of single reports
    # gross errors of less than 5 m/s in both components are not marked: the share is scaled up for
    # them, at most by a half; tanh form of the normal distribution, good to 0.0004
    z = 5.0 / size
    inside = float(np.tanh(z * 0.7979 * (1 + 0.044715 * z * z)))
    seen = 1.0 - min(inside, 0.6) ** 2
    counting = (rate + chance[affected]) / count[affected]
    # shrunk to the common rate by the ratio of counting errors to their scatter
    difference = hits[affected] / count[affected] - chance[affected] - rate
    spread = max(float(np.mean(difference**2 - counting)), 0.0)
    rates = rate + difference * spread / (spread + counting)
    evidence = float(gain[gain > 0].sum())  # of all affected aircraft together
    found: dict[str, tuple[Stated, float]] = {
        frame.tails[a]: ({"fraction": float(max(share, 0.0) / seen), "size_m_s": size}, evidence)
        for a, share in zip(affected, rates, strict=True)
    }
    error = float(np.sqrt(np.median(counting))) / seen
    return effect_of("outliers", found, errors={"fraction": error})


def simulated_rate(frame: Frame, noise: NoiseFit) -> Floats:
    """Share of each aircraft's reports that are marked without any gross error, (aircraft,).

    The mean of the fleet is the least share of an aircraft, whose marks are few; headings in coarse
    steps jump at turns and are counted separately.
    """
    rng, coding = np.random.default_rng(0), Coding.as_found(frame)
    fleet = len(frame.tails)
    hits = np.zeros(fleet)
    draws = 2
    for _ in range(draws):
        error = draw_noise(frame, noise.model, rng=rng)
        u, v = coding.apply(frame.u_ref + error[:, 0], frame.v_ref + error[:, 1])
        marked = gross_errors(np.stack([u - frame.u_ref, v - frame.v_ref], -1), noise.order)
        hits += np.bincount(frame.aircraft, marked, minlength=fleet) / draws
    count = np.maximum(np.bincount(frame.aircraft, minlength=fleet), 1)
    jumping = np.zeros(fleet, bool)
    if coding.headings is not None:
        jumping[frame.aircraft[coding.headings.step > 0.0]] = True
    fine = ~jumping if not jumping.all() else jumping
    common = hits[fine].sum() / count[fine].sum()
    # twice, as the noise model does not hold how aircraft wander about a course
    return np.asarray(np.maximum(np.where(jumping, 2.0, 1.0) * hits / count, common))


def shared_rate(hits: Floats, count: Floats, chance: Floats) -> tuple[float, Floats]:
    """Common rate of gross errors of the affected aircraft, and the evidence of each.

    The rate is beyond chance: beginning with the clearest aircraft, that of a two-part mixture of
    Poisson laws. The gain (m,) is the log likelihood ratio of that rate and chance against chance.
    """

    def gain(rate: float) -> Floats:
        return np.asarray(hits * np.log1p(rate / chance) - count * rate)

    ratios = [against_chance(int(n), h / n, q) for h, n, q in zip(hits, count, chance, strict=True)]
    first = int(np.argmax(ratios))
    rate = float(max(hits[first] / count[first] - chance[first], 0.0))
    # expectation maximisation of one rate settles within a dozen rounds
    for _ in range(30):
        share = 1 / (1 + np.exp(-np.clip(gain(rate), -50, 50)))
        gross = hits * rate / (rate + chance)
        rate = float((share @ gross) / (share @ count))
    return rate, gain(rate)


def reduction_of_gross(
    frame: Frame, residual: Floats, entry: EffectEntry, gross: Booleans
) -> ClosesEntry:
    """Closure of gross errors: the length that normal errors of their size add to other reports."""
    rng = np.random.default_rng(0)
    total, doubt = 0.0, 0.0
    for tail, row in (entry.per_tail or {}).items():
        mask = frame.aircraft_mask(tail)
        values = residual[mask & ~gross]
        if values.size == 0:
            continue
        size, fraction = (number(row.parameters[name]) for name in ("size_m_s", "fraction"))
        error = size * rng.standard_normal(values.shape)
        longer = float((np.hypot(*(values + error).T) - np.hypot(*values.T)).mean())
        count = float(mask.sum())
        total += count * fraction * longer
        doubt += (count * longer) ** 2 * fraction / count
    kt = total / frame.size / KNOT
    # 8 % from the shape of the errors' distribution
    return closes(kt, float(np.hypot(np.sqrt(doubt) / frame.size / KNOT, 0.08 * kt)))


def gross_by_variable(
    frame: Frame, entry: EffectEntry, gross: Booleans, variables: Mapping[str, Variable]
) -> PlaceEntry | None:
    """Entry of gross errors whose rate depends on a variable, in place of that of `outliers`.

    Its log evidence is that of two Dirichlet-multinomial laws of the counts in cells of the
    variable: with rates that vary as much as their mean (a uniform prior), and by `NATURAL`. The
    reported wind, which the error itself changes, is left out.
    """
    tails = [frame.tails.index(tail) for tail in entry.tails]
    affected = np.isin(frame.aircraft, tails)
    found: list[tuple[float, Variable, Floats, Floats]] = []
    for name in sorted(variables.keys() - OF_WIND):
        variable = variables[name]
        edges = variable.edges(24)
        cell = cells_of(variable.values, edges)
        used = affected & (cell >= 0)
        if not used.any():
            continue
        count = np.bincount(cell[used], minlength=edges.size - 1)
        hits = np.bincount(cell[used & gross], minlength=edges.size - 1)
        evidence = _log_evidence(hits, count, 1.0) - _log_evidence(hits, count, NATURAL)
        found.append((evidence, variable, edges, hits / np.maximum(count, 1)))
    if not found or entry.closure is None:
        return None
    evidence, variable, edges, rate = max(found, key=lambda row: row[0])
    evidence -= float(np.log(len(found)))
    if evidence < GATE:
        return None
    size = number(entry.parameters["size_m_s"]) * np.sqrt(rate)
    curve = curve_over([variable.name], [edges.tolist()], size, "m/s")
    typical = float(np.median(size[size > 0]))
    return place_of(
        "scatter", variable.name, tails, frame.tails, evidence, typical, curve, entry.closure
    )


def _log_evidence(hits: Integers, count: Integers, variation: float) -> float:
    """Dirichlet-multinomial law of counts in cells, up to a constant of them."""
    flown = count > 0
    prior = count[flown] / count.sum() * flown.sum() / variation**2
    gain = gammaln(prior + hits[flown]) - gammaln(prior)
    return float(gain.sum() + gammaln(prior.sum()) - gammaln(prior.sum() + hits.sum()))
