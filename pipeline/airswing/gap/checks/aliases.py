"""Which effects look alike on this archive: energy that their columns have in common.

Assumptions: two effects that act on the same aircraft in the same period. Columns are whitened, the
day fields eliminated and the reference's climatology projected out, as in the search. The share of
an effect's energy that another has in common with it is averaged over the effect's coefficients,
independent with their prior scales; it is 1 where the other can copy the effect whatever its size.

Validity: a property of the flights flown, not of the residual: no amount of the same flights
separates two effects of share 1. A rival that begins at a date is given the effect's period, or
the second half of the archive where the effect has none. The share is not symmetric: an effect with
more coefficients copies one with fewer.

Source: docs/gap.md section 6 (the ambiguity set).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from airswing.gap.effects import separated_by
from airswing.gap.effects.base import Effect
from airswing.gap.evidence.terms import Term, term_weights
from airswing.gap.result.schema import AliasEntry
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Base, climatology, included_sums

Floats = NDArray[np.float64]

#: Share of energy in common above which two effects are listed.
LISTED = 0.8
#: Share from which the other is always in the ambiguity set.
ALIAS = 0.9
#: Share from which an effect that weather takes up is in the set of a fleet-wide one.
HIDDEN_ALIAS = 0.5
#: What would tell those apart.
MORE_REGION = "aircraft over a wider region and more days"
#: Aircraft over which the share of an effect of single aircraft is averaged.
MOST_AIRCRAFT = 4


def alias_shares(base: Base, term: Term, effects: Mapping[str, Effect]) -> dict[str, float]:
    """Share of a term's energy that each other effect has in common with it.

    Parameters
    ----------
    term : Term
        Of a known effect.
    effects : mapping
        Name -> effect; those with columns in the sums are compared.

    Returns
    -------
    dict
        Name -> share in 0 to 1, largest first.
    """
    layout = base.stats.layout
    own = term.candidate.name
    names = [n for n in layout.effects if n != own and not _holds(effects[n], own)]
    whole = term_weights(term, base.stats.calendar)
    fleet = term.candidate.scope == "fleet"
    groups = [list(term.tails)] if fleet else [[a] for a in term.tails[:MOST_AIRCRAFT]]
    top, bottom = np.zeros(len(names)), 0.0
    for aircraft in groups:
        weights = np.zeros_like(whole)
        weights[aircraft] = whole[aircraft]
        shared, energy = _energies(base, term, weights, names, effects, aircraft)
        top += shared
        bottom += energy
    if bottom <= 0.0:
        return {}
    shares = np.clip(top / bottom, 0.0, 1.0)
    pairs = zip(names, shares.tolist(), strict=True)
    return dict(sorted(pairs, key=lambda pair: -pair[1]))


def hidden_shares(
    stats: Statistics, terms: Sequence[Term], hidden: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Share of fleet-wide terms' energy in common with effects that weather takes up.

    What is taken up says nothing by its silence: before weather is eliminated it may look like the
    term, and be its cause.

    Parameters
    ----------
    hidden : sequence of str
        Effects of which too little is left to test them.

    Returns
    -------
    dict
        Effect -> hidden effect -> share of the whitened energy, day fields and climatology in it.
    """
    gram = stats.whole_gram.sum(axis=0)
    out: dict[str, dict[str, float]] = {}
    for term in terms:
        own, scales = term.candidate.columns, term.candidate.scales
        if not term.candidate.known or term.candidate.scope != "fleet":
            continue
        energy = float(np.diagonal(gram)[own] @ scales**2)
        for name in hidden:
            block = stats.layout.columns(name)
            if name == term.candidate.name or energy <= 0.0:
                continue
            cross = gram[np.ix_(own, block)] * scales[:, None]
            shared = explained(cross, gram[np.ix_(block, block)])
            out.setdefault(term.candidate.name, {})[name] = min(1.0, shared / energy)
    return out


def _holds(effect: Effect, name: str) -> bool:
    """Whether an effect contains another as a special case: no alias, but a wider claim."""
    return bool(effect.name == "compass_drift" and name == "compass_offset")


