"""The page of forecasts corrected after the fact: what it was worth, then what shows it.

Assumes ``postprocessed.nc``. One self-contained HTML file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from markupsafe import Markup

from airswing.handover.forecasts.correcting import METHODS, TIME
from airswing.products.whole_files import write_text
from airswing.report.forecasts.forecast_figures import (
    NAMES,
    by_lead_figure,
    stations_figure,
    time_line_figure,
)
from airswing.report.html.document import (
    Column,
    Row,
    Section,
    document,
    heading,
    link,
    listing,
    paragraph,
    table,
)
from airswing.report.html.embed import embedded
from airswing.report.html.style import plural
from airswing.version import __version__

_SCORES = ("forecast_error_mean", "forecast_error_centred_rms", "forecast_error_rms", "skill")
_PERIODS = {"held_out": "held out", "all": "all days"}


def write_forecast_page(directory: Path, corrected: xr.Dataset) -> Path:
    """Write ``index.html`` of corrected forecasts.

    Parameters
    ----------
    directory : Path
        Its folder, beside ``postprocessed.nc``.
    corrected : Dataset
        Forecasts and scores, as ``postprocessed.nc`` holds them.
    """
    sections = [_scores_section(corrected), _figures_section(corrected), _notes_section(corrected)]
    first, last = corrected[TIME].to_numpy()[[0, -1]]
    text = document(
        title="airswing: forecasts corrected after the fact",
        kicker="Kalman-filter post-processing  ·  "
        f"{np.datetime_as_string(first, 'D')} to {np.datetime_as_string(last, 'D')}",
        headline=forecast_headline(corrected),
        facts=_facts(corrected),
        sections=[section for section in sections if section.parts],
        footer=[f"airswing {__version__}. Intervals are 95 %, by blocks of start days."],
    )
    return write_text(Path(directory) / "index.html", text)


def forecast_headline(corrected: xr.Dataset) -> str:
    """Say in a sentence what the filter was worth, variable by variable."""
    own = corrected.sel(period="held_out")
    parts = []
    for name in own["variable"].to_numpy():
        rms = own["forecast_error_rms"].sel(variable=name)
        before, after = (float(rms.sel(correction=method)) for method in ("raw", "kalman"))
        unit = str(own["variable_units"].sel(variable=name).item())
        if np.isfinite(before):
            words = str(name).replace("_", " ")
            parts.append(f"of {words} from {before:.2f} to {after:.2f} {unit}".rstrip())
    if not parts:
        return "No day was left to judge the corrected forecasts by."
    return f"On days held out the filter took the forecasts' rms error {', '.join(parts)}."


def _facts(corrected: xr.Dataset) -> list[tuple[str, str]]:
    sizes = corrected.sizes
    return [
        (f"{sizes['station']:,}", "stations"),
        (f"{sizes['lead']:,}", "leads"),
        (f"{sizes[TIME]:,}", "starts"),
        (f"{int(corrected['pair_count'].sel(period='all').sum()):,}", "pairs"),
    ]


def _scores_section(corrected: xr.Dataset) -> Section:
    """Return the table of scores."""
    rows = []
    for variable in corrected["variable"].to_numpy():
        for period, words in _PERIODS.items():
            number = int(corrected["pair_count"].sel(variable=variable, period=period))
            for method in METHODS:
                own = corrected.sel(variable=variable, period=period, correction=method)
                cells = [_cell(own, name) for name in _SCORES]
                shown = [str(variable).replace("_", " "), words, NAMES[method], *cells]
                rows.append(Row([*shown, f"{number:,}"], doubt=period == "all"))
    columns = [
        Column("variable", "words"),
        Column("days", "words"),
        Column("forecast", "words"),
        Column("bias"),
        Column("centred rms"),
        Column("rms"),
        Column("skill"),
        Column("pairs"),
    ]
    caption = (
        "Scores over all stations and leads, in the variable's unit, with 95 % intervals by blocks "
        "of days. Skill: one minus the mean square error over the raw forecast's. Grey italics: "
        "with the days that chose the filter's ratio."
    )
    lead = "Every method is judged on the same pairs; nothing observed after a start corrects it."
    return Section("scores", "What it was worth", lead, [table(columns, rows, caption=caption)])


def _cell(own: xr.Dataset, name: str) -> str:
    value = float(own[name])
    low, high = (float(bound) for bound in own[f"{name}_interval"])
    if not np.isfinite(value):
        return "-"
    if not np.isfinite(low) or low == high:
        return f"{value:.2f}"
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def _figures_section(corrected: xr.Dataset) -> Section:
    parts: list[Markup] = []
    several = corrected.sizes["station"] > 1
    for variable in map(str, corrected["variable"].to_numpy()):
        parts.append(heading(variable.replace("_", " ")))
        if corrected.sizes["lead"] > 1:
            parts.append(embedded(by_lead_figure(corrected, variable)))
        station = _most_improved(corrected, variable)
        parts.append(embedded(time_line_figure(corrected, variable, station)))
        if several:
            parts.append(embedded(stations_figure(corrected, variable)))
    return Section("figures", "Before and after", "", parts)


def _most_improved(corrected: xr.Dataset, variable: str) -> str:
    """Return the station where the filter gained most, the first where none is known."""
    gain = corrected["skill_by_station"].sel(variable=variable, correction="kalman").to_numpy()
    place = int(np.argmax(np.where(np.isfinite(gain), gain, -np.inf)))
    return str(corrected["station"].to_numpy()[place])


def _notes_section(corrected: xr.Dataset) -> Section:
    lines = []
    for name in corrected["variable"].to_numpy():
        own = corrected.sel(variable=name)
        how = (
            "the least mean square error on the training days"
            if int(own["ratio_chosen"])
            else "given, or the usual one where days are too few to choose"
        )
        ratio = float(own["ratio"])
        what = f"ratio {ratio:g} ({how})" if ratio else f"left as it is ({how}: no ratio has less)"
        lines.append(f"{str(name).replace('_', ' ')}: {what}")
    judged = int(corrected["held_out"].sum())
    lines.append(f"{plural(judged, 'start')} of {corrected.sizes[TIME]:,} held out")
    for reason, number in _left_out(corrected).items():
        lines.append(f"left out: {reason} ({number:,})")
    text = paragraph(
        "The filter follows a bias that wanders (Delle Monache et al. 2006, J. Geophys. Res. 111, "
        "D05308); it cannot follow a change of regime within a day or two."
    )
    product = listing([link("../postprocessed.nc", "postprocessed.nc: forecasts and scores")])
    return Section("notes", "How it was done", "", [text, listing(lines), product])


def _left_out(corrected: xr.Dataset) -> dict[str, int]:
    import json

    told = corrected.attrs.get("lines_left_out", {})
    return dict(json.loads(told) if isinstance(told, str) else told)
