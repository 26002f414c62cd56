"""Single reports that scatter more than simulated ones: on some aircraft, or by what they record.

Assumptions: what the other reports of its flight do not foretell of a report holds little but what
is its own: noise, coding, an instrument that jitters. The logarithm of its square, in units of what
the noise model expects, stands beside that of simulated archives of the same paths, noise and
coding. Aircraft then differ as much as their routes and instruments ordinarily do, and the fleet
itself tells how much that is. A curve over a variable differs from a level one by what weather and
routes ordinarily make of it (:data:`NATURAL`), or something scatters there. How much, in m/s, is
found by letting the simulated archives jitter until they show the curve.

Validity: five aircraft and more with 200 reports for what differs between aircraft; scatter that
neither aircraft nor a variable tells apart is taken for the reference's. Effects that move means
are taken off before.

Source: docs/gap.md section 6; logarithms of squares: Harvey (1976), Econometrica 44, 461; what the
neighbours do not foretell: :mod:`airswing.gap.noise.beside_neighbours`.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import KINDS
from airswing.gap.archive.value_tables import Axis, Grid, axis_of
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.noise.model import NoiseFit, flown, gains_beside
from airswing.gap.scatter.simulated_scatter import Scene, jitter_showing
from airswing.physics.robust_spread import robust_sd

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Variance of the logarithm of an exponential variable, pi^2 / 6, twice for what neighbours share.
LOG_VARIANCE = np.pi**2 / 3
#: Reports an aircraft must have, and aircraft a fleet.
LEAST_REPORTS, LEAST_AIRCRAFT = 200, 5
#: Smallest excess of ln sd that is stated, and the least by which aircraft are taken to differ.
LEAST_EXCESS, LEAST_SPREAD = 0.15, 0.03
#: Evidence needed, nats, beyond what looking at a hundred aircraft for the clearest costs.
NEEDED = 3.0 + float(np.log(100.0))
#: Cells of a curve, and of the finer one that tells alike variables apart; share of the best one's
#: evidence from which another is looked at.
CELLS, FINE, ALIKE = 16, 48, 0.5
#: By how much ln variance ordinarily differs between cells: turbulence and what the reference does
#: not resolve change with place, level and hour; how an aircraft points hardly matters to them.
NATURAL, NATURAL_WEATHER = 0.1, 0.2
WEATHER = frozenset(KINDS) - {
    *("magnetic_heading", "track", "drift", "bank", "acceleration", "icing"),
}
#: Prior standard deviations of a curve of ln variance.
PRIOR = (0.3, 0.6, 1.2)
#: Share of a curve's largest excess from which a cell has it.
HAS_IT = 0.2
#: Folds of days by which a curve over the date is confirmed.
DAY_FOLDS = 5
#: Share of aircraft that stand for all.
MOST = 0.75


@dataclass(frozen=True)
class Scattering:
    """Reports that scatter more than the others."""

    tails: tuple[str, ...]  # aircraft that have it
    # standard deviation per component of what is beyond the others, m s-1: of each of these
    # aircraft, or of each cell of the axis
    excess: tuple[float, ...]
    evidence: float  # nats
    sizes: Floats = field(repr=False)  # (n,): the same of every report
    axis: Axis | None = None  # of the variable that tells it; None where the aircraft alone do


@dataclass(frozen=True)
class _Curve:
    """Curve of ln variance over one variable, on the aircraft that have it.

    Evidence weighs it beside what is natural for this variable, rank beside the same for all.
    """

    variable: str
    grid: Grid
    values: Floats
    error: Floats
    struck: NDArray[np.bool_]
    evidence: float
    rank: float


def scattering(
    frame: Frame,
    quiet: Frame,
    residual: Floats,
    noise: NoiseFit,
    *,
    gross: NDArray[np.bool_],
    fold: Integers,
    explained: Collection[str] = (),
    seed: int = 0,
) -> Scattering | None:
    """Find reports that scatter more than simulated ones.

    Parameters
    ----------
    frame, quiet : Frame
        Reports, and the same with heading and airspeed free of the residual's noise.
    residual : (n, 2) float
        With the effects found taken off, m s-1.
    gross : (n,) bool
        Gross errors that have a name: left out.
    fold : (n,) int
        Fold of weeks of every report.
    explained : collection of str
        Aircraft whose scatter has a name already.
    seed : int
        Of the simulated archives.

    Returns
    -------
    Scattering or None
        By a variable where one tells it, else by aircraft.
    """
    reports = flown(quiet, heading_doubt(frame, quiet))
    # whatever stands out is part of the scatter, so long as it has no name
    noise = replace(noise, gains=gains_beside(noise, reports, ~gross), gross=gross)
    scene = Scene(frame, quiet, noise, np.random.default_rng(seed))
    left = ~np.isin(np.array(frame.tails), list(explained))
    real = scene.log_squares(residual[:, None])[:, 0]
    plain = scene.simulated(np.zeros(frame.size))
    usual = np.nansum(plain, axis=1) / np.maximum(np.isfinite(plain).sum(axis=1), 1)
    of_aircraft = _by_aircraft(scene, real - usual, left)
    beside = plain if of_aircraft is None else scene.simulated(of_aircraft.sizes)
    curve = _by_variable(scene, real, beside, left=left, fold=fold)
    if curve is None:
        return of_aircraft
    return _sized(scene, real, plain, curve)


def _by_aircraft(scene: Scene, excess: Floats, left: NDArray[np.bool_]) -> Scattering | None:
    """Aircraft whose reports scatter more than the fleet's, whatever they record."""
    frame = scene.frame
    total, count = scene.means(excess, np.zeros(frame.size, np.int64), 1)
    used = np.flatnonzero(count[:, 0] >= LEAST_REPORTS)
    if used.size < LEAST_AIRCRAFT:
        return None
    level = total[used, 0] / count[used, 0]
    ratio = (level - np.median(level)) / 2
    spread = max(robust_sd(ratio, 0.0), LEAST_SPREAD)
    evidence = 0.5 * (ratio / spread) ** 2
    high = (ratio > LEAST_EXCESS) & (evidence > NEEDED) & left[used]
    if not high.any():
        return None
    wanted = np.zeros(len(frame.tails))
    wanted[used[high]] = 2 * ratio[high]
    size = jitter_showing(scene, wanted, frame.aircraft, float(np.median(level)))
    return Scattering(
        tuple(frame.tails[a] for a in used[high]),
        tuple(float(x) for x in size[used[high]]),
        float(evidence[high].max() - np.log(100.0)),
        size[frame.aircraft],
    )


