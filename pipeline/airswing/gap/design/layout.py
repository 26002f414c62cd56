"""Which column of the sums is what, and the columns themselves.

Assumptions: the columns come in blocks: day fields, climatology, slope (together what is no
aircraft's fault), one block per effect, one per dictionary group. The blocks before the dictionary
are the *core*, of which daily sums are kept. A level at which an effect begins is softened.

Validity: the same layout gives the same columns for every chunk of an archive. Columns in m s-1 per
unit of their coefficient.

Source: docs/gap.md sections 3 to 5.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.design.basis import DictionaryPlan, fill_dictionary
from airswing.gap.design.weather import climatology_columns, day_field_columns, slope_columns
from airswing.gap.effects.base import Effect

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Shifts of ln p over which a level's edge is softened.
LEVEL_EDGE = np.linspace(-0.1, 0.06, 5)


@dataclass(frozen=True)
class Layout:
    """Which column is what."""

    # block name -> slice of columns, in order: ``day_fields``, ``climatology``, ``slope``, one per
    # effect, then one per dictionary group
    blocks: dict[str, slice]
    effects: tuple[str, ...]  # names of the effect blocks
    groups: tuple[str, ...]  # names of the dictionary blocks
    core: int  # the first ``core`` columns are day fields, climatology and effects
    size: int  # number of columns p

    def columns(self, name: str) -> Integers:
        """Column numbers of a block."""
        block = self.blocks[name]
        return np.arange(block.start, block.stop)


def make_layout(effects: Mapping[str, Effect], plan: DictionaryPlan, frame: Frame) -> Layout:
    """Number the columns.

    Parameters
    ----------
    effects : mapping
        Name -> effect whose ``columns`` enter; second-moment effects without columns are left out.
    frame : Frame
        A few reports, to count columns on.
    """
    few = frame.take(np.arange(min(4, frame.size)))
    blocks: dict[str, slice] = {}
    start = 0

    def add(name: str, count: int) -> None:
        nonlocal start
        blocks[name] = slice(start, start + count)
        start += count

    add("day_fields", day_field_columns(few, plan).shape[-1])
    add("climatology", climatology_columns(few, plan).shape[-1])
    add("slope", 2)
    for name, effect in effects.items():
        add(name, np.asarray(effect.columns(few)).shape[0])
    core = start
    for group in plan.groups:
        add(group.name, len(group.labels))
    names = tuple(effects)
    return Layout(blocks, names, tuple(g.name for g in plan.groups), core, start)


def build_columns(
    frame: Frame, layout: Layout, effects: Mapping[str, Effect], plan: DictionaryPlan
) -> NDArray[np.float32]:
    """All columns for some reports.

    Returns
    -------
    (p, 2, n) float32
        m s-1 per unit of each coefficient; unknown context gives 0.
    """
    out = np.empty((layout.size, 2, frame.size), np.float32)
    for name, columns in (
        ("day_fields", day_field_columns(frame, plan)),
        ("climatology", climatology_columns(frame, plan)),
        ("slope", slope_columns(frame)),
    ):
        out[layout.blocks[name]] = columns.T
    for name in layout.effects:
        out[layout.blocks[name]] = np.moveaxis(effect_columns(frame, effects[name]), -1, 1)
    if layout.size > layout.core:
        fill_dictionary(out[layout.core :], frame, plan)
    return out


def effect_columns(frame: Frame, effect: Effect) -> Floats:
    """Columns of an effect, with its edges in pressure softened where it has levels.

    A bias that begins at a level begins between two levels of the model, and no sooner: a sharp
    edge would carry most of the whitened energy of a flight that crosses it.

    Returns
    -------
    (k, n, 2) float
    """
    levelled = any(name.startswith(("above", "below")) for name in effect.column_names)
    found = effect.softened_columns(frame, LEVEL_EDGE) if levelled else effect.columns(frame)
    columns: Floats = np.asarray(found)
    unknown = np.isnan(columns)
    return np.where(unknown, 0.0, columns) if unknown.any() else columns
