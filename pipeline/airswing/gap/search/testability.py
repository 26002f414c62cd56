"""Effects that an archive cannot show, because what is always fitted beside them takes them up.

Assumptions: every day has fields of its own, and the reference its climatology and its slope on the
wind; they are fitted beside everything else. A fleet-wide effect that is nearly a combination of
them (a bias of the whole model wind, winds turned by a grid's angle) leaves so little that silence
about it means nothing: it is then said to be untestable.

Validity: whitened columns; shares of energy between 0 and 1.

Source: Frisch-Waugh-Lovell: the information that remains is the energy of the column beyond the
nuisance columns. docs/gap.md sections 5 and 6.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from airswing.gap.design.candidates import Candidate
from airswing.gap.effects.base import Effect
from airswing.gap.sums.accumulate import Statistics
from airswing.gap.sums.elimination import Base, Conditional

#: Share of an effect's energy that must remain for silence about it to mean something.
LEAST_SHARE = 0.2
#: Share of the fullest day's reports under which a day is an edge of another.
EDGE = 0.25


def surviving_share(base: Base, bare: Conditional, candidate: Candidate) -> float:
    """Share of a fleet-wide effect's whitened energy beyond what is always fitted beside it.

    Parameters
    ----------
    bare : Conditional
        Given the climatology and slope alone.
    candidate : Candidate
        Its columns weigh by their prior scales.

    Returns
    -------
    float
        Between 0 and 1; NaN where the effect acts nowhere.
    """
    columns, weight = candidate.columns, candidate.scales**2
    whole = base.stats.week_gram[:, :, columns, columns].sum(axis=(0, 1), dtype=np.float64)
    left = bare.fleet_gram[columns, columns]
    total = float(whole @ weight)
    return float(np.clip(left @ weight / total, 0.0, 1.0)) if total > 0 else float("nan")


def single_day(stats: Statistics) -> bool:
    """Whether an archive holds one day, and of others no more than an edge."""
    reports = np.bincount(
        np.unique(stats.calendar_day, return_inverse=True)[1], stats.day_count.sum(axis=0)
    )
    return bool(np.count_nonzero(reports >= EDGE * reports.max()) < 2)


def too_short(base: Base, effects: Mapping[str, Effect]) -> dict[str, str]:
    """Effects that a single day cannot tell: changes, and all aircraft's, with the reason.

    Parameters
    ----------
    effects : mapping
        Name -> effect looked for.

    Returns
    -------
    dict
        Name -> reason; empty for two days and more.
    """
    if not single_day(base.stats):
        return {}
    reason = (
        "one day of reports: a day's weather looks like an effect that changes, or that all "
        "aircraft share; two weeks would tell"
    )
    lasting = {name for name, one in effects.items() if _of_units(one) and one.kind == "mean"}
    return dict.fromkeys(effects.keys() - lasting, reason)


def absorbed(
    base: Base, bare: Conditional, pool: Sequence[Candidate], effects: Mapping[str, Effect]
) -> dict[str, str]:
    """Fleet-wide effects of which too little remains, with the reason in words.

    Parameters
    ----------
    bare : Conditional
        Given the climatology and slope alone.
    effects : mapping
        Name -> effect, for the names of its forms.

    Returns
    -------
    dict
        Name -> reason. Where an effect has several forms (levels), those absorbed are named.
    """
    shares: dict[str, dict[str, float]] = {}
    for candidate in pool:
        if not candidate.known or candidate.scope != "fleet" or _of_units(effects[candidate.name]):
            continue
        share = surviving_share(base, bare, candidate)
        if np.isfinite(share):
            form = " and ".join(effects[candidate.name].column_names[k] for k in candidate.subset)
            # parts of a level are called by its pressure
            form = re.sub(r"\b(above|below)_(\d+)", r"\1 \2 hPa", form).replace("_", " ")
            shares.setdefault(candidate.name, {})[form] = share
    out = {}
    for name, forms in shares.items():
        lost = {form: share for form, share in forms.items() if share < LEAST_SHARE}
        if lost:
            out[name] = _reason(lost, len(lost) == len(forms))
    return out


def _of_units(effect: Effect) -> bool:
    """Whether an effect is one of each unit's sensors: an aircraft alone may show it as well."""
    sensor = getattr(effect, "stage", "sensor") == "sensor"
    return bool(sensor and getattr(effect, "scope", "") in ("aircraft", "pair"))


def _reason(lost: Mapping[str, float], entirely: bool) -> str:
    """Why an effect, or some forms of it, cannot be tested."""
    most = 100 * (1 - max(lost.values()))
    which = "" if entirely else f"in part ({', '.join(lost)}): "
    return (
        f"{which}at least {most:.0f} % of it cannot be told from the weather all aircraft of a day "
        "share and the model's own bias; aircraft over a wider region and more days would tell"
    )
