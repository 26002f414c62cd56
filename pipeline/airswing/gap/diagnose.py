"""The diagnosis of an archive in one call: model, closure, what no mean shows, checks, statement.

Order: the effects that can be tested (:mod:`airswing.gap.effects`); search by one statistical model
(:mod:`airswing.gap.model`); effects that show in no mean (:mod:`airswing.gap.distribution`);
closure on held-out days; statement as gap.json (:mod:`airswing.gap.result`) and gap.nc.

Validity: at least two aircraft-weeks and some thousand reports for anything but "nothing found".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.checks.assumptions import run_checks
from airswing.gap.checks.refit_claims import Adjustment
from airswing.gap.distribution.coded_values import coded_effects
from airswing.gap.distribution.gross_errors import outliers
from airswing.gap.distribution.scatter import Scatter, find_scatter
from airswing.gap.distribution.sent_winds import SentWinds, find_sent_winds
from airswing.gap.distribution.verdict import Verdict
from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.base import Effect, number
from airswing.gap.model.closure import Closure, Step, close
from airswing.gap.model.localisation import slices
from airswing.gap.model.passes import Fitted, fit_model, is_sensor
from airswing.gap.model.refit import without_errors
from airswing.gap.model.terms import GATE, Model
from airswing.gap.noise.model import gross_errors
from airswing.gap.result.diagnosis_dataset import diagnosis_dataset
from airswing.gap.result.report import STATED, Findings, assemble
from airswing.gap.result.schema import EffectEntry, GapReport
from airswing.gap.result.statement import by_member, claims_of, effect_entry

#: Steps of an offset of the reference's time, whose winds are known an hour before and after the
#: reports, and the step (h) from which the second order is near enough.
TIME_OFFSET, ROUNDS, CLOSE = "reference_time_offset", 5, 0.5
Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Diagnosis:
    """Result of `diagnose`.

    Attributes
    ----------
    report : GapReport
        Content of gap.json.
    dataset : Dataset
        Content of gap.nc. Figures may use: ``heading_map``, ``level_map_cross``,
        ``level_map_along``, ``region_map_u``, ``region_map_v``, ``time_line``, ``time_line_along``
        (each with ``_standard_error``), ``effect``, ``log_evidence``, ``aircraft_probability``,
        ``noise_distance``, ``noise_autocovariance``, ``noise_autocovariance_model``,
        ``noise_level``, ``noise_level_factor``, ``pit_bin``, ``pit_count``, ``pit_count_before``.
    adjustment : Adjustment
        What removes the effects other than the deviation from the winds.
    """

    report: GapReport
    dataset: xr.Dataset
    adjustment: Adjustment

    def __repr__(self) -> str:
        closure = self.report.closure
        unnamed = [" x ".join(place.variables) for place in self.report.unknown.where]
        return "\n".join(
            [
                f"Diagnosis: {closure.before:.2f} kt before, {closure.after:.2f} kt after",
                *(f"  {_line(effect)}" for effect in self.report.effects),
                *(f"  unknown, by {place}" for place in unnamed),
            ]
        )


def _line(effect: EffectEntry) -> str:
    tails = effect.tails
    whom = "the fleet" if not tails else ", ".join(tails[:4]) + (" ..." if len(tails) > 4 else "")
    return f"{effect.name} ({whom}), probability {effect.probability:.2f}"


def usable_effects(
    frame: Frame, catalogue: Mapping[str, Effect]
) -> tuple[dict[str, Effect], dict[str, str]]:
    """Effects whose columns can be tested in an archive, and why the others cannot.

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
    reports: xr.Dataset | Frame,
    *,
    reference: str | Sequence[str] | None = None,
    catalogue: Mapping[str, Effect] | None = None,
    dictionary: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose where an archive differs from its simulation, why, and how far that closes.

    Parameters
    ----------
    reports : Dataset or Frame
        Screened headings with the columns the gap needs, or reports against one reference.
    reference : str or sequence of str, optional
        Of a Dataset: which reference, or the members of a pool; the first when not given.
    catalogue : mapping, optional
        Name -> effect; the whole catalogue by default.
    dictionary : bool
        Also look outside the catalogue.
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

    Examples
    --------
    >>> found = airswing.diagnose(headings, reference="ruc", dictionary=False)
    >>> found.report.gap.mean_vector_disagreement_kt > 0.0
    True
    """
    if isinstance(reports, xr.Dataset):
        if "reference_eastward_wind_tendency" not in reports:
            raise InputError(
                "the headings hold no derivatives of the reference wind",
                field="reference_eastward_wind_tendency",
                remedy="collocate with derivatives=True; without them four effects cannot be found",
            )
        reports = Frame.from_headings(reports, reference=_asked(reports, reference))
    flights = int(np.unique(reports.flight).size)
    if reports.size < 200 or flights < 4:
        raise InputError(
            "too few reports for a diagnosis",
            found=f"{reports.size} reports of {flights} flights",
            remedy="at least 200 reports of four flights with model winds are needed",
        )
    say = progress or (lambda stage, done: None)
    return _diagnosed(reports, CATALOGUE if catalogue is None else catalogue, dictionary, seed, say)


def attributed(
    report: GapReport,
    members: Sequence[str],
    frame_against: Callable[[str, float], Frame],
    *,
    seed: int = 0,
) -> GapReport:
    """Attribute the effects of a reference to the members of a pool.

    The effects found against the pool are fitted again to the residual against each member, where
    an effect of that member alone has its full size.

    Parameters
    ----------
    report : GapReport
        Diagnosis against the pool, its `reference`.
    members : sequence of str
        References of the pool.
    frame_against : callable
        Reports against a reference whose fields show the atmosphere of a time (h) after the
        stamped one.
    seed : int
        As in `diagnose`.

    Returns
    -------
    GapReport
        With `reference` and `by_reference` of the effects of a reference.
    """
    if len(members) < 2 or all(effect.scope != "reference" for effect in report.effects):
        return report
    names = [effect.name for effect in report.effects]
    found = {one: _effects_against(one, names, frame_against, seed) for one in members}
    return replace(report, effects=by_member(report.effects, str(report.reference), found))


def _effects_against(
    reference: str, names: Sequence[str], frame_against: Callable[[str, float], Frame], seed: int
) -> list[EffectEntry]:
    """Entries of effects against one reference; an offset of its time is found in steps."""
    offset, entries = 0.0, dict[str, EffectEntry]()
    for _ in range(ROUNDS):
        frame = frame_against(reference, offset)
        effects, _untestable = usable_effects(frame, {name: CATALOGUE[name] for name in names})
        fitted = fit_model(frame, effects, tables=False, exchanges=False, seed=seed)
        found = {
            claim.name: effect_entry(fitted, claim, effects, Step(0.0, (0.0, 0.0)), 0.0)
            for claim in claims_of(fitted.terms)
        }
        entries = entries | found
        if TIME_OFFSET not in found:
            break
        step = number(found[TIME_OFFSET].parameters["offset_h"])
        offset += step
        entries[TIME_OFFSET] = replace(found[TIME_OFFSET], parameters={"offset_h": offset})
        if abs(step) < CLOSE:
            break
    return list(entries.values())


def _asked(headings: xr.Dataset, reference: str | Sequence[str] | None) -> str | Sequence[str]:
    if reference is not None:
        return reference
    if "reference" not in headings.coords or not headings.sizes["reference"]:
        raise InputError("the headings hold no reference", field="reference")
    return str(headings["reference"].to_numpy()[0])


def _diagnosed(
    frame: Frame,
    catalogue: Mapping[str, Effect],
    dictionary: bool,
    seed: int,
    say: Progress,
) -> Diagnosis:
    effects, untestable = usable_effects(frame, catalogue)
    say("search", 0.0)
    fitted = fit_model(
        frame, effects, tables=dictionary, exchanges="tail_swap" in catalogue, seed=seed
    )
    say("closure", 0.0)
    claims = claims_of(fitted.terms)
    closure = close(fitted, [claim.terms for claim in claims], seed=seed)
    say("distribution", 0.0)
    named, scatter, sent = _distribution(fitted, closure, catalogue, dictionary, seed)
    say("where", 0.0)
    where = slices(Model(fitted.model.sums)) if dictionary else []
    findings = Findings(
        fitted, effects, claims, closure, named, scatter, sent, where, untestable, seed
    )
    report = assemble(findings)
    say("checks", 0.0)
    checks, histograms = run_checks(fitted, closure, seed=seed)
    report = replace(
        report,
        calibration=checks.calibration,
        decoy=checks.placebo,
        aliases=checks.aliases,
        assumptions=checks.assumptions,
    )
    dataset = diagnosis_dataset(fitted).assign(histograms)
    return Diagnosis(report, dataset, make_adjustment(fitted, effects))


def _distribution(
    fitted: Fitted, closure: Closure, catalogue: Mapping[str, Effect], dictionary: bool, seed: int
) -> tuple[list[Verdict], Scatter | None, SentWinds | None]:
    """What shows in no mean: effects with a name, scatter, winds sent otherwise."""
    frame, rest = fitted.frame, closure.residual
    named = [one for one in coded_effects(frame) if one.name in catalogue]
    # with what moves means taken off: heavy tails of an effect are no gross errors
    gross = gross_errors(rest, fitted.noise.order)
    found = outliers(frame, rest, replace(fitted.noise, gross=gross))
    if found is not None and "outliers" in catalogue:
        named.append(found)
    named = [one for one in named if one.evidence >= STATED]
    if not dictionary:
        return named, None, None
    of_tail = {tail: a for a, tail in enumerate(frame.tails)}
    coded = [of_tail[t] for one in named if one.name != "outliers" for t in one.tails]
    erring = [of_tail[t] for one in named if one.name == "outliers" for t in one.tails]
    left_out = gross & np.isin(frame.aircraft, erring)
    sent = find_sent_winds(frame, rest, without=coded, gross=left_out, gate=GATE, seed=seed)
    also = coded if sent is None else [*coded, *sent.tails]
    scatter = find_scatter(
        frame,
        fitted.context,
        rest,
        fitted.noise,
        fitted.model.sums.candidates.variables,
        gross=left_out,
        without=also,
        gate=GATE,
        seed=seed,
    )
    return named, scatter, sent


def make_adjustment(fitted: Fitted, effects: Mapping[str, Effect]) -> Adjustment:
    """What removes the effects other than the deviation from the winds."""
    frame = fitted.frame
    sensor, report, reference = (np.zeros((frame.size, 2)) for _ in range(3))
    names = []
    for k, term in enumerate(fitted.terms):
        name = term.group.name
        if not term.group.named or effects[name].deviates:
            continue
        error = fitted.exact.effect(k)
        if is_sensor(term, effects):
            sensor += error
        elif effects[name].scope == "reference":
            reference += error
        else:
            report += error
        names.append(name)
    change = -report
    if sensor.any():
        corrected, _, _ = without_errors(frame, sensor)
        moved = sensor.any(axis=1)
        change[moved] += (corrected.residual - frame.residual)[moved]
    return Adjustment(frame.report, change, reference, tuple(dict.fromkeys(names)))


__all__ = ["Diagnosis", "Step", "diagnose", "usable_effects"]
