"""The diagnosis of an archive in one call: noise, sums, search, where, which, how far.

Assumptions: those of the modules it calls, in the order of GAP.md. The search runs twice where
effects are large: the second time on residuals linearised about the effects found first, with the
noise fitted after taking them off.

Validity: at least two aircraft-weeks and some thousand reports for anything but "nothing found".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.checks.aliases import hidden_shares
from airswing.gap.checks.assumptions import run_checks, with_aliases
from airswing.gap.checks.refit_claims import Adjustment, make_adjustment
from airswing.gap.closure.interval import with_interval
from airswing.gap.design.basis import DictionaryPlan, plan_dictionary
from airswing.gap.design.candidates import candidates
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.layout import make_layout
from airswing.gap.effects import CATALOGUE
from airswing.gap.evidence.localisation import residual_maps, slices
from airswing.gap.evidence.terms import Term, given_terms
from airswing.gap.held_out.attenuation import readout_factors
from airswing.gap.held_out.reduction import (
    Closure,
    close,
    is_sensor,
    take_off,
    term_coefficients,
    term_error,
    term_fields,
    whole_coefficients,
)
from airswing.gap.noise.model import NoiseFit, fit_noise
from airswing.gap.result.assembled import aircraft_probability, assemble, best_scores
from airswing.gap.search.absorbed_by_unknown import folded
from airswing.gap.search.coding_and_outliers import second_moments
from airswing.gap.search.cross_validated import Standing, settle
from airswing.gap.search.excess_scatter import scattering
from airswing.gap.search.stepwise import Found, Rules, with_background
from airswing.gap.search.tail_swaps import exchange, find_swap
from airswing.gap.search.testability import absorbed, too_short
from airswing.gap.sums.accumulate import DAY, accumulate, day_of_report
from airswing.gap.sums.elimination import Base, eliminate_days
from airswing.gap.sums.variance_components import shared_prior, shared_variances
from airswing.physics.turns import heading_doubt

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Size at single reports, m/s, from which an effect is in danger of being clipped as gross errors.
PEAK = 2.5


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found.

    Attributes
    ----------
    report : dict
        The content of gap.json.
    dataset : xarray.Dataset
        The content of gap.nc.
    details : dict
        Everything else a page shows: waterfall, evidence, noise, ambiguity, untestable effects,
        calibration, decoy, aliases, assumptions.
    adjustment : Adjustment
        What takes the effects beside the deviation off the winds.
    """

    report: dict[str, Any]
    dataset: xr.Dataset
    details: dict[str, Any]
    adjustment: Adjustment


@dataclass(frozen=True)
class Pass:
    """One pass over the reports and the search on its sums."""

    noise: NoiseFit
    base: Base
    standing: Standing
    columns_frame: Any
    plan: DictionaryPlan


