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

from collections import Counter
from collections.abc import Mapping

import xarray as xr

from airswing.errors import InputError
from airswing.reference.geometry.grids import Grid, UnplaceableGridError
from airswing.reference.grib.gridsections import read_grid
from airswing.reference.gridded.grib_fieldset import GribField, Skipped, fields_of

ISOBARIC = ("isobaricInhPa", "isobaricInPa")
NATIVE = ("hybrid", "hybridLayer", "generalVertical", "generalVerticalLayer")
GRID_SECTION = "grid_section"
SKIPPED = "skipped"
"""What a file holds that could not be read, in the encoding of its first part."""
_KEYS = ("gridType", "shortName", "stepType", "typeOfLevel")
_WITHOUT_ROWS = ("reduced_gg", "reduced_ll", "sh", "unstructured_grid", "healpix")


def cfgrib_parts(path: str) -> list[xr.Dataset]:
    """Datasets of one variable each.

    Raises
    ------
    InputError
        Where the file holds u and v on no grid of rows and columns.
    """
    skipped: Skipped = Counter()
    fields = fields_of(path, _may_matter, skipped)
    native = any(one["typeOfLevel"] in NATIVE for one in fields.values())
    kinds: dict[tuple[object, ...], dict[int, GribField]] = {}
    for number, one in fields.items():
        if _is_wanted(one, native=native):
            kinds.setdefault((*(one[key] for key in _KEYS), one.grid), {})[number] = one
    odd = sorted({kind[0] for kind in kinds if kind[0] in _WITHOUT_ROWS})
    usable = [own for kind, own in kinds.items() if kind[0] not in _WITHOUT_ROWS]
    parts = _parts(usable, skipped)
    if odd and not parts:
        raise InputError(
            "winds on no grid of rows and columns",
            file=path,
            found=", ".join(odd),
            remedy="Ask the archive for a regular grid, or interpolate to one",
        )
    if not parts and skipped:
        raise InputError(
            "cannot be opened as cfgrib",
            file=path,
            found="; ".join(f"{count:,} {what}: {why}" for (what, why), count in skipped.items()),
        )
    if parts:
        parts[0].encoding[SKIPPED] = skipped
    return parts


def _parts(kinds: list[dict[int, GribField]], skipped: Skipped) -> list[xr.Dataset]:
    """A Dataset of each kind of field; kinds whose grid ecCodes cannot lay are counted."""
    found = []
    for fields in kinds:
        try:
            found.append(_part(fields))
        except Exception as error:  # cfgrib and xarray raise many kinds
            reason = f"not to be opened: {type(error).__name__}: {' '.join(str(error).split())}"
            skipped["message", reason[:200]] += len(fields)
    return found


def _may_matter(keys: Mapping[str, object]) -> bool:
    """Whether a field is a wind or can give one its pressure."""
    return all(key in keys for key in _KEYS) and _is_wanted(keys, native=True)


def _is_wanted(one: Mapping[str, object], *, native: bool) -> bool:
    if one["stepType"] != "instant":
        return False
    if one["typeOfLevel"] in ISOBARIC + NATIVE and one["shortName"] in ("u", "v"):
        return True
    if not native:
        return False
    if one["typeOfLevel"] in NATIVE:
        return one["shortName"] in ("pres", "lnsp")
    return one["typeOfLevel"] == "surface" and one["shortName"] in ("sp", "lnsp")


def _part(fields: dict[int, GribField]) -> xr.Dataset:
    """One variable, with the grid section of its first message in `encoding`."""
    found = xr.open_dataset(
        fields,  # type: ignore[arg-type]  # cfgrib takes mappings of fields
        engine="cfgrib",
        decode_timedelta=False,
        cache=False,
        backend_kwargs={"errors": "raise", "read_keys": ["pv", "uvRelativeToGrid"]},
    )
    first = next(iter(fields.values()))
    found.encoding[GRID_SECTION] = first.edition, first.grid
    return found


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
