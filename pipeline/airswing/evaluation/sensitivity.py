"""How far the fits depend on the reference: every reference fitted on the same reports.

Assumes the reports' own errors are the same whichever reference they are held against, so the
difference of two fits owes nothing to them (see :mod:`airswing.evaluation.pairs`). Two
references may be pooled when neither their deviation curves nor their winds, region by region,
differ beyond error by more than a size that matters: 0.2 degrees rms over the compass, or
0.4 m/s in a region's mean wind, by itself or against the other regions on the same days. The seed
paper pooled RUC and RR because "separate fits agreed".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.pairs import (
    COEFFICIENTS,
    clustered_difference,
    holm,
    paired_design,
    persistent_covariance,
    regional_bias,
    wald,
)
from airswing.evaluation.threeway import three_cornered_hat
from airswing.ragged import aircraft_of_report
from airswing.vocabulary import PHASE, SCREENING

SIGNIFICANCE = 0.02
"""Of each of the two tests, curves and winds: equal references pass both 95 times of 100."""
CURVE_RMS_DEG = 0.2
REGION_BIAS = 0.4
MIN_STRATUM = 500
NAMES = ("A", "B", "C", "D", "E")
SEASONS = ("DJF", "MAM", "JJA", "SON")


@dataclass(frozen=True)
class _Rows:
    """Plain columns of the reports all references share, radians and SI."""

    aircraft: NDArray[np.int64]
    day: NDArray[np.int64]
    month: NDArray[np.int64]
    region: NDArray[np.int64]
    phase: NDArray[np.int64]
    pressure: NDArray[np.float64]
    heading: NDArray[np.float64]
    magnetic: NDArray[np.float64]
    airspeed: NDArray[np.float64]
    u: dict[str, NDArray[np.float64]]
    v: dict[str, NDArray[np.float64]]
    lead: dict[str, NDArray[np.float64]]
    kept: NDArray[np.bool_]
    kept_any_phase: NDArray[np.bool_]


def compare(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    never_pool: list[str] | None = None,
    **fit_options: Any,
) -> dict[str, Any]:
    """Fit every reference and pool on the same reports and judge each pair of references.

    Parameters
    ----------
    headings : Dataset
        Screened headings with two references or more.
    pools : mapping of str to list of str
        Members of each reference and pool.
    never_pool : list of str, optional
        References that may be compared but never called poolable.
    **fit_options
        As for :func:`airswing.compass.deviation.fit_deviation`.

    Returns
    -------
    dict
        The content of ``sensitivity.json``: ``reports`` shared, ``pairs`` with differences,
        intervals and a verdict, the same ``by_lead_time``, ``by_phase``, ``by_level`` and
        ``by_season``, and ``three_way``.

    Raises
    ------
    InputError
        If there is one reference only, or no report has all of them.
    """
    singles = [name for name, members in pools.items() if len(members) == 1]
    if len(singles) < 2:
        raise InputError(
            "a comparison needs two references",
            field="references",
            found=", ".join(singles) or "none",
            remedy="Add another reference to the configuration",
        )
    shared = _shared(headings)
    rows = _rows(shared, pools)
    if not rows.kept.any():
        raise InputError(
            "no screened report has a wind of every reference",
            field="references",
            found=", ".join(singles),
            remedy="Check that the references cover the same times and places",
        )
    fits = fit_deviation(shared, pools=pools, **fit_options)
    barred = {name.lower() for name in never_pool or []}
    pairs = [_judge(rows, fits, one, two, rows.kept, barred) for one, two in _pairs(singles, pools)]
    return {
        "reports": int(rows.kept.sum()),
        "references": list(pools),
        "pairs": pairs,
        **_strata(rows, singles, barred),
        "three_way": three_cornered_hat(
            np.array([rows.u[name][rows.kept] for name in singles]),
            np.array([rows.v[name][rows.kept] for name in singles]),
            singles,
            rows.day[rows.kept],
        ),
    }


def _pairs(singles: list[str], pools: Mapping[str, list[str]]) -> list[tuple[str, str]]:
    """Every two references, and every pool against each of its members."""
    inside = [
        (name, member) for name, members in pools.items() if len(members) > 1 for member in members
    ]
    return [*combinations(singles, 2), *inside]


def _shared(headings: xr.Dataset) -> xr.Dataset:
    """Mark reports that lack any reference, so that every fit sees the same reports."""
    lacking = headings["reference_eastward_wind"].isnull().any("reference").to_numpy()
    screening = headings["screening"].to_numpy().copy()
    screening[lacking] |= SCREENING["no_reference"]
    return headings.assign(screening=("report", screening))


def _rows(ds: xr.Dataset, pools: Mapping[str, list[str]]) -> _Rows:
    time = ds["time"].to_numpy()
    u, v, lead = {}, {}, {}
    for name, members in pools.items():
        winds = reference_mean(ds, members)
        u[name] = winds["reference_eastward_wind"].to_numpy().astype(float)
        v[name] = winds["reference_northward_wind"].to_numpy().astype(float)
        lead[name] = ds["lead_time"].sel(reference=members).mean("reference").to_numpy()
    month = time.astype("datetime64[M]").astype(np.int64) % 12
    heading = np.radians(ds["heading"].to_numpy().astype(float))
    screening = ds["screening"].to_numpy()
    return _Rows(
        aircraft=aircraft_of_report(ds),
        day=time.astype("datetime64[D]").astype(np.int64),
        month=month,
        region=_regions(ds["latitude"].to_numpy(), ds["longitude"].to_numpy()),
        phase=ds["phase"].to_numpy().astype(np.int64),
        pressure=ds["pressure"].to_numpy().astype(float),
        heading=heading,
        magnetic=np.radians(ds["magnetic_heading"].to_numpy().astype(float)),
        airspeed=ds["airspeed"].to_numpy().astype(float),
        u=u,
        v=v,
        lead=lead,
        kept=(screening == 0) & np.isfinite(heading),
        kept_any_phase=((screening & ~SCREENING["phase"]) == 0) & np.isfinite(heading),
    )


def _regions(latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> NDArray[np.int64]:
    """Nine regions with about as many reports each: thirds by latitude, then by longitude."""
    row = np.searchsorted(np.nanquantile(latitude, [1 / 3, 2 / 3]), latitude)
    column = np.zeros_like(row)
    for band in range(3):
        here = row == band
        if here.any():
            edges = np.nanquantile(longitude[here], [1 / 3, 2 / 3])
            column[here] = np.searchsorted(edges, longitude[here])
    return np.asarray(row * 3 + column, dtype=np.int64)


def _judge(
    rows: _Rows,
    fits: xr.Dataset | None,
    one: str,
    two: str,
    chosen: NDArray[np.bool_],
    barred: set[str],
) -> dict[str, Any]:
    """Differences, tests and the verdict of one pair over some reports."""
    du, dv = rows.u[one][chosen] - rows.u[two][chosen], rows.v[one][chosen] - rows.v[two][chosen]
    aircraft, fleet = _by_aircraft(rows, fits, one, two, chosen, du, dv)
    regions = regional_bias(du, dv, rows.region[chosen], rows.day[chosen])
    biased = _biased(regions)
    return {
        "references": [one, two],
        "reports": int(chosen.sum()),
        "mean_vector_difference_m_s": float(np.mean(np.hypot(du, dv))),
        "fleet": fleet,
        "aircraft": aircraft,
        "regions": regions,
        **_verdict(fleet, biased, {one.lower(), two.lower()} & barred),
    }


def _biased(regions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Regions whose mean wind differs beyond error and by a size that matters.

    Every region is tested by its own difference and by its contrast to the other regions; Holm's
    adjustment covers all of these tests.
    """
    keys = [(entry, name) for entry in regions for name in ("difference", "contrast")]
    p_values = [
        float("nan") if entry[f"{name}_p_value"] is None else entry[f"{name}_p_value"]
        for entry, name in keys
    ]
    biased = []
    for (entry, name), adjusted in zip(keys, holm(p_values), strict=True):
        entry[f"{name}_adjusted_p_value"] = adjusted
        if adjusted < SIGNIFICANCE and abs(entry[name]) > REGION_BIAS:
            biased.append({"of": name, "value": entry[name]} | entry)
    return biased


