"""Export of corrected winds in the format an assimilation system reads.

Assumes the corrected product of a run or its Dataset. A format of `FORMATS` is a function
``write_NAME(request)`` of the module of its name, or of ``wrf_reports``.
"""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from airswing.errors import InputError
from airswing.products.whole_files import findings

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Handover

Winds = Literal["corrected", "reported"]
FORMATS = {
    "jedi": "errors by aircraft and pressure for JEDI (CSV)",
    "little_r": "reports for OBSPROC, to WRFDA",
    "ob_ascii": "reports for WRFDA, each with its error",
    "obs_domain": "reports for WRF's observation nudging",
    "obs_errors": "wind errors for OBSPROC and WRFDA (obserr.txt)",
    "reject_list": "a GSI reject list without the aircraft whose corrected winds pass",
}
"""Formats by name."""
_MODULES = dict.fromkeys(("little_r", "ob_ascii", "obs_domain"), "wrf_reports")  # else of its name
SHOWN = 5  # files, and aircraft, named in the text for a person
ERRORS = "observation_errors.nc"


@dataclass(frozen=True)
class Request:
    """Arguments of one export, as every format takes them."""

    corrected: xr.Dataset  # corrected reports, in memory or opened lazily
    path: Path  # file or folder to write
    folder: bool  # whether it is a folder
    settings: Handover  # of the configuration, with the options of the command
    winds: Winds = "corrected"
    window: float | None = None  # s; each window of time gets a file
    soundings: bool = False  # join every ascent and descent into one report
    overwrite: bool = False
    products: Path | None = None  # folder of the run's other products


def export(
    corrected: xr.Dataset | Path | str,
    *,
    to: str,
    path: Path | str,
    winds: Winds = "corrected",
    window: str | None = None,
    soundings: bool = False,
    overwrite: bool = False,
    settings: Handover | None = None,
) -> dict[str, Any]:
    """Write corrected winds for an assimilation system.

    Parameters
    ----------
    corrected : Dataset or path
        Of :func:`airswing.correct` on screened headings, or the product of a run; opened from the
        product the archive may be larger than memory.
    to : str
        Name of a format (`FORMATS`): ``obs_domain`` (WRF observation nudging), ``little_r``
        (OBSPROC), ``ob_ascii`` (WRFDA), ``jedi``, ``obs_errors`` or ``reject_list``.
    path : path-like
        File to write. A folder (one that exists, a string that ends in a slash, or any name with
        ``window``) gets files named as their reader expects them.
    winds : {"corrected", "reported"}, default "corrected"
        Which winds to write.
    window : str, optional
        Length of time windows such as "1 h", with a folder each, named by its beginning.
    soundings : bool, default False
        Join every ascent and every descent into one report of many levels.
    overwrite : bool, default False
        Replace existing files instead of refusing to.
    settings : Handover, optional
        Section ``handover`` of a configuration: platforms, domain, period.

    Returns
    -------
    dict
        ``format``, ``winds``, ``files`` and ``notes``; formats that hold reports add ``reports``,
        ``levels``, ``left_out`` (counts by reason), ``platforms``, and ``identifiers`` where
        aircraft are written as numbers.

    Raises
    ------
    InputError
        On an unknown format, missing variables, an existing file, or nothing to write.

    Examples
    --------
    >>> done = airswing.export(corrected, to="little_r", path=folder / "obs.little_r")
    >>> done["format"], done["reports"] > 10_000
    ('little_r', True)
    """
    import xarray as xr

    from airswing.config import Handover
    from airswing.products.netcdf import open_product

    if to not in FORMATS:
        raise InputError(
            "no such export format", field="--to", found=to, remedy=f"Known: {', '.join(FORMATS)}"
        )
    if winds not in ("corrected", "reported"):
        raise InputError(
            "no such winds", field="--winds", found=winds, remedy="Known: corrected, reported"
        )
    length = None if window is None else _seconds(window)
    product = Path(corrected) if isinstance(corrected, (str, Path)) else None
    ds = open_product(product) if product is not None else corrected
    if not isinstance(ds, xr.Dataset):
        raise TypeError("corrected is a Dataset or the path of one")
    try:
        request = Request(
            ds,
            Path(path),
            length is not None or str(path).endswith("/") or Path(path).is_dir(),
            settings or Handover(),
            winds,
            length,
            soundings,
            overwrite,
            None if product is None else product.parent,
        )
        module = importlib.import_module(f"airswing.handover.{_MODULES.get(to, to)}")
        written: dict[str, Any] = getattr(module, f"write_{to}")(request)
        return findings({"format": to, "winds": winds, **written})
    finally:
        if product is not None:
            ds.close()


def _seconds(window: str) -> float:
    from airswing.quantities import quantity

    try:
        seconds = quantity(window, "second")
    except ValueError as err:
        raise InputError(
            "not a length of time", field="--window", found=window, remedy="Such as '1 h'"
        ) from err
    if seconds < 1.0 or seconds != round(seconds):
        raise InputError("a window is a whole number of seconds", field="--window", found=window)
    return seconds


def as_text(result: dict[str, Any]) -> str:
    """Return the result of :func:`export` as text for a person."""
    files = result["files"]
    lines = [str(file["path"]) for file in files[:SHOWN]]
    if len(files) > SHOWN:
        lines.append(f"and {len(files) - SHOWN:,} more")
    if "reports" in result:
        lines.append(
            f"{result['reports']:,} reports, {result['levels']:,} winds as {result['winds']}, "
            f"in {len(files):,} file{'s' * (len(files) != 1)}"
        )
    left_out = {reason: number for reason, number in result.get("left_out", {}).items() if number}
    if left_out:
        reasons = ", ".join(f"{reason.replace('_', ' ')} {n:,}" for reason, n in left_out.items())
        lines.append(f"left out {sum(left_out.values()):,}: {reasons}")
    numbers = [f"{name} {number}" for name, number in result.get("identifiers", {}).items()]
    if numbers:
        more = [f"and {len(numbers) - SHOWN:,} more (--json)"] if len(numbers) > SHOWN else []
        lines.append(f"aircraft by number: {', '.join([*numbers[:SHOWN], *more])}")
    return "\n".join([*lines, *result.get("notes", [])])


def product_of_run(request: Request, name: str, *, why: str) -> xr.Dataset:
    """Open another product of the same run lazily; ``why`` it is needed is part of the message."""
    from airswing.products.netcdf import open_product, product_path

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
    pools = {name: [name] for name in config.get("references", {})} | config.get("pool", {})
    name = str(corrected.attrs.get("correction_reference", ""))
    first = next(iter([*config.get("pool", {}), *config.get("references", {})]), "")
    return list(pools.get(name, pools.get(first, [])))


def refuse_existing(request: Request, *targets: Path) -> None:
    """Raise InputError where a file would be replaced without ``overwrite``."""
    for target in targets:
        if target.is_dir() or (target.exists() and not request.overwrite):
            raise InputError(
                "already exists",
                file=target,
                remedy="Choose another name with -o, or give --overwrite",
            )
