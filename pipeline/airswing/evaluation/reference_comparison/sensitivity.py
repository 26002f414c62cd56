"""How far the fits depend on the reference: every reference fitted on the same reports.

Assumes the reports' own errors are the same whichever reference they are held against, so the
difference of two fits owes nothing to them (see
:mod:`airswing.evaluation.reference_comparison.pairs`). Two references may be pooled when neither
their deviation curves nor their winds, region by region, differ beyond error by more than a size
that matters: 0.2 degrees rms over the compass, or 0.4 m/s in a region's mean wind, by itself or
against the other regions on the same days. The seed paper pooled RUC and RR because "separate fits
agreed".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from math import comb
from typing import Literal, NamedTuple, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation.backtest.folds import only
from airswing.evaluation.disagreement import member_mean, reference_mean
from airswing.evaluation.reference_comparison.pairs import (
    common_difference,
    holm,
    persistent_covariance,
    regional_bias,
    wald,
)
from airswing.evaluation.reference_comparison.pairsums import AircraftPair, PairSums, Regions, Rows
from airswing.evaluation.reference_comparison.threeway import hat_sums, hats_of
from airswing.evaluation.results import Content
from airswing.flags import PHASE, SCREENING
from airswing.physics.triangle import wrap_degrees
from airswing.products.findings import findings
from airswing.products.ragged import blocks, row_bounds, time_span
from airswing.units import NORMAL_95

# Of each of the two tests, curves and winds: equal references pass both 95 times of 100.
_SIGNIFICANCE = 0.02
# Degrees and m/s: a smaller difference does not matter, however sure it is.
_CURVE_RMS_DEG = 0.2
_REGION_BIAS = 0.4
# Reports of a slice that is judged by itself.
_MIN_STRATUM = 500
NAMES = ("A", "B", "C", "D", "E")
_COLUMNS = (
    "time",
    "latitude",
    "longitude",
    "pressure",
    "phase",
    "heading",
    "magnetic_heading",
    "airspeed",
    "screening",
    "lead_time",
    "reference_eastward_wind",
    "reference_northward_wind",
)
_SEASONS = ("DJF", "MAM", "JJA", "SON")
# What the reports are sliced by.
_Kind = Literal["by_lead_time", "by_phase", "by_level", "by_season"]


def compare(
    headings: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    never_pool: list[str] | None = None,
    **fit_options: Unpack[FitOptions],
) -> Content:
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
        As for :func:`airswing.compass.fit.deviation.fit_deviation`.

    Returns
    -------
    SensitivityContent
        A dict with the content of ``sensitivity.json``: ``reports`` shared, ``pairs`` with
        differences, intervals and a verdict (``own_test`` false where a pool stands against its
        member: their difference is made of the members'), the same ``by_lead_time``,
        ``by_phase``, ``by_level`` and ``by_season``, and ``three_way``.

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
    shared = only(headings, _has_all, columns=("reference_eastward_wind",))
    regions = Regions.of(headings)
    fits = fit_deviation(shared, pools=pools, **fit_options)
    first, last = (day.astype("datetime64[D]").astype(np.int64) for day in time_span(headings))
    days = int(last - first) + 1
    whole = {pair: PairSums(*pair, days) for pair in _pairs(singles, pools)}
    slices: dict[tuple[_Kind, str, tuple[str, str]], PairSums] = {}
    hats, number = np.zeros((comb(len(singles), 3), 4, days)), 0
    for block in blocks(shared, _COLUMNS):
        for rows in _aircraft_rows(block, pools, regions, int(first), number):
            for sums in whole.values():
                sums.add(rows, rows.kept)
            for pair in combinations(singles, 2):
                for title, name, chosen in _slices(rows, *pair):
                    slices.setdefault((title, name, pair), PairSums(*pair, days)).add(rows, chosen)
            u, v = (np.array([part[name] for name in singles]) for part in (rows.u, rows.v))
            hats += hat_sums(u[:, rows.kept], v[:, rows.kept], rows.day[rows.kept], days)
        number += block.sizes["aircraft"]
    reports = next(iter(whole.values())).reports
    if not reports:
        raise InputError(
            "no screened report has a wind of every reference",
            field="references",
            found=", ".join(singles),
            remedy="Check that the references cover the same times and places",
        )
    barred = {name.lower() for name in never_pool or []}
    strata = _strata(slices, singles, barred)
    content: Content = {
        "reports": reports,
        "references": list(pools),
        "pairs": [
            _judge(sums, fits, barred, own_test=set(pair) <= set(singles))
            for pair, sums in whole.items()
        ],
        "by_lead_time": strata["by_lead_time"],
        "by_phase": strata["by_phase"],
        "by_level": strata["by_level"],
        "by_season": strata["by_season"],
        "three_way": hats_of(hats, singles),
    }
    return findings(content)


def _pairs(singles: list[str], pools: Mapping[str, list[str]]) -> list[tuple[str, str]]:
    """Every two references, and every pool against each of its members."""
    inside = [
        (name, member) for name, members in pools.items() if len(members) > 1 for member in members
    ]
    return [*combinations(singles, 2), *inside]


def _has_all(reports: xr.Dataset) -> NDArray[np.bool_]:
    """Reports that every reference has a wind at, so that every fit sees the same reports."""
    wind = reports["reference_eastward_wind"]
    return np.asarray(wind.notnull().all("reference").to_numpy())


def _aircraft_rows(
    ds: xr.Dataset, pools: Mapping[str, list[str]], regions: Regions, first: int, number: int
) -> Iterator[Rows]:
    """Plain columns of each aircraft of a block, the first of which has this number."""
    time = ds["time"].to_numpy()
    winds = {name: reference_mean(ds, members) for name, members in pools.items()}
    lead = {
        name: member_mean(ds["lead_time"].sel(reference=members)).to_numpy()
        for name, members in pools.items()
    }
    heading, magnetic = (
        np.radians(ds[name].to_numpy().astype(float)) for name in ("heading", "magnetic_heading")
    )
    airspeed, screening = ds["airspeed"].to_numpy().astype(float), ds["screening"].to_numpy()
    known = np.isfinite(heading + magnetic + airspeed)
    together = Rows(
        number,
        day=time.astype("datetime64[D]").astype(np.int64) - first,
        # months count from January 1970
        month=time.astype("datetime64[M]").astype(np.int64) % 12,
        region=regions.at(ds),
        phase=ds["phase"].to_numpy().astype(np.int64),
        pressure=ds["pressure"].to_numpy().astype(float),
        heading=heading,
        magnetic=magnetic,
        airspeed=airspeed,
        kept=(screening == 0) & known,
        kept_any_phase=((screening & ~SCREENING["phase"]) == 0) & known,
        u={k: w["reference_eastward_wind"].to_numpy().astype(float) for k, w in winds.items()},
        v={k: w["reference_northward_wind"].to_numpy().astype(float) for k, w in winds.items()},
        lead=lead,
    )
    for k, bounds in enumerate(zip(*row_bounds(ds["row_size"].to_numpy()), strict=True)):
        yield together.of_aircraft(number + k, slice(*map(int, bounds)))


def _judge(
    sums: PairSums, fits: xr.Dataset | None, barred: set[str], *, own_test: bool = True
) -> Content:
    """Differences, tests and the verdict of one pair over some reports.

    Without a test of its own: a pool against one of its members, whose difference is made of those
    of the members.
    """
    one, two = sums.one, sums.two
    fleet = _fleet(sums)
    regions = regional_bias(sums.regions)
    verdict = _verdict(fleet, _biased(regions), {one.lower(), two.lower()} & barred)
    return {
        "references": [one, two],
        "reports": sums.reports,
        "mean_vector_difference_m_s": sums.distance / sums.reports if sums.reports else np.nan,
        "fleet": fleet,
        "aircraft": [_entry(own, fits, one, two) for own in sums.aircraft],
        "regions": regions,
        "own_test": own_test,
        "poolable": verdict["poolable"],
        "why": verdict["why"],
    }


class _Biased(NamedTuple):
    """A test that a region's mean wind fails; m/s."""

    of: str  # the difference, or the contrast to the other regions
    value: float
    error: float
    component: str
    region: int


