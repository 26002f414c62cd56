"""Whom to correct: what each aircraft's correction is expected to gain, from the fit alone.

Assumes the deviation does not change (:mod:`airswing.evaluation.monitoring.changes`) and
that the headings, airspeeds and remaining errors to come are like those fitted. The gain is the
fall of the mean wind vector disagreement (Jacobs et al. 2010, Table 1). On the reports of the fit
it looks too large, because the curve was bent to their errors: a curve with error variance s^2 in
the wind takes s^2 off the residual variance it was fitted to and adds s^2 to any other. That
optimism (Efron 2004, J. Amer. Stat. Assoc. 99, 619-632) is taken off, to first order. The interval
holds what the coefficients' covariance leaves and, days being the independent units, how the
headings flown and the errors met happened to fall: nothing later is looked at.

Radians and m/s in the kernels; knots and degrees in what is returned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.correction import corrected_wind, curve_standard_error
from airswing.evaluation.backtest.learning import require_reference
from airswing.evaluation.clustered_mean import cluster_sums, clustered_mean
from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.results import Content
from airswing.flags import STATUS, published
from airswing.products.ragged import blocks, row_bounds
from airswing.units import KNOT, Picked

Floats = NDArray[np.float64]
_FLOWN = (
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "heading",
    "airspeed",
    "time",
    "screening",
)
# Reports of an aircraft that the intervals are drawn over; the gain itself uses all.
MOST_REPORTS = 4000
DRAWS = 300


@dataclass(frozen=True)
class Flown:
    """Plain columns of one aircraft's screened reports."""

    # u, v, u_reference, v_reference: (n,): m/s
    u: Floats
    v: Floats
    u_reference: Floats
    v_reference: Floats
    # heading, argument: (n,): indicated true heading and the argument of the deviation, radians
    heading: Floats
    argument: Floats
    airspeed: Floats  # (n,): m/s
    day: Floats  # (n,): number of the day

    def take(self, chosen: Picked) -> Flown:
        """Some of the reports."""
        return Flown(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def harmonics(argument: Floats) -> Floats:
    """Basis of the deviation.

    Parameters
    ----------
    argument : array, shape (n,), radians

    Returns
    -------
    array, shape (n, 5)
        1, sin m, cos m, sin 2m, cos 2m.
    """
    m = argument
    return np.column_stack([np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)])


