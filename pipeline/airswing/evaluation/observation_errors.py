"""The standard error of a wind component of the reports alone: ``observation_errors.nc``.

*Separation.* Two neighbouring aircraft share the error of the reference and the weather. Half the
mean squared difference of their differences from the reference, extrapolated to zero separation, is
the error variance of the reports (the intercept of Hollingsworth & Loennberg 1986, Tellus 38A,
111-136, as a variogram). The expected half square of a pair is the mean of both reports' error
variances (of the cell, phase of flight and layer, plus that of the aircraft's class) plus the
difference of the reference's errors at that separation, proportional to the disagreement of both
cells; this linear model is fitted by weighted least squares for each bootstrap draw of days. Errors
of different aircraft are taken as independent; motion on scales below their distance counts as
error of the reports.

*Three-cornered hat.* With two references the mean product of a report's two disagreements is the
report's error variance plus the covariance of the references' errors (Gray & Allan 1974). With that
covariance assumed (0 by default) it is an upper bound wherever these errors are correlated, as
those of models that assimilate the same observations are. The covariance is estimated too: the
hat's variance less that of the separation.

*Reported winds.* Both methods use the corrected winds. The error variance of the reported winds
exceeds theirs by the mean square of the correction c (reported minus corrected), which is known
exactly, plus twice the mean of c d, d being the corrected wind's disagreement. The mean of c d
contains the covariance of c with the reference's error, which is the error of the estimate. Neither
days nor aircraft are independent, and its variance is that of both clusters less that of their
intersection (Cameron, Gelbach & Miller 2011, J. Bus. Econ. Stat. 29, 238-249).

The preferred method is the separation; it is the hat where no interval of the separation is known,
or where the covariance is not significant and the interval of the hat is the narrower one.
Intervals (95 %) are a bootstrap over blocks of days and, for the reported winds, over aircraft. A
report counts where it has a reported wind, a corrected one and every reference; archives too large
to pair are thinned to evenly spread whole days. m/s, m2/s2, degrees, Pa, seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from airswing.compass.fit.kernel import group_sums
from airswing.evaluation.innovations import (
    CELLS,
    LAYER_PRESSURES,
    LEVEL_EDGES_HPA,
    STATES,
    Floats,
    Ints,
    chunks,
    profile_cells,
    require_reference,
)
from airswing.evaluation.resampling import day_weights, interval, ratio, widened
from airswing.flags import FREE_OF_DEVIATION, PHASE
from airswing.units import MODEL_EARTH_RADIUS

METHODS = ("separation", "three_cornered_hat")
FLIGHT_PHASES = ("all", "ascent", "cruise", "descent")
DRAWS = 400  # ten draws lie beyond either end of a 95 % interval
FEWEST_REPORTS = 100  # fewest of a cell for a value of the hat
KNOWN_SHARE = 0.8
"""Share of a layer's reports in cells with a value, below which the layer has none."""
MOST_REPORTS, MOST_PAIRS, MOST_CLASSES = 1_000_000, 800_000, 40
"""Most that are used, so that years take no more memory than months."""
USED = {
    # pressures, hPa, and errors of a component, m/s; WRFDA: var/obsproc/obserr.txt of WRF 4.7.1
    "wrfda_tamdar": (
        (150, 200, 350, 400, 450, 500, 600, 650, 750, 800, 850, 900),
        (3.6, 3.2, 3.2, 3.0, 3.0, 2.9, 2.9, 2.7, 2.7, 2.5, 2.5, 2.3),
    ),
    "wrfda_airep": ((500,), (3.6,)),
    # NAM: the error table of the regional system of NCEP
    "nam_tamdar": ((300, 400, 500, 700, 850, 1000), (5.30, 5.12, 4.93, 4.80, 4.33, 3.75)),
    "nam_mdcrs": ((300, 400, 500, 700, 850, 1000), (3.41, 2.87, 2.62, 2.73, 2.79, 2.39)),
}
"""Wind errors that assimilation systems use for aircraft, constant beyond the ends."""
_SPEED_BINS = 100  # of 1 m/s, for the median speed of a layer
_LAYERS = len(LEVEL_EDGES_HPA) - 1
_NAMES = ("latitude", "longitude", "pressure", "phase", "screening")
_KEY = ["aircraft", "day", "cell"]
_SUMMED = ("number", "reported", "corrected", "change", "crossed")
_PAIRED = ("latitude", "longitude", "pressure", "time", "aircraft", "cell", "day", "east", "north")
REACH = (30_000.0, 0.06, 1350.0)  # separation beyond which a pair is no longer near: m, ln p, s
FEWEST_PAIRS, FEWEST_OF_CELL, FEWEST_DAYS = 400, 150, 8
"""Below these the parts of the error cannot be separated."""
_MOST_AT_ONCE = 20_000  # reports of a day; more are thinned at random
_TERMS = 4  # terms of the reference's error as a function of separation
_BINS = 8  # classes of separation, each with one variance of half squares


