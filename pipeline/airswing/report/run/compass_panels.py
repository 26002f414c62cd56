"""Heading error of one aircraft after the other, small side by side and larger below each other.

The same as `airswing.report.run.compass_figures.heading_error_figure` draws, as text the page takes
as it stands: a fleet's page holds a hundred of them.

Assumptions and validity
------------------------
* Reports beyond 1,500 of an aircraft (300 where it is small) are drawn thinned out evenly in time;
  curve, intervals and medians are of all.
* Small panels share one scale, of 25 degrees at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from markupsafe import Markup
from numpy.typing import NDArray

from airswing.flags import published
from airswing.report.html.document import drawing
from airswing.report.html.style import BLUE, INK, SKY, SOFT, VERMILION, plural, thousands
from airswing.report.html.svg_panel import Panel
from airswing.report.run.compass_figures import (
    BIN_WIDTH,
    Binned,
    bias_words,
    binned_medians,
    error_limit,
    fit_words,
)
from airswing.report.run.selection import (
    compass_points,
    curve_with_error,
    one_fit,
    status_words,
    table_error,
)
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
# Reports drawn of an aircraft: more cover each other, and the page grows by every one of them.
DRAWN, DRAWN_SMALL = 1500, 300
# Degrees: one wild aircraft does not flatten the others.
WIDEST = 25.0
# Every four degrees: two cycles look smooth.
_GRID = np.linspace(0.0, 360.0, 91)
_LOOK = (
    "Grey: reports; black: medians in bins of {width:.0f} degrees with 95 % intervals; blue: "
    "fitted curve and its 95 % interval (dashed: not to be trusted); orange diamonds: 8-point "
    "table."
)


class Shown(NamedTuple):
    """What a panel shows of one aircraft; degrees."""

    name: str
    heading: Floats
    error: Floats
    fit: xr.Dataset
    curve: Floats
    half_width: Floats

    @property
    def limit(self) -> float:
        """Half height of a panel of its own, degrees."""
        return error_limit(self.error, self.curve)


def shown_of(headings: xr.Dataset, fits: xr.Dataset, name: str, reference: str) -> Shown:
    """What the panels of one aircraft show, read once for the small one and the larger."""
    heading, error = compass_points(headings, fits, name, reference)
    fit = one_fit(fits, name, reference)
    curve, standard_error = curve_with_error(fit, _GRID)
    return Shown(name, heading, error, fit, curve, NORMAL_95 * standard_error)


def small_panels(shown: Sequence[Shown], reference: str) -> list[Markup]:
    """A small panel an aircraft, on one scale."""
    limit = min(max((one.limit for one in shown), default=5.0), WIDEST)
    panels = []
    for one in shown:
        panel = Panel((236, 182), (32, 14, 22, 20), x=(0.0, 360.0), y=(-limit, limit))
        panel.scales([(at, f"{at}") for at in range(0, 361, 90)], points=10.5)
        panel.words(32, 14, one.name, at="start", more=' font-weight="bold"')
        counted = f"n = {thousands(one.heading.size)}"
        panel.words(222, 14, counted, points=10.5, at="end", color=SOFT)
        _draw(panel, one, binned_medians(one.heading, one.error, width=30.0), small=True)
        panels.append(panel.svg(_said(one, reference)))
    return panels


def small_caption(fits: xr.Dataset, number: int, reference: str) -> str:
    """What the small panels show."""
    return (
        f"Heading error (degree) against indicated magnetic heading (degree) of "
        f"{plural(number, 'aircraft', 'aircraft')} against {reference} on one scale. "
        f"{_LOOK.format(width=30)}{bias_words(fits, reference)} "
        f"At most {DRAWN_SMALL} reports of each are drawn; medians and curves are of all."
    )


def large_panel(one: Shown, fits: xr.Dataset, reference: str) -> Markup:
    """One aircraft's heading error, as wide as the page.

    Parameters
    ----------
    fits : Dataset
        Of the fleet, for the reference's bias.
    """
    panel = Panel((920, 380), (58, 16, 30, 48), x=(0.0, 360.0), y=(-one.limit, one.limit))
    panel.scales([(at, f"{at}") for at in range(0, 361, 45)])
    title = f"{one.name} against {reference}:  {fit_words(one.fit)}"
    panel.words(58, 19, title, points=14, at="start", more=' font-weight="bold"')
    panel.words(480, 372, "indicated magnetic heading (degree)", points=13)
    turned = ' transform="rotate(-90 16 180)"'
    panel.words(16, 180, "heading error (degree)", points=13, more=turned)
    _draw(panel, one, binned_medians(one.heading, one.error), small=False)
    state = "" if published(one.fit["status"]) else " The fit is not to be trusted."
    if one.heading.size > DRAWN:
        state += f" Of {one.heading.size:,} reports at most {DRAWN:,} are drawn."
    caption = (
        f"{_said(one, reference)}. {_LOOK.format(width=BIN_WIDTH)}{bias_words(fits, reference)}"
    )
    return drawing([panel.svg(_said(one, reference))], caption + state, columns=1)


def _said(one: Shown, reference: str) -> str:
    flights = plural(int(one.fit["flight_count"]), "flight")
    state = "" if published(one.fit["status"]) else f" ({status_words(one.fit['status'])})"
    return (
        f"{one.name}{state}: heading error (indicated minus the heading {reference} implies) "
        f"against indicated magnetic heading, n = {plural(one.heading.size, 'report')} of {flights}"
    )


def _draw(panel: Panel, one: Shown, bins: Binned, *, small: bool) -> None:
    step = max(-(-one.heading.size // (DRAWN_SMALL if small else DRAWN)), 1)
    drawn = slice(None, None, step)
    opacity = 0.35 if one.heading.size > DRAWN else 0.55
    panel.dots(one.heading[drawn], one.error[drawn], size=2.0 if small else 3.6, opacity=opacity)
    panel.level(0.0)
    trusted = bool(published(one.fit["status"]))
    if np.isfinite(one.fit["deviation"].to_numpy()).any():
        low, high = one.curve - one.half_width, one.curve + one.half_width
        panel.band(_GRID, low, high, SKY, opacity=0.45)
        dashes = "" if trusted else "6 4"
        panel.line(_GRID, one.curve, BLUE, width=1.7 if small else 2.8, dashes=dashes)
    low, high = bins.median - bins.half_width, bins.median + bins.half_width
    panel.bars(bins.centre, low, high, INK)
    panel.marks(bins.centre, bins.median, INK, size=1.6 if small else 2.8, diamond=False)
    nodes, table = table_error(one.fit)
    if trusted and np.isfinite(table).all():
        whole, round_ = np.append(nodes, 360.0), np.append(table, table[0])
        panel.line(whole, round_, VERMILION, width=1.0 if small else 1.4, dashes="1.5 2.5")
        panel.marks(nodes, table, VERMILION, size=3.4 if small else 6.0, diamond=True)