def _biased(regions: list[Content]) -> list[_Biased]:
    """Regions whose mean wind differs beyond error and by a size that matters.

    Every region is tested by its own difference and by its contrast to the other regions; Holm's
    adjustment covers all of these tests.
    """
    p_values = [p for one in regions for p in (one["difference_p_value"], one["contrast_p_value"])]
    adjusted = holm([float("nan") if p is None else p for p in p_values])
    biased = []
    for entry, own, beside in zip(regions, adjusted[::2], adjusted[1::2], strict=True):
        entry["difference_adjusted_p_value"], entry["contrast_adjusted_p_value"] = own, beside
        where = entry["component"], entry["region"]
        value, error = entry["difference"], entry["difference_standard_error"]
        if own < _SIGNIFICANCE and abs(value) > _REGION_BIAS:
            biased.append(_Biased("difference", value, error, *where))
        contrast = entry["contrast"]
        if contrast is not None and beside < _SIGNIFICANCE and abs(contrast) > _REGION_BIAS:
            error = entry["contrast_standard_error"]
            biased.append(_Biased("contrast", contrast, error, *where))
    return biased


def _verdict(fleet: Content, biased: list[_Biased], barred: set[str]) -> Content:
    """Say whether the pair may be pooled, and why not."""
    why = []
    if not np.isfinite(fleet["p_value"]):
        return {"poolable": None, "why": "too few days or reports to tell"}
    if fleet["p_value"] < _SIGNIFICANCE and fleet["curve_rms_deg"] > _CURVE_RMS_DEG:
        why.append(
            f"the deviation curves differ by {fleet['curve_rms_deg']:.2f} degrees rms "
            f"(p = {fleet['p_value']:.2g})"
        )
    if biased:
        worst = max(biased, key=lambda one: abs(one.value))
        beside = " more than elsewhere" if worst.of == "contrast" else ""
        why.append(
            f"the {worst.component} wind differs by {worst.value:.2f} +- {worst.error:.2f} m/s "
            f"in region {worst.region}{beside}"
        )
    if barred:
        why.append(f"{', '.join(sorted(barred))} is in never_pool")
    return {"poolable": not why, "why": "; ".join(why) or _agreement(fleet)}