@dataclass(frozen=True)
class PairTable:
    """All near pairs of an archive."""

    day: Ints  # (pair,): from 0, in order of time
    cells: Ints  # (pair, 2): of both reports
    classes: Ints  # (pair, 2)
    separation: Floats  # (pair, 3)
    squares: Floats  # (pair,): half squares


def neighbouring_pairs(
    latitude: Floats, longitude: Floats, pressure: Floats, time: Floats, aircraft: Ints
) -> tuple[Ints, Floats]:
    """Find the pairs of reports of different aircraft that are near; degrees, Pa, s.

    Returns the places of both reports (pair, 2) and their separation (pair, 3): distance,
    difference of ln p and of time, in units of :data:`REACH`.
    """
    drawn = np.random.default_rng(latitude.size).permutation(latitude.size)
    sample = np.sort(drawn[:_MOST_AT_ONCE])
    phi, lam = np.radians(latitude[sample]), np.radians(longitude[sample])
    place = np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)], axis=1)
    place *= MODEL_EARTH_RADIUS / REACH[0]
    points = np.column_stack([place, np.log(pressure[sample]) / REACH[1], time[sample] / REACH[2]])
    pairs = cKDTree(points).query_pairs(1.0, output_type="ndarray").astype(np.int64)
    pairs = pairs[np.diff(aircraft[sample][pairs], axis=1)[:, 0] != 0]
    gaps = np.abs(np.diff(points[pairs], axis=1)[:, 0])
    distance = np.sqrt((gaps[:, :3] ** 2).sum(axis=1))
    return sample[pairs], np.column_stack([distance, gaps[:, 3:]])


def half_squares(east: Floats, north: Floats, pairs: Ints) -> Floats:
    """Half the squared difference of two neighbours (pair,), the mean of both components, m2/s2.

    ``east`` and ``north`` are report minus reference, (report,), m/s; ``pairs`` (pair, 2) places.
    """
    squares = np.diff(east[pairs], axis=1) ** 2 + np.diff(north[pairs], axis=1) ** 2
    # half for two components, half for two reports: the error variance of one
    return np.asarray(0.25 * squares[:, 0], dtype=np.float64)


def separate(
    table: PairTable, number: Floats, amplitude: Floats, weights: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]] | None:
    """Separate the reports' error variance from the reference's; None with too few pairs or days.

    ``number`` (cell, class) of reports weights cells and classes; the reference's part is
    proportional to ``amplitude`` (cell,), the mean square disagreement; ``weights`` (1 + draw, day)
    are the weights of each day, the first row being ones. Returns the error variances by cell (1 +
    draw, cell), where cells with too few pairs have one value in common, and by class (1 + draw,
    class), and whether each cell has enough pairs.
    """
    if table.day.size < FEWEST_PAIRS or np.unique(table.day).size < FEWEST_DAYS:
        return None
    # each pair counts in the cells of both its reports
    resolved = np.bincount(table.cells.ravel(), minlength=len(number)) >= 2 * FEWEST_OF_CELL
    column = np.where(resolved, np.cumsum(resolved) - 1, int(resolved.sum()))
    cells, classes = int(column.max()) + 1, number.shape[1]
    design = np.zeros((table.day.size, cells + classes + _TERMS))
    row = np.arange(table.day.size)
    for end in (0, 1):
        np.add.at(design, (row, column[table.cells[:, end]]), 0.5)
        np.add.at(design, (row, cells + table.classes[:, end]), 0.5)
    # A correlation that is smooth at zero separation decreases as a square there, and more slowly
    # further out: the squares of the three components, and the fourth power of their length.
    scale = np.sqrt(amplitude[table.cells]).prod(axis=1)
    scale /= max(float(scale.mean()), 1e-12)  # the terms are in the units of the half squares
    squared = table.separation**2
    terms = np.column_stack([squared, squared.sum(axis=1) ** 2])
    design[:, cells + classes :] = terms * scale[:, None]
    drawn = _solve_draws(design, table, weights, cells + classes)
    of_cell = number / np.maximum(number.sum(axis=1, keepdims=True), 1.0)
    of_class = number / np.maximum(number.sum(axis=0, keepdims=True), 1.0)
    cell_part, class_part = drawn[:, column], drawn[:, cells : cells + classes]
    by_class = cell_part @ of_class + class_part
    return cell_part + class_part @ of_cell.T, by_class, resolved


