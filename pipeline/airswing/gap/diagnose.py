"""Diagnosis of an archive: model, closure, effects that change no mean, checks, statement.

Validity: at least two aircraft-weeks and some thousand reports for anything but "nothing found".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.checks import Adjustment, run_checks
from airswing.gap.distribution.coded_values import coded_effects, reduction_of_coding
from airswing.gap.distribution.entries import unnamed
from airswing.gap.distribution.gross_errors import gross_by_variable, outliers, reduction_of_gross
from airswing.gap.distribution.lasting_errors import find_lasting_errors
from airswing.gap.distribution.scatter import find_scatter
from airswing.gap.distribution.sent_winds import find_sent_winds
from airswing.gap.effects import CATALOGUE
from airswing.gap.effects.base import Effect, number
from airswing.gap.model.closure import Closure, close
from airswing.gap.model.localisation import slices
from airswing.gap.model.passes import Fitted, fit_model, is_sensor
from airswing.gap.model.refit import without_errors
from airswing.gap.model.terms import Model
from airswing.gap.noise import gross_errors
from airswing.gap.result.report import assemble, diagnosis_dataset
from airswing.gap.result.schema import ClosesEntry, EffectEntry, GapReport, PlaceEntry
from airswing.gap.result.statement import by_member, claims_of, effect_entry

Progress = Callable[[str], None]


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
        Corrections of the winds for all effects but the deviation.
    """

    report: GapReport
    dataset: xr.Dataset
    adjustment: Adjustment


