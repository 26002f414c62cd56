"""Summary of a file by its content: model winds, aircraft reports, or a product of airswing.

Assumes that the first bytes show the kind; names are not used.
"""

from __future__ import annotations

from pathlib import Path

from airswing.errors import InputError, shortened
from airswing.products.damaged_netcdf import DAMAGE, require_sound
from airswing.products.foreign_files import foreign_file
from airswing.reference.files import first_bytes, local_path
from airswing.reference.inspection import inspect_winds
from airswing.reports.mapping_proposal import propose_mapping
from airswing.reports.read import reports_summary

_LONGEST_LIST = 20  # most numbers of a list that are shown


def inspect_file(path: Path) -> dict[str, object]:
    """Return ``file``, ``kind`` and the summary of that kind."""
    kind, found = _content(Path(path))
    return {"file": str(path), "kind": kind} | found


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
        found = propose_mapping(path)
    except (InputError, ValueError, ImportError):
        # without a proposal the message of the reader is shown
        return None
    if found is None:
        return None
    summary: dict[str, object] = {"problem": f"{error.field}: {error.what}"}
    summary["proposed mapping, to go under reports"] = found["yaml"]
    if found["unused"]:
        summary["columns not used"] = found["unused"]
    if found["missing"]:
        summary["still missing"] = found["missing"]
        return summary
    try:
        summary["read with it"] = reports_summary(path, columns=found["columns"])
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


def as_text(found: dict[str, object], *, indent: str = "") -> str:
    """Lay the result of :func:`inspect_file` out for a terminal."""
    lines = []
    for key, value in found.items():
        if value is None or value in ("", [], {}):
            continue
        if isinstance(value, dict):
            if inner := as_text(value, indent=indent + "  "):
                lines += [f"{indent}{key}:", inner]
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            lines.append(f"{indent}{key}:")
            lines += [
                f"{indent}  " + ", ".join(f"{k}: {_shown(v)}" for k, v in row.items() if v != {})
                for row in value
            ]
        elif isinstance(value, list):
            lines.append(f"{indent}{key}: {_shown(value)[1:-1]}")
        elif isinstance(value, str) and "\n" in value:
            lines += [f"{indent}{key}:", *(f"{indent}  {row}" for row in value.split("\n"))]
        else:
            lines.append(f"{indent}{key}: {_shown(value)}")
    return "\n".join(lines)


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.7g}"
    if not isinstance(value, list | tuple):
        return str(value)
    texts = [_shown(one) for one in value]
    if len(texts) > _LONGEST_LIST and isinstance(value[0], float):
        texts[2:-1] = [f"... ({len(texts)} values)"]
    return f"[{', '.join(texts)}]"