def _solve_draws(design: Floats, table: PairTable, weights: Floats, variances: int) -> Floats:
    # the variance of a half square is the square of its mean, here by separation
    distance = np.sqrt((table.separation**2).sum(axis=1))
    place = np.minimum((distance * _BINS).astype(np.int64), _BINS - 1)
    count = np.maximum(np.bincount(place, minlength=_BINS), 1)
    mean = np.bincount(place, weights=table.squares, minlength=_BINS) / count
    precision = 1.0 / np.maximum(mean[place], 1e-12) ** 2
    matrix = np.zeros((weights.shape[1], design.shape[1], design.shape[1]))
    right = np.zeros(matrix.shape[:2])
    order = np.argsort(table.day, kind="stable")
    ends = np.searchsorted(table.day[order], np.arange(1, weights.shape[1]))
    for day, rows in enumerate(np.split(order, ends)):
        weighted = design[rows] * precision[rows, None]
        matrix[day], right[day] = weighted.T @ design[rows], weighted.T @ table.squares[rows]
    matrix, right = np.tensordot(weights, matrix, axes=1), weights @ right
    diagonal = np.einsum("dii->di", matrix)
    # a cell without a pair in the days drawn has no row and must stay solvable
    ridge = 1e-9 * diagonal + 1e-30
    # cells and classes both contain the mean; this assigns it to the classes
    ridge[:, :variances] += 1e-4 * diagonal[:, :variances].mean(axis=1, keepdims=True)
    regularized = matrix + ridge[..., None] * np.eye(matrix.shape[-1])
    return np.asarray(np.linalg.solve(regularized, right[..., None])[..., 0])


def added_variance(
    key: Ints,
    number: Floats,
    change: Floats,
    crossed: Floats,
    weights: Floats,
    *,
    cells: int,
    seed: int,
) -> Floats:
    """Error variance of the reported winds less that of the corrected winds, (1 + draw, 1 + cell).

    The estimate, then draws of days (by ``weights``) and aircraft; of all reports, then of each
    cell; NaN without reports. ``key`` (3, group) are aircraft, day and cell of groups of reports;
    of each group ``number`` of reports, summed c squared (mean of both components) and summed
    products c d (of both components).
    """
    aircraft, day, cell = key
    days, craft = weights.shape[1], int(aircraft.max(initial=0)) + 1

    def by(index: Ints, size: int, values: Floats) -> Floats:
        table = np.bincount(cell * size + index, values, cells * size).reshape(cells, size)
        return np.vstack([table.sum(axis=0), table])

    flown = by(aircraft, craft, number)
    total = flown.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = by(day, days, crossed).sum(axis=1) / total
        mean_square = by(day, days, change).sum(axis=1) / total
        by_day, by_aircraft = (
            (by(index, size, crossed) - mean[:, None] * by(index, size, number)) / total[:, None]
            for index, size in ((day, days), (aircraft, craft))
        )
        together = np.bincount(aircraft * days + day, crossed - mean[0] * number)
        by_cell = np.bincount(cell, (crossed - mean[1:][cell] * number) ** 2, cells)
        intersection = np.append((together**2).sum(), by_cell) / total**2
    members = (flown > 0).sum(axis=1)
    by_aircraft *= np.sqrt(members / np.maximum(members - 1.0, 1.0))[:, None]
    drawn = np.random.default_rng([seed, 1]).normal(size=(len(weights), craft))
    drawn[0] = 0.0
    of_days, of_aircraft = (weights - 1.0) @ by_day.T, drawn @ by_aircraft.T
    share: Floats | float = 1.0
    if len(weights) > 1:
        # the intersection is counted once
        variances = of_days[1:].var(axis=0), (by_aircraft**2).sum(axis=1)
        summed = variances[0] + variances[1]
        once = np.maximum(summed - intersection, np.maximum(*variances))
        share = np.sqrt(np.divide(once, summed, out=np.ones_like(summed), where=summed > 0.0))
    return np.asarray(mean_square + mean + share * (of_days + of_aircraft))


