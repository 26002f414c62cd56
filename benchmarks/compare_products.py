"""Compare the products of two result folders, each within its tolerance.

    python -m benchmarks.compare_products BEFORE AFTER

BEFORE and AFTER are output folders of ``airswing run`` on the same input, made by two versions of
the package. Reports are matched by aircraft and time; corrected winds are compared for the aircraft
whose table is the same, because a node that is rounded to the next step moves winds by 0.2 m/s. The
exit status is 1 where a tolerance is exceeded.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

WIND, ANGLE, CORRECTED = 1e-3, 0.01, 0.02  # m/s, degrees of heading errors, m/s
TABLE = 0.1 + 1e-6  # one step of the unit's resolution
RATIO = 0.05  # of standard errors
SHARE_OF_ERROR = 0.1  # of the standard error of a coefficient


@dataclass(frozen=True)
class Difference:
    """The largest difference of one quantity, and what is allowed."""

    name: str
    largest: float
    allowed: float
    note: str = ""

    @property
    def ok(self):
        return self.largest <= self.allowed


def reports_of(folder, product):
    months = sorted((folder / product).glob("*.nc"))
    parts = []
    for path in months or [folder / f"{product}.nc"]:
        with xr.open_dataset(path) as ds:
            names = np.repeat(ds["aircraft"].values.astype(str), ds["row_size"].values)
            parts.append(ds.drop_dims("aircraft").load().assign(aircraft=("report", names)))
    names = set.intersection(*({str(name) for name in month.variables} for month in parts))
    joined = xr.concat(
        [month[sorted(names)] for month in parts], "report", coords="minimal", compat="override"
    )
    order = np.lexsort((joined["time"].values, joined["aircraft"].values))
    return joined.isel(report=order)


def matched(before, after):
    """The reports that both hold, by aircraft, time and position, in the same order."""
    keys = [
        pd.MultiIndex.from_arrays(
            [ds["aircraft"].values, ds["time"].values, ds["latitude"].values.round(6)]
        )
        for ds in (before, after)
    ]
    common = keys[0].intersection(keys[1])
    return before.isel(report=keys[0].get_indexer(common)), after.isel(
        report=keys[1].get_indexer(common)
    )


def largest(name, before, after, allowed):
    """The largest absolute difference; infinite where only one of the two has a value."""
    a, b = np.asarray(before.values, float), np.asarray(after.values, float)
    if a.shape != b.shape:
        return Difference(name, np.inf, allowed, f"shapes {a.shape} and {b.shape}")
    if alone := int((np.isnan(a) != np.isnan(b)).sum()):
        note = f"{alone} of {a.size} values are in one alone"
        return Difference(name, np.inf, allowed, note)
    return Difference(name, float(np.nanmax(np.abs(a - b), initial=0.0)), allowed)


def ratio(name, before, after):
    a, b = np.asarray(before.fillna(0).values, float), np.asarray(after.fillna(0).values, float)
    if a.shape != b.shape or np.any((a > 0) != (b > 0)):
        return Difference(name, np.inf, RATIO)
    return Difference(name, float(np.max(np.abs(b[a > 0] / a[a > 0] - 1.0), initial=0.0)), RATIO)


def of_reports(before, after):
    a, b = reports_of(before, "headings"), reports_of(after, "headings")
    alone = abs(a.sizes["report"] - b.sizes["report"])
    yield Difference("reports", alone, 0, "in one of the two alone" if alone else "")
    a, b = matched(a, b)
    b = b.sel(reference=a["reference"])
    for name in ("reference_eastward_wind", "reference_northward_wind"):
        yield largest(name, a[name], b[name], WIND)
    wrapped = (b["heading_error"] - a["heading_error"] + 180.0) % 360.0 - 180.0
    yield Difference("heading_error", float(np.abs(wrapped).max()), ANGLE)
    changed = int((a["screening"].values != b["screening"].values).sum())
    yield Difference("screening", changed, 0, "reports screened otherwise")
    a, b = matched(reports_of(before, "corrected"), reports_of(after, "corrected"))
    rounded = rounded_otherwise(before, after, a.attrs["correction_reference"])
    same = ~np.isin(a["aircraft"].values, rounded)
    a, b = a.isel(report=same), b.isel(report=same)
    note = f"without {', '.join(rounded)}: another table" if rounded else ""
    for name in ("corrected_eastward_wind", "corrected_northward_wind"):
        difference = largest(name, a[name], b[name], CORRECTED)
        yield replace(difference, note=difference.note or note)
    name = "corrected_wind_standard_error"
    yield ratio(name, a[name], b[name])


def rounded_otherwise(before, after, reference):
    tables = [
        xr.open_dataset(folder / "fits.nc")["table_correction"].sel(reference=reference)
        for folder in (before, after)
    ]
    change = np.abs(tables[1].sel(aircraft=tables[0]["aircraft"]) - tables[0]).max("node") > 1e-6
    return [str(name) for name in tables[0]["aircraft"].values[change.values]]


def of_fits(before, after):
    """Differences of deviation coefficients, their errors, status and tables."""
    a, b = xr.open_dataset(before / "fits.nc"), xr.open_dataset(after / "fits.nc")
    b = b.sel(reference=a["reference"], aircraft=a["aircraft"])
    diagonal = [
        np.sqrt(np.diagonal(d["deviation_covariance"].values, axis1=-2, axis2=-1)) for d in (a, b)
    ]
    errors = [a["deviation"].copy(data=values) for values in diagonal]
    scaled = [(d["deviation"] / errors[0]).where(errors[0] > 0) for d in (a, b)]
    yield largest("deviation / standard error", *scaled, SHARE_OF_ERROR)
    yield ratio("deviation standard error", *errors)
    yield Difference("status", int((a["status"].values != b["status"].values).sum()), 0)
    yield largest("table_correction", a["table_correction"], b["table_correction"], TABLE)


def estimates(folder):
    """Estimates with a standard error: of the fleet between references, and of reports."""
    values = {}
    path = folder / "sensitivity.json"
    for pair in json.loads(path.read_text())["pairs"] if path.exists() else []:
        for name, value in pair["fleet"]["difference"].items():
            where = f"{'/'.join(pair['references'])} {name}"
            values[where] = (value, pair["fleet"]["standard_error"][name])
    path = folder / "observation_errors.nc"
    if path.exists():
        with xr.open_dataset(path) as ds:
            error, interval = ds["observation_error"], ds["observation_error_interval"]
            width = np.ptp(interval.values, axis=-1) / 3.92
            for index in np.ndindex(error.shape):
                value = float(error.values[index])
                if np.isfinite(value):
                    values[f"observation error {index}"] = (value, float(width[index]))
    return values


def of_evaluation(before, after):
    a, b = estimates(before), estimates(after)
    for name in a:
        if name not in b:
            yield Difference(name, float("inf"), 0.2, "not in AFTER")
            continue
        scale = a[name][1] if a[name][1] > 0 else 1.0
        yield Difference(name, abs(b[name][0] - a[name][0]) / scale, 0.2)


def compared(before, after):
    comparisons = of_reports, of_fits, of_evaluation
    differences = [d for compare in comparisons for d in compare(before, after)]
    rows = [(d.name, d.largest, d.allowed, d.ok, d.note) for d in differences]
    return pd.DataFrame(rows, columns=["quantity", "largest", "allowed", "ok", "note"])


def main():
    """Print the comparison; 1 where a tolerance is exceeded."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    asked = parser.parse_args()
    table = compared(asked.before, asked.after)
    print(table.to_string(index=False))
    return int(not table["ok"].all())


if __name__ == "__main__":
    raise SystemExit(main())
