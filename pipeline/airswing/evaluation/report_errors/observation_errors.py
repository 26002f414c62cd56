"""The standard error of a wind component of the reports alone: ``observation_errors.nc``.

Assumes that the disagreement of a report with a reference holds both errors, independent of each
other, and takes the reference's off in two ways.

*Separation*: what neighbouring aircraft share belongs to the reference
(:mod:`airswing.evaluation.report_errors.separation`). One reference will do; different aircraft
must meet. An error all aircraft share, and motion finer than their distance, are not told apart.

*Three-cornered hat*: with two references the mean product of a report's two disagreements is the
report's error variance plus the covariance of the references' errors (Gray & Allan 1974). With that
covariance taken as zero, or as told, it is an upper bound wherever references err together, as
models that take in the same observations do. The covariance itself is measured: the hat's variance
less the separation's.

Both ways are taken with the corrected winds, whose errors are alike; the reported winds' variance
is larger by as much as their mean square disagreement, in which the reference's error is the same.
That takes the reference's error as independent of the correction. What the correction changed is
known; what is not is how it happens to go along with the reference's error, part of which lasts
(:mod:`airswing.evaluation.report_errors.reported_winds`).

Which is believed: the separation; the hat where no interval of the separation is known, and where
the measured covariance cannot be told from zero and the hat's interval is the narrower one.
Intervals (95 %) are a bootstrap over blocks of days, of the reported winds over aircraft as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.evaluation.error_profiles import LEVEL_EDGES_HPA, STATES
from airswing.evaluation.report_errors.disagreements import (
    Disagreements,
    aircraft_classes,
    disagreements,
    near_pairs,
)
from airswing.evaluation.report_errors.reported_winds import added_variance
from airswing.evaluation.report_errors.separation import FEWEST_DAYS, separate
from airswing.evaluation.report_errors.used_errors import USED, used_error
from airswing.evaluation.resampling import day_weights, interval, widened
from airswing.flags import PHASE

Floats = NDArray[np.float64]

METHODS = ("separation", "three_cornered_hat")
FLIGHT_PHASES = ("all", "ascent", "cruise", "descent")
# Either end of a 95 % interval then rests on ten draws.
DRAWS = 400
# Of a cell, below which the hat says nothing of it.
_FEWEST_REPORTS = 100
_LAYERS = len(LEVEL_EDGES_HPA) - 1
# Share of a layer's reports in cells that are known, below which the layer is not.
_TOLD_SHARE = 0.8


@dataclass(frozen=True)
class _Variances:
    """Error variances of one way of separating, the first as found, the others drawn again.

    `cells` is (draw, state, cell), NaN where not known; `fleet` (draw, state); `aircraft`
    (draw, state, aircraft) or None.
    """

    cells: Floats
    fleet: Floats
    aircraft: Floats | None = None

    def widened(self, days: int) -> _Variances:
        """With draws that allow for few days."""
        aircraft = None if self.aircraft is None else widened(self.aircraft, days)
        return _Variances(widened(self.cells, days), widened(self.fleet, days), aircraft)


def observation_errors(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    covariance: float = 0.0,
    seed: int = 0,
) -> xr.Dataset:
    """Find the standard error of the reports by phase of flight, layer and state.

    Parameters
    ----------
    headings : Dataset
        Screened headings.
    corrected : Dataset
        Corrected winds of the same reports.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Reference or pool neighbours are held against.
    covariance : float, default 0
        Covariance of the references' errors the hat takes off, m2/s2.
    seed : int, default 0
        Of the bootstrap.

    Returns
    -------
    Dataset
        ``observation_error`` (flight_phase, layer, state), m/s, by the way that is believed, with
        ``observation_error_interval``; ``*_by_method``; ``fleet_*`` over all reports;
        ``aircraft_observation_error``; ``weight_gain``; the figures others use; and, in the
        attributes, ``believed`` and ``believed_because``.
    """
    members = [name for name, inside in pools.items() if len(inside) == 1]
    found = disagreements(headings, corrected, members, list(pools[reference]))
    days = found.days.size
    weights = np.ones((1, days))
    if days >= FEWEST_DAYS:
        weights = np.vstack([weights, day_weights(days, draws=DRAWS, seed=seed)])
    number = np.maximum(weights @ found.number.T, 0.0)
    classes = aircraft_classes(found)
    added = added_variance(found, weights, seed=seed)
    ways = {
        "separation": _separation(found, classes, number, weights, added),
        "three_cornered_hat": _hat(found, number, weights, added, covariance),
    }
    ways = {name: way and way.widened(days) for name, way in ways.items()}
    believed, because = _believed(ways, len(members))
    ds = _labelled(ways, believed, number, found)
    names = [str(name) for name in headings["aircraft"].to_numpy()]
    ds = ds.assign_coords(aircraft=names)
    ds.attrs |= {
        "believed": believed,
        "believed_because": because,
        "reference": reference,
        "hat_references": _hat_names(found, members),
        "told_covariance": covariance,
        "days": days,
    }
    return ds


def _of_states(cells: Floats, fleet: Floats, added: Floats) -> tuple[Floats, Floats]:
    """Variances of both states by cell and of the fleet, from those of corrected winds."""
    return (
        np.stack([cells + added[:, 1:], cells], axis=1),
        np.stack([fleet + added[:, 0], fleet], axis=1),
    )


def _separation(
    found: Disagreements,
    classes: NDArray[np.int64],
    number: Floats,
    weights: Floats,
    added: Floats,
) -> _Variances | None:
    """Variances from neighbours; None where too few meet."""
    if found.number.sum() == 0:
        return None
    by_class = np.zeros((found.number.shape[0], int(classes.max()) + 1))
    np.add.at(by_class.T, classes, found.aircraft_number)
    amplitude = np.nan_to_num(_ratio(found.squares.sum(axis=1), found.number.sum(axis=1)))
    told = separate(near_pairs(found, classes), by_class, amplitude, weights)
    if told is None:
        return None
    fleet = _ratio((told.by_cell * number).sum(-1), number.sum(-1))
    cells, both = _of_states(np.where(told.resolved, told.by_cell, np.nan), fleet, added)
    own = _ratio(found.aircraft_squares @ weights.T, found.aircraft_day_number @ weights.T)
    moved = np.nan_to_num((own - own[-1:]).transpose(2, 0, 1), nan=0.0)
    aircraft = told.by_class[:, classes][:, None] + moved
    aircraft[..., found.aircraft_number.sum(axis=1) == 0] = np.nan
    return _Variances(cells, both, aircraft)


def _hat(
    found: Disagreements, number: Floats, weights: Floats, added: Floats, covariance: float
) -> _Variances | None:
    """Variances from the two references whose errors covary least; None with only one."""
    row = _hat_row(found)
    if row is None:
        return None
    total = weights @ found.products[row].T
    cells = _ratio(total, number) - covariance
    cells[:, found.number.sum(axis=1) < _FEWEST_REPORTS] = np.nan
    fleet = _ratio(total.sum(-1), number.sum(-1)) - covariance
    return _Variances(*_of_states(cells, fleet, added))


def _hat_row(found: Disagreements) -> int | None:
    """Pair of different references with the least mean product of disagreements."""
    size = found.products.shape[0]
    pairs = _combinations(size)
    sums = [
        (float(found.products[row].sum()), row)
        for row, (one, two) in enumerate(pairs)
        if one != two
    ]
    return min(sums)[1] if sums and found.number.sum() > 0 else None


def _combinations(size: int) -> list[tuple[int, int]]:
    members = round((np.sqrt(8 * size + 1) - 1) / 2)
    return list(combinations_with_replacement(range(members), 2))


def _hat_names(found: Disagreements, members: list[str]) -> str:
    row = _hat_row(found)
    if row is None:
        return ""
    return " ".join(members[place] for place in _combinations(found.products.shape[0])[row])


def _ratio(total: Floats, number: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(number > 0, total / number, np.nan))


def _believed(ways: Mapping[str, _Variances | None], members: int) -> tuple[str, str]:
    """Which way is believed, and why."""
    apart, hat = (ways[name] for name in METHODS)
    if apart is None and hat is None:
        return "", (
            "too few neighbouring aircraft or days to separate the errors, and one reference alone"
        )
    if apart is None:
        return "three_cornered_hat", (
            "too few aircraft meet; an upper bound where the references err together"
        )
    if hat is None or apart.fleet.shape[0] == 1:
        why = "one reference alone" if members < 2 else "the references' covariance is not known"
        return "separation", why
    shared = (hat.fleet - apart.fleet)[:, -1]
    low, high = interval(shared[1:])
    widths = [np.ptp(interval(way.fleet[1:, -1])) for way in (apart, hat)]
    measured = (
        f"covariance of the references' errors {shared[0]:.2f} ({low:.2f} to {high:.2f}) m2/s2"
    )
    if low <= 0.0 <= high and widths[1] < widths[0]:
        return "three_cornered_hat", f"{measured}: not to be told from zero"
    return "separation", f"{measured}: the hat counts it as the reports'"


def _labelled(
    ways: Mapping[str, _Variances | None], believed: str, number: Floats, found: Disagreements
) -> xr.Dataset:
    """Standard errors with intervals, on their dimensions."""
    draws = number.shape[0]
    states, cells = len(STATES), found.number.shape[0]
    none = _Variances(np.full((draws, states, cells), np.nan), np.full((draws, states), np.nan))
    tables = {name: _table(way or none, number) for name, way in ways.items()}
    fleets = {name: (way or none).fleet for name, way in ways.items()}
    cell_dims = ("flight_phase", "layer", "state")
    data: dict[str, object] = {}
    chosen = tables.get(believed, tables["separation"])
    fleet = fleets.get(believed, fleets["separation"])
    _put(data, "observation_error", cell_dims, _root(chosen))
    _put(data, "fleet_observation_error", ("state",), _root(fleet))
    _put(
        data,
        "observation_error_by_method",
        ("way", *cell_dims),
        np.stack([_root(tables[name]) for name in METHODS], axis=1),
    )
    _put(
        data,
        "fleet_observation_error_by_method",
        ("way", "state"),
        np.stack([_root(fleets[name]) for name in METHODS], axis=1),
    )
    _put(data, "weight_gain", cell_dims[:2], _gain(chosen))
    _put(data, "fleet_weight_gain", (), _gain(fleet))
    shared = (fleets["three_cornered_hat"] - fleets["separation"])[:, -1]
    _put(data, "reference_error_covariance", (), shared)
    own = ways["separation"].aircraft if ways["separation"] else None
    size = found.aircraft_number.shape[0]
    own = np.full((draws, states, size), np.nan) if own is None else own
    _put(data, "aircraft_observation_error", ("aircraft", "state"), _root(own.swapaxes(1, 2)))
    data["observation_error_filled"] = (cell_dims, _filled(_root(chosen[:1])[0], _root(fleet)[0]))
    return xr.Dataset(
        data | _beside(found),
        coords={
            "flight_phase": list(FLIGHT_PHASES),
            "state": list(STATES),
            "way": list(METHODS),
            "bound": ["low", "high"],
        },
    )


def _put(data: dict[str, object], name: str, dims: tuple[str, ...], drawn: Floats) -> None:
    """A value and its interval, from what was found and drawn again."""
    data[name] = (dims, drawn[0])
    bounds = np.full((2, *drawn.shape[1:]), np.nan)
    if drawn.shape[0] > 1:
        told = np.isfinite(drawn[0])
        bounds = np.where(told, interval(np.nan_to_num(drawn[1:], nan=0.0)), np.nan)
    data[f"{name}_interval"] = ((*dims, "bound"), np.moveaxis(bounds, 0, -1))


def _root(variance: Floats) -> Floats:
    """Standard error; 0 where a variance came out below none."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _gain(variance: Floats) -> Floats:
    """How many reported winds a corrected one weighs as: the ratio of variances."""
    before, after = variance[..., 0], variance[..., -1]
    return _ratio(np.maximum(before, 0.0), np.maximum(after, 0.0))