@dataclass(frozen=True)
class Disagreements:
    """Disagreement of an archive."""

    days: NDArray[np.datetime64]  # (day,)
    number: int  # of aircraft
    # by aircraft, day and cell: ``number`` of reports; summed squares, ``reported`` and
    # ``corrected`` of the disagreement, ``change`` of the correction c, all three means of both
    # components; ``crossed``: summed products of c and the corrected disagreement, both components;
    # and of the disagreements with two references, by their places
    sums: pd.DataFrame
    speeds: Floats  # (layer, speed class): reports
    # the reports that are paired, of whole days; ``east`` and ``north``: disagreement of the
    # corrected wind
    reports: pd.DataFrame

    def by(self, first: str, second: str, name: Any) -> Floats:
        """A sum by two of ``aircraft``, ``day`` and ``cell``."""
        sizes = {"aircraft": self.number, "day": self.days.size, "cell": CELLS}
        shape = sizes[first], sizes[second]
        places = (self.sums.index.get_level_values(level) for level in (first, second))
        flat = np.ravel_multi_index([*places], shape)
        total = np.bincount(flat, self.sums[name], shape[0] * shape[1])
        return np.asarray(total, dtype=np.float64).reshape(shape)

    @cached_property
    def reports_by_day(self) -> Floats:
        """Number of reports, (cell, day)."""
        return self.by("cell", "day", "number")


