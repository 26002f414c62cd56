"""Effects that show in lattices and rates, not in means: coding and gross errors.

Assumptions: the simulation sends winds in whole degrees and whole knots: coarser is an effect,
whoever has it. Positions come in tenths of a minute of arc or finer and times in seconds; coarser
is an effect of an aircraft, unless the whole fleet is alike in steps that formats use. Headings in
steps of two degrees and more are an effect, whoever has it. A value lies
on a coarse lattice by chance in one of (step / base) cases; the share above chance is the share
coded coarsely. Gross errors are single reports that stand out from both neighbours; how many would
without any, a simulated archive of the same paths, noise and coding tells, so that a rate which all
aircraft share shows as one that a single aircraft has.

Validity: at least 100 reports an aircraft. Steps in knots, degrees and minutes of arc.

Source: docs/gap.md section 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.heading_lattice import heading_lattice_of, in_coarse_steps
from airswing.gap.effects.base import Told, number
from airswing.gap.noise.model import NoiseFit
from airswing.gap.noise.residual_statistics import gross_errors
from airswing.gap.result.schema.entries import Parameter as Value
from airswing.gap.simulation.forward import Coding, draw_noise
from airswing.physics.robust_spread import robust_sd
from airswing.physics.triangle import direction_in_degrees
from airswing.units import KNOT

Floats = NDArray[np.float64]

# Steps looked for: kt, degrees, arc minutes. Finer ones than 1 kt, 1 degree and 0.1 arc minute are
# how reports come anyway.
SPEED_STEPS = (2.0, 5.0, 10.0)
DIRECTION_STEPS = (2.0, 5.0, 10.0)
POSITION_STEPS = (0.5, 0.6, 1.0, 2.0, 3.0, 5.0, 6.0, 10.0)
FREQUENT = {"speed": 2, "direction": 12}
"""Most frequent values that a lattice must show without: a floor or a hole sends one or two speeds
too often, a few directions at weak winds are at most twelve; a coding in steps spreads over all."""
# Share of the values, above chance, from which a lattice is one.
LEAST_SHARE = 0.15
LEAST_RATE = 0.002
"""Share of gross errors from which they are worth a name: 0.1 kt at the usual size."""
LEAST_CHANCE = 5e-4
"""Share that stands out by chance at least: real noise has tails that a simulated one lacks."""
DRAWS = 2
"""Simulated archives from which the share that stands out by chance is counted."""
JUMPING = 2.0
"""The same share where headings come in coarse steps, over that of simulated ones: how often they
jump hangs on how aircraft wander about a course (0.7 to twice as often, of sealed archives and
toys)."""
LEAST_SIZE = 6.0
"""Standard deviation per component, m/s, under which what stands out is no gross error."""
LOOKED_AT = float(np.log(100.0))
"""Price of looking at a hundred aircraft and steps for the clearest one, nats."""


@dataclass(frozen=True)
class MomentVerdict:
    """One second-moment effect found."""

    name: str
    tails: tuple[str, ...]
    parameters: Told
    standard_errors: dict[str, float]
    per_tail: Mapping[str, Mapping[str, Value]]  # tail -> parameters
    period: list[str | None] | None
    # log likelihood ratio of the clearest aircraft against chance, nats, less what looking at all
    # of them costs
    evidence: float


def against_chance(count: int, share: float, chance: float) -> float:
    """Log likelihood ratio of a share of ``count`` draws against the share that chance gives, nats.

    Parameters
    ----------
    share, chance : float
        Between 0 and 1.

    Returns
    -------
    float
        ``count`` times the Kullback-Leibler divergence of the two Bernoulli laws; 0 for a share
        not above chance.
    """
    # all or none have no logarithm, though the divergence of them is finite
    p, q = (float(np.clip(x, 1e-9, 1 - 1e-9)) for x in (share, chance))
    return count * (p * np.log(p / q) + (1 - p) * np.log((1 - p) / (1 - q))) if p > q else 0.0


def lattice_evidence(values: Floats, step: float, *, base: float) -> float:
    """Log likelihood ratio of values on a lattice against chance, nats."""
    on, chance = _on_lattice(values, step, base=base)
    return against_chance(values.size, on, chance)


def _on_lattice(values: Floats, step: float, *, base: float) -> tuple[float, float]:
    """Share of values on a lattice, and what chance puts there."""
    offset = np.abs(values - step * np.round(values / step))
    # under half the finest coding: what is rounded to it lies on the lattice or a whole one
    # beside it
    tolerance = min(0.25 * base, 0.05 * step)
    return float((offset <= tolerance).mean()), min(0.98, max(base, 2 * tolerance) / step)


def lattice_share(values: Floats, step: float, *, base: float) -> float:
    """Share of values on a lattice above what chance gives.

    Parameters
    ----------
    values : (n,) float
    step, base : float
        The coarse step, and the fine one in which values come anyway.

    Returns
    -------
    float
        1 where all lie on the coarse lattice, about 0 where only chance puts them there.
    """
    if values.size == 0:
        return 0.0
    on, chance = _on_lattice(values, step, base=base)
    return (on - chance) / (1 - chance)


def coarsest(values: Floats, steps: tuple[float, ...], *, base: float) -> tuple[float, float]:
    """Coarsest step with a clear share, and that share; (base, 1) where none.

    Parameters
    ----------
    values : (n,) float
    steps : tuple of float
        Increasing.
    """
    # five standard errors of a share of so many
    need = max(LEAST_SHARE, 5.0 / np.sqrt(max(values.size, 1)))
    for step in reversed(steps):
        share = lattice_share(values, step, base=base)
        finer = [lattice_share(values, s, base=base) for s in steps if s < step]
        # values on a coarse lattice lie on its finer divisors too: the coarsest that holds nearly
        # as many
        if share > need and share > 0.8 * max(finer, default=0.0):
            return step, share
    return base, 1.0


def wind_coding(frame: Frame) -> MomentVerdict | None:
    """Find aircraft whose winds come in steps coarser than a degree or a knot."""
    speed = np.hypot(frame.u_rep, frame.v_rep) / KNOT
    direction = direction_in_degrees(frame.u_rep, frame.v_rep)
    moving = speed > 3.0
    per_tail: dict[str, Told] = {}
    evidence: list[float] = []
    start: list[float] = []
    for a, tail in enumerate(frame.tails):
        own = np.flatnonzero((frame.aircraft == a) & moving)
        if own.size < 100:
            continue
        fast = own[_usual(speed[own], FREQUENT["speed"])]
        turned = own[_usual(direction[own], FREQUENT["direction"])]
        step, share = coarsest(speed[fast], SPEED_STEPS, base=1.0)
        turn, turn_share = coarsest(direction[turned], DIRECTION_STEPS, base=1.0)
        if step <= 1.0 and turn <= 1.0:
            continue
        per_tail[tail] = {"step": step if step > 1 else 1.0, "direction_step_deg": turn}
        value, width = (direction[own], turn) if turn > 1 else (speed[own], step)
        evidence.append(lattice_evidence(value, width, base=1.0))
        # nearly all on the lattice: coded so from the first report on, else it began later
        if min(share if step > 1 else 1.0, turn_share if turn > 1 else 1.0) < 0.9:
            start.append(_change_time(value, width, frame.time[own]))
    if not per_tail:
        return None
    period = [_date(float(np.median(start))), None] if len(start) == len(per_tail) else None
    return _verdict("wind_coding", per_tail, period, evidence)


def _usual(values: Floats, frequent: int) -> NDArray[np.bool_]:
    """Reports (n,) but for those of the most frequent whole values."""
    whole, number, count = np.unique(np.round(values), return_inverse=True, return_counts=True)
    if whole.size <= 2 * frequent:
        return np.ones(values.size, bool)
    return ~np.isin(number, np.argsort(-count, kind="stable")[:frequent])


def position_coding(frame: Frame) -> MomentVerdict | None:
    """Find aircraft whose positions come in steps coarser than the fleet's."""
    per_tail: dict[str, Told] = {}
    evidence: dict[str, float] = {}
    steps = []
    for a, tail in enumerate(frame.tails):
        own = np.flatnonzero(frame.aircraft == a)
        if own.size < 100:
            continue
        found = [
            coarsest(60.0 * values[own], POSITION_STEPS, base=0.1)[0]
            for values in (frame.latitude, frame.longitude)
        ]
        steps.append(min(found))
        # tenths of an arc minute are how positions come
        if min(found) > 0.1:
            per_tail[tail] = {"step": min(found)}
            evidence[tail] = lattice_evidence(60.0 * frame.latitude[own], min(found), base=0.1)
    common = float(np.median(steps)) if steps else 0.1
    if common < 1.0:
        # what all send in is their format, and told of none
        per_tail = {t: v for t, v in per_tail.items() if number(v["step"]) > 1.2 * common}
    told = [evidence[tail] for tail in per_tail]
    return _verdict("position_coding", per_tail, None, told) if per_tail else None


