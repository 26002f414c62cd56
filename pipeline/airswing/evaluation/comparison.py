"""Dependence of the fits on the reference: every reference fitted on the same reports.

The errors of the reports are then the same whichever reference they are compared with, so that the
difference of two references' heading errors does not contain them: it is regressed on the design of
the deviation. Errors of one day are correlated over the whole fleet, and over a few days.

Two references may be pooled when neither their deviation curves nor their winds, region by region,
differ beyond error by more than a size that matters: 0.2 degrees rms over the compass, or 0.4 m/s
in the mean wind of a region, absolute or relative to the other regions on the same days. Where
there are three references the three-cornered hat estimates the error variance of each (Gray & Allan
1974, Proc. 28th Freq. Control Symp., 243-246), assuming that their errors are uncorrelated: those
of references that assimilate the same aircraft come out too small, and may be negative.

Kernels in radians and m/s; results in degrees and m/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import special  # not scipy.stats, whose import takes longer than a small fit

from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation import Content
from airswing.evaluation.gains import restrict
from airswing.evaluation.innovations import Chunk, Floats, Ints, chunks, member_mean, paired_design
from airswing.evaluation.resampling import normal_interval
from airswing.flags import PHASE, SCREENING
from airswing.physics.compass_deviation import COEFFICIENTS
from airswing.physics.triangle import along_cross, wrap_degrees
from airswing.products.ragged import time_span
from airswing.products.whole_files import Findings

Mask = NDArray[np.bool_]
Columns = dict[str, NDArray[Any]]

SIGNIFICANCE = 0.02
"""Level of each of the two tests, curves and winds: equal references pass both in 95 % of cases."""
CURVE_RMS_DEG, REGION_BIAS = 0.2, 0.4
"""Degrees and m/s: a smaller difference does not matter, however significant it is."""
COMPONENTS = ("eastward", "northward")
REGIONS = 9  # thirds of the reports by latitude, and of each by longitude
FEWEST_REPORTS, FEWEST_DAYS = 50, 10
"""Fewest for the difference of an aircraft: with fewer days eight coefficients fit the scatter."""
FEWEST_OF_SLICE, FEWEST_OF_HAT = 500, 100
"""Fewest reports of a slice that is tested, and of a three-cornered hat."""
_LAG = 3  # days that a weather situation, and with it a model's error, lasts
_MIN_REGION_DAYS = 10
_SEASONS = ("DJF", "MAM", "JJA", "SON")
KINDS = ("by_lead_time", "by_phase", "by_level", "by_season")
_COLUMNS = (
    *("latitude", "longitude", "pressure", "phase", "heading", "magnetic_heading", "airspeed"),
    *("screening", "lead_time"),
)


def compare(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    never_pool: list[str] | None = None,
    **fit_options: Unpack[FitOptions],
) -> Content:
    """Fit every reference and pool on the same reports and compare each pair of references.

    Parameters
    ----------
    headings : Dataset
        Screened headings with two references or more.
    pools : mapping of str to list of str
        Members of each reference and pool.
    never_pool : list of str, optional
        References that may be compared but never called poolable.
    **fit_options
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.

    Returns
    -------
    dict
        Content of ``sensitivity.json``: number of ``reports`` with every reference, ``references``;
        ``pairs``, each with ``references``, ``reports``, ``mean_vector_difference_m_s``, ``fleet``
        (difference of the coefficients common to the fleet), ``aircraft``, ``regions``,
        ``poolable`` (None where it cannot be determined), ``why``, and ``own_test`` (False for a
        pool and its member, whose difference follows from the members'); the same ``by_lead_time``,
        ``by_phase``, ``by_level`` and ``by_season`` without single aircraft; ``three_way``.

    Raises
    ------
    InputError
        If there is one reference only, or no report has all of them.

    References
    ----------
    Jacobs et al. 2010; Gray & Allan 1974, Proc. 28th Freq. Control Symp.

    Examples
    --------
    >>> pools = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"]}
    >>> sensitivity = airswing.compare(headings, pools=pools)
    >>> sensitivity["pairs"][0]["references"]
    ['ruc', 'rtfdaa']
    """
    singles = [name for name, members in pools.items() if len(members) == 1]
    if len(singles) < 2:
        raise InputError(
            "a comparison needs two references",
            field="references",
            found=", ".join(singles) or "none",
            remedy="Add another reference to the configuration",
        )
    shared = restrict(headings, headings["reference_eastward_wind"].notnull().all("reference"))
    fits = fit_deviation(shared, pools=pools, **fit_options).compute()
    region = regions_of(headings["latitude"].to_numpy(), headings["longitude"].to_numpy())
    first, last = (int(day.astype("M8[D]").astype(np.int64)) for day in time_span(headings))
    days = last - first + 1
    members = [(name, member) for name, pool in pools.items() if len(pool) > 1 for member in pool]
    tested = list(combinations(singles, 2))
    pair_sums = {pair: PairSums(*pair, days) for pair in [*tested, *members]}
    slices: dict[str, dict[tuple[tuple[str, str], str], PairSums]] = {kind: {} for kind in KINDS}
    begin = 0
    for chunk in chunks(shared, pools, _COLUMNS):
        columns = _columns(chunk, pools)
        columns |= {"day": chunk.day - first, "region": region[begin : begin + chunk.day.size]}
        begin += chunk.day.size
        edges = np.flatnonzero(np.diff(chunk.aircraft, prepend=-1, append=-1))
        for low, high in pairwise(edges.tolist()):
            rows = {name: values[..., low:high] for name, values in columns.items()}
            for sums in pair_sums.values():
                sums.add(rows, rows["used"], aircraft=int(chunk.aircraft[low]))
            for pair, (kind, name, selected) in ((p, s) for p in tested for s in _slices(rows, *p)):
                slices[kind].setdefault((pair, name), PairSums(*pair, days)).add(rows, selected)
    reports_used = next(iter(pair_sums.values())).reports
    if not reports_used:
        raise InputError(
            "no screened report has a wind of every reference",
            field="references",
            found=", ".join(singles),
            remedy="Check that the references cover the same times and places",
        )
    barred = {name.lower() for name in never_pool or []}
    squares = {pair: pair_sums[pair].squares for pair in tested}
    counted = pair_sums[tested[0]].regions[0].sum(axis=0)
    by_pair = []
    for pair, sums in pair_sums.items():
        pair_fits = fits.sel(reference=list(pair))
        entries = [_aircraft_entry(*numbers, pair_fits) for numbers in sums.aircraft]
        by_pair.append({**_judged(sums, barred), "aircraft": entries, "own_test": pair in tested})
    by_slice = {
        kind: [
            {"slice": name, **_judged(sums, barred), "own_test": True}
            for (_, name), sums in by_name.items()
            if sums.reports >= FEWEST_OF_SLICE
        ]
        for kind, by_name in slices.items()
    }
    return Findings(
        {
            "reports": reports_used,
            "references": list(pools),
            "pairs": by_pair,
            **by_slice,
            "three_way": hats_of(counted, squares, singles),
        }
    )


def regions_of(latitude: Floats, longitude: Floats) -> Ints:
    """Region of every report: thirds by latitude and, in each, by longitude; 0 to 8."""
    is_finite = np.isfinite(latitude + longitude)
    column = np.zeros(latitude.size, dtype=np.int64)
    if not is_finite.any():
        return column
    thirds = (1.0 / 3.0, 2.0 / 3.0)
    band = np.searchsorted(np.quantile(latitude[is_finite], thirds), latitude)
    for row in range(3):
        in_band = band == row
        if (in_band & is_finite).any():
            west = np.quantile(longitude[in_band & is_finite], thirds)
            column[in_band] = np.searchsorted(west, longitude[in_band])
    return np.asarray(3 * band + column, dtype=np.int64)


def _columns(chunk: Chunk, pools: Mapping[str, list[str]]) -> Columns:
    """Columns of reports as arrays, radians and SI units.

    ``wind`` (2, report) and ``lead`` are followed by the name of a reference or pool.
    """
    block, screening = chunk.block, chunk.block["screening"].to_numpy()
    heading, magnetic = (np.radians(chunk.column(f"{kind}heading")) for kind in ("", "magnetic_"))
    airspeed = chunk.column("airspeed")
    is_finite = np.isfinite(heading + magnetic + airspeed)
    # months count from January 1970: December, January and February are season 0
    month = block["time"].to_numpy().astype("datetime64[M]").astype(np.int64)
    columns: Columns = {
        "heading": heading,
        "magnetic_heading": magnetic,
        "airspeed": airspeed,
        "season": (month + 1) % 12 // 3,
        "phase": block["phase"].to_numpy(),
        "pressure": block["pressure"].to_numpy(),
        "used": (screening == 0) & is_finite,
        "used_any_phase": ((screening & ~SCREENING["phase"]) == 0) & is_finite,
    }
    for name, members in pools.items():
        columns[f"wind {name}"] = chunk.model[name]
        columns[f"lead {name}"] = member_mean(block["lead_time"].sel(reference=members)).to_numpy()
    return columns


def _slices(rows: Columns, first: str, second: str) -> list[tuple[str, str, Mask]]:
    lead, pressure = np.fmax(rows[f"lead {first}"], rows[f"lead {second}"]), rows["pressure"]
    slices = [
        ("by_lead_time", "analysis to 1 h", lead <= 1.0),
        ("by_lead_time", "1 to 6 h", (lead > 1.0) & (lead <= 6.0)),
        ("by_lead_time", "over 6 h", lead > 6.0),
        *(("by_phase", name, rows["phase"] == code) for name, code in PHASE.items()),
        ("by_level", "below 700 hPa", pressure > 70000.0),
        ("by_level", "700 to 500 hPa", (pressure > 50000.0) & (pressure <= 70000.0)),
        ("by_level", "above 500 hPa", pressure <= 50000.0),
        *(("by_season", name, rows["season"] == k) for k, name in enumerate(_SEASONS)),
    ]
    masks = {"by_phase": rows["used_any_phase"]}
    return [(kind, name, some & masks.get(kind, rows["used"])) for kind, name, some in slices]


@dataclass
class PairSums:
    """Sums of the difference of two references over some reports."""

    first: str
    second: str
    days: int  # of the archive
    reports: int = 0
    distance: float = 0.0  # summed wind vector difference, m/s
    counted: int = 0  # aircraft in ``common``
    # number, coefficients (5,) in radians, and their change by each day (day, 5)
    aircraft: list[tuple[int, Floats, Floats]] = field(default_factory=list)

    def __post_init__(self) -> None:
        # (3, region, day): reports, and their summed differences eastward and northward
        self.regions = np.zeros((3, REGIONS, self.days))
        # (day, 5, 6): equations of the difference that the fleet has in common
        self.common = np.zeros((self.days, 5, 6))
        self.squares = np.zeros(self.days)  # halved squares of the difference, m2/s2

    def add(self, rows: Columns, selected: Mask, aircraft: int | None = None) -> None:
        """Add the chosen reports of one aircraft; ``aircraft`` also requests its difference."""
        if not selected.any():
            return
        du, dv = (rows[f"wind {self.first}"] - rows[f"wind {self.second}"])[:, selected]
        day = rows["day"][selected]
        self.reports += du.size
        self.distance += float(np.hypot(du, dv).sum())
        self.squares += np.bincount(day, (du**2 + dv**2) / 2.0, self.days)
        cell = rows["region"][selected] * self.days + day
        sums = [np.bincount(cell, weights, REGIONS * self.days) for weights in (None, du, dv)]
        self.regions += np.reshape(sums, self.regions.shape)
        if du.size < FEWEST_REPORTS:
            return
        heading, magnetic = rows["heading"][selected], rows["magnetic_heading"][selected]
        cross, along = paired_design(magnetic, heading, rows["airspeed"][selected])
        # psi_err is n . (W_ref - W_rep) / V, and |V_A| - |V'_A| is h . (W_ref - W_rep)
        y_along, y_cross = along_cross(du, dv, heading)
        # normal matrix and, last, the right side of each day: (day, p, p + 1)
        order = np.argsort(day, kind="stable")
        days, start = np.unique(day[order], return_index=True)
        pairs = (cross, y_cross), (along, y_along)
        sides = [np.column_stack([*design, y])[order] for design, y in pairs]
        edges = pairwise([*start.tolist(), order.size])
        equations = np.array([sum(p[i:j, :-1].T @ p[i:j] for p in sides) for i, j in edges])
        self.common[days] += common_equations(equations)
        self.counted += 1
        if aircraft is not None and days.size >= FEWEST_DAYS:
            values, influence = solved(equations)
            self.aircraft.append((aircraft, values[:5], influence[:, :5]))


def common_equations(equations: Floats) -> Floats:
    """Equations (day, 5, 6) of A to E only, from those of one aircraft, (day, 8, 9).

    The airspeed scale and the bias are eliminated. The equations of all aircraft add up, day by
    day: parameters that an aircraft cannot determine (few reports, few headings) have no weight.
    """
    total = equations.sum(axis=0)
    rest = np.linalg.pinv(total[5:, 5:-1], hermitian=True) @ total[5:]
    keep = np.vstack([np.eye(5), -rest[:, :5]])
    right = equations[:, :, -1] - equations[:, :, 5:-1] @ rest[:, -1]
    square = keep.T @ equations[:, :, :-1] @ keep
    return np.concatenate([square, (right @ keep)[:, :, np.newaxis]], axis=2)


def solved(equations: Floats) -> tuple[Floats, Floats]:
    """Least-squares solution (p,) of equations (day, p, p + 1), and the influence of each day.

    The outer products of the influences, (day, p), sum to the covariance clustered by day.
    """
    days = len(equations)
    # pseudo-inverse: coefficients that few headings cannot determine stay zero
    inverse = np.linalg.pinv(equations[:, :, :-1].sum(axis=0), hermitian=True)
    values = inverse @ equations[:, :, -1].sum(axis=0)
    score = equations[:, :, -1] - equations[:, :, :-1] @ values
    return values, score @ inverse * np.sqrt(days / max(days - 1.0, 1.0))


def wald(values: Floats, covariance: Floats, clusters: int) -> float:
    """P value that values (q,) differ from zero, for a covariance (q, q) from few clusters.

    From Hotelling's T2 with ``clusters - 1`` degrees of freedom; NaN when there are not more
    clusters than values.
    """
    size = values.size
    if clusters <= size + 1 or not np.all(np.isfinite(covariance)):
        return float("nan")
    statistic = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    scaled = statistic * (clusters - size) / (size * (clusters - 1.0))
    return float(special.fdtrc(size, clusters - size, scaled))


def persistent_covariance(influence: Floats, day: Ints) -> Floats:
    """Covariance (p, p) of a sum over days whose errors last longer than a day.

    ``influence`` is (day, p), ``day`` the increasing calendar days; gaps count. The correlation
    over `_LAG` days has weights that decrease to zero (Newey & West 1987, Econometrica 55,
    703-708); variances are not smaller than without the lags.
    """
    filled = np.zeros((int(day[-1] - day[0]) + 1, influence.shape[1]))
    filled[day - day[0]] = influence
    square = filled.T @ filled
    total = square.copy()
    for shift in range(1, min(_LAG, filled.shape[0] - 1) + 1):
        product = filled[shift:].T @ filled[:-shift]
        total += (1.0 - shift / (_LAG + 1.0)) * (product + product.T)
    # correlations of few days come out negative by chance
    wider = np.sqrt(np.maximum(np.diag(total) / np.maximum(np.diag(square), 1e-300), 1.0))
    return np.asarray(square * np.outer(wider, wider))


def regional_bias(sums: Floats) -> list[Content]:
    """Mean wind difference of two references by region, and relative to the other regions.

    The errors of two models are shared by regions and last for days. Each region is therefore also
    compared with the others on the same days (``contrast``: common differences cancel), and the
    errors are clustered by blocks of five days or more, with Student's t for their number
    (Ibragimov & Mueller 2010, J. Bus. Econ. Stat. 28, 453-468). Holm's adjustment (1979, Scand. J.
    Stat. 6, 65-70) covers all regions, components and both tests. ``sums`` is (3, region, day):
    reports, and their summed differences eastward and northward, m/s.
    """
    number = sums[0]
    seen = np.flatnonzero(number.any(axis=0))
    block = np.zeros(number.shape[1], dtype=np.int64)
    if seen.size:
        # five days exceed the persistence of the weather; under six blocks Student's quantile is
        # wide, and beyond twelve it is hardly narrower
        length = int(np.ptp(seen)) + 1
        block[seen] = (seen - seen[0]) * int(np.clip(length // 5, 6, 12)) // length
    entries: list[Content] = []
    for region in np.flatnonzero(np.count_nonzero(number, axis=1) >= _MIN_REGION_DAYS):
        count = number[region]
        elsewhere = number.sum(axis=0) - count
        shared = (count > 0) & (elsewhere > 0)
        for component, values in zip(COMPONENTS, sums[1:], strict=True):
            entry: Content = {
                "region": int(region),
                "component": component,
                "days": int(np.count_nonzero(count)),
                **_block_mean("difference", values[region], count, block),
                "contrast": None,
                "contrast_p_value": None,
            }
            if np.unique(block[shared]).size >= 4:
                rest = values.sum(axis=0) - values[region]
                less = values[region][shared] - count[shared] * rest[shared] / elsewhere[shared]
                entry |= _block_mean("contrast", less, count[shared], block[shared])
            entries.append(entry)
    tests = ("difference", "contrast")
    p_values = np.array([[entry[f"{name}_p_value"] for name in tests] for entry in entries], float)
    p_values = p_values.reshape(-1)  # None is NaN, and stays so
    adjusted, order = np.full(p_values.size, np.nan), np.argsort(p_values)
    order = order[np.isfinite(p_values[order])]
    steps = p_values[order] * np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    for entry, pair in zip(entries, adjusted.reshape(-1, 2).tolist(), strict=True):
        entry |= {f"{name}_adjusted_p_value": p for name, p in zip(tests, pair, strict=True)}
    return entries


def _block_mean(name: str, total: Floats, number: Floats, block: Ints) -> dict[str, float]:
    """Mean, standard error clustered by block and two-sided p value, from sums by day."""
    some = number > 0
    mean = float(total[some].sum() / number[some].sum())
    rest = np.bincount(block[some], total[some] - mean * number[some])
    freedom = np.unique(block[some]).size - 1
    error = p_value = float("nan")
    if freedom:
        error = float(np.sqrt((rest**2).sum() * (freedom + 1.0) / freedom) / number[some].sum())
        # two references with the same wind have a difference of exactly zero
        p_value = float(2 * special.stdtr(freedom, -abs(mean) / max(error, 1e-12)))
    return {name: mean, f"{name}_standard_error": error, f"{name}_p_value": p_value}


def _judged(sums: PairSums, barred: set[str]) -> Content:
    # difference that the fleet has in common, with the errors that aircraft share by day
    fleet: Content = {"aircraft": 0, "p_value": np.nan, "curve_rms_deg": np.nan}
    days = np.flatnonzero(sums.common.any(axis=(1, 2)))
    if days.size:
        mean, influence = solved(sums.common[days])
        covariance = persistent_covariance(influence, days)
        # rms over the compass of A + B sin + C cos + D sin 2 + E cos 2
        rms = np.degrees(np.sqrt(mean[0] ** 2 + (mean[1:] ** 2).sum() / 2.0))
        fleet = {
            "aircraft": sums.counted,
            "difference": _by_name(mean),
            "standard_error": _by_name(np.sqrt(np.diag(covariance))),
            "curve_rms_deg": float(rms),
            "p_value": wald(mean, covariance, days.size),
        }
    regions = regional_bias(sums.regions)
    return {
        "references": [sums.first, sums.second],
        "reports": sums.reports,
        "mean_vector_difference_m_s": sums.distance / sums.reports if sums.reports else np.nan,
        "fleet": fleet,
        "regions": regions,
        **_verdict(fleet, regions, {sums.first.lower(), sums.second.lower()} & barred),
    }


def _verdict(fleet: Content, regions: list[Content], barred: set[str]) -> Content:
    """Whether a pair may be pooled (None with too few days or reports), and why."""
    p_value, rms = fleet["p_value"], fleet["curve_rms_deg"]
    if not np.isfinite(p_value):
        return {"poolable": None, "why": "too few days or reports for a test"}
    why = []
    significant = p_value < SIGNIFICANCE
    curves = f"the deviation curves differ by {rms:.2f} degrees rms"
    if significant and rms > CURVE_RMS_DEG:
        why.append(f"{curves} (p = {p_value:.2g})")
    biased = [
        (abs(entry[name]), name, entry)
        for entry in regions
        for name in ("difference", "contrast")
        if entry[name] is not None
        and entry[f"{name}_adjusted_p_value"] < SIGNIFICANCE
        and abs(entry[name]) > REGION_BIAS
    ]
    if biased:
        _, name, entry = max(biased, key=lambda item: item[0])
        relative = " more than elsewhere" if name == "contrast" else ""
        why.append(
            f"the {entry['component']} wind differs by {entry[name]:.2f} +- "
            f"{entry[f'{name}_standard_error']:.2f} m/s in region {entry['region']}{relative}"
        )
    if barred:
        why.append(f"{', '.join(sorted(barred))} is in never_pool")
    if why:
        return {"poolable": False, "why": "; ".join(why)}
    # no test shows that two references are equal
    beyond = f"beyond error but less than {CURVE_RMS_DEG:g}" if significant else "not beyond error"
    return {
        "poolable": True,
        "why": f"{curves}, {beyond} (p = {p_value:.2g}, tested at {SIGNIFICANCE:g}); no region's "
        f"mean wind differs by more than {REGION_BIAS:g} m/s beyond error",
    }


def _by_name(coefficients: Floats) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, np.degrees(coefficients).tolist(), strict=True))


def _aircraft_entry(number: int, values: Floats, influence: Floats, fits: xr.Dataset) -> Content:
    """Differences of one aircraft in degrees, with 95 % intervals; fits of both references."""
    covariance = influence.T @ influence
    difference, errors = _by_name(values), _by_name(np.sqrt(np.diag(covariance)))
    pair = fits.isel(aircraft=number)
    # B = amplitude cos(phase), C = amplitude sin(phase): the delta method
    phase, amplitude = np.radians(float(pair["phase"].mean())), float(pair["amplitude"].mean())
    gradients = {
        "offset": np.array([1.0, 0.0, 0.0]),
        "amplitude": np.array([0.0, np.cos(phase), np.sin(phase)]),
        "phase": np.degrees(np.array([0.0, -np.sin(phase), np.cos(phase)]) / amplitude),
    }
    block = np.degrees(np.degrees(covariance))[:3, :3]
    entry: Content = {
        "aircraft": str(pair["aircraft"].item()),
        "p_value": wald(values, covariance, len(influence)),
        "difference": difference,
        "standard_error": errors,
        "ci": {name: normal_interval(difference[name], errors[name]) for name in COEFFICIENTS},
    }
    for name, gradient in gradients.items():
        change = -np.diff(pair[name])[0]
        change = float(wrap_degrees(change) if name == "phase" else change)
        wide = float(np.sqrt(gradient @ block @ gradient))
        ends = normal_interval(change, wide)
        entry[name] = {"difference": change, "standard_error": wide, "ci": ends}
    return entry


def hats_of(
    count: Floats, squares: Mapping[tuple[str, str], Floats], names: list[str]
) -> list[Content]:
    """Error of each of three references, for every triple of the names.

    ``count`` of reports and the summed halved ``squares`` of the difference of each pair (m2/s2)
    are by day. ``component_rms`` is None where the variance came out negative;
    ``variance_standard_error`` is that of a jackknife over days.
    """
    if count.sum() < FEWEST_OF_HAT:
        return []
    seen = count > 0
    count = count[seen]
    hats = []
    corner = 0.5 * np.array([[1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
    for triple in combinations(names, 3):
        total = np.array([squares[pair][seen] for pair in combinations(triple, 2)])
        variances, errors = corner @ (total.sum(1) / count.sum()), np.full(3, np.nan)
        if count.size > 1:
            without = (total.sum(1, keepdims=True) - total) / (count.sum() - count)
            errors = np.sqrt(np.var(corner @ without, axis=1) * (count.size - 1.0))
        entries = [
            {
                "reference": name,
                "variance": float(variance),
                "variance_standard_error": float(error),
                "component_rms": float(np.sqrt(variance)) if variance > 0 else None,
            }
            for name, variance, error in zip(triple, variances, errors, strict=True)
        ]
        content: Content = {"references": list(triple), "reports": int(count.sum())}
        hats.append(content | {"errors": entries})
    return hats