def disagreements(
    headings: xr.Dataset, corrected: xr.Dataset, members: list[str], pool: list[str]
) -> Disagreements:
    """Sum the disagreements of an archive, some whole aircraft at a time.

    ``members`` are compared with each other; the pairs with the mean of ``pool``.
    """
    time = headings["time"].to_numpy()
    days = np.unique(time[~np.isnat(time)].astype("datetime64[D]"))
    stride = -(-headings.sizes["report"] // MOST_REPORTS)
    stride += stride > 1 and stride % 7 == 0  # otherwise one day of the week would represent all
    sums, paired = [], []
    speeds = np.zeros((CELLS, _SPEED_BINS))
    # a pool and its members may have the same name
    pools = {"pool": pool} | {f"single {member}": [member] for member in members}
    for chunk in chunks(headings, pools, _NAMES, corrected):
        pooled, *single = chunk.model.values()
        before, after = chunk.wind - pooled, chunk.corrected - pooled
        change = before - after
        time = chunk.block["time"].to_numpy()
        columns = {
            "aircraft": chunk.aircraft,
            "day": np.searchsorted(days, time.astype("datetime64[D]")),
            "cell": profile_cells(chunk.block),
            "time": time.astype("datetime64[ms]").astype(np.float64) / 1000.0,
            "east": after[0],
            "north": after[1],
            "speed": np.minimum(np.hypot(*pooled), _SPEED_BINS - 1),
            "number": np.ones(time.size),
            "reported": 0.5 * (before**2).sum(axis=0),
            "corrected": 0.5 * (after**2).sum(axis=0),
            "change": 0.5 * (change**2).sum(axis=0),
            "crossed": (change * after).sum(axis=0),
        }
        columns |= {name: chunk.column(name) for name in ("latitude", "longitude", "pressure")}
        differences = [chunk.corrected - model for model in single]
        pairs = {
            (i, j): 0.5 * (differences[i] * differences[j]).sum(axis=0)
            for i, j in combinations(range(len(single)), 2)
        }
        good = (columns["cell"] >= 0) & ~np.isnat(time)
        good &= np.all(np.isfinite([before, after, *differences]), axis=(0, 1))
        good &= np.isin(chunk.applied, FREE_OF_DEVIATION)
        table = pd.DataFrame(columns | pairs)[good]
        sums.append(table.groupby(_KEY)[[*_SUMMED, *pairs]].sum())
        np.add.at(speeds, (table["cell"], table["speed"].astype(int)), 1.0)
        paired.append(table.loc[table["day"] % stride == 0, [*_PAIRED]])
    return Disagreements(
        days,
        headings.sizes["aircraft"],
        pd.concat(sums),
        speeds.reshape(len(PHASE), _LAYERS, -1).sum(axis=0),
        pd.concat(paired),
    )


def near_pairs(archive: Disagreements, classes: Ints) -> PairTable:
    """Pair the neighbouring reports of every day; ``classes`` (aircraft,)."""
    rng, most = np.random.default_rng(0), max(MOST_PAIRS // max(archive.days.size, 1), 1)
    pairs = [(np.zeros(0, np.int64), *np.zeros((2, 0, 2), np.int64), np.zeros((0, 3)), np.zeros(0))]
    for day, rows in archive.reports.groupby("day"):
        reports = {str(name): values.to_numpy() for name, values in rows.items()}
        ends, separation = neighbouring_pairs(*(reports[name] for name in _PAIRED[:5]))
        if len(ends) > most:
            sample = np.sort(rng.permutation(len(ends))[:most])
            ends, separation = ends[sample], separation[sample]
        squares = half_squares(reports["east"], reports["north"], ends)
        columns = reports["cell"][ends], classes[reports["aircraft"][ends]], separation, squares
        pairs.append((np.full(len(ends), day), *columns))
    return PairTable(*(np.concatenate(column) for column in zip(*pairs, strict=True)))


def observation_errors(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    covariance: float = 0.0,
    seed: int = 0,
) -> xr.Dataset:
    """Estimate the standard error of the reports by phase of flight, layer and state.

    Parameters
    ----------
    headings, corrected : Dataset
        Screened headings, and the corrected winds of the same reports.
    pools, reference : mapping of str to list of str, str
        Members of each reference and pool; name of the reference or pool to use.
    covariance : float, default 0
        Covariance of the references' errors that the hat assumes, m2/s2.
    seed : int, default 0
        Of the bootstrap.

    Returns
    -------
    Dataset
        ``observation_error`` (flight_phase, layer, state), m/s, by the preferred method, with
        ``observation_error_interval``; ``*_by_method``; ``fleet_*`` over all reports;
        ``aircraft_observation_error``; ``weight_gain``; the errors that assimilation systems use;
        and, in the attributes, the preferred ``method``, ``method_reason``,
        ``assumed_covariance`` and the references of the hat.

    Raises
    ------
    InputError
        If the reference is unknown.

    References
    ----------
    Gray & Allan 1974, Proc. 28th Freq. Control Symp.

    Examples
    --------
    >>> pools = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}
    >>> errors = airswing.observation_errors(headings, corrected, pools=pools, reference="ruc")
    >>> errors["observation_error"].dims
    ('flight_phase', 'layer', 'state')
    """
    require_reference(pools, reference)
    members = [name for name, inside in pools.items() if len(inside) == 1]
    archive = disagreements(headings, corrected, members, list(pools[reference]))
    days = archive.days.size
    weights = np.ones((1, days))
    if days >= FEWEST_DAYS:
        weights = np.vstack([weights, day_weights(days, draws=DRAWS, seed=seed)])
    number = np.maximum(weights @ archive.reports_by_day.T, 0.0)
    key = np.array([archive.sums.index.get_level_values(level) for level in _KEY])
    of_key, change, crossed = (
        archive.sums[name].to_numpy() for name in ("number", "change", "crossed")
    )
    added = added_variance(key, of_key, change, crossed, weights, cells=CELLS, seed=seed)
    # use the pair of references with the smallest mean product of disagreements
    pairs = [name for name in archive.sums if isinstance(name, tuple) and len(archive.sums)]
    hat_pair = min(pairs, key=lambda pair: archive.sums[pair].sum(), default=None)
    # Variances of corrected winds by cell and of the fleet, (draw, cell) and (draw,), by method;
    # of aircraft (draw, state, aircraft). The first draw is the estimate; NaN where not known.
    cells, fleet = np.full((2, *number.shape), np.nan), np.full((2, len(number)), np.nan)
    aircraft = np.full((len(number), len(STATES), archive.number), np.nan)
    separated = _separation(archive, number, weights)
    if separated is not None:
        cells[0], fleet[0], aircraft = separated
    if hat_pair is not None:
        total = weights @ archive.by("cell", "day", hat_pair).T
        cells[1] = ratio(total, number) - covariance
        cells[1][:, archive.reports_by_day.sum(axis=1) < FEWEST_REPORTS] = np.nan
        fleet[1] = ratio(total.sum(-1), number.sum(-1)) - covariance
    # both states: (draw, state, method, cell) and (draw, state, method)
    fleet = widened(np.stack([fleet.T + added[:, :1], fleet.T], axis=1), days)
    cells = np.moveaxis(cells, 0, 1)
    cells = widened(np.stack([cells + added[:, None, 1:], cells], axis=1), days)
    available = separated is not None, hat_pair is not None
    method, reason = _preferred(fleet[:, -1], available, len(members), covariance)
    preferred = METHODS.index(method or METHODS[0])
    tables = _table(cells, number)
    # the error of the cell, else that of its layer, else that of the fleet
    table, fleet_error = _root(tables[0, ..., preferred]), _root(fleet[0, :, preferred])
    layer = np.where(np.isfinite(table[:1]), table[:1], fleet_error)
    cell = ("flight_phase", "layer", "state")
    drawn_of: dict[str, tuple[tuple[str, ...], Floats]] = {
        "observation_error": (cell, _root(tables[..., preferred])),
        "fleet_observation_error": (("state",), _root(fleet[..., preferred])),
        "observation_error_by_method": (("way", *cell), _root(np.moveaxis(tables, -1, 1))),
        "fleet_observation_error_by_method": (("way", "state"), _root(fleet.swapaxes(1, 2))),
        "weight_gain": (cell[:2], _gain(tables[..., preferred])),
        "fleet_weight_gain": ((), _gain(fleet[..., preferred])),
        "reference_error_covariance": ((), covariance + fleet[:, -1, 1] - fleet[:, -1, 0]),
    }
    of_aircraft = _root(widened(aircraft, days)).swapaxes(1, 2)
    drawn_of["aircraft_observation_error"] = ("aircraft", "state"), of_aircraft
    filled = np.where(np.isfinite(table), table, layer)
    data: dict[str, Any] = {"observation_error_filled": (cell, filled)}
    for name, (dims, drawn) in drawn_of.items():
        data[name] = (dims, drawn[0])
        bounds = np.full((2, *drawn.shape[1:]), np.nan)
        if len(drawn) > 1:
            ends = interval(np.nan_to_num(drawn[1:], nan=0.0))
            bounds = np.where(np.isfinite(drawn[0]), ends, np.nan)
        data[f"{name}_interval"] = ((*dims, "bound"), np.moveaxis(bounds, 0, -1))
    return xr.Dataset(
        data | _context(archive),
        coords={
            "aircraft": headings["aircraft"].to_numpy().astype(str),
            "flight_phase": list(FLIGHT_PHASES),
            "state": list(STATES),
            "way": list(METHODS),
            "bound": ["low", "high"],
        },
        attrs={
            "method": method,
            "method_reason": reason,
            "reference": reference,
            "hat_references": " ".join(members[k] for k in hat_pair or ()),
            "assumed_covariance": covariance,
            "days": days,
        },
    )


def _separation(
    archive: Disagreements, number: Floats, weights: Floats
) -> tuple[Floats, Floats, Floats] | None:
    """Variances of cells, fleet and aircraft from neighbours; None with too few pairs."""
    if archive.sums.empty:
        return None
    flown = archive.by("aircraft", "cell", "number")
    squares = np.stack([archive.by("aircraft", "day", state) for state in STATES])
    # Aircraft of similar disagreement form a class; in a small fleet each is a class.
    disagreement = squares[-1].sum(axis=1) / np.maximum(flown.sum(axis=1), 1.0)
    order, classes = np.argsort(disagreement, kind="stable"), np.empty(archive.number, np.int64)
    count = min(MOST_CLASSES, archive.number)
    classes[order] = np.arange(archive.number) * count // archive.number
    by_class = group_sums(flown, classes, count).T
    amplitude = ratio(
        archive.by("cell", "day", "corrected").sum(axis=1), archive.reports_by_day.sum(axis=1)
    )
    separated = separate(near_pairs(archive, classes), by_class, np.nan_to_num(amplitude), weights)
    if separated is None:
        return None
    by_cell, variances, resolved = separated
    fleet = ratio((by_cell * number).sum(-1), number.sum(-1))
    mean = ratio(squares @ weights.T, archive.by("aircraft", "day", "number") @ weights.T)
    more = np.nan_to_num((mean - mean[-1:]).transpose(2, 0, 1), nan=0.0)
    aircraft = variances[:, classes][:, None] + more
    aircraft[..., flown.sum(axis=1) == 0] = np.nan
    return np.where(resolved, by_cell, np.nan), fleet, aircraft


def _preferred(
    fleet: Floats, available: tuple[bool, bool], members: int, assumed: float
) -> tuple[str, str]:
    """Preferred method by the fleet's variances (draw, method), and the reason; or no method.

    Those of the hat are for an ``assumed`` covariance of the references' errors.
    """
    if not any(available):
        return "", "too few neighbouring aircraft or days, and only one reference"
    words = "the references' errors"
    if not available[0]:
        return METHODS[1], f"too few neighbours; an upper bound where {words} are correlated"
    if not available[1] or len(fleet) == 1:
        reason = "only one reference" if members < 2 else "the references' covariance is not known"
        return METHODS[0], reason
    shared = assumed + fleet[:, 1] - fleet[:, 0]
    low, high = interval(shared[1:])
    widths = np.ptp(interval(fleet[1:]), axis=0)
    estimate = f"covariance of {words} {shared[0]:.2f} ({low:.2f} to {high:.2f}) m2/s2"
    if low <= assumed <= high and widths[1] < widths[0]:
        different = f"different from the assumed {assumed:g}" if assumed else "significant"
        return METHODS[1], f"{estimate}: not {different}"
    return METHODS[0], f"{estimate}: the hat attributes it to the reports"


def _table(cells: Floats, number: Floats) -> Floats:
    """Variances by phase and layer, the first row all phases: (draw, phase, layer, state, method).

    From variances (draw, state, method, cell) and the reports (draw, cell) of each.
    """
    shape = (len(number), len(PHASE), _LAYERS)
    cells = np.moveaxis(cells, 3, 1).reshape(*shape, *cells.shape[1:3])
    weight = number.reshape(shape)[..., None, None] * np.isfinite(cells)
    all_phases = ratio((np.nan_to_num(cells) * weight).sum(axis=1), weight.sum(axis=1))
    total = number.reshape(shape).sum(axis=1)[..., None, None]
    all_phases = np.where(weight.sum(axis=1) >= KNOWN_SHARE * total, all_phases, np.nan)
    return np.stack([all_phases, *(cells[:, PHASE[name]] for name in FLIGHT_PHASES[1:])], axis=1)


def _context(archive: Disagreements) -> dict[str, Any]:
    """Counts, rms disagreement, median speed, and the errors that assimilation systems use."""
    bottom, top = (values for _, values in LAYER_PRESSURES.values())
    names = ("number", *STATES)
    by_cell = np.array([archive.by("cell", "aircraft", name).sum(axis=1) for name in names])
    by_cell = by_cell.reshape(len(names), len(PHASE), _LAYERS)
    rows = [by_cell.sum(axis=1), *(by_cell[:, PHASE[name]] for name in FLIGHT_PHASES[1:])]
    counted, *squares = np.stack(rows, axis=1)
    speeds = archive.speeds.cumsum(axis=-1)
    median = (speeds < 0.5 * speeds[:, -1:]).sum(axis=-1) + 0.5
    return {
        "observation_count": (("flight_phase", "layer"), counted.astype(np.int64)),
        "disagreement_rms": (
            ("flight_phase", "layer", "state"),
            np.sqrt(ratio(np.stack(squares, axis=-1), counted[..., None])),
        ),
        "median_wind_speed": ("layer", np.where(speeds[:, -1] > 0, median, np.nan)),
        **LAYER_PRESSURES,
        **{
            f"{name}_error": ("layer", np.interp((bottom + top) / 200.0, *table))
            for name, table in USED.items()
        },
    }


def _root(variance: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _gain(variance: Floats) -> Floats:
    """Number of reported winds that have the weight of a corrected one: ratio of variances."""
    before, after = variance[..., 0], variance[..., -1]
    return ratio(np.maximum(before, 0.0), np.maximum(after, 0.0))
