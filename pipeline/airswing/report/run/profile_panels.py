"""Errors by layer and phase of flight: a panel a phase and component, as text for the page.

Assumes ``error_profiles.nc`` as :mod:`airswing.evaluation` writes it: rms in m/s and degrees by
layer of pressure, standard errors clustered by flight.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from airswing.report.html.document import drawing, paragraph
from airswing.report.html.style import BLUE, ORANGE, SOFT, plural, thousands
from airswing.report.html.svg_panel import Panel
from airswing.units import NORMAL_95

Floats = NDArray[np.float64]
PROFILES = (
    ("eastward_rms", "eastward wind, rms (m/s)"),
    ("northward_rms", "northward wind, rms (m/s)"),
    ("direction_rms", "wind direction, rms (degree)"),
)
_STATES = (("reported", ORANGE, False, -0.1), ("corrected", BLUE, True, 0.1))


def profile_panels(profiles: xr.Dataset, reference: str) -> Markup:
    """Wind and direction error by layer and phase of flight, before and after the correction.

    Parameters
    ----------
    profiles : Dataset
        ``eastward_rms``, ``northward_rms``, ``direction_rms`` with ``*_standard_error``
        (reference, state, flight_phase, layer) and ``profile_count``.
    reference : str
        Reference or pool.

    Returns
    -------
    Markup
    """
    chosen = profiles.sel(reference=reference)
    counts = chosen["profile_count"].sel(state="reported")
    phases = [
        str(p) for p in chosen["flight_phase"].to_numpy() if int(counts.sel(flight_phase=p).sum())
    ]
    if not phases:
        return paragraph("No report has a layer and a phase (n = 0).")
    bottom, top = (chosen[f"layer_{end}_pressure"].to_numpy() / 100.0 for end in ("bottom", "top"))
    layers = [f"{low:.0f}-{high:.0f}" for low, high in zip(bottom, top, strict=True)]
    width = 940.0 / max(len(phases), 2)
    panels = []
    for name, label in PROFILES:
        values, halves = _values(chosen, name)
        shown = values.sel(flight_phase=phases) + halves.sel(flight_phase=phases)
        most = 1.05 * float(shown.max()) if bool(np.isfinite(shown).any()) else 1.0
        for number, phase in enumerate(phases):
            size = (width, 42.0 + 24.0 * len(layers))
            panel = Panel(size, (64, 12, 24, 38), x=(0.0, most), y=(-0.6, len(layers) - 0.4))
            ticks = [
                t
                for t in MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, most)
                if 0.0 <= t <= most
            ]
            panel.scales([(t, f"{t:g}") for t in ticks], list(enumerate(layers)), points=11)
            title = f"{phase}, layers in hPa" if number == 0 else phase
            panel.words(64, 15, title, points=13, at="start", more=' font-weight="bold"')
            panel.words(64 + panel.width / 2, size[1] - 5, label, points=12)
            if name == PROFILES[0][0]:
                _counts(panel, counts.sel(flight_phase=phase).to_numpy())
            for state, colour, diamond, shift in _STATES:
                at = {"flight_phase": phase, "state": state}
                value, half = values.sel(at).to_numpy(), halves.sel(at).to_numpy()
                level = np.arange(len(layers)) + shift
                panel.line(value, level, colour, width=1.5)
                panel.bars_across(level, value - half, value + half, colour)
                panel.marks(value, level, colour, size=4.0 if diamond else 3.0, diamond=diamond)
            panels.append(panel.svg(f"{label} by layer in {phase}, against {reference}"))
    caption = (
        f"Difference from {reference} by layer and phase of flight, as reported (orange discs) and "
        f"corrected (blue diamonds), with 95 % intervals clustered by flight (n = "
        f"{plural(int(counts.sum()), 'report')}; numbers at the left: reports of the layer)."
    )
    return drawing(panels, caption, columns=len(phases))


def _values(chosen: xr.Dataset, name: str) -> tuple[xr.DataArray, xr.DataArray]:
    """Values and half widths of their 95 % intervals (none where there is no standard error)."""
    return chosen[name].astype(float), NORMAL_95 * chosen[f"{name}_standard_error"].fillna(0.0)


def _counts(panel: Panel, counts: NDArray[np.int64]) -> None:
    for layer, number in enumerate(counts.tolist()):
        at = panel.top + float(panel.down(layer)) + 4.0
        panel.words(panel.left + 4.0, at, thousands(number), points=10, at="start", color=SOFT)
