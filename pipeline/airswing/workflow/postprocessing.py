"""`airswing postprocess`: forecasts corrected by their past errors, and the page of scores."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import xarray as xr
from pydantic import BaseModel

from airswing.config import Config, FlightLevelWinds
from airswing.config_file import load_postprocess, naming_configuration
from airswing.errors import ConfigError
from airswing.handover.forecasts.correcting import (
    SCORES,
    correct_forecasts,
    score_forecasts,
    station_distribution,
)
from airswing.handover.forecasts.forecast_pairs import flight_level_pairs, pairs_from_tables
from airswing.handover.forecasts.stations import pairs_at_stations
from airswing.products.netcdf import open_product, product_path, read_product, write_product
from airswing.products.whole_files import workspace
from airswing.report.forecast_page import NAMES, forecast_headline, write_forecast_page
from airswing.reports import expand
from airswing.workflow.job import CORRECTED, HEADINGS
from airswing.workflow.progress import Progress


def postprocess(config: Path, *, output: Path | None = None, quiet: bool = False) -> dict[str, Any]:
    """Correct the forecasts of a configuration; write ``postprocessed.nc`` and its page.

    Returns ``headline``, ``summary`` (lines for a person), ``product``, ``page``, ``left_out``
    (lines, by reason) and by ``variables`` ``ratio``, ``pairs``, and by method the scores on the
    days held out and, as ``stations``, their distribution over stations.
    """
    section, folder, configuration = load_postprocess(config, output=output)
    progress = Progress(quiet=quiet)
    with naming_configuration(config), workspace(folder):
        with progress.stage("pairs") as stage:
            if section.pairs is not None:
                tables = section.pairs
                pairs = pairs_from_tables(
                    expand(tables.files, "postprocess.pairs.files"),
                    columns=tables.columns,
                    variable=tables.variable,
                    units=tables.units,
                )
            elif section.forecasts is not None and section.stations is not None:
                pairs = pairs_at_stations(
                    expand(section.forecasts.files, "postprocess.forecasts.files"),
                    expand(section.stations.files, "postprocess.stations.files"),
                    columns=section.stations.columns,
                    max_time_gap=section.stations.max_time_gap,
                )
            else:
                pairs = _flight_levels(section.winds or FlightLevelWinds(), configuration)
            stage.note = " x ".join(f"{size} {name}" for name, size in pairs.sizes.items())
        with progress.stage("filter"):
            corrected = correct_forecasts(
                pairs, ratio=section.ratio, training=section.training, window=section.running_mean
            )
            product = xr.merge([corrected, score_forecasts(corrected)], combine_attrs="override")
            path = write_product(
                product,
                folder / "postprocessed.nc",
                title="Forecasts at stations corrected by a Kalman filter",
                config_json=configuration.model_dump_json(),
                sources=["forecasts and observations at stations"],
            )
        with progress.stage("page"):
            page = write_forecast_page(folder / "postprocess", read_product(path))
    variables = {name: _scores(product, name) for name in map(str, product["variable"].to_numpy())}
    return {
        "headline": forecast_headline(product),
        "variables": variables,
        "summary": [line for name, scores in variables.items() for line in _lines(name, scores)],
        "product": str(path),
        "page": str(page),
        "left_out": pairs.attrs["lines_left_out"],
    }


def _flight_levels(section: FlightLevelWinds, configuration: BaseModel) -> xr.Dataset:
    if not isinstance(configuration, Config):
        raise ConfigError(
            "winds at flight levels are those of the main job",
            field="postprocess.winds",
            remedy="Give the configuration of `airswing run`, with reports and references",
        )
    pools = configuration.pools()
    reference = section.reference or configuration.main_reference()
    if reference not in pools:
        raise ConfigError(
            "no such reference or pool",
            field="postprocess.winds.reference",
            found=reference,
            remedy=f"Known: {', '.join(pools)}",
        )
    headings, corrected = (
        open_product(product_path(configuration.output, name)) for name in (HEADINGS, CORRECTED)
    )
    with headings, corrected:
        region, fewest = math.degrees(section.region), section.fewest
        return flight_level_pairs(
            headings, corrected, pools[reference], region=region, fewest=fewest
        )


def _scores(product: xr.Dataset, variable: str) -> dict[str, Any]:
    held_out = product.sel(variable=variable, period="held_out")
    scores: dict[str, Any] = {
        "ratio": float(held_out["ratio"]),
        "ratio_chosen": bool(held_out["ratio_chosen"]),
        "pairs": int(held_out["pair_count"]),
    }
    for method in map(str, held_out["correction"].to_numpy()):
        values = held_out.sel(correction=method)
        scores[method] = {
            name.removeprefix("forecast_error_"): {
                "value": float(values[name]),
                "ci": values[f"{name}_interval"].to_numpy(),
            }
            for name in SCORES
        }
        if method != "raw":
            scores[method]["stations"] = station_distribution(product, variable, method)
    return scores


def _lines(variable: str, scores: dict[str, Any]) -> list[str]:
    lines = []
    for method, label in NAMES.items():
        stations = scores[method].get("stations")
        if not stations or stations["stations"] == 1:
            continue
        _, tenth, median, ninetieth, most = stations["rms_ratio_quantiles"]
        lines.append(
            f"{variable.replace('_', ' ')}, {label}: rms error over the raw forecast's at "
            f"{stations['stations']:,} stations: median {median:.2f}, 10 to 90 % {tenth:.2f} to "
            f"{ninetieth:.2f}, worst {most:.2f} ({stations['worst_station']}); better at "
            f"{stations['surely_better']:.0%} and worse at {stations['surely_worse']:.0%} beyond "
            "the 95 % interval"
        )
    return lines
