"""What no mean shows: winds whose speeds or directions are never, or too often, sent.

Assumptions: a simulated archive of the same paths with the effects found, coded as the unit codes,
has the reported speeds and directions that the real one has. Trees that tell a real report from a
simulated one by them, learned on half of the days, are judged on the others by the area under the
receiver's curve: 0.5 where there is nothing to tell. What they tell a simulated archive from
another by, and how the area scatters between days, is the measure of chance: what is sent
otherwise is so every day, while some days' weather may look like nothing simulated. A floor, a
ceiling or a hole sends another speed for every speed: the monotone map between the quantiles of
simulated and reported speeds.

Validity: whole flights, a sample of reports; effects that move a few percent of the reports. The
map holds for an effect of the speed alone; directions sent on a few values are told, not mapped.

Source: Lopez-Paz & Oquab (2017), classifier two-sample tests; Hanley & McNeil (1982), Radiology
143, 29-36 (area under the curve).

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from airswing.gap.archive.direction_lattice import Lattice, lattice_of
from airswing.gap.effects.empirical import mapped_speed
from airswing.gap.simulation.forward import Coding
from airswing.gap.witness.bench import Bench
from airswing.gap.witness.learned import Sample
from airswing.units import KNOT

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingClassifier

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Of the trees.
TREES = {"max_iter": 24, "max_leaf_nodes": 31, "learning_rate": 0.25, "min_samples_leaf": 60}
#: Area beyond that of simulated archives that counts: least, and in standard errors of it.
LEAST_AREA, SIGNIFICANT = 0.025, 4.0
#: Least standard error of an area between simulated archives; reports of a day that tell one.
LEAST_ERROR, LEAST_OF_DAY = 0.004, 100
#: Share of the clearest variable's loss from which another counts.
TELLING = 0.5
#: Spread of the areas of aircraft that have the same effect, as a share of their mean: routes
#: differ in how often they meet it.
UNEVEN = 0.4
#: Variables the trees see; those by which an effect on the wind sent is told come first.
SEEN = ("wind_speed", "wind_direction", "altitude", "hour")
#: Quantiles of the map of speeds, and the least change that is one, m/s and standard errors.
QUANTILES, LEAST_CHANGE, CLEAR = 80, 1.0 * KNOT, 4.0


@dataclass(frozen=True)
class SentWinds:
    """Winds sent otherwise than simulated ones."""

    area: float  # under the receiver's curve, real against simulated
    # simulated, error: the same between simulated archives, and its standard error
    simulated: float
    error: float
    telling: tuple[str, ...]  # ``wind_speed``, ``wind_direction``: what tells, most first
    aircraft: tuple[int, ...]  # those that have it
    # speeds, sent: (m,): speeds and what is sent in their place; None where the map is the identity
    speeds: Floats | None
    sent: Floats | None
    # closes, closes_error: how far the disagreement shrinks, kt
    closes: float
    closes_error: float
    # (36,): reports beside simulated ones in each ten degrees of direction, as a share less 1
    directions: Floats
    lattice: Lattice | None = None  # steps in which they come

    @property
    def component(self) -> str:
        """Name under which it is told."""
        return "reported_direction" if self.speeds is None else "reported_speed"

    @property
    def evidence(self) -> float:
        """Half the square of the excess in standard errors, nats."""
        return 0.5 * ((self.area - self.simulated) / self.error) ** 2


@dataclass(frozen=True)
class _Told:
    """Area under the curve, what permuting each variable costs of it, areas by aircraft."""

    area: float
    loss: dict[str, float]
    by_aircraft: Floats


def sent_winds(bench: Bench, fold: Integers, *, without: Sequence[int] = ()) -> SentWinds | None:
    """Find winds that are sent otherwise than the simulation sends them.

    Parameters
    ----------
    bench : Bench
        With three simulated archives or more.
    fold : (D,) int
        Fold of every day.
    without : sequence of int
        Aircraft left out: their winds are coded otherwise, and that has a name.

    Returns
    -------
    SentWinds or None
        None where trees tell no more than between simulated archives.
    """
    frame = bench.setting.frame
    sample = Sample.of(bench.setting)
    keep = ~np.isin(frame.aircraft[sample.rows], without)
    keep &= ~bench.setting.noise.gross[sample.rows]
    # of fewer the trees learn reports by heart
    if keep.sum() < 2000 or sample.too_short:
        return None
    sample = Sample(sample.rows[keep], sample.day[keep], sample.second[keep])
    trees = _trees(bench, sample, 0)
    area = _area(trees)
    if area - 0.5 < LEAST_AREA - LEAST_ERROR:  # no simulated archive would make it count
        return None
    others = [_trees(bench, sample, k) for k in range(2, len(bench.winds))]
    alike = [_area(halves) for halves in others]
    simulated = float(np.mean(alike))
    between = float(np.std(alike, ddof=1)) if len(alike) > 1 else 0.0
    error = float(np.hypot(max(between, LEAST_ERROR), _scatter_of_days(sample, trees)))
    if area - simulated < max(LEAST_AREA, SIGNIFICANT * error):
        return None
    real = _told(bench, sample, trees)
    winds = {name: real.loss[name] for name in SEEN[:2]}
    most = max(winds.values())
    if most < 0.5 * (real.area - 0.5) or most < max(real.loss.values()):
        return None  # what the weather of these days had, not what is sent of it
    telling = tuple(n for n, x in sorted(winds.items(), key=lambda i: -i[1]) if x >= TELLING * most)
    chance = np.stack([_by_aircraft(bench, sample, halves) for halves in others])
    own = struck_of(real.by_aircraft - 0.5, max(float(chance.std()), LEAST_ERROR))
    aircraft = tuple(int(a) for a in np.flatnonzero(own))
    speeds, sent = _map_of(bench, aircraft, np.ones(frame.size, bool))
    turned = _directions(bench, aircraft)
    if telling[0] != "wind_speed" or not (speeds != sent).any():
        own = np.isin(frame.aircraft, aircraft)
        lattice = lattice_of(*(x[own] for x in _sent(bench, 0)))
        return SentWinds(
            real.area, simulated, error, telling, aircraft, None, None, 0.0, 0.0, turned, lattice
        )
    closes, doubt = _closure(bench, aircraft, fold)
    return SentWinds(
        real.area, simulated, error, telling, aircraft, speeds, sent, closes, doubt, turned
    )


def _sent(bench: Bench, k: int) -> tuple[Floats, Floats]:
    """Winds of an archive as the unit codes them."""
    return Coding.of_archive(bench.setting.frame).apply(*bench.winds[k])


def _features(bench: Bench, rows: Integers, k: int) -> Floats:
    u, v = (x[rows] for x in _sent(bench, k))
    speed = np.round(np.hypot(u, v) / KNOT, 1)
    direction = np.round(np.mod(np.degrees(np.arctan2(-u, -v)), 360.0))
    other = [bench.variables[n].values[rows] for n in SEEN[2:] if n in bench.variables]
    return np.stack([speed, direction, *other, bench.setting.frame.aircraft[rows]], -1)


@dataclass(frozen=True)
class _Half:
    """Trees that learned half of the days, and what they are judged on."""

    trees: HistGradientBoostingClassifier
    left: Floats
    label: Integers
    score: Floats
    learned: NDArray[np.bool_]


def _trees(bench: Bench, sample: Sample, k: int) -> list[_Half]:
    """Let trees tell an archive from the first simulated one, on each half of the days."""
    from sklearn.ensemble import HistGradientBoostingClassifier

    one, other = (_features(bench, sample.rows, j) for j in (k, 1))
    out = []
    for learn in (sample.second, ~sample.second):
        trees = HistGradientBoostingClassifier(
            **TREES, categorical_features=[one.shape[1] - 1], early_stopping=False, random_state=0
        )
        trees.fit(np.concatenate([one[learn], other[learn]]), np.repeat([1, 0], learn.sum()))
        left = np.concatenate([one[~learn], other[~learn]])
        label = np.repeat([1, 0], (~learn).sum())
        out.append(_Half(trees, left, label, trees.decision_function(left), learn))
    return out


def _area(halves: Sequence[_Half]) -> float:
    """Mean area under the curve on the days left out."""
    from sklearn.metrics import roc_auc_score

    return float(np.mean([roc_auc_score(half.label, half.score) for half in halves]))


def _scatter_of_days(sample: Sample, halves: Sequence[_Half]) -> float:
    """Standard error of the area from its scatter between days."""
    from sklearn.metrics import roc_auc_score

    areas = []
    for half in halves:
        day = np.tile(sample.day[~half.learned], 2)
        for one in np.unique(day):
            own = day == one
            if own.sum() > LEAST_OF_DAY:
                areas.append(roc_auc_score(half.label[own], half.score[own]))
    return float(np.std(areas, ddof=1) / np.sqrt(len(areas))) if len(areas) > 1 else 0.0


def _told(bench: Bench, sample: Sample, halves: Sequence[_Half]) -> _Told:
    """Loss of every variable, and areas by aircraft."""
    from sklearn.metrics import roc_auc_score

    names = [*SEEN[:2], *(n for n in SEEN[2:] if n in bench.variables), "aircraft"]
    rng = np.random.default_rng(0)
    loss = dict.fromkeys(names, 0.0)
    for half in halves:
        left, label, score = half.left, half.label, half.score
        area = roc_auc_score(label, score)
        for j, name in enumerate(names):
            moved = left.copy()
            moved[:, j] = left[rng.permutation(left.shape[0]), j]
            lost = area - roc_auc_score(label, half.trees.decision_function(moved))
            loss[name] += 0.5 * float(lost)
    return _Told(_area(halves), loss, _by_aircraft(bench, sample, halves))


def _by_aircraft(bench: Bench, sample: Sample, halves: Sequence[_Half]) -> Floats:
    """Area of each aircraft's reports alone, (A,); a half for those with few."""
    from sklearn.metrics import roc_auc_score

    tails = bench.setting.frame.aircraft[sample.rows]
    areas = np.full((len(halves), len(bench.setting.frame.tails)), 0.5)
    for half, area in zip(halves, areas, strict=True):
        owner = np.tile(tails[~half.learned], 2)
        for a in range(area.size):
            own = owner == a
            # of fewer an area scatters by a tenth, and half says that nothing is told
            if own.sum() > 50:
                area[a] = roc_auc_score(half.label[own], half.score[own])
    return np.asarray(areas.mean(axis=0))


