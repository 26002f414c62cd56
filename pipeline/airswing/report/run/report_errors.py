"""The page's section on the error of the reports alone, with its figure.

Assumes ``observation_errors.nc``. Bars are 95 % intervals by blocks of days.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airswing.report.html.document import Column, Row, Section, listing, table
from airswing.report.html.embed import embedded
from airswing.report.html.style import SOFT, blank, new_figure, plural, series_style, styled

_PHASES = ("ascent", "cruise", "descent")
_WAYS = {"separation": "what neighbours do not share", "three_cornered_hat": "three-cornered hat"}
_USED = {
    "wrfda_tamdar_error": ("WRFDA, TAMDAR", "-"),
    "wrfda_airep_error": ("WRFDA, AIREP", "--"),
    "nam_tamdar_error": ("NAM, TAMDAR", "-."),
    "nam_mdcrs_error": ("NAM, MDCRS", ":"),
}


def report_errors_section(errors: xr.Dataset | None) -> Section:
    """Return the section: what a report is worth by itself, before and after.

    Parameters
    ----------
    errors : Dataset or None
        ``observation_errors.nc``.
    """
    title = "The reports' own error"
    if errors is None:
        return Section("report-errors", title)
    why = str(errors.attrs.get("believed_because", "")).replace("m2/s2", "m²/s²")
    believed = str(errors.attrs.get("believed", ""))
    if not believed:
        return Section("report-errors", title, f"Not known: {why}.", [listing([why])])
    lines = [f"believed: {_WAYS[believed]} ({why})", *_worst(errors)]
    parts: list[Markup] = [
        embedded(report_errors_figure(errors)),
        _ways_table(errors),
        listing(lines),
    ]
    return Section("report-errors", title, worth_sentence(errors), parts)


def worth_sentence(errors: xr.Dataset) -> str:
    """Say what a wind's error is, and what correcting it is worth in an analysis."""
    own = errors["fleet_observation_error"]
    before, after = (float(own.sel(state=state)) for state in ("reported", "corrected"))
    gain = float(errors["fleet_weight_gain"])
    text = (
        "With the reference's share taken off, a wind component of a report is off by "
        f"{before:.2f} m/s as reported and {after:.2f} m/s as corrected"
    )
    if not np.isfinite(gain):
        return text + "."
    low, high = (float(bound) for bound in errors["fleet_weight_gain_interval"])
    ends = f" ({low:.1f} to {high:.1f})" if np.isfinite(low) else ""
    return f"{text}: in an analysis one corrected report weighs as {gain:.1f}{ends} reported ones."


@styled
def report_errors_figure(errors: xr.Dataset) -> Figure:
    """Draw the error by layer for each phase of flight it is known in, beside what others use."""
    figure = new_figure(4.2)
    reached = {phase: _cells_known(errors, phase) for phase in _PHASES}
    phases = [phase for phase, cells in reached.items() if cells]
    # an empty panel would take the room of a full one
    drawn = phases or list(_PHASES)
    panels = figure.subplots(1, len(drawn), sharey=True, sharex=True, squeeze=False)[0]
    level = 0.5 * (errors["layer_bottom_pressure"] + errors["layer_top_pressure"]) / 100.0
    for axes, phase in zip(panels, drawn, strict=True):
        own = errors.sel(flight_phase=phase)
        if phases:
            for name, (label, line) in _USED.items():
                axes.plot(
                    errors[name], level, color=SOFT, linewidth=1.0, linestyle=line, label=label
                )
            for index, state in enumerate(("reported", "corrected")):
                _profile(axes, own.sel(state=state), level.to_numpy(), index)
        else:
            blank(axes, "too few reports meet")
        axes.set_title(phase)
        axes.set_xlabel("error of a component (m/s)")
    panels[0].set_ylim(1000, 200)
    panels[0].set_xlim(left=0.0)
    panels[0].set_ylabel("pressure (hPa)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    number = int(errors["observation_count"].sel(flight_phase="all").sum())
    missing = " and ".join(phase for phase in _PHASES if phases and phase not in phases)
    few = f" Too few reports meet in {missing}." if missing else ""
    return figure.say(
        "Standard error of a wind component of the reports alone, by phase of flight and layer, "
        "with 95 % intervals; in grey the errors that assimilation systems use "
        f"(n = {plural(number, 'report')}, {plural(sum(reached.values()), 'cell')} known).{few}"
    )


def _cells_known(errors: xr.Dataset, phase: str) -> int:
    """Return in how many layers of a phase the error is known, of either state."""
    own = errors["observation_error"].sel(flight_phase=phase)
    return int(own.notnull().any("state").sum())


def _profile(axes: Axes, own: xr.Dataset, level: np.ndarray, index: int) -> None:
    values = own["observation_error"].to_numpy()
    low, high = own["observation_error_interval"].to_numpy().T
    shown = np.isfinite(values)
    colour, marker = series_style(1 - index)
    reach = np.array([values - low, high - values])[:, shown]
    bars = np.maximum(np.nan_to_num(reach, nan=0.0), 0.0)
    axes.errorbar(
        values[shown],
        level[shown] + 8.0 * (index - 0.5),
        xerr=bars,
        color=colour,
        marker=marker,
        markersize=5,
        linewidth=1.4,
        label=f"as {own['state'].item()}",
    )


def _ways_table(errors: xr.Dataset) -> Markup:
    rows = []
    for method, words in _WAYS.items():
        own = errors.sel(way=method)
        cells = []
        for state in ("reported", "corrected"):
            value = float(own["fleet_observation_error_by_method"].sel(state=state))
            ends = own["fleet_observation_error_by_method_interval"].sel(state=state)
            cells.append(_with_ends(value, *(float(bound) for bound in ends)))
        rows.append(Row([words, *cells], doubt=method != errors.attrs.get("believed")))
    columns = [Column("way", "words"), Column("reported (m/s)"), Column("corrected (m/s)")]
    caption = (
        "Error of a component over all reports by either way, with 95 % intervals. The hat counts "
        "what the references err in common as the reports'. Grey italics: not believed."
    )
    return table(columns, rows, caption=caption)


def _with_ends(value: float, low: float, high: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f} ({low:.2f} to {high:.2f})" if np.isfinite(low) else f"{value:.2f}"


def _worst(errors: xr.Dataset) -> list[str]:
    """The aircraft whose reports gain most, in words."""
    own = errors["aircraft_observation_error"]
    before, after = (own.sel(state=state).to_numpy() for state in ("reported", "corrected"))
    gain = np.where(np.isfinite(before) & np.isfinite(after), before - after, -np.inf)
    if not np.isfinite(gain).any():
        return []
    place = int(np.argmax(gain))
    name = str(errors["aircraft"].to_numpy()[place])
    return [f"{name} gains most: {before[place]:.2f} m/s as reported, {after[place]:.2f} corrected"]
