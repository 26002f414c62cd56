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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.value_tables import COMPONENTS
from airswing.gap.noise.beside_neighbours import interpolation_errors
from airswing.gap.noise.whitening import flight_order, take_gains
from airswing.gap.witness.bench import Bench, Setting
from airswing.gap.witness.ground import prepare

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Reports learned from and judged, about.
SAMPLE = 40_000
#: Quantiles of a variable between which trees may cut.
CELLS = 100
#: Of the trees.
TREES = {"max_iter": 40, "max_leaf_nodes": 15, "learning_rate": 0.15, "min_samples_leaf": 80}
#: Error as it is, and less what the flight's other reports foretell.
VIEWS = ("level", "change")
#: Covariance beyond the simulated archives' that counts, (m/s)^2, by view: on archives with no
#: effect whose model errs otherwise than the noise model supposes it comes to a half of it.
LEAST = {"level": 0.1, "change": 0.012}
#: The same in standard errors.
SIGNIFICANT = 4.0
#: Bound on single errors, m/s.
BOUND = 7.0
#: Variables that tell each other: permuted together.
GROUPS = (("magnetic_heading", "track"), ("altitude", "temperature"), ("wind_speed", "airspeed"))
#: A group of variables tells where permuting it costs this share of the most telling one's loss.
TELLING = 0.15
#: Groups whose pairs are offered as tables, and pairs at most.
MOST_GROUPS, MOST_PAIRS = 3, 5
#: Simulated archives the trees learn.
ARCHIVES = 3


@dataclass(frozen=True)
class Explained:
    """What the trees explain of one component in one view.

    Attributes
    ----------
    component, view : str
    covariance : float
        Of prediction and error on days left out, (m/s)^2.
    simulated : float
        Mean of the same over simulated archives.
    error : float
        Standard error of the difference: between days, and between simulated archives.
    """

    component: str
    view: str
    covariance: float
    simulated: float
    error: float

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
    """What the learned witness says of an archive.

    Attributes
    ----------
    explained : tuple of Explained
        Strongest first.
    telling : tuple of (str, float)
        Variables of the strongest and what permuting each costs, (m/s)^2; none where nothing is
        claimed.
    """

    explained: tuple[Explained, ...]
    telling: tuple[tuple[str, float], ...]

    @property
    def raised(self) -> bool:
        """Whether something shows that simulated archives do not have."""
        return self.explained[0].strength >= 1.0

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
    """Whole flights of an archive that the trees see.

    Attributes
    ----------
    rows : (m,) int
    day : (m,) int
    second : (m,) bool
        Whether a report is of the second half of the days, drawn.
    """

    rows: Integers
    day: Integers
    second: NDArray[np.bool_]

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


