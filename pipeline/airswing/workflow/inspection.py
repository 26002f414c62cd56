"""Summary of a file by its content: model winds, aircraft reports, or a product of airswing.

Assumes that the first bytes show the kind; names are not used.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from airswing.errors import InputError, shortened
from airswing.products.damaged_netcdf import DAMAGE, require_sound
from airswing.products.foreign_files import foreign_file
from airswing.products.whole_files import json_types
from airswing.reference.files import first_bytes, local_path
from airswing.reference.inspection import inspect_winds
from airswing.reports.mapping_proposal import propose_mapping
from airswing.reports.read import reports_summary


def inspect_file(path: Path) -> dict[str, object]:
    """Return ``file``, ``kind`` and the summary of that kind."""
    kind, summary = _content(Path(path))
    return {"file": str(path), "kind": kind} | summary


def _content(path: Path) -> tuple[str, dict[str, object]]:
    if path.is_dir():
        return "model winds", inspect_winds(str(path))
    try:
        start = first_bytes(str(path), 4096)
        refusal = foreign_file(path, start)
    except OSError as err:
        remedy = "Check the path, which starts at the current directory"
        raise InputError(
            "cannot open the file", file=path, found=err.strerror, remedy=remedy
        ) from err
    if refusal is not None:
        raise refusal
    no_winds: InputError | None = None
    if start.startswith((b"CDF", b"\x89HDF")):
        product = _product(Path(local_path(str(path))))
        if product is not None:
            return "product", product
        try:
            return "model winds", inspect_winds(str(path))
        except InputError as error:
            if not error.what.startswith(("no wind on", "holds observations")):
                no_winds = error
    elif b"GRIB" in start and b"\x00" in start:  # text may contain the word GRIB
        return "model winds", inspect_winds(str(path))
    try:
        return "reports", reports_summary(path)
    except InputError as error:
        proposed = _proposal(path, error)
        if no_winds is not None:
            raise no_winds from error
        if proposed is None:
            raise
        return "a table of unknown columns", proposed


def _proposal(path: Path, error: InputError) -> dict[str, object] | None:
    """Proposed mapping of an unknown table, and its content with it; None for other files."""
    if "column" not in error.what and "is there" not in error.what:
        return None
    try:
        proposal = propose_mapping(path)
    except (InputError, ValueError):
        # without a proposal the message of the reader is shown
        return None
    if proposal is None:
        return None
    summary: dict[str, object] = {"problem": f"{error.field}: {error.what}"}
    summary["proposed mapping, to go under reports"] = proposal["yaml"]
    if proposal["unused"]:
        summary["columns not used"] = proposal["unused"]
    if proposal["missing"]:
        summary["still missing"] = ", ".join(proposal["missing"])
        return summary
    try:
        summary["read with it"] = reports_summary(path, columns=proposal["columns"])
    except InputError as again:
        summary["read with it"] = str(again)
    return summary


def _product(path: Path) -> dict[str, object] | None:
    import xarray as xr

    try:
        require_sound(path)
        opened = xr.open_dataset(path, engine="netcdf4", decode_timedelta=False)
    except DAMAGE as err:
        raise InputError("not a complete NetCDF file", file=path, found=err) from err
    with opened as ds:
        if "airswing_version" not in ds.attrs:
            return None
        names = ("title", "airswing_version", "history", "uuid")
        return {name: shortened(ds.attrs.get(name, "absent: damaged")) for name in names} | {
            "dimensions": {str(name): int(size) for name, size in ds.sizes.items()},
            "variables": {
                str(name): f"({', '.join(map(str, entry.dims))}) "
                f"{entry.attrs.get('units', '')} {entry.attrs.get('long_name', '')}".strip()
                for name, entry in ds.variables.items()
            },
        }


class _Dumper(yaml.SafeDumper):
    """Writes texts of several lines as they are, so that a mapping can be pasted."""


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style="|" if "\n" in text else None
    ),
)


def as_text(summary: dict[str, object]) -> str:
    """Lay the result of :func:`inspect_file` out for a terminal, as YAML."""
    content = {key: value for key, value in summary.items() if value not in (None, "", [], {})}
    options: Any = {"sort_keys": False, "allow_unicode": True, "width": 10_000}
    text: str = yaml.dump(json_types(content), Dumper=_Dumper, **options)
    return text.rstrip()
