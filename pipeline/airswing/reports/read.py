"""Read aircraft reports of any known format.

Two steps, each usable by itself: :func:`read_file` brings one file to cleaned canonical columns,
:func:`airswing.reports.assembly.assemble` makes one Dataset of the columns of several files.
:func:`read_reports` does both.

Assumes files named by path or glob. The format follows from a file's content, not from its name,
and a file that cannot be read to its end counts as not read at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import xarray as xr
from pandas.api.types import union_categoricals

from airswing.errors import InputError
from airswing.reports.assembly import assemble
from airswing.reports.canonical.audit import Audit, similar
from airswing.reports.canonical.columns import ColumnMapping, parse_mapping
from airswing.reports.files import (
    Format,
    Policy,
    expand,
    file_frames,
    none_read,
    none_usable,
    require_format,
)


def read_file(
    path: str | Path, *, format: Format = "auto", columns: ColumnMapping | None = None
) -> tuple[pd.DataFrame, Audit]:
    """Read one report file to cleaned canonical columns.

    Parameters
    ----------
    path : str or path
    format, columns
        As for :func:`read_reports`.

    Returns
    -------
    reports : DataFrame
        One row a report in the order of the file, in SI units (angles in degrees): ``tail`` and
        ``flight`` (categories; blank where there is no label), ``time`` (datetime64[ns], UTC),
        ``latitude, longitude`` (float64), ``pressure, pressure_altitude, wind_speed,
        wind_direction, eastward_wind, northward_wind, air_temperature, reported_airspeed,
        reported_heading`` (float32) and the flags (int8). May be empty.
    audit : Audit
        Reports read, dropped and repaired, by reason.

    Raises
    ------
    InputError
        The file cannot be read to its end, or a mapped or required column is absent.
    """
    require_format(format)
    audit = Audit()
    pieces = list(file_frames(Path(path), format, parse_mapping(columns), audit))
    if len(pieces) == 1:
        return pieces[0], audit
    labels = {
        name: union_categoricals([piece[name] for piece in pieces]) for name in ("tail", "flight")
    }
    return pd.concat(pieces, ignore_index=True).assign(**labels), audit


def read_reports(
    files: str | Path | Sequence[str | Path],
    *,
    format: Format = "auto",
    columns: ColumnMapping | None = None,
    on_bad_file: Policy = "skip",
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
        For tables, in one of the forms of :mod:`airswing.reports.canonical.columns`: their name to
        a canonical name (``wind_speed_kt``), or to ``{"name": "wind_speed_kt", "unit": "m/s"}``
        where the unit is another; several names, constants, times made of two columns.
    on_bad_file : {"skip", "fail"}, default "skip"
        Whether a file that cannot be read is left out and counted, or refused.
    interval : float, default 0
        Reports are averaged over intervals of so many seconds of straight flight; 0 keeps them all.

    Returns
    -------
    Dataset
        Dimension ``report`` in order of ``aircraft`` and time with ``row_size``: time,
        latitude, longitude (degrees), pressure (Pa), pressure_altitude (m), eastward_wind and
        northward_wind (m s-1, as reported), air_temperature (K), the flags, phase, flight,
        reported_airspeed (m s-1), reported_heading (degrees), and per aircraft the resolutions
        found in the data. ``attrs["reading_audit"]`` holds the counts as JSON.

    Raises
    ------
    InputError
        No file matches, none can be read, none holds a usable report, or (policy "fail") one
        cannot be read.
    """
    require_format(format)
    parse_mapping(columns)  # refused before a file is opened
    parts, audit, errors = [], Audit(), []
    for path in expand(files):
        try:
            part, counts = read_file(path, format=format, columns=columns)
        except InputError as error:
            if on_bad_file == "fail":
                raise
            errors.append(error)
            audit.files_skipped.append({"file": str(path), "reason": str(error)})
        else:
            parts.append(part)
            audit.add(counts)
    if not parts:
        raise none_read(errors)
    if not audit.kept:
        raise none_usable(audit)
    reports = assemble(parts, interval=interval, audit=audit)
    audit.similar_tails = similar(reports["aircraft"].to_numpy().tolist())
    return reports.assign_attrs(reading_audit=audit.as_json())
