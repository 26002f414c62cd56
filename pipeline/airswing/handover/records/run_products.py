"""Products of a run that stand beside its corrected winds, as some formats need them.

Assumes the names the main job gives them.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from airswing.errors import InputError
from airswing.handover.records.registry import Request

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr


def product_beside(request: Request, name: str, *, why: str) -> xr.Dataset:
    """Open a product of the same run lazily; ``why`` it is needed goes into the message.

    Raises
    ------
    InputError
        If it is not there or cannot be read.
    """
    from airswing.products.netcdf import read_product

    if request.products is None:
        raise InputError(
            f"{name} is needed: {why}",
            field="corrected",
            remedy="Give the path of a run's corrected.nc instead of a Dataset",
        )
    path = request.products / name
    if not path.exists():
        raise InputError(
            f"no such product, and it is needed: {why}",
            file=path,
            remedy="Run `airswing run` with the same configuration first",
        )
    return read_product(path, lazy=True)


def errors_beside(request: Request) -> xr.Dataset:
    """``observation_errors.nc`` of the same run, in memory."""
    name, why = "observation_errors.nc", "it holds the errors to write"
    with product_beside(request, name, why=why) as product:
        return product.load()


def none_known(errors: xr.Dataset) -> InputError:
    """Say that a run could tell no error of its reports."""
    return InputError(
        "no error of the reports is known",
        field="observation_error",
        found=errors.attrs.get("believed_because"),
        remedy="It takes two references, or aircraft that meet, on some days",
    )


def correction_members(corrected: xr.Dataset) -> list[str]:
    """References behind the correction of ``corrected.nc``: members of the pool fitted against.

    Empty where the product does not tell.
    """
    told = str(corrected.attrs.get("airswing_config", "") or "{}")
    config = json.loads(told)
    pools = {name: [name] for name in config.get("references", {})} | config.get("pool", {})
    name = str(corrected.attrs.get("correction_reference", ""))
    first = next(iter([*config.get("pool", {}), *config.get("references", {})]), "")
    return list(pools.get(name, pools.get(first, [])))


def refuse_existing(request: Request, *targets: Path) -> None:
    """Refuse to write over what is there, unless asked to."""
    for target in targets:
        if target.is_dir() or (target.exists() and not request.overwrite):
            raise InputError(
                "is there already",
                file=target,
                remedy="Choose another name with -o, or give --overwrite",
            )
