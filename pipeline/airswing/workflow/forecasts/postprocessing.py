"""Forecasts corrected after the fact: ``postprocessed.nc`` and its page."""

from __future__ import annotations

import glob
import math
from pathlib import Path
from typing import TypedDict

import xarray as xr
from pydantic import BaseModel

from airswing.config import Config, FlightLevelWinds, Postprocess
from airswing.config_file import load_postprocess
from airswing.errors import ConfigError
from airswing.products.named_files import none_found
from airswing.products.netcdf import read_product, write_product
from airswing.products.whole_files import require_writable
from airswing.products.workspace import workspace
from airswing.workflow.job import CORRECTED, HEADINGS, main_reference
from airswing.workflow.progress import Progress

_POSTPROCESSED = "postprocessed.nc"


class Postprocessed(TypedDict):
    """What was made of the forecasts."""

    headline: str
    variables: dict[str, object]  # by name ``ratio``, and by method the scores on the days held out
    product: str
    page: str
    left_out: dict[str, int]  # lines, by reason


def postprocess(config: Path, *, output: Path | None = None, quiet: bool = False) -> Postprocessed:
    """Correct the forecasts of a configuration: ``postprocessed.nc`` and its page.

    Parameters
    ----------
    config : Path
        With a section ``postprocess``; that of the main job or one of its own.
    output : Path, optional
        Replaces the configuration's folder.

    Returns
    -------
    Postprocessed

    Raises
    ------
    InputError
        If there is nothing to correct, or it cannot be read.
    """
    from airswing.report.forecasts.forecast_page import forecast_headline, write_forecast_page

    section, folder, whole = load_postprocess(config, output=output)
    progress = Progress(quiet=quiet)
    with workspace(folder):
        require_writable(folder)
        with progress.stage("pairs") as stage:
            pairs = _read_pairs(section, whole)
            stage.note = " x ".join(f"{size} {name}" for name, size in pairs.sizes.items())
        with progress.stage("filter"):
            made = _corrected(pairs, section)
            path = write_product(
                made,
                folder / _POSTPROCESSED,
                title="Forecasts at stations corrected by a Kalman filter",
                config_json=whole.model_dump_json(),
                sources=["forecasts and observations at stations"],
            )
        with progress.stage("page"):
            page = write_forecast_page(folder / "postprocess", read_product(path))
    return {
        "headline": forecast_headline(made),
        "variables": _summary(made),
        "product": str(path),
        "page": str(page),
        "left_out": pairs.attrs["lines_left_out"],
    }


def _read_pairs(section: Postprocess, whole: BaseModel) -> xr.Dataset:
    """Pairs of forecast and observation: tables, GRIB and stations, or a run's winds."""
    from airswing.handover.forecasts.forecast_pairs import pairs_from_tables
    from airswing.handover.forecasts.station_observations import pairs_at_stations

    if section.pairs is not None:
        given = section.pairs
        return pairs_from_tables(
            _found(given.files, "postprocess.pairs.files"),
            columns=given.columns,
            variable=given.variable,
            units=given.units,
        )
    if section.forecasts is not None and section.stations is not None:
        return pairs_at_stations(
            _found(section.forecasts.files, "postprocess.forecasts.files"),
            _found(section.stations.files, "postprocess.stations.files"),
            columns=section.stations.columns,
            max_time_gap=section.stations.max_time_gap,
        )
    return _flight_levels(section.winds or FlightLevelWinds(), whole)


def _flight_levels(section: FlightLevelWinds, whole: BaseModel) -> xr.Dataset:
    """Pairs of a run's model winds and its corrected aircraft winds."""
    from airswing.handover.forecasts.flight_level_winds import flight_level_pairs

    if not isinstance(whole, Config):
        raise ConfigError(
            "winds at flight levels are those of the main job",
            field="postprocess.winds",
            remedy="Give the configuration of `airswing run`, with reports and references",
        )
    pools = whole.pools()
    reference = section.reference or main_reference(whole)
    if reference not in pools:
        raise ConfigError(
            "no such reference or pool",
            field="postprocess.winds.reference",
            found=reference,
            remedy=f"Known: {', '.join(pools)}",
        )
    products = (read_product(whole.output / name, lazy=True) for name in (HEADINGS, CORRECTED))
    headings, corrected = products
    with headings, corrected:
        return flight_level_pairs(
            headings,
            corrected,
            pools[reference],
            region=math.degrees(section.region),
            fewest=section.fewest,
        )


def _found(patterns: list[str], field: str) -> list[Path]:
    """Files of several patterns, each named once."""
    files: dict[Path, None] = {}
    for pattern in patterns:
        matches = [Path(name) for name in sorted(glob.glob(pattern, recursive=True))]
        found = [path for path in matches if path.is_file()]
        if not found:
            raise none_found(pattern, field)
        files |= dict.fromkeys(found)
    return list(files)


def _corrected(pairs: xr.Dataset, section: Postprocess) -> xr.Dataset:
    """Forecasts and their scores in one Dataset."""
    from airswing.handover.forecasts.correcting import correct_forecasts
    from airswing.handover.forecasts.forecast_scores import score_forecasts

    corrected = correct_forecasts(
        pairs, ratio=section.ratio, training=section.training, window=section.running_mean
    )
    return xr.merge([corrected, score_forecasts(corrected)], combine_attrs="override")


def _summary(made: xr.Dataset) -> dict[str, object]:
    """Scores on the days held out, for printing."""
    own = made.sel(period="held_out")
    names = ("forecast_error_mean", "forecast_error_centred_rms", "forecast_error_rms", "skill")
    found: dict[str, object] = {}
    for variable in map(str, own["variable"].to_numpy()):
        one = own.sel(variable=variable)
        found[variable] = {
            "ratio": float(one["ratio"]),
            "ratio_chosen": bool(one["ratio_chosen"]),
            "pairs": int(one["pair_count"]),
            **{
                str(method): {
                    short: {
                        "value": float(one[name].sel(correction=method)),
                        "ci": one[f"{name}_interval"].sel(correction=method).to_numpy(),
                    }
                    for name in names
                    for short in [name.removeprefix("forecast_error_")]
                }
                for method in one["correction"].to_numpy()
            },
        }
    return found
