"""Expected gain of correcting each aircraft, from its fit alone.

Assumes that the deviation does not change (:mod:`airswing.evaluation.monitoring.changes`) and that
the headings, airspeeds and remaining errors to come are like those fitted. The gain is the
reduction of the mean wind vector disagreement (Jacobs et al. 2010, Table 1). On the reports of the
fit it is too large, because the curve was fitted to their errors: a curve with error variance s^2
in the wind reduces the residual variance it was fitted to by s^2 and adds s^2 to any other. That
optimism (Efron 2004, J. Amer. Stat. Assoc. 99, 619-632) is subtracted, to first order. The interval
contains the covariance of the coefficients and, days being the independent units, the scatter of
the headings flown and the errors met.

Radians and m/s in the kernel; knots and degrees in the results.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from airswing.compass.correction import corrected_wind
from airswing.compass.table import curve_standard_error
from airswing.evaluation import Content
from airswing.evaluation.disagreement import Ints, parts_of, require_reference
from airswing.evaluation.resampling import Floats, cluster_sums, clustered_mean, interval
from airswing.flags import STATUS, published
from airswing.physics.compass_deviation import deviation_basis
from airswing.products.ragged import row_bounds
from airswing.units import KNOT

MOST_REPORTS = 1500
"""Reports of an aircraft that the interval is drawn over; the gain itself uses all."""
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

    Of the reports the deviation was fitted to, ``wind`` and ``reference`` are (2, n), eastward and
    northward, m/s; ``heading`` (indicated true) and ``argument`` of the deviation (n,) in radians;
    ``deviation`` (5,) and ``covariance`` (5, 5) in degrees. Returns the mean disagreement as
    reported, the expected reduction with the optimism subtracted, and the gain under draws of the
    coefficients and days (draws,), all m/s; infinite spread with one day.
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
    east, north = np.cos(heading[some]), -np.sin(heading[some])
    across = (after[0, some] * east + after[1, some] * north)[:, np.newaxis]
    along = ((after[0, some] * north - after[1, some] * east) ** 2)[:, np.newaxis]
    turned = (airspeed[some] * np.sin(fitted[some]))[:, np.newaxis] - across
    off = (basis[some] * airspeed[some, np.newaxis]) @ (root @ normal.T)
    drawn = np.sqrt((off + turned) ** 2 + along) - np.sqrt((off - across) ** 2 + along)
    drawn = drawn.mean(axis=0)
    # about their mean, so that the squares of the sums do not cancel
    sums = cluster_sums(gains - gains.mean(), np.zeros(gains.size, np.int64), day, 1)
    by_day = float(clustered_mean(sums)[1][0])
    sampled = np.random.default_rng([seed, 1]).standard_normal(draws)
    # the optimism is an expectation: how far this curve is off is known to half of it only
    wide = np.hypot(by_day, optimism / 2.0) if np.isfinite(by_day) else np.inf
    return float(lengths[0].mean()), gain, gain + drawn - drawn.mean() + wide * sampled


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
    headings : Dataset
        Screened headings the fits were made from.
    fits : Dataset
        Of :func:`airswing.compass.fit.deviation.fit_deviation`.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Whose fit is used.
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
        If there is no such reference.

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
    fit = fits.sel(reference=reference)
    argument = "heading" if fits.attrs.get("abscissa") == "true" else "magnetic_heading"
    words = {code: name for name, code in STATUS.items()}
    entries: list[Content] = []
    ranked: list[Content] = []
    drawn: list[Floats] = []
    names = ["heading", argument, "airspeed", "screening"]
    for part in parts_of(headings, {reference: pools[reference]}, names):
        wind, model = part.wind, part.model[reference]
        heading, angle = (np.radians(part.column(name)) for name in names[:2])
        airspeed, used = part.column("airspeed"), part.column("screening") == 0
        good = used & np.isfinite(wind.sum(axis=0) + model.sum(axis=0) + heading + angle + airspeed)
        for start, stop in zip(*row_bounds(part.block["row_size"].to_numpy()), strict=True):
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
            if not published(status) or not rows.size:
                entry["why"] = f"no published fit: {words[status]}"
                continue
            before, gain, spread = expected_gain(
                wind[:, rows],
                model[:, rows],
                heading[rows],
                angle[rows],
                airspeed[rows],
                part.day[rows],
                fit["deviation"].to_numpy()[number],
                fit["deviation_covariance"].to_numpy()[number],
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
