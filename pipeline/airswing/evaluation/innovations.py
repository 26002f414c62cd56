"""Innovations (observation minus reference): measures, error profiles, statistics by aircraft.

Both winds are true eastward and northward components in m/s at the same place and time. The mean
magnitude of the vector difference is the measure of Jacobs et al. (2010, Table 1); it is not
additive, so component rms and the components along and across the heading are given as well.

Products are by phase of flight and pressure layer, as reported and as corrected; they include the
errors of the reference. A pool is the mean of its members. *Error profiles* are rms over the fleet,
with standard errors clustered by flight, because reports of one flight share the model's error.
*Statistics* are bias, standard deviation and root mean square (for example Drüe et al. 2008, Q. J.
R. Meteorol. Soc. 134, 229-239); all reports have equal weight, and a standard error from their
number would be too small. m/s, degrees.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.evaluation.resampling import SUMS, cluster_sums, clustered_mean, ratio
from airswing.flags import CORRECTION, PHASE, SCREENING
from airswing.physics.compass_deviation import deviation_basis
from airswing.physics.triangle import angle_of_vector
from airswing.products.ragged import aircraft_of_report, blocks, time_span

Floats = NDArray[np.float64]
FloatArray = NDArray[np.floating]
Ints = NDArray[np.int64]
_Winds = TypeVar("_Winds", xr.DataArray, xr.Dataset)
WINDS = ("eastward_wind", "northward_wind", "reference_eastward_wind", "reference_northward_wind")
CORRECTED_WINDS = ("corrected_eastward_wind", "corrected_northward_wind")
MIN_DIRECTION_WIND = 5.0
"""Reference wind, m/s, below which the direction has no meaning: it is mostly that of the error."""
STATES = ("reported", "corrected")
LEVEL_EDGES_HPA = (1100.0, 900.0, 800.0, 700.0, 600.0, 500.0, 400.0, 300.0, 200.0)
"""Edges of the layers from the ground upwards (merged from WRFDA's error table)."""
LAYER_PRESSURES = {
    "layer_bottom_pressure": ("layer", np.array(LEVEL_EDGES_HPA[:-1]) * 100.0),
    "layer_top_pressure": ("layer", np.array(LEVEL_EDGES_HPA[1:]) * 100.0),
}
"""Variables of every product by layer, Pa."""
CELLS = len(PHASE) * (len(LEVEL_EDGES_HPA) - 1)  # phases of flight times layers
_UNUSABLE = ("no_reference", "missing_wind", "wind_qc", "gross_error", "no_ground_vector")
QUANTITIES = ("speed", "direction", "eastward", "northward")
PROFILED = ("eastward", "northward", "direction")
HISTOGRAM_EDGES = np.arange(-20.0, 21.0)
"""Edges of the classes of a component's innovation, m/s; larger ones are in the last class."""


@dataclass(frozen=True)
class Chunk:
    """Some whole aircraft of an archive, in memory."""

    block: xr.Dataset
    aircraft: Ints  # (report,): numbered over the archive
    day: Ints  # (report,): since 1970
    wind: Floats  # (2, report): eastward and northward, as reported, m/s
    model: dict[str, Floats]  # (2, report): of each reference or pool
    corrected: Floats  # (2, report): as reported without a corrected product
    applied: NDArray[np.integer]  # (report,): codes of `CORRECTION`

    def column(self, name: str) -> Floats:
        """A variable of the reports."""
        return self.block[name].to_numpy().astype(np.float64)


def chunks(
    headings: xr.Dataset,
    pools: Mapping[str, list[str]],
    names: Sequence[str] = (),
    corrected: xr.Dataset | None = None,
) -> Iterator[Chunk]:
    """Read an archive, some whole aircraft at a time.

    ``names`` are further variables to read; ``corrected`` the corrected winds of the same reports.
    """
    first = 0
    wanted = (*CORRECTED_WINDS, "correction_applied")
    corrected_blocks = iter(()) if corrected is None else blocks(corrected, wanted)
    for block in blocks(headings, [*WINDS, "time", *names]):
        aircraft = aircraft_of_report(block) + first
        first += block.sizes["aircraft"]
        winds = next(corrected_blocks, block)
        applied = np.full(aircraft.size, CORRECTION["corrected"])
        if "correction_applied" in winds:
            applied = winds["correction_applied"].to_numpy()
        yield Chunk(
            block,
            aircraft,
            block["time"].to_numpy().astype("datetime64[D]").astype(np.int64),
            _vectors(block, WINDS[:2]),
            {
                key: _vectors(member_mean(block[[*WINDS[2:]]].sel(reference=members)), WINDS[2:])
                for key, members in pools.items()
            },
            _vectors(winds, WINDS[:2] if winds is block else CORRECTED_WINDS),
            applied,
        )


def _vectors(ds: xr.Dataset, names: Sequence[str]) -> Floats:
    return np.array([ds[name].to_numpy() for name in names], dtype=np.float64)


def require_reference(pools: Collection[str], reference: str) -> None:
    """Raise InputError for a reference or pool that is not known."""
    if reference not in pools:
        problem, known = "no such reference or pool", f"Known: {', '.join(pools)}"
        raise InputError(problem, field="reference", found=reference, remedy=known)


def innovations(
    eastward: FloatArray,
    northward: FloatArray,
    reference_eastward: FloatArray,
    reference_northward: FloatArray,
) -> dict[str, Floats]:
    """Innovation of the speed, the direction and both components of a wind, m/s and degrees.

    Directions are in (-180, 180], positive where the observation is veered (clockwise). NaN where a
    wind is missing, and of the direction where the observed wind is calm or the reference wind is
    weaker than :data:`MIN_DIRECTION_WIND`.
    """
    u, v, u_ref, v_ref = eastward, northward, reference_eastward, reference_northward
    speed = np.hypot(u_ref, v_ref)
    # the angle between the two vectors, clockwise positive, is the same for directions "from"
    turned = np.degrees(angle_of_vector(u_ref, v_ref, u, v))
    differences = {
        "speed": np.hypot(u, v) - speed,
        "direction": np.where(speed >= MIN_DIRECTION_WIND, turned, np.nan),
        "eastward": u - u_ref,
        "northward": v - v_ref,
    }
    return {name: np.asarray(values, np.float64) for name, values in differences.items()}


def members_of(headings: xr.Dataset, reference: str) -> list[str]:
    """Members of a reference or pool: those of the configuration the headings were made with.

    Else those in the name of the pool (``ruc+rtfdaa``), else all references of the headings.
    """
    names = [str(name) for name in headings["reference"].to_numpy()]
    pools = json.loads(headings.attrs.get("airswing_config") or "{}").get("pool") or {}
    members = [reference] if reference in names else pools.get(reference, reference.split("+"))
    return [name for name in members if name in names] or names


def member_mean(values: _Winds) -> _Winds:
    """Mean over ``reference`` of the members with a value at the report, NaN without any.

    A report outside one model's grid or hours still has the wind of the other model.
    """
    return values.mean("reference", skipna=True)


def paired_design(
    magnetic_heading: Floats, heading: Floats, airspeed: Floats
) -> tuple[Floats, Floats]:
    """Design of the joint fit across and along the heading, each (8, report), in m/s.

    Rows A, B, C, D, E (radians), airspeed scale, and the bias b_u, b_v (m/s); see
    docs/method.md: cross-track V psi_err, along-track |V_A| - |V'_A|. Headings in radians, airspeed
    in m/s.
    """
    zero, sine, cosine = np.zeros_like(heading), np.sin(heading), np.cos(heading)
    cross = [*(airspeed * deviation_basis(magnetic_heading)), zero, cosine, -sine]
    along = [zero, zero, zero, zero, zero, airspeed, sine, cosine]
    return np.stack(cross), np.stack(along)


def error_profiles(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> xr.Dataset:
    """Profile the wind error by phase of flight and layer, as reported and as corrected.

    Parameters
    ----------
    headings, corrected : Dataset
        Screened headings, and the corrected winds of the same reports, in memory or lazy.
    pools : mapping of str to list of str
        Members of each reference and pool.

    Returns
    -------
    Dataset
        ``eastward_rms``, ``northward_rms`` (m/s), ``direction_rms`` (degrees) with
        ``*_standard_error`` (reference, state, flight_phase, layer), ``profile_count`` and
        ``profile_flights``.

    Examples
    --------
    >>> profiles = airswing.error_profiles(headings, corrected, pools={"ruc": ["ruc"]})
    >>> profiles["eastward_rms"].dims
    ('reference', 'state', 'flight_phase', 'layer')
    """
    return innovation_products(headings, corrected, pools=pools)[0]


def profile_cells(headings: xr.Dataset) -> NDArray[np.int64]:
    """Phase and layer of every report as one number; -1 where it does not count.

    Below :data:`CELLS`: phase times the number of layers, plus the layer from the ground up.
    """
    usable = (headings["screening"].to_numpy() & sum(SCREENING[name] for name in _UNUSABLE)) == 0
    layers = len(LEVEL_EDGES_HPA) - 1
    # the level falls as the pressure rises: digitize on the negated edges
    layer = np.digitize(-headings["pressure"].to_numpy() / 100.0, -np.array(LEVEL_EDGES_HPA)) - 1
    phase = headings["phase"].to_numpy().astype(np.int64)
    cell = np.where(usable & (layer >= 0) & (layer < layers), phase * layers + layer, -1)
    return np.asarray(cell, dtype=np.int64)


def innovation_statistics(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> xr.Dataset:
    """Statistics of the innovations: the content of ``innovation_statistics.nc``.

    Parameters
    ----------
    headings, corrected : Dataset
        Screened headings, and the corrected winds of the same reports, in memory or lazy.
    pools : mapping of str to list of str
        Members of each reference and pool.

    Returns
    -------
    Dataset
        For each quantity of :data:`QUANTITIES`:

        ``innovation_{quantity}_bias``, ``_standard_deviation``, ``_rms``, ``_count``
            (reference, state, aircraft, flight_phase, layer): m/s, of the direction degrees.
            :func:`combined` gives them over whole phases, layers, aircraft or the fleet.
        ``daily_innovation_{quantity}``, ``daily_innovation_count``
            (reference, state, aircraft, day): mean of the day (UTC); NaN without a report.
        ``innovation_histogram``
            (reference, state, eastward_class, northward_class): number of reports by the
            innovation of both components, in classes of 1 m/s named by their lower edge.

    Examples
    --------
    >>> statistics = airswing.innovation_statistics(headings, corrected, pools={"ruc": ["ruc"]})
    >>> statistics["innovation_speed_bias"].dims
    ('reference', 'state', 'aircraft', 'flight_phase', 'layer')
    """
    return innovation_products(headings, corrected, pools=pools)[1]


def innovation_products(
    headings: xr.Dataset, corrected: xr.Dataset, *, pools: Mapping[str, list[str]]
) -> tuple[xr.Dataset, xr.Dataset]:
    """Results of :func:`error_profiles` and :func:`innovation_statistics`, from one reading."""
    first, last = (day.astype("datetime64[D]") for day in time_span(headings))
    days = np.arange(first, last + 1)
    shape = (len(pools), len(STATES), headings.sizes["aircraft"])
    profiles = np.zeros((*shape[:2], len(PROFILED), SUMS, CELLS))
    cells = {name: np.zeros((3, *shape, CELLS)) for name in QUANTITIES}
    daily = {name: np.zeros((2, *shape, days.size)) for name in QUANTITIES}
    classes = HISTOGRAM_EDGES.size - 1
    histogram = np.zeros((*shape[:2], classes * classes), np.int64)
    for chunk in chunks(headings, pools, ("pressure", "phase", "flight", "screening"), corrected):
        cell, day = profile_cells(chunk.block), chunk.day - first.astype(np.int64)
        flight = chunk.block["flight"].to_numpy().astype(np.int64)
        for i, j in np.ndindex(*shape[:2]):
            wind, model = (chunk.wind, chunk.corrected)[j], list(chunk.model.values())[i]
            differences = innovations(*wind, *model)
            for name, values in differences.items():
                good = np.isfinite(values) & (cell >= 0)
                moments = [values[good] ** power for power in (0, 1, 2)]
                for table, place in ((cells[name], cell), (daily[name], day)):
                    key = chunk.aircraft[good] * table.shape[-1] + place[good]
                    for power, total in enumerate(table[:, i, j]):
                        total += np.bincount(key, moments[power], total.size).reshape(total.shape)
                if name in PROFILED:
                    profiles[i, j, PROFILED.index(name)] += cluster_sums(
                        moments[2], cell[good], flight[good], CELLS
                    )
            good = np.isfinite(differences["eastward"]) & (cell >= 0)
            east, north = (
                np.clip(np.digitize(differences[name][good], HISTOGRAM_EDGES) - 1, 0, classes - 1)
                for name in ("eastward", "northward")
            )
            histogram[i, j] += np.bincount(east * classes + north, minlength=classes**2)
    names_of = {"reference": list(pools), "state": list(STATES), "flight_phase": list(PHASE)}
    axes = ("reference", "state", "aircraft", "flight_phase", "layer")
    ds = xr.Dataset(
        coords=names_of
        | {
            "aircraft": headings["aircraft"].to_numpy().astype(str),
            "day": days.astype("datetime64[ns]"),
            "eastward_class": HISTOGRAM_EDGES[:-1],
            "northward_class": HISTOGRAM_EDGES[:-1],
        }
    )
    for name in QUANTITIES:
        moments = list(cells[name].reshape(3, *shape, len(PHASE), -1))
        for kind, statistic in _statistics(*moments).items():
            ds[f"innovation_{name}_{kind}"] = axes, statistic
        ds[f"daily_innovation_{name}"] = ((*axes[:3], "day"), ratio(daily[name][1], daily[name][0]))
    ds["daily_innovation_count"] = (*axes[:3], "day"), daily["eastward"][0].astype(np.int32)
    ds["innovation_histogram"] = (
        (*axes[:2], "eastward_class", "northward_class"),
        histogram.reshape(*shape[:2], classes, classes),
    )
    sums = profiles.reshape(*profiles.shape[:-1], len(PHASE), -1)
    mean, error = clustered_mean(np.moveaxis(sums, 3, 0))
    rms = np.sqrt(mean)
    error = ratio(error, 2.0 * rms)  # the delta method
    dims = ("reference", "state", "flight_phase", "layer")
    profiled = xr.Dataset(LAYER_PRESSURES, coords=names_of)
    for k, name in enumerate(PROFILED):
        profiled[f"{name}_rms"] = dims, rms[:, :, k]
        profiled[f"{name}_rms_standard_error"] = dims, error[:, :, k]
    for name, place in (("profile_count", 0), ("profile_flights", 2)):
        profiled[name] = dims, sums[:, :, 0, place].astype(np.int32)
    return profiled, ds.assign(LAYER_PRESSURES)


def combined(statistics: xr.Dataset, over: Iterable[str]) -> xr.Dataset:
    """Statistics of the innovations over whole dimensions, such as all layers of a phase.

    Those of :func:`innovation_statistics` for the union of the cells along ``over``, any of
    ``aircraft``, ``flight_phase``, ``layer``: exact, as the moments add up.
    """
    dims = list(over)
    ds = xr.Dataset()
    for name in QUANTITIES:
        count = statistics[f"innovation_{name}_count"].astype(np.float64)
        bias, rms = (statistics[f"innovation_{name}_{kind}"] for kind in ("bias", "rms"))
        moments = [moment.sum(dims) for moment in (count, count * bias, count * rms**2)]
        for kind, values in _statistics(*(moment.to_numpy() for moment in moments)).items():
            ds[f"innovation_{name}_{kind}"] = moments[0].dims, values
    return ds.assign_coords(
        {name: axis for name, axis in statistics.coords.items() if set(axis.dims) <= set(ds.dims)}
    )


def _statistics(count: Floats, total: Floats, squares: Floats) -> dict[str, NDArray[np.generic]]:
    bias, square = ratio(total, count), ratio(squares, count)
    variance = ratio(np.maximum(square - bias**2, 0.0) * count, count - 1.0)
    return {
        "bias": bias,
        "standard_deviation": np.sqrt(variance),
        "rms": np.sqrt(square),
        "count": count.astype(np.int64),
    }
