"""Hand over corrected winds in the format an assimilation system reads.

Assumes ``corrected.nc`` or its Dataset; formats are those of
:mod:`airswing.handover.records.registry`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from airswing.errors import InputError
from airswing.handover.records.registry import WINDS, Account, Request, Winds, format_of
from airswing.products.findings import findings

if TYPE_CHECKING:
    import xarray as xr

    from airswing.config import Handover


SHOWN = 5  # Files, and aircraft, named to a person


class Exported(Account):
    """What was handed over, and as what."""

    format: str
    winds: Winds


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
) -> Exported:
    """Write corrected winds for an assimilation system.

    Parameters
    ----------
    corrected : Dataset or path
        Of :func:`airswing.correct` on screened headings, or ``corrected.nc``; opened from the file
        the archive may be larger than memory.
    to : str
        Name of a format: ``obs_domain`` (WRF observation nudging), ``little_r`` (OBSPROC),
        ``ob_ascii`` (WRFDA) and others; see `airswing export --help`.
    path : path-like
        File to write. A folder (one that is there, a string that ends in a slash, or any name
        with ``window``) gets files named as their reader expects them.
    winds : {"corrected", "reported"}, default "corrected"
        Which winds to write.
    window : str, optional
        Length of time windows such as "1 h", with a folder each, named by its beginning.
    soundings : bool, default False
        Join every ascent and every descent into one report of many levels.
    overwrite : bool, default False
        Replace files that are there instead of refusing to.
    settings : Handover, optional
        Section ``handover`` of a configuration: platforms, domain, period.

    Returns
    -------
    dict
        ``format``, ``files`` with their reports and levels, ``reports``, ``levels``, ``left_out``
        (counts by reason), ``platforms``, ``notes``, and ``identifiers`` where aircraft are written
        as numbers.

    Raises
    ------
    InputError
        On an unknown format, missing variables, a file that is there already, or nothing to write.
    """
    from airswing.config import Handover
    from airswing.products.netcdf import read_product

    chosen = format_of(to)
    if winds not in WINDS:
        raise InputError(
            "no such winds", field="--winds", found=winds, remedy=f"Known: {', '.join(WINDS)}"
        )
    length = _seconds(window)
    product = Path(corrected) if isinstance(corrected, (str, Path)) else None
    ds = read_product(product, lazy=True) if product is not None else _dataset(corrected)
    folder = length is not None or str(path).endswith("/") or Path(path).is_dir()
    try:
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
        told: Exported = {"format": to, "winds": winds, **chosen.write(request)}
        return findings(told)
    finally:
        if product is not None:
            ds.close()


def _dataset(corrected: object) -> xr.Dataset:
    import xarray as xr

    if not isinstance(corrected, xr.Dataset):
        raise TypeError("corrected is a Dataset or the path of one")
    return corrected


def _seconds(window: str | None) -> float | None:
    from airswing.quantities import quantity

    if window is None:
        return None
    try:
        seconds = quantity(window, "second")
    except ValueError as err:
        raise InputError(
            "not a length of time", field="--window", found=window, remedy="Such as '1 h'"
        ) from err
    if seconds < 1.0 or seconds != round(seconds):
        raise InputError("a window is some whole seconds", field="--window", found=window)
    return seconds


def as_text(result: Exported) -> str:
    """Tell a person what :func:`export` wrote."""
    files = result["files"]
    places = [str(file["path"]) for file in files[:SHOWN]]
    more = [f"and {len(files) - SHOWN:,} more"] if len(files) > SHOWN else []
    lines = [*places, *more]
    if "reports" in result:
        lines.append(
            f"{result['reports']:,} reports, {result['levels']:,} winds as {result['winds']}, "
            f"in {len(files):,} file{'s' * (len(files) != 1)}"
        )
    left_out = {reason: count for reason, count in result.get("left_out", {}).items() if count}
    if left_out:
        told = ", ".join(f"{reason.replace('_', ' ')} {n:,}" for reason, n in left_out.items())
        lines.append(f"left out {sum(left_out.values()):,}: {told}")
    numbers = [f"{name} {number}" for name, number in result.get("identifiers", {}).items()]
    if numbers:
        more = [f"and {len(numbers) - SHOWN:,} more (--json)"] if len(numbers) > SHOWN else []
        lines.append(f"aircraft by number: {', '.join([*numbers[:SHOWN], *more])}")
    return "\n".join([*lines, *result.get("notes", [])])
