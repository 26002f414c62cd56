"""Read aircraft reports of any known format, recognised by the content of a file.

A file that cannot be read completely is treated as unreadable.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import xarray as xr

from airswing.errors import InputError
from airswing.products.foreign_files import foreign_file
from airswing.products.whole_files import none_found
from airswing.reports.assembly import assemble
from airswing.reports.audit import Audit, similar
from airswing.reports.cleaning import FLAGS, clean
from airswing.reports.columns import ONLY, ColumnMapping, Mapped, parse_mapping
from airswing.reports.formats import damage_named, first_bytes, formats

_TABLE = "Save the reports as a CSV or Parquet table, or as one of the formats that are read"


def read_file(
    path: str | Path, *, format: str = "auto", columns: ColumnMapping | None = None
) -> tuple[pd.DataFrame, Audit]:
    """Read one report file to cleaned canonical columns; options as for :func:`read_reports`.

    One row a report in the order of the file, in SI units (angles in degrees): ``tail`` and
    ``flight`` (categories), ``time`` (datetime64[ns], UTC), ``latitude, longitude`` (float64),
    ``pressure, pressure_altitude, wind_speed, wind_direction, eastward_wind, northward_wind,
    air_temperature, reported_airspeed, reported_heading`` (float32) and the flags (int8).
    """
    _require_format(format)
    path, mapping, audit = Path(path), parse_mapping(columns), Audit()
    name = _format_of(path) if format == "auto" else format
    audit.formats[name] += 1
    try:
        pieces = [
            clean(_wanted(raw, mapping, path, audit), audit)
            for raw in _pieces(name, path, mapping, audit)
        ]
    except InputError as error:
        if format != "auto" and (refusal := foreign_file(path, first_bytes(path), "reports")):
            raise refusal from error
        raise
    for name in ("latitude", "longitude"):
        # A wrong unit leaves some values possible and wrong.
        if (dropped := audit.dropped[f"{name}_out_of_range"]) > 0.5 * audit.read:
            problem = f"{dropped:,} of {audit.read:,} values are impossible{audit.likely(name)}"
            remedy = "Positions are in degrees north and east; map the column with its unit"
            raise InputError(problem, file=path, field=name, remedy=remedy)
    frame = pd.concat(pieces, ignore_index=True)
    return frame.astype({"tail": "category", "flight": "category"}), audit


def read_reports(
    files: str | Path | Sequence[str | Path],
    *,
    format: str = "auto",
    columns: ColumnMapping | None = None,
    on_bad_file: Literal["skip", "fail"] = "skip",
    interval: float = 0.0,
) -> xr.Dataset:
    """Read aircraft reports into the canonical Dataset.

    Parameters
    ----------
    files : str, path, or sequence of them
        Paths or globs.
    format : str, default "auto"
        A registered format; "auto" finds it from each file's content.
    columns : mapping, optional
        For tables, in one of the forms of :mod:`airswing.reports.columns`: their name to
        a canonical name (``wind_speed_kt``), or to ``{"name": "wind_speed_kt", "unit": "m/s"}``
        with another unit; several names, constants, times made of two columns.
    on_bad_file : {"skip", "fail"}, default "skip"
        Whether a file that cannot be read is left out and counted, or refused.
    interval : float, default 0
        Seconds of straight flight over which reports are averaged; 0 keeps all reports.

    Returns
    -------
    Dataset
        Dimension ``report`` in order of ``aircraft``, flight and time with ``row_size``: time,
        latitude, longitude (degrees), pressure (Pa), pressure_altitude (m), eastward_wind and
        northward_wind (m s-1, as reported), air_temperature (K), the flags, phase, flight,
        reported_airspeed (m s-1), reported_heading (degrees), and per aircraft the resolutions
        found in the data. ``attrs["reading_audit"]`` holds the counts as JSON.

    Raises
    ------
    InputError
        No file matches, none can be read, none holds a usable report, or (policy "fail") one
        cannot be read.

    Examples
    --------
    >>> reports = airswing.read_reports("data_samples/reports/N40[1-3].csv")
    >>> reports["aircraft"].values.tolist()
    ['N401', 'N402', 'N403']
    """
    parts, audit = read_each(files, format, columns, on_bad_file)
    reports = assemble(parts, interval=interval, audit=audit)
    audit.similar_tails = similar(reports["aircraft"].to_numpy().tolist())
    return reports.assign_attrs(reading_audit=audit.as_json())


def read_each(
    files: str | Path | Sequence[str | Path],
    format: str,
    columns: ColumnMapping | None,
    on_bad_file: str,
    read: Callable[[Path], tuple[Any, Audit]] | None = None,
) -> tuple[list[Any], Audit]:
    """Results of :func:`read_file`, or of ``read``, for every file, and the sum of the counts.

    Options as of :func:`read_reports`. Files that cannot be read are listed, or refused (policy
    "fail"). InputError if none can be read or no report is usable.
    """
    _require_format(format)
    parse_mapping(columns)  # refused before a file is opened
    read = read or partial(read_file, format=format, columns=columns)
    results, paths = [], expand(files)
    audit, errors = Audit(), []
    for path in paths:
        try:
            result, counts = read(path)
        except InputError as error:
            if on_bad_file == "fail" or len(paths) == 1:
                raise
            errors.append(error)
            audit.files_skipped.append({"file": str(path), "reason": str(error)})
        else:
            results.append(result)
            audit.add(counts)
    if len(errors) == len(paths):
        problem = f"none of the {len(errors)} report files can be read; the first: {errors[0]}"
        raise InputError(problem, field="reports.files")
    if audit.usable:
        return results, audit
    reasons = ", ".join(
        f"{reason} {n}{audit.likely(reason.removesuffix('_out_of_range'))}"
        for reason, n in audit.dropped.most_common()
    )
    unread = ", ".join(f"{name} such as {value}" for name, value in audit.examples.items())
    remedy = "Numbers have a decimal point and no unit"
    if any("time" in reason for reason in audit.dropped):
        remedy = (
            "Times from 1973 to now are ISO 8601 UTC, yyyymmddHH[MM[SS]], seconds since 1970 or "
            "Julian dates; give another format under reports.columns: "
            'COLUMN: {name: time, format: "%d.%m.%Y %H:%M"}, or for a date and a time of day '
            'time: {date: COLUMN, time: COLUMN, format: "%d.%m.%Y %H:%M"}'
        )
    elif set(audit.dropped) == {"not_wanted"}:
        remedy = "No report has the values that the key `only` asks for"
    raise InputError(
        "no usable report",
        field="reports.files",
        found=f"{audit.read} reports read, dropped for: {reasons}"
        + (f"; cannot be read: {unread}" if unread else ""),
        remedy=remedy,
    )


def reports_summary(path: str | Path, *, columns: ColumnMapping | None = None) -> dict[str, object]:
    """Summarise the content of report files in JSON types; duplicates count as reports.

    ``file, format, reports, aircraft, first, last`` (ISO 8601 UTC), ``bounding_box``
    (``{"south", "north", "west", "east"}`` in degrees), ``columns`` (reports that have a value, per
    quantity), ``flags`` (reports per code, per field) and ``audit`` (the other counts). InputError
    if the file cannot be read or holds no usable report.
    """
    parts, audit = read_each(path, "auto", columns, "fail")
    frame = pd.concat(parts, ignore_index=True)
    measured = ["pressure", "eastward_wind", "air_temperature", "reported_airspeed"]
    there = frame[[*measured, "reported_heading"]].notna()
    there = there.assign(**{name: frame[name] != missing for name, missing in FLAGS.items()})
    present = there.assign(flight=frame["flight"].astype(str) != "").sum()
    audit.missing["eastward_wind"] = audit.usable - int(present["eastward_wind"])
    content = audit.as_dict()
    first, last = (f"{time.isoformat()}Z" for time in frame["time"].agg(["min", "max"]))
    limits = frame[["latitude", "longitude"]].agg(["min", "max"]).to_numpy(float).T.ravel()
    return {
        "file": str(path),
        "format": next(iter(content["formats"]), None),
        "reports": audit.usable,
        "aircraft": int(frame["tail"].nunique()),
        "first": first,
        "last": last,
        "bounding_box": dict(zip(("south", "north", "west", "east"), limits.tolist(), strict=True)),
        "columns": {str(name): int(number) for name, number in present.items() if number},
        "flags": content["flags"],
        "audit": {
            name: counts
            for name, counts in content.items()
            if name not in ("flags", "missing", "mistakes", "remarks")
        },
    }


def expand(
    files: str | Path | Iterable[str | Path],
    field: str = "reports.files",
    usable: Callable[[str], bool] = os.path.isfile,
) -> list[Path]:
    """The paths that match names and globs, each once; InputError if one matches nothing."""
    patterns = [files] if isinstance(files, str | Path) else list(files)
    matches: dict[str, None] = {}
    for pattern in patterns:
        text = str(Path(pattern).expanduser())
        # A name with brackets is first a file of that name, then a pattern.
        names = [text] if usable(text) else glob.glob(text, recursive=True)
        # A broken link is a missing file: reading it fails and names it.
        names = sorted(name for name in names if usable(name) or not os.path.exists(name))
        if not names:
            raise none_found(text, field)
        matches.update(dict.fromkeys(names))
    if not matches:
        remedy = "Give a path, or a pattern such as reports/*.csv"
        raise InputError("names no file", field=field, remedy=remedy)
    return [Path(name) for name in matches]


def _require_format(format: str) -> None:
    names = ("auto", *formats())
    if format not in names:
        problem, remedy = "unknown report format", f"One of: {', '.join(names)}"
        raise InputError(problem, field="reports.format", found=format, remedy=remedy)


def _format_of(path: Path) -> str:
    start = first_bytes(path)
    if (refusal := foreign_file(path, start, "reports")) is not None:
        raise refusal
    for name, candidate in formats().items():
        if candidate.recognises(start):
            return name
    problem = "is not a report file of a known format"
    raise InputError(problem, file=path, found=start[:16], remedy=_TABLE)


def _pieces(name: str, path: Path, mapping: Mapped, audit: Audit) -> Iterator[pd.DataFrame]:
    """Raw pieces of a file; any exception of a library about its content is an InputError."""
    report_format = formats()[name]
    tail = mapping["tail"].value if "tail" in mapping else None
    with damage_named(path, report_format.title):
        for raw in report_format.read(path, mapping, audit):
            yield raw if tail is None else raw.assign(tail=str(tail))


def _wanted(raw: pd.DataFrame, mapping: Mapped, path: Path, audit: Audit) -> pd.DataFrame:
    keep = np.ones(len(raw), dtype=bool)
    for name, source in mapping.items():
        if not name.startswith(ONLY):
            continue
        if name not in raw:
            raise InputError(
                "has no column by which reports could be selected",
                file=path,
                field=f"reports.only.{source.column}",
                found=", ".join(raw.columns),
                remedy="Leave it out for these files",
            )
        keep &= raw[name].isin(source.wanted).to_numpy(dtype=bool)
    audit.drop("not_wanted", int(np.count_nonzero(~keep)), unread=True)
    return raw if keep.all() else raw.loc[keep]