def heading_coding(frame: Frame) -> MomentVerdict | None:
    """Find aircraft whose headings come in coarse steps."""
    per_tail: dict[str, Told] = {}
    evidence = []
    for a, tail in enumerate(frame.tails):
        found = heading_lattice_of(frame, a)
        if found is not None:
            per_tail[tail] = {"step_deg": found.step, "true_north": found.true_north or None}
            evidence.append(found.evidence)
    return _verdict("heading_coding", per_tail, None, evidence) if per_tail else None


def whole_minutes(frame: Frame) -> MomentVerdict | None:
    """Find aircraft whose times are cut to the minute while others' are not."""
    cut, evidence = [], []
    for a, tail in enumerate(frame.tails):
        seconds = np.mod(frame.time[frame.aircraft == a], 60.0)
        if seconds.size < 100:
            continue
        # half a second: times come in whole ones
        whole = float((np.minimum(seconds, 60 - seconds) < 0.5).mean())
        # nearly all: a time that is whole by chance is one in sixty
        if whole > 0.95:
            cut.append(tail)
            evidence.append(against_chance(seconds.size, whole, 1 / 60))
    counted = np.bincount(frame.aircraft, minlength=len(frame.tails)) >= 100
    if not cut or len(cut) == int(counted.sum()):
        return None
    # seconds cut off are thirty in the mean
    return _verdict("time_lag", {t: {"offset_s": -30.0} for t in cut}, None, evidence)


