"""The learned witness: gradient-boosted trees that need no idea of what they look for.

Assumptions: whatever nobody thought of moves one component of the wind by an amount that what the
report records foretells. Trees learn it on some days and are judged on the others by the covariance
of prediction and error, which the trees' own noise does not make positive; the error is taken
twice, as it is (what holds all along a flight) and less what the flight's other reports foretell
(what changes along it, :mod:`airswing.gap.noise.beside_neighbours`). Day fields and climatology
are out of both. The reported wind holds the noise of the report, which foretells a part of it on
every archive: so the same trees judge simulated archives of the same paths, and the real one counts
by what it exceeds them.

Validity: a sample of whole flights (:data:`SAMPLE` reports); an effect that moves less than
:data:`LEAST` of the archive's mean square, on one aircraft for a short while say, is left to the
tables of single variables. What a report records and what follows from it alone are seen.

Source: Friedman (2001), Annals of Statistics 29, 1189-1232; scikit-learn's histogram gradient
boosting; Breiman (2001), Machine Learning 45, 5-32 (permutation); docs/gap.md section 8.

Units: (m/s)^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.value_tables import COMPONENTS
from airswing.gap.noise.beside_neighbours import interpolation_errors
from airswing.gap.noise.whitening import flight_order, take_gains
from airswing.gap.witness.bench import Bench, Setting

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingRegressor

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Reports learned from and judged, about.
SAMPLE = 40_000
#: Quantiles of a variable between which trees may cut.
CELLS = 100
#: Of the trees.
TREES = {"max_iter": 24, "max_leaf_nodes": 15, "learning_rate": 0.25, "min_samples_leaf": 80}
#: Error as it is, and less what the flight's other reports foretell.
VIEWS = ("level", "change")
#: Covariance beyond the simulated archives' that counts, (m/s)^2, by view: on archives with no
#: effect whose model errs otherwise than the noise model supposes it comes to a half of it.
LEAST = {"level": 0.1, "change": 0.012}
#: The same in standard errors.
SIGNIFICANT = 4.0
#: Days without which nothing is heard: half of them are learned from, and an error between fewer
#: than six is known too badly for four of its standard errors to mean much.
FEWEST_DAYS = 6
#: Bound on single errors, m/s.
BOUND = 7.0
#: Variables that tell each other: permuted together.
GROUPS = (
    ("magnetic_heading", "track"),
    ("altitude", "temperature"),
    ("wind_speed", "airspeed", "ground_speed"),
)
#: A group of variables tells where permuting it costs this share of the most telling one's loss.
TELLING = 0.15
#: Groups whose pairs are offered as tables, and pairs at most.
MOST_GROUPS, MOST_PAIRS = 3, 5
#: Simulated archives the trees learn at most; strengths between which two of them do not decide.
ARCHIVES, CLOSE = 3, (0.6, 1.6)
#: What chance has trees explain less than nothing, in the least that counts.
SLACK = 0.1

Key = tuple[str, str]
"""Component and view."""


@dataclass(frozen=True)
class Explained:
    """What the trees explain of one component in one view."""

    component: str
    view: str
    covariance: float  # of prediction and error on days left out, (m/s)^2
    simulated: float  # mean of the same over simulated archives
    error: float  # standard error of the difference: between days, and between simulated archives

    @property
    def excess(self) -> float:
        """What the real archive exceeds the simulated ones by, (m/s)^2."""
        return self.covariance - self.simulated

    @property
    def strength(self) -> float:
        """Excess over the least that counts; 1 and more is a claim."""
        least = max(LEAST[self.view], SIGNIFICANT * self.error)
        return self.excess / least


@dataclass(frozen=True)
class Heard:
    """What the learned witness says of an archive."""

    explained: tuple[Explained, ...]  # what was set beside simulated archives, strongest first
    # variables of the strongest and what permuting each costs, (m/s)^2; none where nothing is
    # claimed
    telling: tuple[tuple[str, float], ...]

    @property
    def components(self) -> tuple[str, ...]:
        """Components in which something shows, strongest first."""
        return tuple(dict.fromkeys(e.component for e in self.explained if e.strength >= 1.0))

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Pairs of telling variables that do not tell each other, most telling first."""
        both = combinations(self.telling, 2)
        apart = [(x * y, (m, n)) for (m, x), (n, y) in both if _group(m) != _group(n)]
        return [pair for _, pair in sorted(apart, reverse=True)[:MOST_PAIRS]]