def _energies(
    base: Base,
    term: Term,
    weights: Floats,
    names: Sequence[str],
    effects: Mapping[str, Effect],
    aircraft: Sequence[int],
) -> tuple[Floats, float]:
    """Energy each effect shares with the term on some aircraft, and the term's own."""
    layout = base.stats.layout
    nuisance = climatology(base)
    own = term.candidate.columns
    blocks = [layout.columns(name) for name in names]
    columns = np.concatenate([[x.column for x in nuisance], own, *blocks]).astype(np.int64)
    stacked = [x.weights for x in nuisance] + [weights] * own.size
    for name, block in zip(names, blocks, strict=True):
        stacked += [_rival_weights(effects[name], term, weights, aircraft)] * block.size
    gram, _ = included_sums(base, columns, np.stack(stacked))
    k = len(nuisance)
    gram = project(gram, k, np.array([x.precision for x in nuisance]))
    inner = gram[: own.size, : own.size] * np.outer(term.candidate.scales, term.candidate.scales)
    out, start = [], own.size
    for block in blocks:
        there = slice(start, start + block.size)
        cross = gram[: own.size, there] * term.candidate.scales[:, None]
        out.append(explained(cross, gram[there, there]))
        start += block.size
    return np.array(out), float(np.trace(inner))


def _rival_weights(effect: Effect, term: Term, weights: Floats, aircraft: Sequence[int]) -> Floats:
    """Aircraft and days on which a rival acts."""
    if effect.kind == "step" and term.period is None:
        half = np.zeros_like(weights)
        half[aircraft, weights.shape[1] // 2 :] = 1.0
        return half
    if effect.kind == "step":
        return np.asarray(weights > 0, float)
    if effect.scope in ("fleet", "reference"):
        return np.ones_like(weights)
    out = np.zeros_like(weights)
    out[aircraft] = 1.0
    return out


def project(gram: Floats, k: int, precision: Floats) -> Floats:
    """Gram of all but the first ``k`` columns with those projected out, as far as priors let.

    Parameters
    ----------
    gram : (m, m) float
    precision : (k,) float
        1 over the prior variances of the first columns' coefficients.

    Returns
    -------
    (m - k, m - k) float
    """
    share = np.linalg.solve(gram[:k, :k] + np.diag(precision), gram[:k, k:])
    return np.asarray(gram[k:, k:] - gram[k:, :k] @ share)


def explained(cross: Floats, gram: Floats) -> float:
    """Energy of columns that others explain: trace of C G^-1 C', collinear directions left out.

    Parameters
    ----------
    cross : (i, j) float
        Products with the other columns.
    gram : (j, j) float
        Products of the others with each other.
    """
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-30))
    # a column that nothing moves on these flights is no alias of any
    live = scale > 1e-12
    if not live.any():
        return 0.0
    # at unit diagonal, so that the bound means the same for radians and for m/s
    inner = np.linalg.pinv((gram / np.outer(scale, scale))[np.ix_(live, live)], rcond=1e-6)
    sides = (cross / scale)[:, live]
    return float(np.trace(sides @ inner @ sides.T))


def alias_table(
    base: Base, terms: Sequence[Term], effects: Mapping[str, Effect]
) -> tuple[list[AliasEntry], dict[str, dict[str, float]]]:
    """List the aliases of the effects found, and every share by effect.

    Parameters
    ----------
    terms : sequence of Term
        Unknown terms are passed over.

    Returns
    -------
    listed : list of AliasEntry
        Of a share above 0.8, largest first.
    shares : dict
        Effect -> other -> share; of an effect found twice the larger.
    """
    shares: dict[str, dict[str, float]] = {}
    for term in terms:
        if not term.candidate.known:
            continue
        known = shares.setdefault(term.candidate.name, {})
        for name, share in alias_shares(base, term, effects).items():
            known[name] = max(share, known.get(name, 0.0))
    listed = [
        AliasEntry(effect, other, share, separated_by(effect, other))
        for effect, others in shares.items()
        for other, share in others.items()
        if share > LISTED
    ]
    return sorted(listed, key=lambda pair: -pair.alias_share), shares