def expected_gain(
    flown: Flown, deviation: Floats, covariance: Floats, *, draws: int, seed: int
) -> tuple[float, float, Floats]:
    """Expected fall of the mean wind vector disagreement of one aircraft.

    Parameters
    ----------
    flown : Flown
        Reports the deviation was fitted to.
    deviation : array, shape (5,), degrees
    covariance : array, shape (5, 5), degrees squared
    draws : int
        Draws of the coefficients behind the interval.

    Returns
    -------
    before : float
        Mean disagreement as reported, m/s.
    gain : float
        Expected fall, m/s, the optimism taken off.
    drawn : array, shape (draws,)
        The gain under draws of the coefficients, m/s.
    """
    reported, after = _magnitudes(flown, np.radians(harmonics(flown.argument) @ deviation))
    spread = flown.airspeed * np.radians(
        curve_standard_error(covariance, np.degrees(flown.argument))
    )
    # E|e| of a normal vector moves by |e| / (4 s^2) per unit of one component's variance.
    optimism = 2.0 * float((spread**2).mean()) * np.pi / (8.0 * max(float(after.mean()), 1e-6))
    gain = float(reported.mean() - after.mean()) - optimism
    step = max(1, flown.u.size // MOST_REPORTS)
    part = flown.take(slice(None, None, step))
    drawn = _drawn_gains(part, deviation, covariance, draws=draws, seed=seed)
    drawn -= drawn.mean()
    sampled = np.random.default_rng([seed, 1]).standard_normal(draws)
    # The optimism is an expectation: how far this very curve is off is not known to half of it.
    drawn += np.hypot(_error_by_day(reported - after, flown.day), optimism / 2.0) * sampled
    return float(reported.mean()), gain, gain + drawn


def _error_by_day(values: Floats, day: Floats) -> float:
    """Standard error of a mean, days being independent of each other; infinite with one day."""
    # About their mean, so that the sums' squares do not cancel.
    sums = cluster_sums(
        values - values.mean(), np.zeros(values.size, dtype=np.int64), day.astype(np.int64), 1
    )
    error = float(clustered_mean(sums)[1][0])
    return error if np.isfinite(error) else float("inf")


def _magnitudes(flown: Flown, error: Floats) -> tuple[Floats, Floats]:
    """Distance from the reference as reported and with ``error`` (radians) taken off."""
    u, v = corrected_wind(flown.u, flown.v, flown.airspeed, flown.heading, error)
    return (
        np.hypot(flown.u - flown.u_reference, flown.v - flown.v_reference),
        np.hypot(u - flown.u_reference, v - flown.v_reference),
    )


def _drawn_gains(
    flown: Flown, deviation: Floats, covariance: Floats, *, draws: int, seed: int
) -> Floats:
    """Gain of the fitted correction were the coefficients others, as the covariance allows."""
    rng = np.random.default_rng(seed)
    basis = np.radians(harmonics(flown.argument))
    fitted = basis @ deviation
    u, v = corrected_wind(flown.u, flown.v, flown.airspeed, flown.heading, fitted)
    left_u, left_v = u - flown.u_reference, v - flown.v_reference
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # Were the deviation larger by x, both winds would hold -x V across the heading: only what is
    # left across it changes, what is left along it stays.
    east, north = np.cos(flown.heading), -np.sin(flown.heading)
    across = left_u * east + left_v * north
    along = (left_u * north - left_v * east) ** 2
    turned = flown.airspeed * np.sin(fitted) - across
    basis *= flown.airspeed[:, np.newaxis]
    found, work = np.empty(draws), np.empty_like(across)

    def mean_length(off: Floats, from_: Floats) -> float:
        np.add(off, from_, out=work)
        np.multiply(work, work, out=work)
        np.add(work, along, out=work)
        return float(np.sqrt(work, out=work).mean())

    across = -across
    for k in range(draws):
        off = basis @ (root @ rng.standard_normal(deviation.size))
        found[k] = mean_length(off, turned) - mean_length(off, across)
    return found


def flown_reports(
    headings: xr.Dataset, members: list[str], *, abscissa: str = "magnetic"
) -> Iterator[Flown]:
    """Screened reports of every aircraft as plain columns, one aircraft after the other.

    Parameters
    ----------
    members : list of str
        References whose mean is held against.
    abscissa : {"magnetic", "true"}

    Yields
    ------
    Flown
        One an aircraft.
    """
    argument = "magnetic_heading" if abscissa == "magnetic" else "heading"
    for block in blocks(headings, [*_FLOWN, argument]):
        yield from _flown_block(block, members, argument)


def _flown_block(headings: xr.Dataset, members: list[str], argument: str) -> Iterator[Flown]:
    """Screened reports of every aircraft of one block."""
    winds = reference_mean(headings, members)
    columns = [
        headings["eastward_wind"].to_numpy(),
        headings["northward_wind"].to_numpy(),
        winds["reference_eastward_wind"].to_numpy(),
        winds["reference_northward_wind"].to_numpy(),
        np.radians(headings["heading"].to_numpy().astype(np.float64)),
        np.radians(headings[argument].to_numpy().astype(np.float64)),
        headings["airspeed"].to_numpy(),
        headings["time"].to_numpy().astype("datetime64[D]").astype(np.int64),
    ]
    columns = [np.asarray(column, dtype=np.float64) for column in columns]
    good = (headings["screening"].to_numpy() == 0) & np.isfinite(sum(columns))
    for start, stop in zip(*row_bounds(headings["row_size"].to_numpy()), strict=True):
        chosen = good[start:stop]
        yield Flown(*(column[start:stop][chosen] for column in columns))


def rank_aircraft(
    headings: xr.Dataset,
    fits: xr.Dataset,
    *,
    pools: Mapping[str, list[str]],
    reference: str,
    seed: int = 0,
) -> list[Content]:
    """Rank the aircraft by what correcting them is expected to gain.

    Parameters
    ----------
    headings : Dataset
        Screened headings the fits were made from.
    fits : Dataset
        Of :func:`airswing.compass.fit.deviation.fit_deviation`.
    pools : mapping of str to list of str
        Members of each reference and pool.
    reference : str
        Whose fit is judged.

    Returns
    -------
    list of Ranked
        Largest expected gain first, aircraft without a fit last: ``rank``, ``aircraft``,
        ``status``, ``reports``, ``disagreement_kt``, ``expected_gain_kt``,
        ``expected_gain_ci_kt`` (not a number for reports of one day: nothing tells how days
        differ), ``rank_ci``, ``amplitude_deg`` and ``why`` where there is none.

    Raises
    ------
    InputError
        If there is no such reference.
    """
    require_reference(pools, reference)
    chosen = fits.sel(reference=reference)
    flown = flown_reports(
        headings, pools[reference], abscissa=str(fits.attrs.get("abscissa", "magnetic"))
    )
    words = {code: name for name, code in STATUS.items()}
    entries: list[Content] = []
    drawn = []
    for k, (name, own) in enumerate(zip(chosen["aircraft"].to_numpy(), flown, strict=True)):
        status = words[int(chosen["status"][k])]
        if not published(chosen["status"][k]) or not own.u.size:
            entries.append(
                {
                    "rank": None,
                    "aircraft": str(name),
                    "status": status,
                    "reports": int(own.u.size),
                    "expected_gain_kt": None,
                    "why": f"no fit to be trusted: {status}",
                }
            )
            continue
        before, gain, spread = expected_gain(
            own,
            chosen["deviation"].to_numpy()[k],
            chosen["deviation_covariance"].to_numpy()[k],
            draws=DRAWS,
            seed=seed + k,
        )
        drawn.append(spread)
        entries.append(
            {
                "rank": None,
                "aircraft": str(name),
                "status": status,
                "reports": int(own.u.size),
                "disagreement_kt": before / KNOT,
                "expected_gain_kt": gain / KNOT,
                "expected_gain_ci_kt": _interval(spread),
                "expected_gain_standard_error_kt": _spread(spread),
                "amplitude_deg": float(chosen["amplitude"][k]),
            }
        )
    return _ordered(entries, drawn)


def _interval(values: Floats) -> list[float]:
    """95 % interval in knots; not a number where one day leaves the spread between days unknown."""
    if not np.isfinite(values).all():
        return [float("nan"), float("nan")]
    return [float(end / KNOT) for end in np.percentile(values, [2.5, 97.5])]


def _spread(values: Floats) -> float:
    return float(values.std() / KNOT) if np.isfinite(values).all() else float("nan")


def _ordered(entries: list[Content], drawn: list[Floats]) -> list[Content]:
    """Sort by expected gain and give every rank its interval."""
    ranked = [entry for entry in entries if entry["expected_gain_kt"] is not None]
    if ranked:
        place = np.argsort(np.argsort(-np.array(drawn), axis=0), axis=0) + 1
        low, high = np.percentile(place, [2.5, 97.5], axis=1, method="nearest")
        for k, entry in enumerate(ranked):
            entry["rank_ci"] = [int(low[k]), int(high[k])]
        ranked.sort(key=lambda entry: -(entry["expected_gain_kt"] or 0.0))
    for number, entry in enumerate(ranked, start=1):
        entry["rank"] = number
    return [*ranked, *(entry for entry in entries if entry["expected_gain_kt"] is None)]