def usable_effects(
    frame: Any, catalogue: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Effects whose columns can be tested in an archive, and why the others cannot.

    Parameters
    ----------
    frame : Frame
    catalogue : mapping

    Returns
    -------
    effects : dict
        Name -> effect with design columns.
    untestable : dict
        Name -> reason.
    """
    effects, untestable = {}, {}
    for name, effect in catalogue.items():
        reason = effect.testable(frame)
        if reason is not None:
            untestable[name] = reason
        elif effect.kind not in ("second_moment", "swap"):
            effects[name] = effect
    return effects, untestable


def diagnose(
    frame: Any,
    *,
    catalogue: Mapping[str, Any] | None = None,
    rules: Rules | None = None,
    dictionary: bool = True,
    maps: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose where an archive parts from its simulation, why, and how far that closes.

    Parameters
    ----------
    frame : Frame
        Reports against one reference.
    catalogue : mapping, optional
        Name -> effect; the whole catalogue by default.
    rules : Rules, optional
        Thresholds of the search.
    dictionary : bool
        Also look outside the catalogue.
    maps : bool
        Also make the maps.
    seed : int
        Of the draws (noise fit, bootstrap).
    progress : callable, optional
        Called with a stage's name and the fraction done.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        Fewer than 200 reports or fewer than four flights.
    """
    _check(frame)
    tell = progress or (lambda stage, done: None)
    effects, untestable = usable_effects(frame, CATALOGUE if catalogue is None else catalogue)
    rules = rules or Rules()
    columns_frame = exogenous(frame)
    first = _run(frame, columns_frame, frame.residual, effects, rules, dictionary, seed, tell, None)
    swap = None
    if catalogue is None or "tail_swap" in catalogue:
        swap = find_swap(first.base, given_terms(first.base, []), effects)
    if swap is not None:
        start = float(first.base.stats.days[swap.day]) * DAY + first.base.stats.day_shift * 3600
        frame = exchange(frame, swap, start)
        columns_frame = exogenous(frame)
        first = _run(
            frame, columns_frame, frame.residual, effects, rules, dictionary, seed, tell, None
        )
    final = first
    parts = _parts(frame, columns_frame, first, effects)
    if parts.peak > PEAK or any(_large(t) for t in first.standing.found.terms):
        quiet = take_off(frame, parts.sensor, parts.other)
        final = _run(
            frame, columns_frame, quiet + parts.linear, effects, rules, dictionary, seed, tell,
            quiet, first.standing.found.terms,
        )  # fmt: skip
    found, base = final.standing.found, final.base
    energy, energy_error = final.standing.energy, final.standing.error
    days, _ = day_of_report(frame)
    day = np.searchsorted(base.stats.days, days)
    tell("closure", 0.0)
    means = folded(found.terms, energy, energy_error)
    stated = [k for k, t in enumerate(found.terms) if t.candidate.known and k not in means]
    fitted = term_coefficients(found.given, found.terms)
    factors, doubts = readout_factors(
        frame, columns_frame, found.terms, fitted, base=base, noise=final.noise, effects=effects,
        plan=final.plan, again=final is not first,
    )  # fmt: skip
    reduce = partial(
        close, frame, base, effects=effects, plan=final.plan, day=day, factors=factors, seed=seed
    )
    closure = reduce([found.terms[k] for k in stated])
    whole = closure if len(stated) == len(found.terms) else reduce(found.terms)
    closure = with_interval(
        closure, frame, base, found, known=stated, effects=effects, plan=final.plan, day=day,
        factors=factors, doubts=doubts, seed=seed,
    )  # fmt: skip
    bare = given_terms(base, [])
    hidden = absorbed(base, bare, candidates(base.stats.layout, effects, dictionary=False), effects)
    named = {term.candidate.name for term in found.terms}
    untestable |= {name: reason for name, reason in hidden.items() if name not in named}
    untestable |= too_short(base, effects)
    tell("where", 0.0)
    where = slices(base, bare, final.plan) if dictionary else []
    known_names = set(CATALOGUE if catalogue is None else catalogue)
    moments = [m for m in second_moments(frame, final.noise) if m.name in known_names]
    told = {tail for moment in moments for tail in moment.tails}
    jittery = None
    if dictionary:
        jittery = scattering(frame, whole.residual, final.noise, explained=told)
    report, details = assemble(
        frame, base=base, noise=final.noise, found=found, closure=closure, whole=whole,
        where=where, effects=effects, untestable=untestable, plan=final.plan,
        energy=(energy, energy_error), means=means, factors=factors, doubts=doubts,
        seed=seed, swap=swap, moments=moments, jittery=jittery,
    )  # fmt: skip
    tell("checks", 0.0)
    checks = run_checks(
        frame, final.columns_frame, base=base, noise=final.noise, plan=final.plan, found=found,
        closure=closure, effects=effects, day=day, seed=seed,
    )  # fmt: skip
    unseen = [name for name, reason in hidden.items() if not reason.startswith("in part")]
    with_aliases(report["effects"], checks.shares, hidden_shares(base.stats, found.terms, unseen))
    dataset = _dataset(frame, final, found, closure, maps)
    adjustment = make_adjustment(
        frame, found.terms, whole_coefficients(fitted, found.terms, factors), effects=effects,
        plan=final.plan, day=day, shape=base.stats.day_count.shape,
    )  # fmt: skip
    dataset = dataset.assign(checks.histograms())
    return Diagnosis(report, dataset, details | checks.details(), adjustment)


def _check(frame: Any) -> None:
    flights = np.unique(frame.flight).size
    if frame.size < 200 or flights < 4:
        raise InputError(
            "too few reports for a diagnosis", found=f"{frame.size} reports of {flights} flights",
            remedy="at least 200 reports of four flights with model winds are needed",
        )  # fmt: skip


def _large(term: Term) -> bool:
    """Whether a term is large enough to be linearised again and to disturb the noise fit."""
    return bool(np.max(term.score.size[list(term.tails)]) > 1.5)


def _run(
    frame: Any,
    columns_frame: Any,
    residual: Floats,
    effects: Mapping[str, Any],
    rules: Rules,
    dictionary: bool,
    seed: int,
    tell: Progress,
    quiet: Floats | None,
    start: Sequence[Term] = (),
) -> Pass:
    """Fit the noise, accumulate and search; the noise on ``quiet`` residuals where given.

    Beside that noise all that is at work stands out, most of all what is not conditioned on yet: a
    second search begins with the terms of the first.
    """
    tell("noise", 0.0)
    noise = fit_noise(
        residual if quiet is None else quiet, aircraft=frame.aircraft, flight=frame.flight,
        time=frame.time, latitude=frame.latitude, longitude=frame.longitude,
        pressure=frame.pressure, heading=columns_frame.heading, airspeed=columns_frame.airspeed,
        doubt=heading_doubt(frame, columns_frame), seed=seed,
    )  # fmt: skip
    plan = plan_dictionary(columns_frame, effects)
    if not dictionary:
        plan = DictionaryPlan(plan.knots, (), plan.centre, plan.means, plan.flags)
    layout = make_layout(effects, plan, columns_frame)
    stats = accumulate(
        columns_frame, residual, noise=noise, layout=layout, effects=effects, plan=plan,
        known=None if quiet is None else residual - quiet,
        progress=lambda done: tell("statistics", done),
    )  # fmt: skip
    tell("search", 0.0)
    base = eliminate_days(stats, shared_variances(stats, shared_prior(layout, effects)))
    pool = candidates(layout, effects, dictionary=dictionary)
    base = with_background(base, pool)
    return Pass(noise, base, settle(base, pool, rules, start), columns_frame, plan)


def _quantile(size: Floats) -> float:
    return float(np.quantile(size, 0.999)) if size.size else 0.0


@dataclass(frozen=True)
class _Parts:
    """Wind errors (n, 2) of the terms found so far, m/s.

    ``sensor`` and ``other`` on the frame as reported, ``linear`` by the design columns; ``peak``
    is the size that one report in a thousand of those a term acts on exceeds, of the worst term.
    """

    sensor: Floats
    other: Floats
    linear: Floats
    peak: float


def _parts(frame: Any, columns_frame: Any, first: Pass, effects: Mapping[str, Any]) -> _Parts:
    """Evaluate the terms of a pass on every report."""
    base, terms = first.base, first.standing.found.terms
    days, _ = day_of_report(frame)
    day = np.searchsorted(base.stats.days, days)
    shape = base.stats.day_count.shape
    values = term_coefficients(first.standing.found.given, terms)
    sensor, other, linear = (np.zeros((frame.size, 2)) for _ in range(3))
    nothing = np.zeros(frame.size, np.int64)
    peak = 0.0
    for term, value in zip(terms, values, strict=True):
        for source in (frame, columns_frame):
            fields = term_fields(source, term, effects=effects, plan=first.plan)
            part = term_error(fields, term, [value], aircraft=frame.aircraft, day=day,
                              fold=nothing, shape=shape)  # fmt: skip
            if source is columns_frame:
                linear += part
                size = np.hypot(*part.T)
                peak = max(peak, _quantile(size[size > 0]))
            elif is_sensor(term, effects):
                sensor += part
            else:
                other += part
    return _Parts(sensor, other, linear, peak)


def _dataset(frame: Any, final: Pass, found: Found, closure: Closure, maps: bool) -> xr.Dataset:
    """Maps, evidence table and statistics as one Dataset."""
    stats = final.base.stats
    out = residual_maps(frame) if maps else xr.Dataset(coords={"aircraft": list(frame.tails)})
    core = stats.layout.core
    names = np.array([f"{n}[{i}]" for n, b in stats.layout.blocks.items() if b.stop <= core
                      for i in range(b.stop - b.start)], dtype=object)  # fmt: skip
    out["core_column"] = ("core_column", names)
    out["core_column_2"] = ("core_column_2", names)
    out["day"] = ("day", (stats.days * 86400).astype("datetime64[s]").astype("datetime64[ns]"))
    out["score"] = (("aircraft", "day", "core_column"), stats.day_score[:, :, :core])
    out["information"] = (
        ("aircraft", "core_column", "core_column_2"), stats.day_gram.sum(axis=1, dtype=float),
    )  # fmt: skip
    out["report_count"] = (("aircraft", "day"), stats.day_count)
    out["clipped_count"] = (("aircraft",), stats.clipped)
    out["gross_error_count"] = (("aircraft",), stats.gross)
    best = best_scores(found)
    out["effect"] = ("effect", np.array([s.candidate.name for s in best], dtype=object))
    out["log_evidence"] = ("effect", np.array([s.tempered for s in best], float))
    shares = [aircraft_probability(s) for s in best]
    out["aircraft_probability"] = (
        ("effect", "aircraft"), np.reshape(shares, (len(best), len(frame.tails)))
    )  # fmt: skip
    noise = final.noise
    out["noise_distance"] = (("distance",), noise.distance_km)
    out["noise_autocovariance"] = (("distance",), noise.autocovariance)
    out["noise_autocovariance_model"] = (("distance",), noise.autocovariance_model)
    out["noise_level_factor"] = (("noise_level",), noise.model.level_factors)
    out["noise_level"] = (("noise_level",), np.exp(noise.model.level_nodes) / 100)
    return out
