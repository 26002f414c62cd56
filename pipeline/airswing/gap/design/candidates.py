"""What could explain the residual: effects of the catalogue in all their forms, dictionary groups.

Assumptions: an effect of single aircraft has coefficients of its own for each, one of the fleet or
the reference one set for all; a lasting effect of aircraft is tried both ways: what all have alike
(one installation, one table) would pass for the little of it that every fleet has. A
change at a date is tried as an offset, as one cycle and as both; a drift also as one that sets in
on a date, from nothing. Dictionary groups are tried for
single aircraft and for the fleet; those of the reference's wind for single aircraft only where what
would make one aircraft follow them is not in the catalogue in use.

Validity: the columns of a :class:`airswing.gap.design.layout.Layout`. Prior scales are the effects'
own; 0.8 m/s for a dictionary group.

Source: docs/gap.md sections 4 to 6.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.design.layout import Layout
from airswing.gap.effects import HeadingEffect
from airswing.gap.effects.base import Effect

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Dictionary groups of the reference's wind -> what makes single aircraft follow them; those are
#: tried where it is not in the catalogue in use.
OF_SINGLE_AIRCRAFT = {"wind:shear": "altitude_offset", "wind:advection": "time_lag"}
#: Prior standard deviation of a dictionary group's coefficients, m/s.
GROUP_SCALE = 0.8
#: Share of the energy of an effect nobody thought of that a dictionary group carries at most: nine
#: of ten drawn at random (`airswing.synthetic.sealed.cases`) leave more to others.
GROUP_SHARE = 0.6


@dataclass(frozen=True)
class Candidate:
    """Something that could explain the residual."""

    name: str  # effect or dictionary group
    columns: Integers  # (k,): columns of the layout
    scope: str  # ``aircraft`` (own coefficients for each) or ``fleet`` (one set for all)
    scales: Floats  # (k,): prior standard deviations
    known: bool  # true for an effect of the catalogue, False for a dictionary group
    subset: tuple[int, ...] = ()  # which of the effect's coefficients these columns are
    kind: str = "mean"  # the effect's kind; ``onset`` of a drift that sets in on a date
    # of an effect that changes steadily in time: columns of the layout that hold it unchanged, with
    # their prior scales
    lasting: tuple[tuple[int, float], ...] = ()
    told_share: float = 1.0  # share of the effect's energy that its columns carry
    heading: bool = False  # true for an effect of the heading and for a dictionary group across it
    # (k, m): how its coefficients follow from those that are free; None: all are
    tied: Floats | None = None

    @property
    def key(self) -> tuple[str, str, tuple[int, ...]]:
        """What identifies the candidate."""
        return self.name, self.scope, self.subset

    @property
    def dated(self) -> bool:
        """Whether it acts from a date on, which is looked for."""
        return self.kind in ("step", "onset")

    @property
    def steady(self) -> Integers:
        """Columns that hold an effect that drifts unchanged in time."""
        return np.array([j for j, _ in self.lasting], np.int64)

    @property
    def free(self) -> int:
        """Number of free coefficients, the first of all."""
        return int(self.columns.size if self.tied is None else self.tied.shape[1])

    def coefficients(self, free: Floats) -> Floats:
        """All coefficients (..., k) that follow from the free ones (..., m)."""
        return free if self.tied is None else np.asarray(free @ self.tied.T)

    @property
    def component(self) -> str:
        """Component of a dictionary group: cross, along or wind; empty for an effect."""
        return "" if self.known else self.name.partition(":")[0]


def candidates(
    layout: Layout, effects: Mapping[str, Effect], *, dictionary: bool = True
) -> list[Candidate]:
    """All candidates of a layout.

    Parameters
    ----------
    effects : mapping
        Name -> effect, for scopes, scales and alternatives.
    dictionary : bool
        Also the dictionary groups, each for single aircraft and for the fleet.
    """
    out = []
    for name in layout.effects:
        effect, block = effects[name], layout.columns(name)
        scales = np.asarray(effect.column_scales, float)
        scope = "aircraft" if effect.scope in ("aircraft", "pair") else "fleet"
        subsets = effect.alternatives or (tuple(range(block.size)),)
        if effect.kind == "step" and block.size == 3:
            subsets = ((0,), (1, 2), (0, 1, 2))
        for subset in subsets:
            pick = np.array(subset, np.int64)
            tied = effect.tied(tuple(subset))
            out.append(
                Candidate(
                    name,
                    block[pick],
                    scope,
                    scales[pick],
                    True,
                    tuple(subset),
                    effect.kind,
                    _lasting_columns(effect, block, scales),
                    float(getattr(effect, "told_share", 1.0)),
                    isinstance(effect, HeadingEffect),
                    None if tied.shape[0] == tied.shape[1] else tied,
                )
            )
            if scope == "aircraft" and effect.kind in ("mean", "drift"):
                out.append(replace(out[-1], scope="fleet"))
        if scope == "aircraft" and effect.kind == "drift":
            out.append(_onset(out[-1], effect))
    if not dictionary:
        return out
    own = {name for name, known in OF_SINGLE_AIRCRAFT.items() if known not in layout.effects}
    for name in layout.groups:
        block = layout.columns(name)
        scales = np.full(block.size, GROUP_SCALE)
        for scope in ("aircraft", "fleet"):
            if scope == "aircraft" and name.startswith("wind:") and name not in own:
                continue
            whole, across = tuple(range(block.size)), name.startswith("cross:")
            curve = Candidate(name, block, scope, scales, False, whole, heading=across)
            out.append(replace(curve, told_share=GROUP_SHARE))
    return out


def _onset(drift: Candidate, effect: Effect) -> Candidate:
    """Drift that sets in on a date: what is steady of it, times the days since."""
    steady = tuple(k for k, name in enumerate(effect.column_names) if name != "rate")
    return replace(
        drift,
        columns=drift.steady,
        scope="aircraft",
        scales=np.array([scale for _, scale in drift.lasting]),
        subset=steady,
        kind="onset",
        lasting=(),
    )


def _lasting_columns(
    effect: Effect, block: Integers, scales: Floats
) -> tuple[tuple[int, float], ...]:
    """Columns of a drift that do not change in time: all but the rates."""
    if effect.kind != "drift":
        return ()
    names = zip(effect.column_names, block, scales, strict=True)
    return tuple((int(j), float(scale)) for name, j, scale in names if name != "rate")