def _table(way: _Variances, number: Floats) -> Floats:
    """Variances by phase and layer, the first row all phases: (draw, phase, layer, state)."""
    shape = (number.shape[0], len(PHASE), _LAYERS)
    cells = np.moveaxis(way.cells, 1, 2).reshape(*shape, -1)
    weight = number.reshape(shape)[..., None] * np.isfinite(cells)
    whole = _ratio((np.nan_to_num(cells) * weight).sum(axis=1), weight.sum(axis=1))
    total = number.reshape(shape).sum(axis=1)[..., None]
    whole = np.where(weight.sum(axis=1) >= _TOLD_SHARE * total, whole, np.nan)
    own = [cells[:, PHASE[name]] for name in FLIGHT_PHASES[1:]]
    return np.stack([whole, *own], axis=1)


def _filled(table: Floats, fleet: Floats) -> Floats:
    """Errors of every cell: its own, else its layer's, else the fleet's."""
    layer = np.where(np.isfinite(table[:1]), table[:1], fleet)
    return np.where(np.isfinite(table), table, layer)


def _beside(found: Disagreements) -> dict[str, object]:
    """Counts, disagreement, median speed, and what others use."""
    edges = np.array(LEVEL_EDGES_HPA) * 100.0
    middle = 0.5 * (edges[:-1] + edges[1:])
    shape = (len(PHASE), _LAYERS)
    number = found.number.sum(axis=1).reshape(shape)
    after = found.squares.sum(axis=1)
    before = after + found.change_squares + found.crossed.sum(axis=1)
    square = np.stack([before, after], axis=-1).reshape(*shape, len(STATES))
    rows = [slice(None), *(slice(PHASE[name], PHASE[name] + 1) for name in FLIGHT_PHASES[1:])]
    counted = np.stack([number[row].sum(axis=0) for row in rows])
    squares = np.stack([square[row].sum(axis=0) for row in rows])
    speeds = found.speeds.reshape(*shape, -1).sum(axis=0).cumsum(axis=-1)
    median = (speeds < 0.5 * speeds[:, -1:]).sum(axis=-1) + 0.5
    return {
        "observation_count": (("flight_phase", "layer"), counted.astype(np.int64)),
        "disagreement_rms": (
            ("flight_phase", "layer", "state"),
            np.sqrt(_ratio(squares, counted[..., None])),
        ),
        "median_wind_speed": ("layer", np.where(speeds[:, -1] > 0, median, np.nan)),
        "layer_bottom_pressure": ("layer", edges[:-1]),
        "layer_top_pressure": ("layer", edges[1:]),
        **{f"{name}_error": ("layer", used_error(name, middle)) for name in USED},
    }
