"""One door to the winds of any model: GRIB by its octets, all else as a Dataset.

Assumptions and validity
------------------------
* What files are is told by their first octets, never by their names; all files of one reference
  are read one way.
* GRIB is read by its octets; where these hold no wind that can be used, ecCodes (by cfgrib) is
  asked, which knows more kinds of GRIB and is slower. Where both can, they give the same winds.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import xarray as xr

from airswing.errors import InputError
from airswing.model_formats import model_formats
from airswing.reference.geometry.wind_profiles import Catalogue
from airswing.reference.grib import catalogue as grib
from airswing.reference.gridded.cf.naming import Naming
from airswing.reference.gridded.gridded_catalogue import (
    build_gridded_catalogue,
    engine_of,
    find_stored,
)
from airswing.reference.gridded.opening import ENGINES, kind_of

FALL_BACK = "opened by cfgrib, which is slower: the reader of octets found {what}"


def build_catalogue(
    files: str | os.PathLike[str] | Sequence[str] | xr.Dataset,
    *,
    name: str,
    engine: str = "auto",
    lead: str = "any",
    member: int | None = None,
    naming: Naming | Mapping[str, object] | None = None,
    cache_dir: str | os.PathLike[str] | None = None,
    on_bad_file: str = "skip",
) -> Catalogue:
    """Catalogue the winds of a model: of files of one kind, or of a Dataset.

    Parameters
    ----------
    files : str, sequence of str, or Dataset
        Paths or glob patterns of GRIB or NetCDF files or Zarr stores; or a Dataset with CF winds.
    name : str
        The reference's name.
    engine : {"auto", "grib", "cfgrib", "netcdf", "zarr", "wrf"}
        How files are opened; by their content where ``auto``.
    lead : str
        ``any``, ``analysis`` or a comparison such as ``>= 1 h``.
    member : int, optional
        Number of the ensemble member whose winds count; the lowest where not given.
    naming : Naming or mapping, optional
        What a Dataset does not say itself: names of variables and coordinates, units, projection.
    cache_dir : path-like, optional
        Folder for the cache of GRIB headers; default the user's cache folder.
    on_bad_file : {"skip", "fail"}
        Whether damaged files and what cannot be used are skipped (named and counted) or refused.

    Raises
    ------
    InputError
        No file found, no usable wind at all, files of several kinds, or bad input under
        ``on_bad_file="fail"``.
    """
    if on_bad_file not in ("skip", "fail"):
        raise InputError("must be skip or fail", field="on_bad_file", found=on_bad_file)
    engines = [*ENGINES, *model_formats()]
    if engine not in engines:
        raise InputError(
            "no such engine",
            field=f"references.{name}.engine",
            found=engine,
            remedy="Engines are " + ", ".join(engines),
        )
    if isinstance(naming, Mapping):
        naming = Naming(**naming)  # type: ignore[arg-type]
    patterns: str | Sequence[str] | xr.Dataset
    if isinstance(files, xr.Dataset):
        used, patterns = "", files
    else:
        named: str | Sequence[str] = files if isinstance(files, Sequence) else os.fspath(files)
        patterns = named
        used = _told(find_stored(named, name), name) if engine == "auto" else engine
    if used != "grib":
        return build_gridded_catalogue(
            patterns,
            name=name,
            engine=used,
            lead=lead,
            member=member,
            naming=naming,
            on_bad_file=on_bad_file,
        )
    assert not isinstance(patterns, xr.Dataset)
    try:
        return grib.build_catalogue(
            patterns,
            name=name,
            lead=lead,
            member=member,
            cache_dir=cache_dir,
            on_bad_file=on_bad_file,
        )
    except InputError as refused:
        if engine == "grib" or not refused.what.startswith("no wind on pressure levels"):
            raise
        return _by_cfgrib(patterns, refused, name=name, lead=lead, member=member, naming=naming)


def _by_cfgrib(
    files: str | Sequence[str],
    refused: InputError,
    *,
    name: str,
    lead: str,
    member: int | None,
    naming: Naming | None,
) -> Catalogue:
    """What cfgrib finds; the first reader's refusal stands where it finds nothing either."""
    try:
        found = build_gridded_catalogue(
            files, name=name, engine="cfgrib", lead=lead, member=member, naming=naming
        )
    except InputError as second:
        raise refused from second
    found.notes.insert(0, FALL_BACK.format(what=refused.found))
    return found


def _told(paths: Sequence[str], name: str) -> str:
    """The engine of all files, by what most of them are; damaged ones are left to the reader."""
    kinds: dict[str, list[str]] = {}
    for path in paths:
        kinds.setdefault(_kind(path), []).append(path)
    unknown = kinds.pop("", [])
    if unknown and not kinds:
        return "grib"  # garbage is counted and named by the reader of octets
    if len(kinds) > 1:
        raise InputError(
            "files of several kinds under one reference",
            field=f"references.{name}.files",
            found="; ".join(f"{kind}: {found[0]}" for kind, found in sorted(kinds.items())),
            remedy="Give each kind a reference of its own, or narrow the pattern",
        )
    kind, found = next(iter(kinds.items()))
    return engine_of(found[0]) if kind == "netcdf" else kind


def _kind(path: str) -> str:
    """What a file is; empty where that cannot be told or the file cannot be read."""
    try:
        return kind_of(path)
    except OSError:
        return ""


def catalogues_of(references: Mapping[str, Catalogue | xr.Dataset]) -> dict[str, Catalogue]:
    """Catalogues of references, some of which may be given as Datasets."""
    return {
        name: build_catalogue(one, name=name) if isinstance(one, xr.Dataset) else one
        for name, one in references.items()
    }