def _agreement(fleet: Content) -> str:
    """What was found of a pair that may be pooled: no test shows that two things are equal."""
    beyond = (
        f"beyond error but less than {_CURVE_RMS_DEG:g}"
        if fleet["p_value"] < _SIGNIFICANCE
        else "not beyond error"
    )
    return (
        f"the deviation curves differ by {fleet['curve_rms_deg']:.2f} degrees rms, {beyond} "
        f"(p = {fleet['p_value']:.2g}, judged at {_SIGNIFICANCE:g}); no region's wind differs by "
        f"more than {_REGION_BIAS:g} m/s beyond error"
    )


def _entry(own: AircraftPair, fits: xr.Dataset | None, one: str, two: str) -> Content:
    """Differences of one aircraft in degrees, with 95 % intervals."""
    values, clusters, index = own.values, own.days.size, own.number
    covariance = own.influence.T @ own.influence
    degrees, error = np.degrees(values), np.degrees(np.sqrt(np.diag(covariance)))
    entry: Content = {
        "p_value": wald(values, covariance, clusters),
        "difference": dict(zip(NAMES, degrees, strict=True)),
        "standard_error": dict(zip(NAMES, error, strict=True)),
        "ci": {
            name: [value - NORMAL_95 * wide, value + NORMAL_95 * wide]
            for name, value, wide in zip(NAMES, degrees, error, strict=True)
        },
    }
    if fits is not None:
        entry["aircraft"] = str(fits["aircraft"].to_numpy()[index])
        entry["offset"], entry["amplitude"], entry["phase"] = _sinusoid_difference(
            fits, one, two, index, np.degrees(np.degrees(covariance))
        )
    return entry