def outliers(frame: Frame, noise: NoiseFit) -> MomentVerdict | None:
    """Find aircraft with more gross errors than a simulated archive of the same paths has.

    Parameters
    ----------
    noise : NoiseFit
        Holds the reports taken for gross errors.
    """
    fleet = len(frame.tails)
    count = np.bincount(frame.aircraft, minlength=fleet).astype(float)
    hits = np.bincount(frame.aircraft, noise.gross, minlength=fleet).astype(float)
    used = count >= 100
    # of a handful a rate, and whose it is, is anybody's
    if not used.any() or hits[used].sum() < 5:
        return None
    chance = np.maximum(simulated_rate(frame, noise), LEAST_CHANCE)
    rate, gain = shared_rate(hits[used], count[used], chance[used])
    struck = np.flatnonzero(used)[gain > 0]
    if struck.size == 0 or rate < LEAST_RATE:
        return None
    size = _gross_size(frame, noise.gross & np.isin(frame.aircraft, struck))
    if size < LEAST_SIZE:
        return None  # an effect that is switched on and off, not an error of single reports
    # gross errors of less than 5 m/s in both components pass for noise: those seen are scaled up by
    # them, at most by a half
    seen = 1.0 - float(np.clip(_inside(5.0 / size), 0, 0.6)) ** 2
    counting = (rate + chance[struck]) / count[struck]
    own = _shrunk(hits[struck] / count[struck] - chance[struck], counting, rate)
    per_tail = {
        frame.tails[a]: {"fraction": float(max(one, 0.0) / seen), "size_m_s": size}
        for a, one in zip(struck, own, strict=True)
    }
    verdict = _verdict("outliers", per_tail, None, [float(gain[gain > 0].sum())])
    error = np.sqrt(np.median(counting))
    verdict.standard_errors["fraction"] = float(error) / seen
    return verdict


def simulated_rate(frame: Frame, noise: NoiseFit, *, seed: int = 0) -> Floats:
    """Share of each aircraft's reports that stand out where none errs grossly, (aircraft,).

    Reports of the same paths through the same noise, coded as the unit codes: what coarse coding
    and sparse neighbours make stand out is in it. Rare as they are, the fleet's mean counts as much
    as an aircraft's own share; but headings in coarse steps jump at turns, which are not rare.
    """
    rng, coding = np.random.default_rng(seed), Coding.as_found(frame)
    fleet = len(frame.tails)
    hits = np.zeros(fleet)
    for _ in range(DRAWS):
        error = draw_noise(frame, noise.model, rng=rng)
        u, v = coding.apply(frame.u_ref + error[:, 0], frame.v_ref + error[:, 1])
        made = gross_errors(np.stack([u - frame.u_ref, v - frame.v_ref], -1), noise.order)
        hits += np.bincount(frame.aircraft, made, minlength=fleet) / DRAWS
    count = np.maximum(np.bincount(frame.aircraft, minlength=fleet), 1)
    jumping = in_coarse_steps(frame)
    fine = ~jumping if not jumping.all() else jumping
    common = hits[fine].sum() / count[fine].sum()
    return np.asarray(np.maximum(np.where(jumping, JUMPING, 1.0) * hits / count, common))


