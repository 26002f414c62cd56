"""From reports to a fitted model: noise, sums, search, exchange of identifiers, second pass.

An archive is searched once to first order. Where two aircraft look as if they had exchanged
identifiers, the archive with their reports given back is searched as well, with the same noise, and
the labelling with the larger evidence is kept. Where sensor effects are large, a second pass is
linearised about them: heading and airspeed are corrected by what was found, the noise is fitted
again, and to the residual of the corrected reports the *per-report* correction is added back to
first order at the corrected heading, so that what is searched is a function of the true heading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.exogenous import exogenous
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.design.weather import day_field_columns
from airswing.gap.effects.base import Effect
from airswing.gap.model.candidates import Candidates
from airswing.gap.model.evidence import Exchange, exchange_evidence
from airswing.gap.model.selection import search
from airswing.gap.model.sums import Sums
from airswing.gap.model.terms import GATE, Model, Term, set_prior
from airswing.gap.noise.model import NoiseFit, fit_noise

Floats = NDArray[np.float64]
Say = Callable[[str], None]

#: Size from which the model is linearised about an effect, m/s rms where it acts: at 120 m/s it is
#: half a degree, where first order errs by 0.4 % of the effect; and at single reports, where an
#: effect is in danger of being taken for gross errors.
LARGE, PEAK = 1.0, 2.5


@dataclass
class Fitted:
    """A model with all that it was made of.

    Attributes
    ----------
    frame : Frame
        Reports as given, but with exchanged identifiers given back.
    corrected : Frame
        The same with the sensor effects of the first pass taken off.
    residual : (n, 2) float
        What the terms explain: see the module, m/s.
    exchange : Exchange or None
    """

    frame: Frame
    corrected: Frame
    context: Frame
    noise: NoiseFit
    residual: Floats
    model: Model
    terms: list[Term]
    exchange: Exchange | None = None

    def effect(self, k: int, theta: Floats | None = None) -> Floats:
        """What the k-th term does to every report, (n, 2) m/s, to first order."""
        return term_effect(self.model, k, self.model.theta if theta is None else theta)


def prepared(
    frame: Frame,
    effects: Mapping[str, Effect],
    *,
    tables: bool,
    seed: int,
    noise: NoiseFit | None = None,
    residual: Floats | None = None,
    less: Floats | float = 0.0,
    indicated: Floats | None = None,
) -> Fitted:
    """Build candidates and sums of an archive; nothing is searched yet.

    Parameters
    ----------
    noise : NoiseFit, optional
        Used instead of fitting it.
    residual : (n, 2) float, optional
        Instead of reported minus reference wind.
    less : (n, 2) float, optional
        Taken off the residual before the noise is fitted.
    indicated : (n,) float, optional
        Indicated magnetic heading, of which errors of the heading are functions, where that of the
        frame is a corrected one, rad.
    """
    context = exogenous(frame)
    if indicated is not None:
        context = replace(context, magnetic_heading=indicated)
    if noise is None:
        quiet = frame.residual - less
        noise = fit_noise(quiet, context, heading_doubt(frame, context), seed=seed)
    residual = frame.residual if residual is None else residual
    candidates = Candidates(frame, context, effects, tables=tables)
    fields = day_field_columns(context)
    sums = Sums(frame, noise, candidates, fields, residual)
    return Fitted(frame, frame, context, noise, residual, Model(sums), [])


def fit_model(
    frame: Frame,
    effects: Mapping[str, Effect],
    *,
    tables: bool = True,
    exchanges: bool = True,
    seed: int = 0,
    say: Say = lambda text: None,
) -> Fitted:
    """Search an archive for what is at work.

    Parameters
    ----------
    frame : Frame
        Reports against one reference.
    effects : mapping
        Name -> effect that can be tested.
    tables : bool
        Also look outside the catalogue.
    exchanges : bool
        Also look for exchanged identifiers.
    seed : int
        Of the draw of flights that the noise is fitted to.
    say : callable
        Called with a line on every step of the search.
    """
    fitted = prepared(frame, effects, tables=tables, seed=seed)
    found = _exchange(fitted, effects) if exchanges else None
    fitted.terms = search(fitted.model, say=say)
    if found is not None:
        say(f"exchange {found}")
        other = _with_exchange(fitted, found, effects, tables, seed, say)
        if other is not None:
            fitted = other
    return _linearised(fitted, effects, tables, seed, say)


def _exchange(fitted: Fitted, effects: Mapping[str, Effect]) -> Exchange | None:
    """The likeliest exchange where it beats none, and changes of the two aircraft."""
    groups = fitted.model.sums.candidates.groups
    steps = [g for g in groups if g.kind == "dated" and len(g.form) == 3]
    if not steps:
        return None
    factor = fitted.model.statistics(steps[0]).factor
    found = exchange_evidence(fitted.model, steps[0], max(1.0, float(np.mean(factor))))
    if found is None or found.evidence - np.log(2 * len(effects)) < GATE:
        return None
    return found if found.evidence > found.as_changes else None


def exchanged(frame: Frame, found: Exchange, sums: Sums) -> Frame:
    """Frame with the later reports of a pair given back to each other."""
    first, second = found.pair
    late = sums.day >= found.day
    aircraft = frame.aircraft.copy()
    aircraft[late & (frame.aircraft == first)] = second
    aircraft[late & (frame.aircraft == second)] = first
    return replace(frame, aircraft=aircraft)


def _with_exchange(
    fitted: Fitted,
    found: Exchange,
    effects: Mapping[str, Effect],
    tables: bool,
    seed: int,
    say: Say,
) -> Fitted | None:
    """The archive with identifiers given back, where its evidence is larger."""
    frame = exchanged(fitted.frame, found, fitted.model.sums)
    other = prepared(frame, effects, tables=tables, seed=seed, noise=fitted.noise)
    other.terms = search(other.model, say=say)
    kappa = max(fitted.model.kappa, other.model.kappa)
    gain = total_evidence(other, kappa) - total_evidence(fitted, kappa)
    pairs = fitted.model.sums.A * (fitted.model.sums.A - 1) / 2 * fitted.model.sums.D
    evidence = gain - float(np.log(pairs))
    say(f"exchange with all other terms: {evidence:.1f}")
    if evidence - np.log(2 * len(effects)) < GATE:
        return None
    other.exchange = replace(found, evidence=evidence)
    return other


def total_evidence(fitted: Fitted, kappa: float) -> float:
    """Log evidence of all terms against none with their log prior."""
    model = fitted.model
    prior = sum(t.group.prior + set_prior(model, t) for t in fitted.terms)
    return model.evidence(fitted.terms, kappa) - model.evidence([], kappa) + prior


def is_sensor(term: Term, effects: Mapping[str, Effect]) -> bool:
    """Whether a term acts on the indicated heading or airspeed."""
    if term.group.named:
        return effects[term.group.name].stage == "sensor"
    return term.group.component in ("heading_angle", "along_heading")


def term_effect(model: Model, k: int, theta: Floats) -> Floats:
    """What the k-th term does to every report, (n, 2) m/s, with coefficients of the whole model."""
    term, sums = model.terms[k], model.sums
    own = theta[model.offsets[k + 1] : model.offsets[k + 2]]
    coefficients = np.zeros((sums.A, term.group.size))
    coefficients[list(term.tails)] = own.reshape(-1, term.group.size)
    columns = sums.candidates.raw(term.group.columns)
    raw = coefficients @ term.group.transform.T
    effect = np.einsum("nck,nk->nc", columns, raw[sums.aircraft])
    if term.start:
        first = np.full(sums.A, np.iinfo(np.int64).max)
        for a, day in term.start.items():
            first[a] = day
        effect = effect * (sums.day >= first[sums.aircraft])[:, None]
    return np.asarray(effect)


def without_errors(frame: Frame, effect: Floats) -> tuple[Frame, Floats, Floats]:
    """Remove a sensor effect (n, 2) exactly: corrected frame, turn (rad), airspeed error (m/s)."""
    sine, cosine = np.sin(frame.heading), np.cos(frame.heading)
    turn = -(effect[:, 0] * cosine - effect[:, 1] * sine) / np.maximum(frame.airspeed, 1.0)
    faster = -(effect[:, 0] * sine + effect[:, 1] * cosine)
    heading, airspeed = frame.heading - turn, frame.airspeed - faster
    corrected = replace(
        frame,
        heading=np.mod(heading, 2 * np.pi),
        magnetic_heading=np.mod(frame.magnetic_heading - turn, 2 * np.pi),
        airspeed=airspeed,
        u_rep=frame.ground_u - airspeed * np.sin(heading),
        v_rep=frame.ground_v - airspeed * np.cos(heading),
    )
    return corrected, turn, faster


def _linearised(
    fitted: Fitted, effects: Mapping[str, Effect], tables: bool, seed: int, say: Say
) -> Fitted:
    """A second pass about the sensor effects found, where they are large."""
    sensor = [k for k, term in enumerate(fitted.terms) if is_sensor(term, effects)]
    if not sensor:
        return fitted
    every = [fitted.effect(k) for k in range(len(fitted.terms))]
    off = sum(every[k] for k in sensor)
    assert isinstance(off, np.ndarray)
    size = np.hypot(off[:, 0], off[:, 1])
    acting = size > 1e-3 * size.max()
    if np.sqrt((size[acting] ** 2).mean()) < LARGE and size.max() < PEAK:
        return fitted
    say("second pass")
    corrected, turn, faster = without_errors(fitted.frame, off)
    context = exogenous(corrected)
    rest = sum((e for k, e in enumerate(every) if k not in sensor), np.zeros_like(off))
    sine, cosine = np.sin(context.heading), np.cos(context.heading)
    residual = corrected.residual.copy()
    residual[:, 0] += -context.airspeed * turn * cosine - faster * sine
    residual[:, 1] += context.airspeed * turn * sine - faster * cosine
    fitted.model.sums.release()
    again = prepared(
        corrected,
        effects,
        tables=tables,
        seed=seed,
        residual=residual,
        less=rest,
        indicated=fitted.context.magnetic_heading,
    )
    candidates = again.model.sums.candidates
    for term in fitted.terms:
        if len(term.group.variables) == 2:
            table = fitted.model.sums.candidates.tables[term.group.name]
            candidates.add_table(table, term.group.prior)
    again.model.sums.extend()
    groups = {(g.name, g.form, g.kind): g for g in candidates.groups}
    known = [(t, groups.get((t.group.name, t.group.form, t.group.kind))) for t in fitted.terms]
    start: Sequence[Term] = [replace(t, group=g) for t, g in known if g is not None]
    again.terms = search(again.model, start=start, say=say)
    again.frame, again.exchange = fitted.frame, fitted.exchange
    return again