def struck_of(beyond: Floats, error: float) -> NDArray[np.bool_]:
    """Aircraft that have an effect, from how far each one's area is beyond a half.

    More likely of a normal law about the level they share than of one about nothing, whose
    standard deviation is ``error``; level and share by expectation maximisation: what hardly shows
    on one shows on a fleet. The clearest has it in any case.
    """
    level, share = float(beyond.max()), 0.5
    has = np.zeros(beyond.size)
    # expectation maximisation of level and share
    for _ in range(50):
        spread = float(np.hypot(error, UNEVEN * level))
        against = (np.maximum(beyond, 0.0) / error) ** 2 - ((beyond - level) / spread) ** 2
        has = expit(np.log(share / (1 - share) * error / spread) + 0.5 * against)
        has[np.argmax(beyond)] = 1.0
        level = float(has @ beyond / has.sum())
        share = float(np.clip(has.mean(), 0.5 / has.size, 1 - 0.5 / has.size))
    return np.asarray(has >= 0.5)


def _map_of(bench: Bench, aircraft: Sequence[int], use: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Speeds and what is sent in their place, (m,) each, m/s: the identity where chance allows."""
    own = np.flatnonzero(np.isin(bench.setting.frame.aircraft, aircraft) & use)
    coding = Coding.of_archive(bench.setting.frame)
    step = np.broadcast_to(np.asarray(coding.speed, float), bench.setting.frame.size)[own]
    rng = np.random.default_rng(0)
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
    spread = rng.uniform(-0.5, 0.5, own.size) * step
    made = np.stack(
        [
            np.quantile(np.abs(np.hypot(*(x[own] for x in _sent(bench, k))) + spread), levels)
            for k in range(1, len(bench.winds))
        ]
    )
    speeds = made.mean(axis=0)
    # m/s at least: a few simulated winds may agree by chance; their mean errs as well
    error = np.maximum(made.std(axis=0, ddof=1), 0.02) * np.sqrt(1 + 1 / made.shape[0])
    told = np.hypot(*(x[own] for x in _sent(bench, 0)))
    sent, smooth = np.quantile(told, levels), np.quantile(np.abs(told + spread), levels)
    same = np.abs(smooth - speeds) < np.maximum(LEAST_CHANGE, CLEAR * error)
    sent = np.maximum.accumulate(np.where(same, speeds, sent))
    # speeds sent in steps put several quantiles on one: a map needs them to increase
    speeds = np.maximum.accumulate(speeds + 1e-6 * np.arange(QUANTILES))
    return speeds, np.where(same, speeds, sent)


def _directions(bench: Bench, aircraft: Sequence[int]) -> Floats:
    """Reports beside simulated ones in each ten degrees of direction, as a share less 1, (36,)."""
    own = np.isin(bench.setting.frame.aircraft, aircraft)
    count = []
    for k in range(len(bench.winds)):
        u, v = (x[own] for x in _sent(bench, k))
        # ten degrees: what direction is commonly coded in
        sector = np.mod(np.degrees(np.arctan2(-u, -v)), 360.0) // 10.0
        count.append(np.bincount(sector.astype(int), minlength=36)[:36])
    return np.asarray(count[0] / np.maximum(np.mean(count[1:], axis=0), 1.0) - 1.0)


def _closure(bench: Bench, aircraft: Sequence[int], fold: Integers) -> tuple[float, float]:
    """How far the disagreement shrinks, kt, and its standard error.

    Simulated winds of every fold of days, with the map fitted to the other folds and without,
    beside the reference: what the effect adds to the disagreement, as a twin archive would show.
    """
    frame = bench.setting.frame
    own, group = np.isin(frame.aircraft, aircraft), fold[bench.setting.day]
    added = np.zeros((len(bench.winds) - 1, int(fold.max()) + 1))
    for f in range(added.shape[1]):
        speeds, sent = _map_of(bench, aircraft, group != f)
        rows = np.flatnonzero(own & (group == f))
        for k in range(1, len(bench.winds)):
            u, v = (x[rows] for x in _sent(bench, k))
            speed = np.hypot(u, v)
            # a calm stays one
            scale = mapped_speed(speed, speeds, sent) / np.maximum(speed, 1e-6)
            after = np.hypot(scale * u - frame.u_ref[rows], scale * v - frame.v_ref[rows])
            before = np.hypot(u - frame.u_ref[rows], v - frame.v_ref[rows])
            added[k - 1, f] = (after - before).sum() / frame.size / KNOT
    total = added.sum(axis=1)
    folds = added.mean(axis=0)
    within = folds.std(ddof=1) * np.sqrt(folds.size)
    # kt: nothing is known better than that
    return float(total.mean()), float(np.hypot(within, total.std(ddof=1)) + 0.01)