def shared_rate(hits: Floats, count: Floats, chance: Floats) -> tuple[float, Floats]:
    """One rate of gross errors of those aircraft that have them, and what speaks for each.

    Parameters
    ----------
    hits, count, chance : (m,) float
        Hits and reports of each aircraft, and the share that chance gives.

    Returns
    -------
    rate : float
        Beyond chance; beginning with the clearest aircraft, that of a two-part mixture of Poisson
        laws.
    gain : (m,) float
        Log likelihood ratio of each aircraft, that rate and chance against chance, nats.
    """

    def gain(rate: float) -> Floats:
        return np.asarray(hits * np.log1p(rate / chance) - count * rate)

    own = [against_chance(int(n), h / n, q) for h, n, q in zip(hits, count, chance, strict=True)]
    first = int(np.argmax(own))
    rate = float(max(hits[first] / count[first] - chance[first], 0.0))
    # expectation maximisation of one rate settles within a dozen rounds
    for _ in range(30):
        share = 1 / (1 + np.exp(-np.clip(gain(rate), -50, 50)))
        gross = hits * rate / (rate + chance)
        rate = float((share @ gross) / (share @ count))
    return rate, gain(rate)


def _shrunk(rates: Floats, counting: Floats, common: float) -> Floats:
    """Rates of single aircraft, drawn to the common one as far as counting alone scatters them.

    Parameters
    ----------
    counting : (m,) float
        Variance that counting gives each.
    """
    spread = max(float(np.mean((rates - common) ** 2 - counting)), 0.0)
    return np.asarray(common + (rates - common) * spread / (spread + counting))


def _inside(z: float) -> float:
    """Probability that a standard normal value lies within z."""
    # tanh form of the normal distribution, sqrt(2 / pi) and its cubic term: good to 0.0004
    return float(np.tanh(z * 0.7979 * (1 + 0.044715 * z * z)))


def _gross_size(frame: Frame, gross: NDArray[np.bool_]) -> float:
    """Standard deviation per component of the gross errors, m/s."""
    values = frame.residual[gross]
    if values.shape[0] < 5:
        return 20.0
    ordinary = robust_sd(frame.residual, 0.0)
    # at least 5 m/s: gross is what stands out by five standard deviations, each a metre a second
    # or so
    return float(np.sqrt(max(float(np.mean(values**2)) - ordinary**2, 25.0)))


def _change_time(values: Floats, step: float, time: Floats) -> float:
    """Time at which values begin to lie on a lattice: largest cumulative excess, s."""
    order = np.argsort(time)
    on = (np.abs(values - step * np.round(values / step)) < 0.05 * step)[order].astype(float)
    # before the change fewer lie on it than in the mean, after it more: the sum is least between
    excess = np.cumsum(on - on.mean())
    return float(time[order][int(np.argmin(excess))])


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def _verdict(
    name: str,
    per_tail: Mapping[str, Mapping[str, Value]],
    period: list[str | None] | None,
    evidence: list[float],
) -> MomentVerdict:
    first = next(iter(per_tail.values()))
    middle = {name: _middle([values[name] for values in per_tail.values()]) for name in first}
    clearest = float(max(evidence) - LOOKED_AT)
    return MomentVerdict(name, tuple(per_tail), middle, {}, per_tail, period, clearest)


def _middle(values: list[Value]) -> Value:
    """Median of numbers; of what is none, the one that most aircraft have."""
    numbers = [value for value in values if isinstance(value, float)]
    if len(numbers) == len(values):
        return float(np.median(numbers))
    return max(values, key=values.count)


def second_moments(frame: Frame, noise: NoiseFit) -> list[MomentVerdict]:
    """All second-moment effects of an archive."""
    found = [
        wind_coding(frame),
        position_coding(frame),
        heading_coding(frame),
        whole_minutes(frame),
    ]
    return [f for f in (*found, outliers(frame, noise)) if f is not None]
