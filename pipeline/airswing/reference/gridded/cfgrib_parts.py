"""Winds of a GRIB file by cfgrib: whatever ecCodes can decode, for files the octet reader cannot.

Assumptions and validity
------------------------
* u, v, and the pressure, the surface pressure or its logarithm on native levels, each opened by
  itself. The coefficients of the levels come from the messages' pv section.
* Grids of rows and columns only; reduced Gaussian grids and spherical harmonics are refused.
* The grid is read from the first message's octets where the octet reader knows it, else from the
  latitudes and longitudes ecCodes gives.
"""

from __future__ import annotations

from typing import Any

import xarray as xr

from airswing.errors import InputError
from airswing.reference.geometry.grids import Grid, UnplaceableGridError
from airswing.reference.grib.gridsections import read_grid

ISOBARIC = ("isobaricInhPa", "isobaricInPa")
NATIVE = ("hybrid", "hybridLayer", "generalVertical", "generalVerticalLayer")
GRID_SECTION = "grid_section"
_KEYS = ("gridType", "shortName", "stepType", "typeOfLevel")
_WITHOUT_ROWS = ("reduced_gg", "reduced_ll", "sh", "unstructured_grid", "healpix")


def cfgrib_parts(path: str) -> list[xr.Dataset]:
    """Datasets of one variable each.

    Parameters
    ----------
    path : str

    Returns
    -------
    list of Dataset

    Raises
    ------
    InputError
        Where the file holds u and v on no grid of rows and columns.
    """
    from cfgrib import messages

    stream = messages.FileStream(path, errors="ignore")
    index = messages.FileIndex.from_fieldset(stream, list(_KEYS))
    held = [dict(zip(_KEYS, map(str, values), strict=True)) for values, _ in index.field_ids_index]
    native = any(one["typeOfLevel"] in NATIVE for one in held)
    wanted = [one for one in held if _is_wanted(one, native=native)]
    odd = sorted({one["gridType"] for one in wanted if one["gridType"] in _WITHOUT_ROWS})
    wanted = [one for one in wanted if one["gridType"] not in _WITHOUT_ROWS]
    if odd and not wanted:
        raise InputError(
            "winds on no grid of rows and columns",
            file=path,
            found=", ".join(odd),
            remedy="Ask the archive for a regular grid, or interpolate to one",
        )
    return [_part(path, index.subindex(one), one) for one in wanted]


def _is_wanted(one: dict[str, str], *, native: bool) -> bool:
    if one["stepType"] != "instant":
        return False
    if one["typeOfLevel"] in ISOBARIC + NATIVE and one["shortName"] in ("u", "v"):
        return True
    if not native:
        return False
    if one["typeOfLevel"] in NATIVE:
        return one["shortName"] in ("pres", "lnsp")
    return one["typeOfLevel"] == "surface" and one["shortName"] in ("sp", "lnsp")


def _part(path: str, index: Any, filters: dict[str, str]) -> xr.Dataset:
    """One variable, with the grid section of its first message in `encoding`."""
    import eccodes

    found = xr.open_dataset(
        path,
        engine="cfgrib",
        decode_timedelta=False,
        cache=False,
        backend_kwargs={
            "filter_by_keys": filters,
            "indexpath": "",
            "errors": "raise",
            "read_keys": ["pv", "uvRelativeToGrid"],
        },
    )
    message = index.first()
    found.encoding[GRID_SECTION] = grid_section(eccodes.codes_get_message(message.context.codes_id))
    return found


def grid_section(message: bytes) -> tuple[int, bytes]:
    """Edition and octets of the grid section of a GRIB message; no octets where it has none."""
    edition = message[7]
    if edition == 1:
        at = 8 + int.from_bytes(message[8:11], "big")
        held = bool(message[15] & 0x80)
        length = int.from_bytes(message[at : at + 3], "big")
        return edition, message[at : at + length] if held else b""
    at = 16
    while at + 5 <= len(message) - 4:
        length = int.from_bytes(message[at : at + 4], "big")
        if message[at + 4] == 3:
            return edition, message[at : at + length]
        at += length
    return edition, b""


def known_grid(ds: xr.Dataset) -> Grid | None:
    """The grid of a part as the octet reader has it; None where rows and columns tell it."""
    edition, section = ds.encoding.get(GRID_SECTION, (0, b""))
    if not section:
        return None
    try:
        grid = read_grid(edition, section)
    except UnplaceableGridError:
        return None
    plain = not grid.j_consecutive and not grid.alternate_rows
    return grid if plain and grid.kind != "regular_ll" else None
