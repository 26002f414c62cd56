"""Simple methods beside ours: least squares with BIC, a tree on slices, a two-sample classifier.

Assumptions
-----------
Each gets the same collocated reports as the diagnosis, the catalogue's design columns included, and
does what a careful person without a noise model would: reports are taken as independent.

* **Least squares**: forward selection over the catalogue (each effect per aircraft or for the
  fleet), a term enters while the Bayesian information criterion falls.
* **Tree** (scikit-learn): a regression tree on slices (aircraft, magnetic heading, height, phase,
  icing, date, hour, longitude, bank) of the heading error and of the airspeed error, grown on two
  thirds of the flights; claims a gap where it explains any of the rest (lower bound of three
  standard errors); what it splits on is read as an effect by the rules a person would use.
* **Classifier** (scikit-learn): logistic regression, on the innovation and its products with the
  context, real reports against simulated ones (the same context, innovations of other reports'
  size and random direction), split by flight; claims a gap where the held-out area under its curve
  exceeds one half by three standard errors; it names nothing.

Validity: a yardstick, not a method to use. Units: m/s, radians.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from airswing.blind_check.scores import BaselineScore
from airswing.blind_check.scoring import draws
from airswing.gap.archive.frame import Frame
from airswing.products.whole_files import write_json
from airswing.synthetic.sealed.labels import Label

if TYPE_CHECKING:
    from sklearn.tree import DecisionTreeRegressor

__all__ = ["classifier", "least_squares_bic", "run_baselines", "slice_tree"]

Array = NDArray[np.float64]
# Archives hold two effects and a background: what enters later is noise.
_MOST_TERMS = 6
_LEAF = 400
_DEPTH = 4


class Claim(TypedDict):
    """What a simple method says of an archive, most important name first."""

    names: list[str]
    detected: bool
    importance: NotRequired[dict[str, float]]  # of the tree's variables
    area: NotRequired[float]  # under the classifier's held-out curve


def collocated(config: Path, output: Path) -> Frame:
    """Return the frame the diagnosis works on.

    Parameters
    ----------
    config, output : Path
        Configuration and a folder for what is written on the way.
    """
    from airswing.config_file import load_config
    from airswing.workflow import Job
    from airswing.workflow.gap_stage import gap_headings
    from airswing.workflow.progress import Progress

    job = Job(load_config(config, output=output), Progress(quiet=True), False)
    members = job.config.pools()[job.config.gap_reference()]
    return Frame.from_headings(gap_headings(job), reference=members, phases=job.config.gap.phases)


def run_baselines(
    output: Path, labels: Sequence[Label], *, say: Callable[[str], None]
) -> dict[str, list[BaselineScore]]:
    """Run every baseline on every case and score the names it claims.

    Parameters
    ----------
    labels : sequence of Label
        Truth of the cases.
    say : callable
        Told what goes on.

    Returns
    -------
    dict
        Baseline to one score per case.
    """
    out: dict[str, list[BaselineScore]] = {name: [] for name in _BASELINES}
    for label in labels:
        target = output / "diagnosed" / label["name"]
        kept = target / "baselines.json"
        if kept.exists():
            found: dict[str, Claim] = json.loads(kept.read_text(encoding="utf-8"))
        else:
            frame = collocated(output / "cases" / label["name"] / "config.yaml", target)
            found = {name: method(frame, label["without"]) for name, method in _BASELINES.items()}
            write_json(kept, found)
            say(f"{label['name']} baselines done")
        truth = set(label["names"]) - set(label["without"])
        for name, claim in found.items():
            told = claim["names"]
            out[name].append(
                {
                    "name": label["name"],
                    "kind": label["kind"],
                    "rung": label["rung"],
                    "size": label["size"],
                    "claimed": told,
                    "detected": claim["detected"],
                    "first_right": bool(told) and told[0] in truth,
                    "false_names": [one for one in told if one not in truth],
                }
            )
    return out


def least_squares_bic(frame: Frame, without: Sequence[str] = ()) -> Claim:
    """Select effects by ordinary least squares and BIC.

    Returns
    -------
    dict
        ``names`` in the order they entered, ``detected``.
    """
    from airswing.gap.effects import CATALOGUE

    columns = {
        name: effect.columns(frame).transpose(0, 2, 1)
        for name, effect in CATALOGUE.items()
        if name not in without
        and effect.testable(frame) is None
        and effect.column_names
        and effect.kind in ("mean", "drift")
    }
    per_fleet = {n for n in columns if CATALOGUE[n].scope != "aircraft"}
    left = frame.residual.T.copy()
    left -= left.mean(axis=1, keepdims=True)
    size = 2 * frame.size
    names: list[str] = []
    while len(names) < _MOST_TERMS:
        total = float((left**2).sum())
        best, gain, fit = "", 0.0, np.zeros_like(left)
        for name, design in columns.items():
            if name in names:
                continue
            value, trial = _least_squares_gain(frame, left, design, name in per_fleet, total, size)
            if value > gain:
                best, gain, fit = name, value, trial
        if not best:
            break
        names.append(best)
        left = left - fit
    return {"names": names, "detected": bool(names)}


def _least_squares_gain(
    frame: Frame, left: Array, design: Array, fleet: bool, total: float, size: int
) -> tuple[float, Array]:
    """Return how far BIC falls when an effect enters, and its fitted part (2, n)."""
    fit = np.zeros_like(left)
    groups = [np.ones(frame.size, bool)]
    if not fleet:
        groups = [frame.aircraft == index for index in range(len(frame.tails))]
    gain = 0.0
    for rows in groups:
        x = design[:, :, rows].reshape(design.shape[0], -1)
        y = left[:, rows].ravel()
        keep = np.isfinite(x).all(axis=0)
        gram = x[:, keep] @ x[:, keep].T
        if not keep.any() or np.linalg.matrix_rank(gram) < len(gram):
            continue
        solution = np.linalg.solve(gram, x[:, keep] @ y[keep])
        part = np.where(keep, np.nan_to_num(x).T @ solution, 0.0)
        drop = float((y**2).sum() - ((y - part) ** 2).sum())
        fall = size * drop / total - len(gram) * np.log(size)
        if fall > 0:
            gain += fall
            fit[:, rows] = part.reshape(2, -1)
    return gain, fit


def _targets(frame: Frame) -> tuple[Array, Array]:
    """Return innovation across (right of) and along the heading, (n,) m/s each."""
    u, v = frame.residual.T
    sine, cosine = np.sin(frame.heading), np.cos(frame.heading)
    return u * cosine - v * sine, u * sine + v * cosine


def _features(frame: Frame) -> dict[str, Array]:
    """Return the slices a person would look at."""
    return {
        "heading": np.mod(np.degrees(frame.magnetic_heading), 360.0),
        "pressure": frame.pressure,
        "phase": frame.phase.astype(float),
        "icing": (frame.icing > 0).astype(float),
        "date": frame.time - frame.epoch,
        "hour": np.mod(frame.time / 3600.0, 24.0),
        "longitude": frame.longitude,
        "bank": np.nan_to_num(frame.bank),
    }


def _training(frame: Frame) -> NDArray[np.bool_]:
    """Return two thirds of the flights."""
    flights, which = np.unique(frame.flight, return_inverse=True)
    return np.asarray((np.random.default_rng(0).permutation(flights.size) % 3 > 0)[which])


def slice_tree(frame: Frame, without: Sequence[str] = ()) -> Claim:
    """Grow a regression tree on slices and read it.

    Parameters
    ----------
    without : sequence of str
        Names not to be used.

    Returns
    -------
    dict
        ``names``, ``detected``, ``importance`` by variable.
    """
    features, train = _features(frame), _training(frame)
    own = np.eye(len(frame.tails))[frame.aircraft]
    table = np.concatenate([own, np.stack(list(features.values()), axis=1)], axis=1)
    columns = ["aircraft"] * own.shape[1] + list(features)
    best: tuple[float, str, dict[str, float]] = (0.0, "", {})
    for component, target in zip(("across", "along"), _targets(frame), strict=True):
        tree = _grown(table[train], target[train])
        test = ~train
        saved = target[test] ** 2 - (target[test] - tree.predict(table[test])) ** 2
        flights = np.unique(frame.flight[test], return_inverse=True)[1]
        by_flight = np.bincount(flights, saved)
        error = float(by_flight.std() * np.sqrt(by_flight.size))
        # flights alike to the last digit (a tree that does not split) have no error to divide by
        ratio = float(by_flight.sum()) / max(error, 1e-9)
        if ratio > max(3.0, best[0]):
            importance: dict[str, float] = {}
            for name, weight in zip(columns, tree.feature_importances_, strict=True):
                importance[name] = importance.get(name, 0.0) + float(weight)
            best = ratio, component, importance
    if not best[1]:
        return {"names": [], "detected": False, "importance": {}}
    read = _read_tree(best[1], best[2])
    told = [read] if read is not None and read not in without else []
    return {"names": told, "detected": True, "importance": best[2]}


def _grown(x: Array, y: Array) -> DecisionTreeRegressor:
    """Return a regression tree whose every split is worth twelve times the noise."""
    from sklearn.tree import DecisionTreeRegressor

    # so shallow and with leaves so large that a person would read it
    tree = DecisionTreeRegressor(
        max_depth=_DEPTH,
        min_samples_leaf=_LEAF,
        min_impurity_decrease=12.0 * float(y.var()) / y.size,
    )
    return tree.fit(x, y)


def _read_tree(component: str, weights: Mapping[str, float]) -> str | None:
    """Return the effect a person reads from what a tree splits on most."""
    other = {name: value for name, value in weights.items() if name != "aircraft"}
    lead = "aircraft"
    if other and max(other.values()) > 0.5 * weights.get("aircraft", 0.0):
        lead = max(other, key=lambda name: other[name])
    for name, how in draws().items():
        if (component, lead) in how.read_from:
            return name
    return None


def classifier(frame: Frame, without: Sequence[str] = ()) -> Claim:
    """Tell real reports from simulated ones.

    Returns
    -------
    dict
        ``names`` (empty), ``detected``, ``area`` under the held-out curve.
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.metrics import roc_auc_score
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    # one signature for all of them; this one names no effect
    del without
    rng = np.random.default_rng(0)
    across, along = _targets(frame)
    length = rng.permutation(np.hypot(across, along))
    turn = rng.uniform(0, 2 * np.pi, frame.size)
    train = _training(frame)
    context = _context(frame)
    real, simulated = (
        _design(a, b, context)
        for a, b in ((across, along), (length * np.cos(turn), length * np.sin(turn)))
    )
    x = np.concatenate([real[train], simulated[train]])
    y = np.repeat([1.0, 0.0], train.sum())
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=200)).fit(x, y)
    test = ~train
    held = np.concatenate([real[test], simulated[test]])
    area = float(roc_auc_score(np.repeat([1.0, 0.0], test.sum()), model.decision_function(held)))
    flights = np.unique(frame.flight[test]).size
    # An area by chance scatters by sqrt((1 / m + 1 / n) / 12), m = n flights on either side.
    error = 0.29 * np.sqrt(2.0 / max(flights, 1))
    return {"names": [], "detected": bool(area > 0.5 + 3.0 * error), "area": area}


def _context(frame: Frame) -> Array:
    """Return standardised context, (n, c)."""
    m = frame.magnetic_heading
    own = np.eye(len(frame.tails))[frame.aircraft]
    shared = np.stack(
        [
            np.sin(m),
            np.cos(m),
            np.sin(2 * m),
            np.cos(2 * m),
            # nil in the middle of what turboprops fly through
            np.log(frame.pressure / 6e4),
            frame.phase == 1,
            frame.phase == 3,
            frame.icing > 0,
        ],
        axis=1,
    ).astype(float)
    return np.concatenate([own, shared], axis=1)


def _design(across: Array, along: Array, context: Array) -> Array:
    """Return innovation, its square and its products with the context."""
    scale = 3.0
    a, b = across[:, None] / scale, along[:, None] / scale
    return np.concatenate([np.ones_like(a), a, b, a**2, b**2, a * context, b * context], axis=1)


# Name to method.
_BASELINES: dict[str, Callable[[Frame, Sequence[str]], Claim]] = {
    "least squares with BIC": least_squares_bic,
    "regression tree on slices": slice_tree,
    "two-sample classifier": classifier,
}
