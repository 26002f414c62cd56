"""Files that are no reports: what they are, and what to do with them."""

from __future__ import annotations

import re
from pathlib import Path

from airswing.errors import InputError
from airswing.reports.formats import is_text

_UNPACK = "Unpack it first and name the files in it"
_BINARY = (
    (b"\xfd7zXZ\x00", "is compressed with xz", _UNPACK),
    (b"\x28\xb5\x2f\xfd", "is compressed with zstd", _UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "is a 7z archive", _UNPACK),
    (b"%PDF", "is a PDF document", "Save its table as CSV"),
    (b"SQLite format 3", "is a SQLite database", "Export its table as CSV or Parquet"),
    (b"\xd0\xcf\x11\xe0", "is an Excel workbook", "Save the sheet as CSV"),
    (b"ARROW1", "is an Arrow (Feather) file", "Save the table as Parquet"),
)
_TABLE = "Save the reports as a CSV or Parquet table, or as one of the formats that are read"


def refusal_of(start: bytes, path: Path) -> InputError | None:
    """Return the error for a file of a known kind that holds no reports, or None.

    Parameters
    ----------
    start : bytes
        The first bytes of the file after decompression.
    path : Path
        Named in the error.
    """
    what = remedy = None
    if start[:4] == b"PK\x03\x04":
        workbook = b"[Content_Types].xml" in start or b"xl/" in start
        what = "is an Excel workbook" if workbook else "is a zip archive"
        remedy = "Save the sheet as CSV" if workbook else _UNPACK
    elif start[257:262] == b"ustar":
        what, remedy = "is a tar archive", _UNPACK
    elif start[:1] == b"\x80" and start[1:2] in b"\x02\x03\x04\x05" and len(start) > 2:
        what, remedy = "is a Python pickle, which is not opened because it may run code", _TABLE
    elif is_text(start):
        what, remedy = _text(start)
    elif b"GRIB" in start[:4096]:
        what, remedy = "is a GRIB file, not reports", "Name it under references"
    else:
        what, remedy = next(
            ((what, remedy) for mark, what, remedy in _BINARY if start.startswith(mark)),
            (None, None),
        )
    return None if what is None else InputError(what, file=path, remedy=remedy)


def _text(start: bytes) -> tuple[str | None, str | None]:
    head = start.removeprefix(b"\xef\xbb\xbf").lstrip()
    lower = head[:200].lower()
    if lower.startswith((b"<!doctype html", b"<html")):
        return (
            "is a page of HTML, not reports: the download failed or needs a login",
            "Download it again and look at it in a browser",
        )
    if lower.startswith(b"version https://git-lfs"):
        return (
            "is a Git LFS pointer: the file itself has not been downloaded",
            "Run git lfs pull in its folder",
        )
    if lower.startswith(b"<?xml") or lower.startswith(b"<"):
        return "is an XML file", _TABLE
    first = head.split(b"\n", 1)[0]
    if icartt := re.fullmatch(rb"\s*(\d+)\s*,\s*1001\s*(,.*)?\s*", first):
        return (
            f"is an ICARTT file (file format index 1001) with a header of {int(icartt[1])} lines",
            "Save its table as CSV: the last header line holds the names; map them under "
            "reports.columns and give the time as date and time",
        )
    if re.match(rb"[\[{]", head) and not _JSON_OF_REPORTS.search(start):
        return (
            "is JSON of no known layout",
            "Known are traces of readsb and tables of Mode-S messages of traffic, rs1090 and "
            "jet1090; save other reports as a CSV or Parquet table",
        )
    return None, None


# Keys by which the JSON formats are recognised: readsb's, and those of Mode-S messages.
_JSON_OF_REPORTS = re.compile(rb'"icao"|"icao24"')