class LearnedWitness:
    """Trees on a bench; remembers what simulated archives gave."""

    def __init__(self) -> None:
        self._simulated: dict[tuple[str, str], list[float]] = {}

    def hear(self, bench: Bench) -> Heard:
        """Let the trees learn an archive and say what they explain.

        Parameters
        ----------
        bench : Bench
            The real residual and those of simulated archives.

        Returns
        -------
        Heard
        """
        setting = bench.setting
        sample = Sample.of(setting)
        count = min(ARCHIVES, len(bench.simulated)) if not self._simulated else 0
        made = _cleared(bench, count)
        for k in range(1, 1 + count):
            for key, value in self._covariances(bench, sample, made[k], k).items():
                self._simulated.setdefault(key, []).append(value[0])
        real = self._covariances(bench, sample, made[0], 0)
        explained = []
        for (component, view), (covariance, error) in real.items():
            alike = np.array(self._simulated[component, view])
            between = max(float(alike.std(ddof=1)), 0.15 * abs(float(alike.mean())))
            between *= np.sqrt(1 + 1 / alike.size)
            explained.append(
                Explained(
                    component,
                    view,
                    covariance,
                    float(alike.mean()),
                    float(np.hypot(error, between)),
                )
            )
        explained.sort(key=lambda e: -e.strength)
        telling: tuple[tuple[str, float], ...] = ()
        if explained[0].strength >= 1.0:
            telling = self._telling(bench, sample, made[0], explained[0])
        return Heard(tuple(explained), telling)

    def _covariances(
        self, bench: Bench, sample: Sample, cleared: Floats, k: int
    ) -> dict[tuple[str, str], tuple[float, float]]:
        """Covariance and its standard error of every component and view of an archive."""
        features, _ = _features(bench, sample.rows, k)
        views = _views(bench.setting, sample, cleared)
        out = {}
        for component in COMPONENTS:
            direction = bench.direction(component, k)[sample.rows]
            for view, (error, weight) in views.items():
                own = np.clip(np.einsum("nc,nc->n", error, direction), -BOUND, BOUND)
                told = np.zeros(own.size)
                for learn in (sample.second, ~sample.second):
                    trees = _fitted(features[learn], own[learn], weight[learn])
                    told[~learn] = trees.predict(features[~learn])
                out[component, view] = _by_day(weight * told * own, weight, sample.day)
        return out

    def _telling(
        self, bench: Bench, sample: Sample, cleared: Floats, strongest: Explained
    ) -> tuple[tuple[str, float], ...]:
        """Permute every group of variables on the days left out."""
        features, names = _features(bench, sample.rows, 0)
        error, weight = _views(bench.setting, sample, cleared)[strongest.view]
        direction = bench.direction(strongest.component, 0)[sample.rows]
        own = np.clip(np.einsum("nc,nc->n", error, direction), -BOUND, BOUND)
        rng = np.random.default_rng(1)
        loss: dict[str, float] = {}
        for learn in (sample.second, ~sample.second):
            trees = _fitted(features[learn], own[learn], weight[learn])
            left, value, scale = features[~learn], own[~learn], weight[~learn]
            whole = float((scale * value * trees.predict(left)).sum() / weight.sum())
            for name in names:
                if name == "aircraft":
                    continue
                for other in (_group(name), (name,)):  # what both tell, and what it alone does
                    columns = [names.index(one) for one in other if one in names]
                    moved = left.copy()
                    moved[:, columns] = left[rng.permutation(left.shape[0])][:, columns]
                    part = float((scale * value * trees.predict(moved)).sum() / weight.sum())
                    loss[name] = loss.get(name, 0.0) + 0.5 * (whole - part)
        ranked = sorted(loss.items(), key=lambda item: -item[1])
        groups = list(dict.fromkeys(_group(name) for name, _ in ranked))[:MOST_GROUPS]
        least = TELLING * ranked[0][1]
        return tuple((n, x) for n, x in ranked if x >= least and _group(n) in groups)


def _group(name: str) -> tuple[str, ...]:
    """Variables that tell each other, of one of them."""
    return next((group for group in GROUPS if name in group), (name,))


def _cleared(bench: Bench, count: int) -> Floats:
    """Real and the first simulated residuals without days and climatology, (1 + count, n, 2)."""
    setting = bench.setting
    residuals = bench.residuals[: 1 + count]
    ground = prepare(
        setting.quiet,
        residuals,
        noise=setting.noise,
        plan=setting.plan,
        variances=setting.variances,
        day=setting.day,
    )
    return ground.cleared(setting.quiet, residuals, plan=setting.plan, day=setting.day)


def _features(bench: Bench, rows: Integers, k: int) -> tuple[Any, list[str]]:
    """Everything the reports of an archive record, aircraft last, (m, p)."""
    own = bench.simulated[k - 1] if k else {}
    names = list(bench.variables)
    columns = [own[name] if name in own else bench.variables[name].values for name in names]
    columns.append(bench.setting.frame.aircraft.astype(float))
    made = [_coded(c[rows]) for c in columns[:-1]] + [columns[-1][rows]]
    return np.stack(made, -1).astype(np.float32), [*names, "aircraft"]


def _coded(values: Floats) -> Floats:
    """Number of the quantile of every value: trees need no more, and cut weighted ones slowly."""
    known = np.isfinite(values)
    cuts = np.unique(np.quantile(values[known], np.arange(1, CELLS) / CELLS))
    return np.where(known, np.searchsorted(cuts, values, "right"), np.nan)


def _views(setting: Setting, sample: Sample, cleared: Floats) -> dict[str, tuple[Floats, Floats]]:
    """Errors (m, 2) and weights (m,) of each view."""
    rows, frame = sample.rows, setting.frame
    order = flight_order(frame.flight[rows], frame.time[rows])
    change, precision = interpolation_errors(
        cleared[rows], order, take_gains(setting.noise.gains, rows)
    )
    known = (precision > 0).astype(float)
    return {"level": (cleared[rows], known), "change": (change, precision)}


def _fitted(features: Any, values: Floats, weight: Floats) -> Any:
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