@dataclass(frozen=True)
class Sample:
    """Whole flights of an archive that the trees see."""

    rows: Integers  # (m,)
    day: Integers  # (m,)
    second: NDArray[np.bool_]  # (m,): whether a report is of the second half of the days, drawn

    @classmethod
    def of(cls, setting: Setting, seed: int = 0) -> Sample:
        """Draw flights and days."""
        rng = np.random.default_rng(seed)
        flight = setting.frame.flight
        flights = np.unique(flight)
        number = int(np.ceil(flights.size * min(1.0, SAMPLE / flight.size)))
        rows = np.flatnonzero(np.isin(flight, rng.permutation(flights)[:number]))
        day = setting.day[rows]
        turn = rng.permutation(np.unique(setting.day))
        return cls(rows, day, np.isin(day, turn[: turn.size // 2]))

    @property
    def too_short(self) -> bool:
        """Whether it has too few days for some to be learned from and others to judge by."""
        return np.unique(self.day).size < FEWEST_DAYS


class LearnedWitness:
    """Trees on a bench; remembers what simulated archives gave."""

    def __init__(self) -> None:
        self._simulated: dict[Key, list[float]] = {}

    def hear(self, bench: Bench) -> Heard:
        """Let the trees learn an archive and say what they explain.

        Simulated archives are drawn as far as the decision needs: what is strongest, where that
        counts. Of what can no longer be the strongest only the archive's own covariance is known.

        Parameters
        ----------
        bench : Bench
            The real residual and those of simulated archives.

        Returns
        -------
        Heard
            Nothing, where the archive has fewer than :data:`FEWEST_DAYS` days.
        """
        sample = Sample.of(bench.setting)
        if sample.too_short:
            return Heard((), ())
        learned = _Learned(bench, sample)
        told = {(c, v): learned.covariance((c, v), 0) for c in COMPONENTS for v in VIEWS}
        # a simulated archive explains nothing at the least, but for chance
        bounds = {
            key: (covariance + SLACK * LEAST[key[1]]) / max(LEAST[key[1]], SIGNIFICANT * error)
            for key, (covariance, error) in told.items()
        }
        explained: list[Explained] = []
        for key in sorted(bounds, key=lambda key: -bounds[key]):
            if bounds[key] < max([1.0, *(e.strength for e in explained)]):
                break
            explained.append(self._beside_simulated(learned, key, *told[key]))
        explained.sort(key=lambda e: -e.strength)
        telling: tuple[tuple[str, float], ...] = ()
        if explained and explained[0].strength >= 1.0:
            telling = learned.telling((explained[0].component, explained[0].view))
        return Heard(tuple(explained), telling)

    def _beside_simulated(
        self, learned: _Learned, key: Key, covariance: float, error: float
    ) -> Explained:
        """Set a covariance beside those of as many simulated archives as it takes."""
        alike = self._simulated.setdefault(key, [])
        most = min(ARCHIVES, len(learned.bench.simulated))
        for count in range(min(2, most), most + 1):
            while len(alike) < count:
                alike.append(learned.covariance(key, 1 + len(alike))[0])
            mean = float(np.mean(alike))
            # two or three archives may agree by chance: taken to differ by 0.15 of their mean at
            # the least
            between = max(float(np.std(alike, ddof=min(1, count - 1))), 0.15 * abs(mean))
            between *= np.sqrt(1 + 1 / len(alike))
            told = Explained(*key, covariance, mean, float(np.hypot(error, between)))
            if not CLOSE[0] < told.strength < CLOSE[1]:
                break
        return told


class _Learned:
    """Trees of an archive and of simulated ones, with what they see made once."""

    def __init__(self, bench: Bench, sample: Sample) -> None:
        self.bench, self._sample = bench, sample
        rows, variables = sample.rows, bench.variables
        self._names = [*variables, "aircraft"]
        self._coded = {name: _coded(own.values[rows]) for name, own in variables.items()}
        self._views: dict[int, dict[str, tuple[Floats, Floats]]] = {}

    def covariance(self, key: Key, k: int) -> tuple[float, float]:
        """Covariance of prediction and error in the ``k``-th archive, and its standard error."""
        features = self._features(k)
        own, weight = self._error(key, k)
        told = np.zeros(own.size)
        for learn in (self._sample.second, ~self._sample.second):
            trees = _fitted(features[learn], own[learn], weight[learn])
            told[~learn] = trees.predict(features[~learn])
        return _by_day(weight * told * own, weight, self._sample.day)

    def telling(self, key: Key) -> tuple[tuple[str, float], ...]:
        """Permute every group of variables on the days left out."""
        features, names = self._features(0), self._names
        own, weight = self._error(key, 0)
        rng = np.random.default_rng(1)
        loss = dict.fromkeys(names[:-1], 0.0)
        for learn in (self._sample.second, ~self._sample.second):
            trees = _fitted(features[learn], own[learn], weight[learn])
            left, value = features[~learn], (weight * own)[~learn] / weight.sum()
            whole = float(value @ trees.predict(left))
            lost: dict[tuple[str, ...], float] = {}
            for name in loss:
                for other in (_group(name), (name,)):  # what both tell, and what it alone does
                    if other not in lost:
                        columns = [names.index(one) for one in other if one in names]
                        moved = left.copy()
                        moved[:, columns] = left[rng.permutation(left.shape[0])][:, columns]
                        lost[other] = whole - float(value @ trees.predict(moved))
                    loss[name] += 0.5 * lost[other]
        ranked = sorted(loss.items(), key=lambda item: -item[1])
        groups = list(dict.fromkeys(_group(name) for name, _ in ranked))[:MOST_GROUPS]
        least = TELLING * ranked[0][1]
        return tuple((n, x) for n, x in ranked if x >= least and _group(n) in groups)

    def _features(self, k: int) -> Floats:
        """Everything the reports of an archive record, aircraft last, (m, p)."""
        rows, own = self._sample.rows, self.bench.simulated[k - 1] if k else {}
        columns = [
            _coded(own[name][rows]) if name in own else self._coded[name]
            for name in self._names[:-1]
        ]
        return np.stack([*columns, self.bench.setting.frame.aircraft[rows]], -1)

    def _error(self, key: Key, k: int) -> tuple[Floats, Floats]:
        """Errors of one component and their weights in one view, (m,) each."""
        bench, rows = self.bench, self._sample.rows
        if k not in self._views:
            setting = bench.setting
            cleared = setting.ground.cleared(
                setting.quiet,
                bench.residuals[k : k + 1],
                plan=setting.plan,
                day=setting.day,
                rows=rows,
            )[0]
            self._views[k] = _views(setting, self._sample, cleared)
        error, weight = self._views[k][key[1]]
        direction = bench.direction(key[0], k)[rows]
        return np.clip(np.einsum("nc,nc->n", error, direction), -BOUND, BOUND), weight


def _group(name: str) -> tuple[str, ...]:
    """Variables that tell each other, of one of them."""
    return next((group for group in GROUPS if name in group), (name,))


def _coded(values: Floats) -> Floats:
    """Number of the quantile of every value: trees need no more, and cut weighted ones slowly."""
    known = np.isfinite(values)
    cuts = np.unique(np.quantile(values[known], np.arange(1, CELLS) / CELLS))
    return np.where(known, np.searchsorted(cuts, values, "right"), np.nan)


def _views(setting: Setting, sample: Sample, cleared: Floats) -> dict[str, tuple[Floats, Floats]]:
    """Errors (m, 2), of a sample's reports, and weights (m,) of each view."""
    rows, frame = sample.rows, setting.frame
    order = flight_order(frame.flight[rows], frame.time[rows])
    change, precision = interpolation_errors(cleared, order, take_gains(setting.noise.gains, rows))
    known = (precision > 0).astype(float)
    return {"level": (cleared, known), "change": (change, precision)}


def _fitted(features: Floats, values: Floats, weight: Floats) -> HistGradientBoostingRegressor:
    from sklearn.ensemble import HistGradientBoostingRegressor

    trees = HistGradientBoostingRegressor(
        **TREES, categorical_features=[features.shape[1] - 1], early_stopping=False, random_state=0
    )
    return trees.fit(features, values, sample_weight=weight)


def _by_day(values: Floats, weight: Floats, day: Integers) -> tuple[float, float]:
    """Weighted mean and its standard error between days."""
    each, mass = np.bincount(day, values), np.bincount(day, weight)
    mean = float(each.sum() / mass.sum())
    apart = each - mean * mass
    return mean, float(np.sqrt((apart**2).sum()) / mass.sum())
