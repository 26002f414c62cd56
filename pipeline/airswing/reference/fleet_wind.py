"""A wind field fitted to the winds of all aircraft of a fleet, as a reference for each of them.

Each component of the wind is multilinear between nodes in latitude, longitude, ln p and time, with
penalised second differences. A heading offset and an airspeed scale of each aircraft are unknowns
of the same fit with robust weights (Huber), so that no single aircraft dominates the field. An
offset common to all aircraft is determined only if headings cover the compass. Valid for hours to a
day and some hundred kilometres where no model is available. SI units; degrees for places. Source:
Sun, Vu, Ellerbroek & Hoekstra 2018 (PLoS ONE 13, e0205029), wind of Mode-S reports.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from airswing.errors import InputError
from airswing.flags import QC
from airswing.physics.great_circle import unwrapped
from airswing.physics.splines import hat_products
from airswing.products.ragged import aircraft_of_report

Floats = NDArray[np.float64]
STEPS = (0.7, 1.1, 0.15, 1800.0)  # Node distances: degrees of latitude and longitude, ln p, s
# Limits of one fit: the equations of all nodes and aircraft are solved together.
MOST_NODES, MOST_REPORTS = 2500, 100_000
BEND = 6.0  # weight of a second difference of 1 m/s, as m/s of wind error
# Prior standard deviations: heading offset in radians, airspeed scale.
OFFSET_SPREAD, SCALE_SPREAD = np.radians(2.0), 0.01
NOISE = 4.0  # m/s, standard error of a report about the field, with gusts
# Standard errors beyond which a report has less weight, and number of iterations.
HUBER, ROUNDS = 1.5, 4
# with fewer aircraft the compass of one determines much of the field it is compared with
FEWEST_AIRCRAFT = 5
_PLACE = ("latitude", "longitude", "log_pressure", "second")
_WIND = ("eastward_wind", "northward_wind")


def fleet_wind(reports: xr.Dataset | Iterable[xr.Dataset]) -> xr.Dataset:
    """Fit a wind field to the winds of a fleet.

    Parameters
    ----------
    reports : Dataset or iterable of Dataset
        Canonical reports, whole or some aircraft at a time.

    Returns
    -------
    Dataset
        ``eastward_wind``, ``northward_wind`` (time, pressure, latitude, longitude), m/s: a
        reference like any other.

    Raises
    ------
    InputError
        Fewer than five aircraft have winds.

    Examples
    --------
    >>> reports = airswing.read_reports("data_samples/reports/*.csv")
    >>> winds = airswing.fleet_wind(reports)
    >>> winds["eastward_wind"].attrs["units"]
    'm s-1'
    """
    data = _gathered([reports] if isinstance(reports, xr.Dataset) else reports)
    data = data.assign(longitude=unwrapped(data["longitude"].to_numpy()))
    axes = _nodes(data[[*_PLACE]].to_numpy().T)
    lat, lon, log_p, second = axes
    level = {"units": "Pa", "standard_name": "air_pressure", "positive": "down"}
    coords = {
        "time": ("time", (second * 1e9).astype("datetime64[ns]"), {"standard_name": "time"}),
        "pressure": ("pressure", np.exp(log_p), level),
        "latitude": ("latitude", lat, {"units": "degrees_north"}),
        "longitude": ("longitude", lon, {"units": "degrees_east"}),
    }
    attrs = {"Conventions": "CF-1.11", "title": "Wind field of the fleet's own reports"}
    winds = xr.Dataset(coords=coords, attrs=attrs)
    for name, values in zip(_WIND, _field(data, axes), strict=True):
        grid = values.reshape([axis.size for axis in axes]).transpose(3, 2, 0, 1)
        attrs = {"units": "m s-1", "standard_name": name}
        winds[name] = tuple(coords), grid.astype(np.float32), attrs
    return winds


def _gathered(blocks: Iterable[xr.Dataset]) -> pd.DataFrame:
    """Places, winds, true heading (rad) and airspeed of the reports with winds, thinned if many."""
    tables, aircraft = list[pd.DataFrame](), 0
    for block in blocks:
        names = [*_PLACE[:2], "pressure", *_WIND, "reported_heading", "reported_airspeed"]
        columns = {name: block[name].to_numpy() if name in block else 0.0 for name in names}
        table = pd.DataFrame(columns, dtype=np.float64)
        time = block["time"].to_numpy().astype("datetime64[ns]").astype(np.int64)
        table["second"], table["log_pressure"] = time / 1e9, np.log(table.pop("pressure"))
        table["aircraft"] = aircraft_of_report(block) + aircraft
        aircraft += block.sizes["aircraft"]
        # reports without an air vector contribute their winds only
        air = table[names[-2:]].to_numpy()
        table[names[-2:]] = np.where(np.isfinite(air).all(axis=1, keepdims=True), air, 0.0)
        good = np.isfinite(table.to_numpy()).all(axis=1)
        if "wind_qc" in block:
            good &= block["wind_qc"].to_numpy() != QC["fail"]
        tables.append(table[good])
    data = pd.concat(tables, ignore_index=True)
    if (count := data["aircraft"].nunique()) < FEWEST_AIRCRAFT:
        raise InputError(
            "too few aircraft have winds for a wind field of the fleet",
            field="references",
            found=f"{count} aircraft",
            remedy=f"{FEWEST_AIRCRAFT} or more are needed, or a model",
        )
    return data.iloc[:: -(-len(data) // MOST_REPORTS) or 1]


def _nodes(place: Floats) -> list[Floats]:
    low, high = place.min(axis=1), place.max(axis=1)
    spread = np.array(STEPS)
    while True:
        counts = np.maximum(np.ceil((high - low) / spread).astype(int) + 1, 2)
        if np.prod(counts) <= MOST_NODES:
            break
        spread = spread * 1.15
    # the outermost reports lie between nodes, not on them
    margin = np.maximum(1e-6 * np.abs(high), 1e-3)
    ends = zip(low - margin, high + margin, counts, strict=True)
    return [np.linspace(start, stop, count) for start, stop, count in ends]


def _field(data: pd.DataFrame, axes: list[Floats]) -> Floats:
    """Both components at the nodes, shape (2, nodes)."""
    index, share = hat_products([*data[[*_PLACE]].to_numpy().T], axes)
    rows, nodes = np.arange(len(data)), int(np.prod([axis.size for axis in axes]))
    start = np.append(rows, rows.size) * index.shape[1]
    basis = sparse.csr_matrix((share.ravel(), index.ravel(), start), (rows.size, nodes))
    aircraft = data["aircraft"].to_numpy()
    owners = int(aircraft.max()) + 1
    heading, airspeed = np.radians(data["reported_heading"]), data["reported_airspeed"]
    u, v = airspeed * np.sin(heading), airspeed * np.cos(heading)
    # wind = ground vector - air vector: its change if the air vector is turned or stretched
    turned_u, turned_v, stretched_u, stretched_v = (
        sparse.csr_matrix((change, (rows, aircraft)), (rows.size, owners))
        for change in (-v, u, -u, -v)
    )
    design = sparse.bmat(
        [[basis, None, turned_u, stretched_u], [None, basis, turned_v, stretched_v]], format="csr"
    )
    bend = _bends([axis.size for axis in axes])
    # The identity matrix determines nodes without reports nearby.
    smooth = (bend.T @ bend) * (BEND / NOISE) ** 2 + sparse.identity(nodes) * 1e-6
    spread = np.repeat([(NOISE / OFFSET_SPREAD) ** 2, (NOISE / SCALE_SPREAD) ** 2], owners)
    prior = sparse.block_diag([smooth, smooth, sparse.diags(spread)], format="csr")
    wind = data[[*_WIND]].to_numpy().T
    middle = np.median(wind, axis=1)
    right = (wind - middle[:, np.newaxis]).ravel()
    # the weight of an aircraft with many reports is limited: its errors are not independent
    reports = np.bincount(aircraft)[aircraft]
    base = np.tile(1.0 / np.sqrt(reports / np.median(reports)), 2)
    weight, solution = base, np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        normal = (design.T @ sparse.diags(weight) @ design + prior).tocsc()
        solution = spsolve(normal, design.T @ (weight * right))
        # Huber's weights by the median residual, which outliers do not change
        rest = np.abs(right - design @ solution)
        # the median of a normal variable's size is 0.6745 of its standard deviation
        limit = HUBER * max(float(np.median(rest)) / 0.6745, 1e-6)
        weight = base * np.minimum(1.0, limit / np.maximum(rest, 1e-9))
    return np.asarray(solution[: 2 * nodes].reshape(2, nodes) + middle[:, np.newaxis])


def _bends(sizes: list[int]) -> sparse.csr_matrix:
    """Second differences along every axis (first where there are but two nodes)."""
    differences = []
    for k, size in enumerate(sizes):
        if size > 2:
            difference = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(size - 2, size))
        else:
            # two nodes have no curvature: their difference is penalised, with less weight
            difference = sparse.diags([-0.3, 0.3], [0, 1], shape=(size - 1, size))
        factors = [difference if k == j else sparse.identity(n) for j, n in enumerate(sizes)]
        differences.append(reduce(sparse.kron, factors))
    return sparse.vstack(differences, format="csr")