def _by_variable(
    scene: Scene,
    real: Floats,
    beside: Floats,
    *,
    left: NDArray[np.bool_],
    fold: Integers,
) -> _Curve | None:
    """The variable by which reports scatter most, where it stands on weeks left out."""
    curves = [_curve(scene, real, beside, name=name, left=left) for name in scene.variables]
    shown = [c for c in curves if c.evidence > NEEDED and np.ptp(c.values) > 2 * LEAST_EXCESS]
    if not shown:
        return None
    best = max(shown, key=lambda one: one.rank)
    own = best.struck
    # variables alike (heading, track) tell themselves apart by how sharp the curve's edges are
    near = [one for one in shown if one.rank > ALIKE * best.rank]
    if len(near) > 1:
        finer = [
            _curve(scene, real, beside, name=one.variable, left=own, cells=FINE, all_of=True)
            for one in near
        ]
        best = near[int(np.argmax([one.rank for one in finer]))]
    if best.variable == "date":  # weeks have no dates in common
        fold = scene.frame.day % DAY_FOLDS
    gain = []
    for k in np.unique(fold):
        learned, judged = (
            _curve(scene, real, beside, name=best.variable, left=own, use=use, all_of=True)
            for use in (fold != k, fold == k)
        )
        weight = 1 / judged.error**2
        gain.append(float((weight * learned.values * (2 * judged.values - learned.values)).sum()))
    told, doubt = float(np.sum(gain)), float(np.std(gain, ddof=1) * np.sqrt(len(gain)))
    return best if told > 2 * doubt else None


def _curve(
    scene: Scene,
    real: Floats,
    beside: Floats,
    *,
    name: str,
    left: NDArray[np.bool_],
    use: NDArray[np.bool_] | None = None,
    all_of: bool = False,
    cells: int = CELLS,
) -> _Curve:
    """Curve of ln variance beyond simulated archives, on the aircraft whose own it is."""
    grid = Grid((axis_of(scene.variables[name], cells),))
    real = real if use is None else np.where(use, real, np.nan)
    total, count = scene.means(real, scene.cells(grid), grid.size)
    excess = total / np.maximum(count, 1)
    for k in range(beside.shape[1]):
        own, number = scene.means(beside[:, k], scene.cells(grid, k), grid.size)
        excess = excess - own / np.maximum(number, 1) / beside.shape[1]
    count = np.where(left[:, None], count, 0.0)
    excess = np.where(count > 0, excess, 0.0)
    natural = NATURAL_WEATHER if name in WEATHER else NATURAL
    struck = left.copy() if all_of else _struck(excess, count, natural) & left
    weight = count * struck[:, None]
    values = _level(excess, weight)[0]
    error = np.sqrt(LOG_VARIANCE / np.maximum(weight.sum(axis=0), 1e-3) + natural**2)
    # an aircraft chosen for its scatter shows some: choosing has the odds of one in a hundred
    price = 0.0 if struck.sum() == left.sum() else float(np.log(100.0))
    evidence = _against_level(values, error) - price
    rank = _against_level(values, np.sqrt(error**2 - natural**2 + NATURAL**2))
    return _Curve(name, grid, values, error, struck, evidence, rank)


