"""Export of corrected winds in the format an assimilation system reads.

Assumes the corrected product of a run or its Dataset.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airswing.config import Handover
from airswing.errors import InputError
from airswing.handover.error_tables import write_jedi, write_obs_errors
from airswing.handover.reject_list import write_reject_list
from airswing.handover.selection import Request, Winds
from airswing.handover.wrf_reports import write_little_r, write_ob_ascii, write_obs_domain
from airswing.products.netcdf import open_product
from airswing.products.whole_files import Findings
from airswing.quantities import quantity

if TYPE_CHECKING:
    import xarray as xr

FORMATS: dict[str, Callable[[Request], dict[str, Any]]] = {
    "jedi": write_jedi,
    "little_r": write_little_r,
    "ob_ascii": write_ob_ascii,
    "obs_domain": write_obs_domain,
    "obs_errors": write_obs_errors,
    "reject_list": write_reject_list,
}
SHOWN = 5  # files, and aircraft, named in the text for a person


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
        Result of :func:`airswing.correct` on screened headings, or the product of a run, which may
        be larger than memory.
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
    >>> result = airswing.export(corrected, to="little_r", path=folder / "obs.little_r")
    >>> result["format"], result["reports"] > 10_000
    ('little_r', True)
    """
    import xarray as xr

    if to not in FORMATS:
        raise InputError(
            "no such export format", field="--to", found=to, remedy=f"Known: {', '.join(FORMATS)}"
        )
    if winds not in ("corrected", "reported"):
        raise InputError(
            "no such winds", field="--winds", found=winds, remedy="Known: corrected, reported"
        )
    length = None
    if window is not None:
        try:
            length = quantity(window, "second")
        except ValueError as err:
            raise InputError(
                "not a length of time", field="--window", found=window, remedy="Such as '1 h'"
            ) from err
        if length < 1.0 or length != round(length):
            raise InputError(
                "a window is a whole number of seconds", field="--window", found=window
            )
    product = Path(corrected) if isinstance(corrected, (str, Path)) else None
    ds = open_product(product) if product is not None else corrected
    if not isinstance(ds, xr.Dataset):
        raise TypeError("corrected is a Dataset or the path of one")
    folder = length is not None or str(path).endswith("/") or Path(path).is_dir()
    with ds if product is not None else contextlib.nullcontext():
        request = Request(
            ds,
            Path(path),
            folder,
            settings or Handover(),
            winds,
            length,
            soundings,
            overwrite,
            None if product is None else product.parent,
        )
        return Findings({"format": to, "winds": winds, **FORMATS[to](request)})


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
