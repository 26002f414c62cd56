"""The slices that hold the gap.

Assumes slices of :mod:`airswing.gap.result.schema` (shares in 0 to 1 of the gap's cross-fitted
energy, q values of false-discovery control).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from airswing.gap.result.schema import SliceEntry
from airswing.report.gap.words import slice_words, small_text
from airswing.report.html.style import (
    BLUE,
    FAINT,
    SOFT,
    empty_figure,
    new_figure,
    plural,
    styled,
)

# Share of the gap below which a slice stands in the table alone.
_LEAST = 0.005


@styled
def slices_figure(where: Sequence[SliceEntry]) -> Figure:
    """Bars of the slices of the archive that hold the gap, by share of its energy.

    At most 15 of them; the rest is in the table.
    """
    known = sorted(where, key=lambda entry: -entry.share_of_gap)[:15]
    rows = [entry for entry in known if entry.share_of_gap >= _LEAST] or known[:3]
    if not rows:
        return empty_figure("No slice holds more of the gap than noise would")
    figure = new_figure(1.0 + 0.3 * len(rows))
    axes = figure.add_subplot()
    share = 100 * np.array([entry.share_of_gap for entry in rows])
    sure = [entry.q_value < 0.05 for entry in rows]
    y = np.arange(len(rows))
    axes.barh(y, share, color=[BLUE if good else FAINT for good in sure], height=0.7)
    for row, entry in enumerate(rows):
        q = f"   q {small_text(entry.q_value)}" if np.isfinite(entry.q_value) else ""
        text = f"  {share[row]:.0f} %{q}"
        axes.text(max(share[row], 0), row, text, va="center", fontsize=8.5)
    axes.set_yticks(y, [slice_words(entry, most=2) for entry in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.axvline(0.0, color=SOFT, linewidth=0.8)
    axes.set_xlim(right=max(float(share.max()) * 1.4, 5.0))
    # room for the figures beside the bars, where no share can lie
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= 100.0])
    axes.set_xlabel("share of the gap's energy (%)")
    more = (
        f"; {len(where) - len(rows)} smaller ones are in the table"
        if len(where) > len(rows)
        else ""
    )
    return figure.say(
        f"Slices that hold the gap, by their share of its cross-fitted energy (n = "
        f"{plural(len(rows), 'slice')}{more}). Blue: beyond noise at a false-discovery rate of "
        "5 %. Slices overlap, so shares need not add to 100 %."
    )