def usable_effects(
    frame: Frame, catalogue: Mapping[str, Effect]
) -> tuple[dict[str, Effect], dict[str, str]]:
    """Effects whose columns can be tested in an archive, and the reason why others cannot."""
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
        Called with the name of each stage as it begins.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        Fewer than 200 reports or fewer than four flights.

    Examples
    --------
    >>> report = airswing.diagnose(headings, reference="ruc", dictionary=False).report
    >>> report.gap.mean_vector_disagreement_kt > 0.0
    True
    """
    if isinstance(reports, xr.Dataset):
        if "reference_eastward_wind_tendency" not in reports:
            raise InputError(
                "the headings hold no derivatives of the reference wind",
                field="reference_eastward_wind_tendency",
                remedy="collocate with derivatives=True; without them four effects cannot be found",
            )
        if reference is None:
            if "reference" not in reports.coords or not reports.sizes["reference"]:
                raise InputError("the headings hold no reference", field="reference")
            reference = str(reports["reference"].to_numpy()[0])
        reports = Frame.from_headings(reports, reference=reference)
    flights = int(np.unique(reports.flight).size)
    if reports.size < 200 or flights < 4:
        raise InputError(
            "too few reports for a diagnosis",
            found=f"{reports.size} reports of {flights} flights",
            remedy="at least 200 reports of four flights with model winds are needed",
        )
    say = progress or (lambda stage: None)
    frame, catalogue = reports, CATALOGUE if catalogue is None else catalogue
    effects, untestable = usable_effects(frame, catalogue)
    say("search")
    fitted = fit_model(
        frame, effects, tables=dictionary, exchanges="tail_swap" in catalogue, seed=seed
    )
    say("closure")
    claims = claims_of(fitted.terms)
    closure = close(fitted, [claim.terms for claim in claims], seed=seed)
    say("distribution")
    unseen = _effects_without_mean(fitted, closure, catalogue, dictionary, seed)
    say("where")
    where = slices(Model(fitted.model.sums)) if dictionary else []
    report = assemble(fitted, effects, claims, closure, unseen, where)
    say("checks")
    checks, histograms = run_checks(fitted, closure, seed=seed)
    report = replace(report, untestable=untestable, seed=seed, **checks)
    dataset = diagnosis_dataset(fitted).assign(histograms)
    return Diagnosis(report, dataset, make_adjustment(fitted, effects))


def attributed(
    report: GapReport,
    members: Sequence[str],
    frame_against: Callable[[str, float], Frame],
    *,
    seed: int = 0,
) -> GapReport:
    """Attribute the effects of a reference, in a report, to the members of a pool.

    The effects found against the pool are fitted again to the residual against each member, where
    an effect of that member alone has its full size. ``frame_against`` makes the reports against a
    reference whose fields show the atmosphere of a time (h) after the stamped one.
    """
    if len(members) < 2 or all(effect.scope != "reference" for effect in report.effects):
        return report
    names = [effect.name for effect in report.effects]
    fits = {member: _effects_against(member, names, frame_against, seed) for member in members}
    return replace(report, effects=by_member(report.effects, str(report.reference), fits))


def _effects_against(
    reference: str, names: Sequence[str], frame_against: Callable[[str, float], Frame], seed: int
) -> list[EffectEntry]:
    offset, entries, of_time = 0.0, dict[str, EffectEntry](), "reference_time_offset"
    # the winds are known an hour before and after the reports: five steps of an hour or two
    for _ in range(5):
        frame = frame_against(reference, offset)
        effects, _untestable = usable_effects(frame, {name: CATALOGUE[name] for name in names})
        fitted = fit_model(frame, effects, tables=False, exchanges=False, seed=seed)
        latest = {
            claim.name: effect_entry(fitted, claim, effects, ClosesEntry(0.0, [0.0, 0.0]))
            for claim in claims_of(fitted.terms)
        }
        entries = entries | latest
        if of_time not in latest:
            break
        step = number(latest[of_time].parameters["offset_h"])
        offset += step
        entries[of_time] = replace(latest[of_time], parameters={"offset_h": offset})
        if abs(step) < 0.5:  # the second order is near enough
            break
    return list(entries.values())


def _effects_without_mean(
    fitted: Fitted, closure: Closure, catalogue: Mapping[str, Effect], dictionary: bool, seed: int
) -> list[EffectEntry | PlaceEntry]:
    frame, rest = fitted.frame, closure.residual
    # without the effects on means: heavy tails of an effect are no gross errors
    gross = gross_errors(rest, fitted.noise.order)
    entries = [*coded_effects(frame), outliers(frame, rest, replace(fitted.noise, gross=gross))]
    out: list[EffectEntry | PlaceEntry] = []
    coded, erring = list[int](), list[int]()
    for entry in entries:
        # from odds of a thousand
        if entry is None or entry.evidence_nats < 7.0:
            continue
        if entry.name not in catalogue and not dictionary:
            continue
        reduction, affected = reduction_of_coding, coded
        if entry.name == "outliers":
            reduction, affected = reduction_of_gross, erring
        entry = replace(entry, closure=reduction(frame, rest, entry, gross))
        variables = fitted.model.sums.candidates.variables
        conditional = dictionary and affected is erring
        place = gross_by_variable(frame, entry, gross, variables) if conditional else None
        if place is None and entry.name not in catalogue:
            place = unnamed(entry, frame)
        out.append(place or entry)
        affected.extend(frame.tails.index(tail) for tail in entry.tails)
    if not dictionary:
        return out
    named = gross & np.isin(frame.aircraft, erring)
    sent = find_sent_winds(frame, rest, without=coded, gross=named, seed=seed)
    if sent is not None:
        out.append(sent[0])
        coded.extend(sent[1])
    scatter = find_scatter(fitted, rest, gross=gross, named=named, without=coded, seed=seed)
    lasting = find_lasting_errors(fitted, rest, gross)
    return [*out, *(place for place in (scatter, lasting) if place is not None)]


def make_adjustment(fitted: Fitted, effects: Mapping[str, Effect]) -> Adjustment:
    """Corrections of the winds for all effects but the deviation."""
    frame = fitted.frame
    sensor, report, reference = np.zeros((3, frame.size, 2))
    names = []
    for k, term in enumerate(fitted.terms):
        name = term.group.name
        if term.group.named and not effects[name].deviates:
            target = reference if effects[name].scope == "reference" else report
            target = sensor if is_sensor(term, effects) else target
            target += fitted.exact.response.linear(k, fitted.exact.theta)
            names.append(name)
    change = -report
    if sensor.any():
        corrected, _, _ = without_errors(frame, sensor)
        affected = sensor.any(axis=1)
        change[affected] += (corrected.residual - frame.residual)[affected]
    return Adjustment(frame.report, change, reference, tuple(dict.fromkeys(names)))
