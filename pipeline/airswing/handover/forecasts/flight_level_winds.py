"""Model winds at flight levels beside corrected aircraft winds, as pairs the filter can follow.

Assumes screened reports with model winds and their correction. A place is a box of latitude and
longitude in a layer of pressure; its pair of a day is the mean model wind and the mean corrected
wind of its reports, where there are enough. Aircraft fly where they fly: a day's mean is that of
the reports, not of the box. The bias of a day is known on the next, whatever the model's lead.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import xarray as xr

from airswing.errors import InputError
from airswing.evaluation.disagreement import reference_mean
from airswing.evaluation.error_profiles import LEVEL_EDGES_HPA, profile_cells
from airswing.flags import CORRECTION
from airswing.handover.forecasts.correcting import TIME
from airswing.handover.forecasts.forecast_pairs import on_axes
from airswing.physics.triangle import wrap_degrees
from airswing.products.ragged import blocks

VARIABLES = ("eastward_wind", "northward_wind")
# A day's bias is known on the next.
LEAD_HOURS = 24.0
_NEEDED = (
    "latitude",
    "longitude",
    "pressure",
    "time",
    "phase",
    "screening",
    "reference_eastward_wind",
    "reference_northward_wind",
)
_APPLIED = (CORRECTION["corrected"], CORRECTION["already_corrected"])
_LAYERS = len(LEVEL_EDGES_HPA) - 1


def flight_level_pairs(
    headings: xr.Dataset,
    corrected: xr.Dataset,
    members: list[str],
    *,
    region: float,
    fewest: int,
) -> xr.Dataset:
    """Pair the model's winds with corrected aircraft winds, by box, layer and day.

    Parameters
    ----------
    headings, corrected : Dataset
        In memory or opened lazily.
    members : list of str
        References whose mean is the forecast.
    region : float
        Side of a box, degrees.
    fewest : int
        Reports of a box, layer and day that make a pair.

    Returns
    -------
    Dataset
        As :func:`airswing.handover.forecasts.correcting.correct_forecasts` takes it; a station is
        a box in a layer, with ``latitude``, ``longitude`` and ``pressure`` of its middle.

    Raises
    ------
    InputError
        If no box has reports enough on any day.
    """
    parts = []
    names = [*(f"corrected_{name}" for name in VARIABLES), "correction_applied"]
    mended = blocks(corrected, names)
    for block, better in zip(blocks(headings, list(_NEEDED)), mended, strict=True):
        parts.append(_sums(_reports(block, better, members, region)))
    columns = ["reports", *(f"{kind}_{name}" for kind in ("model", "air") for name in VARIABLES)]
    summed = pd.concat(parts).groupby(level=[0, 1, 2, 3]).sum()
    kept = summed[summed["reports"] >= fewest]
    if kept.empty:
        raise InputError(
            f"no box of {region:g} degrees has {fewest} corrected winds in a layer on any day",
            field="postprocess.winds",
            found=f"at most {int(summed['reports'].max()) if len(summed) else 0}",
            remedy="Make region larger or fewest smaller",
        )
    means = kept[columns[1:]].div(kept["reports"], axis=0)
    found = on_axes(_lines(means, region))
    few = int((summed["reports"] < fewest).sum())
    found.attrs["lines_left_out"] = {f"box, layer and day with under {fewest} winds": few}
    return found.rename(altitude="pressure")  # what `on_axes` knows a place's level by


def _reports(
    block: xr.Dataset, better: xr.Dataset, members: list[str], region: float
) -> pd.DataFrame:
    """Box, layer, day and winds of the reports that count."""
    cell, _ = profile_cells(block)
    model = reference_mean(block, members)
    table = pd.DataFrame(
        {
            "south": np.floor(block["latitude"].to_numpy() / region),
            "west": np.floor(wrap_degrees(block["longitude"].to_numpy()) / region),
            "layer": cell % _LAYERS,
            "day": block["time"].to_numpy().astype("datetime64[D]").astype("datetime64[ns]"),
        }
    )
    for name in VARIABLES:
        table[f"model_{name}"] = model[f"reference_{name}"].to_numpy().astype(np.float64)
        table[f"air_{name}"] = better[f"corrected_{name}"].to_numpy().astype(np.float64)
    good = (cell >= 0) & table.notna().all(axis=1).to_numpy()
    kept: pd.DataFrame = table[good & np.isin(better["correction_applied"].to_numpy(), _APPLIED)]
    return kept


def _sums(table: pd.DataFrame) -> pd.DataFrame:
    """Sums by box, layer and day."""
    return table.assign(reports=1).groupby(["south", "west", "layer", "day"]).sum()


def _lines(means: pd.DataFrame, region: float) -> pd.DataFrame:
    """A line a box, layer, day and component."""
    south, west, layer, day = (means.index.get_level_values(k) for k in range(4))
    edges = np.array(LEVEL_EDGES_HPA)
    middle = 0.5 * (edges[:-1] + edges[1:])[layer.astype(int)]
    latitude, longitude = (south + 0.5) * region, (west + 0.5) * region
    names = [
        f"{p:04.0f}_hPa_{abs(y):.4g}{'S' if y < 0 else 'N'}_{abs(x):.4g}{'W' if x < 0 else 'E'}"
        for p, y, x in zip(middle, latitude, longitude, strict=True)
    ]
    parts = [
        pd.DataFrame(
            {
                "variable": name,
                "station": names,
                TIME: day,
                "lead": LEAD_HOURS,
                "units": "m s-1",
                "forecast": means[f"model_{name}"].to_numpy(),
                "observation": means[f"air_{name}"].to_numpy(),
                "latitude": latitude,
                "longitude": longitude,
                "altitude": middle * 100.0,
            }
        )
        for name in VARIABLES
    ]
    return pd.concat(parts, ignore_index=True)
