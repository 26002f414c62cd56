"""The closing summary of a run: reports read, aircraft fitted, gain of the winds.

Assumes the products of one run. Disagreement is the mean magnitude of the wind vector difference
over screened reports, in knots, against the main reference or pool, the same reports before and
after; it is computed from the data of the fit (the field test uses held-out data).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
import xarray as xr

from airswing.compass.plausibility import heading_kind_warnings, plausibility_warnings
from airswing.config import Config
from airswing.evaluation.monitoring.changes import change_warnings
from airswing.flags import STATUS
from airswing.report.html.text import Units, shown_per_kt
from airswing.report.run.reading_warnings import reading_warnings, reference_warnings, tally
from airswing.report.run.selection import BeforeAfter, kept_reports, screening_warnings
from airswing.units import NORMAL_95
from airswing.workflow.job import main_reference, months_text
from airswing.workflow.progress import Accounts


class FitLine(TypedDict):
    """One aircraft of the summary: its fit, degrees, and its winds before and after, knots."""

    aircraft: str
    status: str
    offset: float
    amplitude: float
    phase: float
    offset_standard_error: float
    amplitude_standard_error: float
    reports: int
    before_kt: float
    after_kt: float


class Summary(TypedDict):
    """Main results of a run, for a person."""

    reference: str
    reports: dict[str, int]
    aircraft: int
    status: dict[str, int]
    disagreement_kt: dict[str, float]
    warnings: list[str]
    fits: list[FitLine]
    accounts: NotRequired[Accounts]
    months: dict[str, list[str]]  # those made by this run, and those kept
    watched: NotRequired[str]  # lines on the events that are new
    events: NotRequired[int]  # all there are


def summarise(
    config: Config, headings: xr.Dataset, fits: xr.Dataset, apart: BeforeAfter
) -> Summary:
    """Collect the main results of a run.

    Parameters
    ----------
    headings, fits : Dataset
        Products of the run.
    apart : BeforeAfter
        Disagreement with the main reference.

    Returns
    -------
    Summary
        ``reports``, ``aircraft``, ``status`` counts, ``disagreement_kt`` before and after, and
        one entry per aircraft under ``fits``.
    """
    main = main_reference(config)
    chosen = fits.sel(reference=main)
    names = {code: name for name, code in STATUS.items()}
    status = [names[int(code)] for code in chosen["status"].to_numpy()]
    return {
        "reference": main,
        "reports": {
            "read": tally(headings, "reading_audit").get("reports_read", headings.sizes["report"]),
            "usable": headings.sizes["report"],
            "kept": kept_reports(headings),
        },
        "aircraft": headings.sizes["aircraft"],
        "months": json.loads(headings.attrs.get("months", "{}")),
        "status": {name: status.count(name) for name in STATUS},
        "disagreement_kt": {"before": apart.total.before, "after": apart.total.after},
        "warnings": [
            *plausibility_warnings(fits),
            *screening_warnings(headings),
            *reading_warnings(tally(headings, "reading_audit")),
            *reference_warnings(tally(headings, "reference_audit")),
            *heading_kind_warnings(fits, main),
            *change_warnings(fits),
        ],
        "fits": [
            {
                "aircraft": str(name),
                "status": status[i],
                "offset": float(chosen["offset"][i]),
                "amplitude": float(chosen["amplitude"][i]),
                "phase": float(chosen["phase"][i]),
                "offset_standard_error": float(chosen["offset_standard_error"][i]),
                "amplitude_standard_error": float(chosen["amplitude_standard_error"][i]),
                "reports": int(chosen["report_count"][i]),
                "before_kt": float(apart.before[i]),
                "after_kt": float(apart.after[i]),
            }
            for i, name in enumerate(chosen["aircraft"].to_numpy())
        ],
    }


def as_text(summary: Summary, output: Path, *, units: Units = "kt") -> str:
    """Lay the summary out for a terminal.

    Parameters
    ----------
    summary : Summary
        Of :func:`summarise`.
    output : Path
        Folder of the products.
    units : {"kt", "m/s"}, optional
        Unit of speeds.
    """
    reports, status, factor = summary["reports"], summary["status"], shown_per_kt(units)
    before, after = (factor * summary["disagreement_kt"][when] for when in ("before", "after"))
    lines = [
        f"{reports['read']:,} reports read, {reports['kept']:,} kept for the fit; "
        f"{status['ok']} of {summary['aircraft']} aircraft fitted against {summary['reference']}"
        + (f", {status['offset_only']} with an offset alone" if status["offset_only"] else ""),
        "",
        "aircraft    amplitude*       phase   offset*          reports   "
        f"{f'wind disagreement ({units})':<24}status",
        *(_line(fit, factor) for fit in summary["fits"]),
        "* degrees, with 95 % intervals",
    ]
    lines += ["", *summary.get("warnings", [])] if summary.get("warnings") else []
    lines += ["", summary["watched"]] if summary.get("watched") else []
    months = summary.get("months")
    lines += ["", months_text(months)] if months else []
    lines += [
        "",
        f"mean wind vector disagreement of the corrected reports: {before:.2f} {units} before, "
        f"{after:.2f} {units} after (same data as the fit)"
        if np.isfinite(before)
        else "no report could be corrected",
        f"products: {output}",
        f"page:     {output / 'report' / 'index.html'}",
    ]
    return "\n".join(lines)


def _line(fit: FitLine, factor: float) -> str:
    """One aircraft; a dash for what was not fitted."""
    wide = NORMAL_95 * fit["amplitude_standard_error"], NORMAL_95 * fit["offset_standard_error"]
    amplitude = _digits("{:6.2f} +- {:4.2f}", fit["amplitude"], wide[0])
    offset = _digits("{:8.2f} +- {:4.2f}", fit["offset"], wide[1])
    winds = _digits("{:7.2f} -> {:5.2f}", factor * fit["before_kt"], factor * fit["after_kt"])
    return (
        f"{fit['aircraft']:<10} {amplitude} {_digits('{:8.1f}', fit['phase'])} "
        f"{offset} {fit['reports']:9,}   {winds}         {fit['status']}"
    )


def _digits(form: str, *values: float) -> str:
    text = form.format(*values)
    return text if np.isfinite(values).all() else "-".rjust(len(form.format(*[0.0] * len(values))))