def _level(excess: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Curve of mean 0 and levels of aircraft that fit cells best, (cells,), (aircraft,)."""
    curve = np.zeros(excess.shape[1])
    whole = np.maximum(weight.sum(axis=0), 1e-9)
    # levels and curve in turn: each settles the other within a few rounds
    for _ in range(10):
        level = (weight * (excess - curve)).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
        curve = (weight * (excess - level[:, None])).sum(axis=0) / whole
        curve = curve - (whole * curve).sum() / whole.sum()
    return curve, level


def _own_level(excess: Floats, weight: Floats) -> Floats:
    """Curve of mean 0 that fits the cells of each aircraft by itself best, (aircraft, cells)."""
    whole = np.maximum(weight, 1e-9)
    level = (weight * excess).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    curve = weight * (excess - level[:, None]) / whole
    return np.asarray(curve - ((whole * curve).sum(axis=1) / whole.sum(axis=1))[:, None])


def _struck(excess: Floats, count: Floats, natural: float) -> NDArray[np.bool_]:
    """Aircraft that show one curve rather than a level one: a mixture of the two, (aircraft,)."""
    variance = LOG_VARIANCE / np.maximum(count, 1e-3) + natural**2
    level = _own_level(excess, count)
    own = np.array([_against_level(v, np.sqrt(s)) for v, s in zip(level, variance, strict=True)])
    known = count.sum(axis=1) > 0
    share = known / (1 + np.exp(-np.clip(own, -30, 30)))
    if share.max(initial=0.0) < 0.5:
        share = known.astype(float)
    # expectation maximisation of who is struck
    for _ in range(20):
        curve, _ = _level(excess, count * share[:, None])
        rest = _own_level(excess - curve, count)
        apart = 0.5 * ((level**2 - rest**2) / variance).sum(axis=1)
        usual = np.clip(share[known].mean(), 0.02, 0.98)
        odds = apart + np.log(usual / (1 - usual))
        share = known / (1 + np.exp(-np.clip(odds, -30, 30)))
    struck = share > 0.5
    whole = struck.sum() >= MOST * known.sum() or not struck.any()
    return np.asarray(known if whole else struck)


def _against_level(values: Floats, error: Floats) -> float:
    """Log evidence of a curve against a level one, nats, averaged over prior sizes."""
    each = []
    for size in PRIOR:
        ratio = 1 + (size / error) ** 2
        each.append(float(0.5 * ((values / error) ** 2 * (1 - 1 / ratio) - np.log(ratio)).sum()))
    return float(np.logaddexp.reduce(each) - np.log(len(each)))


def _sized(scene: Scene, real: Floats, plain: Floats, curve: _Curve) -> Scattering | None:
    """Excess beyond the quietest third of the cells, in m/s."""
    count = int(curve.struck[scene.frame.aircraft].sum())
    found = _curve(
        scene,
        real,
        plain,
        name=curve.variable,
        left=curve.struck,
        all_of=True,
        cells=int(np.clip(count / LEAST_REPORTS, CELLS, FINE)),
    )
    order = np.argsort(found.values)
    floor = float(np.median(found.values[order[: max(found.values.size // 3, 1)]]))
    above = found.values - floor
    has = above > np.maximum(HAS_IT * above.max(), np.maximum(LEAST_EXCESS, 2 * found.error))
    if not has.any():
        return None
    cells = np.where(curve.struck[scene.frame.aircraft], scene.cells(found.grid), -1)
    own = np.isfinite(real) & (cells >= 0)
    quiet = own & np.isin(cells, np.flatnonzero(~has))
    beyond = float(np.nanmean(real[quiet]) - np.nanmean(plain[quiet])) if quiet.any() else 0.0
    size = jitter_showing(scene, np.where(has, above, 0.0), cells, beyond)
    tails = tuple(t for t, has_it in zip(scene.frame.tails, curve.struck, strict=True) if has_it)
    sizes = np.where(cells >= 0, size[np.maximum(cells, 0)], 0.0)
    axis = found.grid.axes[0]
    return Scattering(tails, tuple(float(x) for x in size), curve.evidence, sizes, axis)
