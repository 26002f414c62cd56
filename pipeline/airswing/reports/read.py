"""Read aircraft reports of any known format into one Dataset.

Assumes files named by path or glob; what a file is comes from its content, never its name. Files
are read one by one and piece by piece, and each file counts whole or not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from airswing.reports.assemble import assembled, completed
from airswing.reports.canonical.audit import similar
from airswing.reports.canonical.columns import ColumnMapping
from airswing.reports.files import Format, Policy
from airswing.reports.staging_store import Spool


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
        A registered format; "auto" tells it from each file's content.
    columns : mapping, optional
        For tables, in one of the forms of :mod:`airswing.reports.canonical.columns`: their name to
        a canonical name (``wind_speed_kt``), or to ``{"name": "wind_speed_kt", "unit": "m/s"}``
        where the unit is another; several names, constants, times made of two columns.
    on_bad_file : {"skip", "fail"}, default "skip"
        Whether a file that cannot be read is left out and counted, or refused.
    interval : float, default 0
        Reports are brought to one in so many seconds, means over straight flight; 0 leaves them.

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
    spool = Spool()
    spool.fill(files, format=format, columns=columns, on_bad_file=on_bad_file)
    tails = list(spool.counts())
    block = assembled(*spool.columns(tails[0], tails[-1]), spool.audit, interval=interval)
    spool.audit.similar_tails = similar(tails)
    (reports,) = completed([block])
    return reports.assign_attrs(reading_audit=spool.audit.as_json(), featureType="trajectory")
