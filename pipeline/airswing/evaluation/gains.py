"""Gain of correcting each aircraft: expected from its fit, and realised on reports not used in it.

*Expected gain.* The reduction of the mean wind vector disagreement. On the reports of the fit it is
too large: a curve with error variance s^2 in the wind reduces the residual variance it was fitted
to by s^2 and adds s^2 to any other. That optimism (Efron 2004, J. Amer. Stat. Assoc. 99, 619-632)
is subtracted, to first order: 2 s^2 pi / (8 |e|) from the mean residual |e|, s^2 from the sampling
errors of the coefficients that were fitted (:func:`sampling_covariance`). The interval contains
their covariance and, days being the independent units, the scatter of the headings and errors
between days.

*Realised gain.* Reports are held out by date (the virtual field test) or by day (cross-validation:
every tenth day in turn, with coefficients less the effect of the equations of these days). The same
report is compared before and after its correction by the 8-point table, so that the model's error
hardly enters. Assumes that compasses do not change. Radians and m/s in the kernel; knots and
degrees in results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import (
    add_tables,
    corrected_wind,
    curve_standard_error,
    error_from_table,
    heading_histogram,
    unit_interpolation,
)
from airswing.compass.fit.acceptance import FitOptions
from airswing.compass.fit.deviation import fit_deviation
from airswing.errors import InputError
from airswing.evaluation import Content
from airswing.evaluation.field_test import require_aircraft
from airswing.evaluation.innovations import Ints, chunks, require_reference
from airswing.evaluation.resampling import (
    Floats,
    cluster_sums,
    clustered_mean,
    day_weights,
    interval,
    normal_interval,
)
from airswing.flags import SCREENING, STATUS, published
from airswing.physics.compass_deviation import deviation_basis
from airswing.physics.triangle import along_cross
from airswing.products.ragged import row_bounds, time_span
from airswing.units import KNOT

MOST_REPORTS = 1500  # most reports of an aircraft used for the interval; the gain itself uses all
DRAWS = 300


def expected_gain(
    wind: Floats,
    reference: Floats,
    heading: Floats,
    argument: Floats,
    airspeed: Floats,
    day: Ints,
    deviation: Floats,
    covariance: Floats,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> tuple[float, float, Floats]:
    """Expected reduction of the mean wind vector disagreement of one aircraft.

    For the reports of the fit, ``wind`` and ``reference`` are (2, n), eastward and northward, m/s;
    ``heading`` (indicated true) and ``argument`` of the deviation (n,) in radians; ``deviation``
    (5,) and ``covariance`` (5, 5) of its sampling errors in degrees. Returns the mean disagreement
    as reported, the expected reduction with the optimism subtracted, and the gain under draws of
    the coefficients and days (draws,), all m/s; infinite spread with one day.
    """
    basis = np.radians(deviation_basis(argument).T)
    fitted = basis @ deviation
    after = np.stack(corrected_wind(wind[0], wind[1], airspeed, heading, fitted)) - reference
    lengths = np.hypot(*(wind - reference)), np.hypot(*after)
    gains = lengths[0] - lengths[1]
    spread = airspeed * np.radians(curve_standard_error(covariance, np.degrees(argument)))
    # E|e| of a normal vector changes by |e| / (4 s^2) per unit of one component's variance
    optimism = 2.0 * float((spread**2).mean()) * np.pi / (8.0 * max(float(lengths[1].mean()), 1e-6))
    gain = float(gains.mean()) - optimism
    # gain of the fitted correction if the coefficients were others, as the covariance allows: if
    # the deviation were larger by x, both winds would differ by -x V across the heading
    some = slice(None, None, max(1, gains.size // MOST_REPORTS))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(seed).standard_normal((draws, deviation.size))
    components = along_cross(after[0, some], after[1, some], heading[some])
    along, across = (component[:, np.newaxis] for component in components)
    turned = (airspeed[some] * np.sin(fitted[some]))[:, np.newaxis] - across
    off = (basis[some] * airspeed[some, np.newaxis]) @ (root @ normal.T)
    drawn = (np.hypot(off + turned, along) - np.hypot(off - across, along)).mean(axis=0)
    # about their mean, so that the squares of the sums do not cancel
    sums = cluster_sums(gains - gains.mean(), np.zeros(gains.size, np.int64), day, 1)
    by_day = float(clustered_mean(sums)[1][0])
    sampled = np.random.default_rng([seed, 1]).standard_normal(draws)
    # the optimism is an expectation: its standard error for this curve is taken as half of it
    wide = np.hypot(by_day, optimism / 2.0) if np.isfinite(by_day) else np.inf
    return float(lengths[0].mean()), gain, gain + drawn - drawn.mean() + wide * sampled


def sampling_covariance(fit: xr.Dataset) -> Floats:
    """Covariance (5, 5) of the sampling errors of the fit of one aircraft, degree2.

    Coefficients that are published as zero were not fitted and have none. The published variance of
    a constant (``offset_only``) contains those of cycles and of the reference's bias too, which are
    the same in later reports; its sampling variance is that of a jackknife over the parts of the
    days (Tukey 1958, Ann. Math. Stat. 29, 614). Where one part has most days, as in a single day,
    it is that of ``offset_standard_error``.
    """
    names = ("deviation", "deviation_covariance", "held_out_deviation")
    deviation, covariance, held_out = (fit[name].to_numpy() for name in names)
    fitted = deviation != 0.0
    covariance = covariance * np.outer(fitted, fitted)
    if int(fit["status"]) == STATUS["offset_only"]:
        change = held_out[:, 0] - deviation[0]
        # parts without reports do not change the constant
        variance = (1.0 - 1.0 / max(int(np.count_nonzero(change)), 1)) * float(change @ change)
        stated = float(fit["offset_standard_error"]) ** 2
        covariance[0, 0] = variance if variance > 0.0 else stated
    return np.asarray(covariance, dtype=np.float64)


def rank_aircraft(
    headings: xr.Dataset,
    fits: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int = 0,
) -> list[Content]:
    """Rank the aircraft by the expected gain of correcting them.

    Parameters
    ----------
    headings, fits : Dataset
        Screened headings, and the fits to them.
    pools, reference : mapping of str to list of str, str
        Members of each reference and pool; name of the reference or pool to use.
    seed : int, default 0

    Returns
    -------
    list of dict
        Rows of ``ranking.csv``, largest expected gain first, aircraft without a fit last:
        ``rank``, ``aircraft``, ``status``, ``reports``, ``disagreement_kt``, ``expected_gain_kt``,
        ``expected_gain_ci_kt`` and ``expected_gain_standard_error_kt`` (NaN for reports of one
        day), ``rank_ci``, ``amplitude_deg``; without a fit ``why`` and no gain.

    Raises
    ------
    InputError
        If there is no such reference, or an aircraft of the headings is not in the fits.

    References
    ----------
    Jacobs et al. 2010, Table 1; Efron 2004, J. Amer. Stat. Assoc. 99, 619-632.

    Examples
    --------
    >>> ranking = airswing.rank_aircraft(headings, fits, pools={"ruc": ["ruc"]}, reference="ruc")
    >>> ranking[0]["rank"]
    1
    """
    require_reference(pools, reference)
    fit = _fits_of(headings, fits, reference)
    argument = "heading" if fits.attrs.get("abscissa") == "true" else "magnetic_heading"
    words = {code: name for name, code in STATUS.items()}
    entries: list[Content] = []
    ranked: list[Content] = []
    drawn: list[Floats] = []
    names = ["heading", argument, "airspeed", "screening"]
    for chunk in chunks(headings, {reference: pools[reference]}, names):
        wind, model = chunk.wind, chunk.model[reference]
        heading, angle = (np.radians(chunk.column(name)) for name in names[:2])
        airspeed, used = chunk.column("airspeed"), chunk.column("screening") == 0
        good = used & np.isfinite(wind.sum(axis=0) + model.sum(axis=0) + heading + angle + airspeed)
        for start, stop in zip(*row_bounds(chunk.block["row_size"].to_numpy()), strict=True):
            rows = np.flatnonzero(good[start:stop]) + start
            number = len(entries)
            status = int(fit["status"][number])
            entry: Content = {
                "rank": None,
                "aircraft": str(fit["aircraft"].to_numpy()[number]),
                "status": words[status],
                "reports": rows.size,
                "expected_gain_kt": None,
            }
            entries.append(entry)
            if not published(status):
                entry["why"] = f"no published fit: {words[status]}"
                continue
            if not rows.size:
                entry["why"] = "no screened report has a wind of the reference"
                continue
            before, gain, spread = expected_gain(
                wind[:, rows],
                model[:, rows],
                heading[rows],
                angle[rows],
                airspeed[rows],
                chunk.day[rows],
                fit["deviation"].to_numpy()[number],
                sampling_covariance(fit.isel(aircraft=number)),
                seed=seed + number,
            )
            ends = spread / KNOT if np.isfinite(spread).all() else np.full(DRAWS, np.nan)
            entry |= {
                "disagreement_kt": before / KNOT,
                "expected_gain_kt": gain / KNOT,
                "expected_gain_ci_kt": interval(ends).tolist(),
                "expected_gain_standard_error_kt": float(ends.std()),
                "amplitude_deg": float(fit["amplitude"][number]),
            }
            ranked.append(entry)
            drawn.append(spread)
    if ranked:
        place = np.argsort(np.argsort(-np.array(drawn), axis=0), axis=0) + 1
        ends = np.percentile(place, [2.5, 97.5], axis=1, method="nearest")
        for entry, bounds in zip(ranked, ends.T.astype(int).tolist(), strict=True):
            entry["rank_ci"] = bounds
        ranked.sort(key=lambda entry: -float(entry["expected_gain_kt"]))
        for rank, entry in enumerate(ranked, start=1):
            entry["rank"] = rank
    return [*ranked, *(entry for entry in entries if entry["rank"] is None)]


def restrict(headings: xr.Dataset, selected: xr.DataArray | NDArray[np.bool_]) -> xr.Dataset:
    """Headings with all other reports marked ``no_reference``, so that no fit uses them; lazy."""
    screening = headings["screening"]
    mark = screening.dtype.type(SCREENING["no_reference"])
    return headings.assign(screening=screening | mark * ~selected)


def _learned(
    headings: xr.Dataset,
    until: date,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int,
    **options: Unpack[FitOptions],
) -> tuple[xr.Dataset, xr.Dataset, list[Content]]:
    """Reports before a day, fits to them against one reference or pool, and ranking."""
    before = restrict(headings, headings["time"] < np.datetime64(until))
    members = list(pools[reference])
    subset = before.sel(reference=members)
    # computed here, because every later use of a lazy fit would repeat it
    fits = fit_deviation(subset, pools={reference: members}, alone=False, **options).compute()
    return subset, fits, rank_aircraft(before, fits, pools=pools, reference=reference, seed=seed)


def virtual_field_test(
    headings: xr.Dataset,
    *,
    learned_until: date,
    pools: Mapping[str, list[str]],
    reference: str,
    corrected: list[str] | None = None,
    draws: int = 1000,
    seed: int = 0,
    resolution: float = 0.1,
    **options: Unpack[FitOptions],
) -> Content:
    """Learn the corrections up to a date, apply them after it, and compare with the prediction.

    Parameters
    ----------
    headings : Dataset
        Screened headings; a subset is marked by :func:`restrict`.
    learned_until : date
        Reports before it give the corrections, reports from it on are used for the comparison.
    pools, reference : mapping of str to list of str, str
        Members of each reference and pool; name of the reference or pool to use.
    corrected : list of str, optional
        Aircraft that get the correction; all by default.
    draws, seed : int
        Of the bootstrap.
    resolution : float
        Of the tables, degrees.
    **options
        As for :func:`airswing.fit_deviation`.

    Returns
    -------
    dict
        ``later`` of ``virtual_field_test.json``: ``groups`` as in ``field_test.json``, of the
        corrected aircraft only; ``predicted_gain_kt`` and ``realised_gain_kt`` with intervals, over
        all reports of the corrected aircraft that have a fit and ``by_aircraft``; ``agree``:
        whether their difference is within its interval.

    Raises
    ------
    InputError
        If an aircraft or the reference is unknown, or a period has no screened report.

    Examples
    --------
    >>> from datetime import date
    >>> pools = {"ruc": ["ruc"]}
    >>> options = {"learned_until": date(2009, 10, 10), "pools": pools, "reference": "ruc"}
    >>> airswing.virtual_field_test(headings, draws=200, **options)["realised_gain_kt"] > 0.0
    True
    """
    names = headings["aircraft"].to_numpy().astype(str)
    if corrected is not None:
        require_aircraft(names, corrected, "corrected")
    require_reference(pools, reference)
    treated = np.ones(names.size, bool) if corrected is None else np.isin(names, corrected)
    early, used = headings["time"] < np.datetime64(learned_until), headings["screening"] == 0
    for words, period in (("before", early), ("from", ~early)):
        if not (used & period).any():
            first, last = time_span(headings)
            raise InputError(
                f"the virtual field test has no screened report {words} {learned_until}",
                field="learned_until",
                found=f"reports from {str(first)[:10]} to {str(last)[:10]}",
                remedy="Choose a date inside the archive",
            )
    before, fits, ranking = _learned(
        headings, learned_until, pools=pools, reference=reference, seed=seed, **options
    )
    fit = add_tables(fits, before, resolution=resolution).sel(reference=reference).compute()
    origin, correctable, (number, before, after) = _sum_by_day(
        headings, pools[reference], fit, error_from_table(fit).to_numpy()[np.newaxis]
    )
    until = np.datetime64(learned_until, "D").astype(np.int64)
    late = origin + np.arange(number.shape[1]) >= until
    reports, reported, corrected_sum = (
        np.array([by_day[treated][:, period].sum() for period in (~late, late)])
        for by_day in (number, before, after)
    )
    groups = {}
    # reports on one side of the date only give no difference
    if reports.all():
        earlier, later = (reported / reports).tolist()
        now = float(corrected_sum[1] / reports[1])
        groups["corrected"] = {
            "aircraft": int(treated.sum()),
            "before_kt": earlier,
            "during_kt": now,
            "during_uncorrected_kt": later,
            "reduction_kt": earlier - now,
            "reports_before": int(reports[0]),
            "reports_during": int(reports[1]),
        }
    counted = (treated & correctable)[:, np.newaxis] & late
    return {
        "reference": reference,
        "learned_until": str(learned_until),
        "method": "table",
        "groups": groups,
        **_compared(
            names,
            np.where(counted, number, 0.0),
            np.where(counted, before - after, 0.0),
            ranking,
            draws=draws,
            seed=seed,
        ),
    }


def predicted_reduction(
    headings: xr.Dataset,
    *,
    start: date,
    corrected: list[str],
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int = 0,
    **options: Unpack[FitOptions],
) -> Content:
    """Reduction that the fits before a field test predict, each aircraft with the same weight.

    Part of ``field_test.json``: ``ranking`` of all aircraft before ``start``, and
    ``predicted_reduction_kt`` with ``predicted_reduction_ci_kt`` of the ``predicted_aircraft``
    corrected aircraft that have a fit (None without any). Options as for
    :func:`airswing.fit_deviation`.
    """
    require_reference(pools, reference)
    *_, ranking = _learned(headings, start, pools=pools, reference=reference, seed=seed, **options)
    ranked = [row for row in ranking if row["rank"] is not None and row["aircraft"] in corrected]
    mean = ends = None
    if ranked:
        gains, errors = (
            np.array([row[f"expected_gain_{name}kt"] for row in ranked])
            for name in ("", "standard_error_")
        )
        # the errors of the fits of different aircraft are independent
        mean = float(gains.mean())
        ends = normal_interval(mean, float(np.linalg.norm(errors) / errors.size))
    return {
        "ranking": ranking,
        "predicted_reduction_kt": mean,
        "predicted_reduction_ci_kt": ends,
        "predicted_aircraft": len(ranked),
    }


def cross_validate(
    headings: xr.Dataset,
    fits: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    ranking: list[Content] | None = None,
    draws: int = 1000,
    seed: int = 0,
) -> Content:
    """Correct every report with a fit that did not use its day, and compare with the prediction.

    Parameters
    ----------
    headings, fits : Dataset
        Screened headings, and the fits of all these reports, with tables.
    pools, reference : mapping of str to list of str, str
        Members of each reference and pool; name of the reference or pool to use.
    ranking : list of dict, optional
        Ranking by these fits (:func:`airswing.rank_aircraft`); computed by default.
    draws, seed : int
        Of the bootstrap.

    Returns
    -------
    dict
        ``held_out`` of ``virtual_field_test.json``: as :func:`virtual_field_test` without groups,
        and ``folds``: number of parts.

    Raises
    ------
    InputError
        If the reference is unknown, an aircraft of the headings is not in the fits, or no report
        could be corrected.

    Examples
    --------
    >>> pools = {"ruc": ["ruc"]}
    >>> gains = airswing.cross_validate(headings, fits, pools=pools, reference="ruc", draws=200)
    >>> gains["realised_gain_kt"] > 0.0
    True
    """
    require_reference(pools, reference)
    if ranking is None:
        ranking = rank_aircraft(headings, fits, pools=pools, reference=reference, seed=seed)
    fit = _fits_of(headings, fits, reference)
    # fits without each part of the days are stored in place of references
    fold_fits = fit[["held_out_deviation", "status"]].drop_vars("reference")
    fold_fits = fold_fits.rename(held_out_deviation="deviation", fold="reference")
    folds = fold_fits.sizes["reference"]
    left_out = add_tables(
        fold_fits.assign(status=fold_fits["status"].expand_dims(reference=folds)),
        heading_histogram(headings, abscissa=fits.attrs.get("abscissa", "magnetic")).compute(),
        resolution=fits.attrs.get("table_resolution", 0.1),
        sign=fits.attrs.get("table_sign", "subtract_error"),
    )
    tables = error_from_table(left_out).to_numpy()
    _, correctable, (number, *winds) = _sum_by_day(headings, pools[reference], fit, tables)
    names = headings["aircraft"].to_numpy().astype(str)
    number = np.where(correctable[:, np.newaxis], number, 0.0)
    gain = np.where(number > 0, winds[0] - winds[1], 0.0)
    if not number.any():
        problem = "no held-out report could be corrected"
        remedy = "Lower fit.min_reports, or add reports"
        raise InputError(problem, field="reference", found=reference, remedy=remedy)
    return {
        "reference": reference,
        "folds": folds,
        "method": "table",
        **_compared(names, number, gain, ranking, draws=draws, seed=seed),
    }


def _fits_of(headings: xr.Dataset, fits: xr.Dataset, reference: str) -> xr.Dataset:
    """Fits against a reference, in the order of the aircraft of the headings."""
    names = headings["aircraft"].to_numpy()
    if (absent := names[~np.isin(names, fits["aircraft"].to_numpy())]).size:
        remedy = "fit these headings"
        raise InputError("no fit of an aircraft", field="aircraft", found=absent[0], remedy=remedy)
    return fits.sel(reference=reference, aircraft=names)


def _sum_by_day(
    headings: xr.Dataset, members: list[str], fit: xr.Dataset, tables: Floats
) -> tuple[int, NDArray[np.bool_], Floats]:
    """Sum the disagreement as reported and as corrected.

    The tables, (part, aircraft, node) in degrees of heading error, have one part, or one for each
    part of the days that are held out. A fit leaves out a report with its own day or, where no
    shared error was estimated, with the first day of its flight: a report for which these are in
    different parts is not used. Returns the first day (since 1970), which aircraft have a table,
    and reports and their summed disagreement (kt) before and after the correction, (3, aircraft,
    day); aircraft without a table remain as reported.
    """
    argument = "heading" if fit.attrs.get("abscissa") == "true" else "magnetic_heading"
    correctable = published(fit["status"].to_numpy()) & np.isfinite(tables).all(axis=(0, 2))
    first, last = (day.astype("datetime64[D]").astype(np.int64) for day in time_span(headings))
    shape = (correctable.size, int(last - first) + 1)
    sums = np.zeros((3, *shape))
    names = ("heading", argument, "airspeed")
    for chunk in chunks(headings, {"": members}, [*names, "screening", "flight"]):
        columns = np.array([*chunk.wind, *chunk.model[""], *map(chunk.column, names)])
        used = (chunk.column("screening") == 0) & np.isfinite(columns.sum(axis=0))
        part, flight = chunk.day % len(tables), chunk.block["flight"].to_numpy()[used]
        _, begin, number = np.unique(flight, return_index=True, return_inverse=True)
        used[used] = part[used] == part[used][begin][number]
        u, v, model_u, model_v, heading, magnetic, airspeed = columns[:, used]
        aircraft, day = chunk.aircraft[used], chunk.day[used]
        rows = tables[part[used], aircraft]
        error = np.radians(unit_interpolation(np.nan_to_num(rows), magnetic))
        error[~correctable[aircraft]] = 0.0
        better = corrected_wind(u, v, airspeed, np.radians(heading), error)
        before, after = (
            np.hypot(east - model_u, north - model_v) / KNOT for east, north in ((u, v), better)
        )
        values = np.ones(day.size), before, after
        cell = aircraft * shape[1] + day - first
        for total, column in zip(sums, values, strict=True):
            total += np.bincount(cell, column, total.size).reshape(shape)
    return int(first), correctable, sums


def _compared(
    names: NDArray[np.str_],
    number: Floats,
    gain: Floats,
    ranking: Sequence[Content],
    *,
    draws: int,
    seed: int,
) -> Content:
    """Predicted and realised gain with intervals, of each aircraft and of all together.

    ``number`` of reports and their summed ``gain`` are (aircraft, day). ``agree`` is None where one
    day leaves the intervals unknown; the gains are None where nothing could be compared.
    """
    ranked = {entry["aircraft"]: entry for entry in ranking}
    usable = np.array([ranked[name]["rank"] is not None for name in names])
    usable &= number.any(axis=1)
    names, number, gain = names[usable], number[usable], gain[usable]
    if not names.size:
        return {"by_aircraft": [], "predicted_gain_kt": None, "realised_gain_kt": None}
    expected, errors = (
        np.array([ranked[name][f"expected_gain_{kind}kt"] for name in names])
        for kind in ("", "standard_error_")
    )

    def compared(rows: slice) -> Content:
        reports, by_day = number[rows].sum(axis=1), number[rows].sum(axis=0)
        share = reports / reports.sum()
        predicted = float(share @ expected[rows])
        error = float(np.linalg.norm(share * errors[rows]))
        seen = by_day > 0
        by_day, gains = by_day[seen], gain[rows].sum(axis=0)[seen]
        realised, drawn = float(gains.sum() / by_day.sum()), np.full(draws, np.nan)
        if by_day.size > 1:
            # days are independent units
            weights = day_weights(by_day.size, draws=draws, seed=seed, length=1)
            drawn = (weights @ gains) / np.maximum(weights @ by_day, 1.0)
        wide = float(np.hypot(error, drawn.std()))
        ends = normal_interval(realised - predicted, wide)
        return {
            "reports": int(reports.sum()),
            "predicted_gain_kt": predicted,
            "predicted_standard_error_kt": error,
            "predicted_gain_ci_kt": normal_interval(predicted, error),
            "realised_gain_kt": realised,
            "realised_gain_ci_kt": interval(drawn).tolist(),
            "difference_kt": realised - predicted,
            "difference_ci_kt": ends,
            "agree": bool(ends[0] <= 0.0 <= ends[1]) if np.isfinite(wide) else None,
        }

    by_aircraft = [
        {"aircraft": str(name), **compared(slice(k, k + 1))} for k, name in enumerate(names)
    ]
    return {**compared(slice(None)), "by_aircraft": by_aircraft}