def _sinusoid_difference(
    fits: xr.Dataset, one: str, two: str, index: int, covariance: NDArray[np.float64]
) -> tuple[Content, Content, Content]:
    """Differences of the published offset, amplitude and phase, by the delta method."""
    pair = fits.isel(aircraft=index).sel(reference=[one, two])
    change = {name: float(-np.diff(pair[name])[0]) for name in ("offset", "amplitude", "phase")}
    change["phase"] = float(wrap_degrees(change["phase"]))
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

    def part(name: str) -> Content:
        half = NORMAL_95 * errors[name]
        return {
            "difference": change[name],
            "standard_error": float(errors[name]),
            "ci": [change[name] - half, change[name] + half],
        }

    return part("offset"), part("amplitude"), part("phase")


def _fleet(sums: PairSums) -> Content:
    """Difference the fleet has in common, honouring that aircraft share the days' errors."""
    days = np.flatnonzero(sums.common.any(axis=(1, 2)))
    if not days.size:
        return {"aircraft": 0, "p_value": float("nan"), "curve_rms_deg": float("nan")}
    mean, moved = common_difference(sums.common[days])
    covariance = persistent_covariance(moved, days)
    # rms over the compass of A + B sin + C cos + D sin 2 + E cos 2.
    rms = np.degrees(np.sqrt(mean[0] ** 2 + (mean[1:] ** 2).sum() / 2.0))
    return {
        "aircraft": sums.counted,
        "difference": dict(zip(NAMES, np.degrees(mean), strict=True)),
        "standard_error": dict(zip(NAMES, np.degrees(np.sqrt(np.diag(covariance))), strict=True)),
        "curve_rms_deg": float(rms),
        "p_value": wald(mean, covariance, days.size),
    }


def _slices(rows: Rows, one: str, two: str) -> Iterator[tuple[_Kind, str, NDArray[np.bool_]]]:
    """Slices of one aircraft's reports: of what kind, which, and the reports in it."""
    for name, mask in _lead_slices(rows.lead[one], rows.lead[two]).items():
        yield "by_lead_time", name, mask & rows.kept
    for name, code in PHASE.items():
        yield "by_phase", name, (rows.phase == code) & rows.kept_any_phase
    # Pa; between them the rest
    high, low = rows.pressure <= 50000.0, rows.pressure > 70000.0
    for name, mask in (
        ("below 700 hPa", low),
        ("700 to 500 hPa", ~high & ~low),
        ("above 500 hPa", high),
    ):
        yield "by_level", name, mask & rows.kept
    # months count from 0: December, January and February come first
    season = ((rows.month + 1) % 12) // 3
    for number, name in enumerate(_SEASONS):
        yield "by_season", name, (season == number) & rows.kept


def _strata(
    slices: Mapping[tuple[_Kind, str, tuple[str, str]], PairSums],
    singles: list[str],
    barred: set[str],
) -> Content:
    """The same judgement within slices of the reports."""
    found: Content = {"by_lead_time": [], "by_phase": [], "by_level": [], "by_season": []}
    for pair in combinations(singles, 2):
        for (title, name, own), sums in slices.items():
            if own != pair or sums.reports < _MIN_STRATUM:
                continue
            entry = _judge(sums, None, barred)
            entry.pop("aircraft")
            found[title].append({"slice": name, **entry})
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