def _verdict(
    fleet: dict[str, Any], biased: list[dict[str, Any]], barred: set[str]
) -> dict[str, Any]:
    """Say whether the pair may be pooled, and why not."""
    why = []
    if not np.isfinite(fleet["p_value"]):
        return {"poolable": None, "why": "too few days or reports to tell"}
    if fleet["p_value"] < SIGNIFICANCE and fleet["curve_rms_deg"] > CURVE_RMS_DEG:
        why.append(
            f"the deviation curves differ by {fleet['curve_rms_deg']:.2f} degrees rms "
            f"(p = {fleet['p_value']:.2g})"
        )
    if biased:
        worst = max(biased, key=lambda entry: abs(entry["value"]))
        beside = " more than elsewhere" if worst["of"] == "contrast" else ""
        why.append(
            f"the {worst['component']} wind differs by {worst['value']:.2f} +- "
            f"{worst[worst['of'] + '_standard_error']:.2f} m/s in region {worst['region']}{beside}"
        )
    if barred:
        why.append(f"{', '.join(sorted(barred))} is in never_pool")
    return {"poolable": not why, "why": "; ".join(why) or "they agree within error"}


def _by_aircraft(
    rows: _Rows,
    fits: xr.Dataset | None,
    one: str,
    two: str,
    chosen: NDArray[np.bool_],
    du: NDArray[np.float64],
    dv: NDArray[np.float64],
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Difference of the coefficients per aircraft and over the fleet, with their tests."""
    heading = rows.heading[chosen]
    cross, along = paired_design(rows.magnetic[chosen], heading, rows.airspeed[chosen])
    # psi_err is n . (W_ref - W_rep) / V, and |V_A| - |V'_A| is h . (W_ref - W_rep).
    y_cross = du * np.cos(heading) - dv * np.sin(heading)
    y_along = du * np.sin(heading) + dv * np.cos(heading)
    which, days = rows.aircraft[chosen], rows.day[chosen]
    day_names, day = np.unique(days, return_inverse=True)
    total, influence = [], []
    found = []
    for index in np.unique(which):
        here = which == index
        if here.sum() < 50:
            continue
        values, moved, clusters = clustered_difference(
            cross[here], along[here], y_cross[here], y_along[here], day[here]
        )
        spread = np.zeros((day_names.size, COEFFICIENTS))
        spread[np.unique(day[here])] = moved[:, :COEFFICIENTS]
        covariance = spread.T @ spread
        total.append(values[:COEFFICIENTS])
        influence.append(spread)
        found.append(_entry(int(index), fits, one, two, values, covariance, clusters))
    return found, _fleet(total, influence, day_names)


def _entry(
    index: int,
    fits: xr.Dataset | None,
    one: str,
    two: str,
    values: NDArray[np.float64],
    covariance: NDArray[np.float64],
    clusters: int,
) -> dict[str, Any]:
    """Differences of one aircraft in degrees, with 95 % intervals."""
    degrees, error = np.degrees(values[:COEFFICIENTS]), np.degrees(np.sqrt(np.diag(covariance)))
    entry: dict[str, Any] = {
        "p_value": wald(values[:COEFFICIENTS], covariance, clusters),
        "difference": dict(zip(NAMES, degrees, strict=True)),
        "standard_error": dict(zip(NAMES, error, strict=True)),
        "ci": {
            name: [value - 1.96 * wide, value + 1.96 * wide]
            for name, value, wide in zip(NAMES, degrees, error, strict=True)
        },
    }
    if fits is not None:
        entry["aircraft"] = str(fits["aircraft"].to_numpy()[index])
        entry |= _sinusoid_difference(fits, one, two, index, np.degrees(np.degrees(covariance)))
    return entry


def _sinusoid_difference(
    fits: xr.Dataset, one: str, two: str, index: int, covariance: NDArray[np.float64]
) -> dict[str, Any]:
    """Differences of the published offset, amplitude and phase, by the delta method."""
    pair = fits.isel(aircraft=index).sel(reference=[one, two])
    change = {name: float(-np.diff(pair[name])[0]) for name in ("offset", "amplitude", "phase")}
    change["phase"] = float((change["phase"] + 180.0) % 360.0 - 180.0)
    phase = np.radians(float(pair["phase"].mean()))
    size = float(pair["amplitude"].mean())
    # B = amplitude cos(phase), C = amplitude sin(phase).
    along = np.array([np.cos(phase), np.sin(phase)])
    around = np.degrees(np.array([-np.sin(phase), np.cos(phase)]) / size)
    block = covariance[1:3, 1:3]
    errors = {
        "offset": np.sqrt(covariance[0, 0]),
        "amplitude": np.sqrt(along @ block @ along),
        "phase": np.sqrt(around @ block @ around),
    }
    return {
        name: {
            "difference": change[name],
            "standard_error": float(errors[name]),
            "ci": [change[name] - 1.96 * errors[name], change[name] + 1.96 * errors[name]],
        }
        for name in change
    }


def _fleet(
    total: list[NDArray[np.float64]],
    influence: list[NDArray[np.float64]],
    days: NDArray[np.int64],
) -> dict[str, Any]:
    """Mean difference over the fleet, honouring that aircraft share the days' errors."""
    if not total:
        return {"aircraft": 0, "p_value": float("nan"), "curve_rms_deg": float("nan")}
    mean, moved = np.mean(total, axis=0), np.mean(influence, axis=0)
    covariance = persistent_covariance(moved, days)
    # rms over the compass of A + B sin + C cos + D sin 2 + E cos 2.
    rms = np.degrees(np.sqrt(mean[0] ** 2 + (mean[1:] ** 2).sum() / 2.0))
    return {
        "aircraft": len(total),
        "difference": dict(zip(NAMES, np.degrees(mean), strict=True)),
        "standard_error": dict(zip(NAMES, np.degrees(np.sqrt(np.diag(covariance))), strict=True)),
        "curve_rms_deg": float(rms),
        "p_value": wald(mean, covariance, days.size),
    }


def _strata(rows: _Rows, singles: list[str], barred: set[str]) -> dict[str, Any]:
    """The same judgement within slices of the reports."""
    phases = {code: name for name, code in PHASE.items()}
    slices: dict[str, Callable[[str, str], dict[str, NDArray[np.bool_]]]] = {
        "by_lead_time": lambda one, two: _lead_slices(rows.lead[one], rows.lead[two]),
        "by_phase": lambda one, two: {
            phases[int(code)]: rows.phase == code for code in np.unique(rows.phase)
        },
        "by_level": lambda one, two: {
            "below 700 hPa": rows.pressure > 70000.0,
            "700 to 500 hPa": (rows.pressure <= 70000.0) & (rows.pressure > 50000.0),
            "above 500 hPa": rows.pressure <= 50000.0,
        },
        "by_season": lambda one, two: {
            name: ((rows.month + 1) % 12) // 3 == number for number, name in enumerate(SEASONS)
        },
    }
    found: dict[str, Any] = {}
    for title, make in slices.items():
        found[title] = []
        for one, two in combinations(singles, 2):
            for name, mask in make(one, two).items():
                chosen = mask & (rows.kept_any_phase if title == "by_phase" else rows.kept)
                if chosen.sum() < MIN_STRATUM:
                    continue
                entry = _judge(rows, None, one, two, chosen, barred)
                entry.pop("aircraft")
                found[title].append({"slice": name} | entry)
    return found


def _lead_slices(
    one: NDArray[np.float64], two: NDArray[np.float64]
) -> dict[str, NDArray[np.bool_]]:
    longer = np.fmax(one, two)
    return {
        "analysis to 1 h": longer <= 1.0,
        "1 to 6 h": (longer > 1.0) & (longer <= 6.0),
        "over 6 h": longer > 6.0,
    }
