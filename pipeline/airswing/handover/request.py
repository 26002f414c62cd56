"""Arguments of every export format, and the other products of the run that some formats need."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from airswing.config import Handover
from airswing.errors import InputError
from airswing.products.netcdf import open_product, product_path

if TYPE_CHECKING:
    import xarray as xr

Winds = Literal["corrected", "reported"]
ERRORS = "observation_errors.nc"


@dataclass(frozen=True)
class Request:
    """Arguments of one export, common to all formats."""

    corrected: xr.Dataset  # corrected reports, in memory or opened lazily
    path: Path  # file or folder to write
    folder: bool  # whether it is a folder
    settings: Handover  # of the configuration, with the options of the command
    winds: Winds = "corrected"
    window: float | None = None  # s; each window of time gets a file
    soundings: bool = False  # join every ascent and descent into one report
    overwrite: bool = False
    products: Path | None = None  # folder of the run's other products

    @property
    def aircraft(self) -> list[str]:
        """Names of all aircraft, in the order of the product."""
        return [str(name) for name in self.corrected["aircraft"].to_numpy()]


def product_of_run(request: Request, name: str, *, why: str) -> xr.Dataset:
    """Open another product of the same run lazily; ``why`` it is needed is part of the message."""
    if request.products is None:
        raise InputError(
            f"the product {name} is needed: {why}",
            field="corrected",
            remedy="Give the path of a run's corrected winds instead of a Dataset",
        )
    path = product_path(request.products, name)
    if not path.exists():
        raise InputError(
            f"no such product, and it is needed: {why}",
            file=path,
            remedy="Run `airswing run` with the same configuration first",
        )
    return open_product(path)


def correction_members(corrected: xr.Dataset) -> list[str]:
    """References the correction was fitted against; empty where the product does not name them."""
    config = json.loads(str(corrected.attrs.get("airswing_config", "") or "{}"))
    pools = config.get("pool", {}) | {name: [name] for name in config.get("references", {})}
    name = str(corrected.attrs.get("correction_reference", ""))
    return list(pools.get(name, next(iter(pools.values()), [])))


def refuse_existing(request: Request, *targets: Path) -> None:
    """Raise InputError where a file would be replaced without ``overwrite``."""
    for target in targets:
        if target.is_dir() or (target.exists() and not request.overwrite):
            raise InputError(
                "already exists",
                file=target,
                remedy="Choose another name with -o, or give --overwrite",
            )
