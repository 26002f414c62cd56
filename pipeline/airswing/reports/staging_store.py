"""Canonical reports set down by aircraft as they are read, so that no process holds them all.

Files come in order of time and the fit wants aircraft; the turn is made out of core. Cleaned rows
are gathered until there are `SEGMENT_REPORTS` of them, sorted by tail and set down as one segment;
the reports of some aircraft are then one stretch of every segment. Without a folder the segments
stay in memory. With one, a manifest stands for the files whose segments are complete: it is written
after them, under another name, and renamed, and a later filling takes up every manifest whose files
are still the same, so that only new files are read.

Assumptions
-----------
* Each file counts whole or not at all.
* What becomes of the reports depends neither on their order nor on which files were read together
  (:mod:`airswing.reports.assembly`); the tally is kept file by file and added up in order of name.
* A file that keeps its size and its modification time keeps its content.
"""

from __future__ import annotations

import hashlib
import logging
import uuid
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.products.atomic import replacing
from airswing.products.checked import SEAL, digest, note, noted
from airswing.products.ragged import aircraft_groups
from airswing.reports.assembly import in_alphabetical_order
from airswing.reports.canonical.audit import Audit
from airswing.reports.canonical.cleaning import FLAGS
from airswing.reports.canonical.columns import ColumnMapping, parse_mapping
from airswing.reports.derive import Columns
from airswing.reports.files import (
    Format,
    Policy,
    expand,
    file_frames,
    none_read,
    none_usable,
    require_format,
)

SEGMENT_REPORTS = 250_000
"""Reports gathered before they are set down."""
_NUMBERS = (
    "pressure",
    "pressure_altitude",
    "wind_speed",
    "wind_direction",
    "eastward_wind",
    "northward_wind",
    "air_temperature",
    "reported_airspeed",
    "reported_heading",
)
ROW = np.dtype(
    [("tail", "i4"), ("flight", "i4"), ("time", "M8[ns]"), ("latitude", "f8"), ("longitude", "f8")]
    + [(name, "f4") for name in _NUMBERS]
    + [(name, "i1") for name in FLAGS]
)
"""One report as it is set down."""

_BLOCK = 1 << 22  # Octets of a segment hashed at a time
Identity = tuple[str, int, int]
_LOG = logging.getLogger("airswing.reports")


class Segment(NamedTuple):
    """Some reports sorted by tail: rows, and what their numbers stand for."""

    rows: NDArray[np.void] | Path  # of `ROW`
    tails: list[str]  # in alphabetical order, as the flights' labels
    flights: list[str]
    stop: list[int]  # one past the last row of each tail
    hours: list[tuple[int, int]]  # hours since 1970 and how many reports fall in each
    checksum: str = ""  # of rows in a file

    def take(self, first: str, last: str) -> tuple[NDArray[np.void], list[str]]:
        """Rows of the tails from one to another, both included, and those tails."""
        names = np.array(self.tails, dtype=object)
        begin, end = np.searchsorted(names, first), np.searchsorted(names, last, side="right")
        bounds = np.concatenate([[0], self.stop])
        start, count = int(bounds[begin]), int(bounds[end] - bounds[begin])
        if not isinstance(self.rows, Path):
            rows = self.rows[start : start + count].copy()
        elif count:
            rows = np.fromfile(self.rows, ROW, count, offset=start * ROW.itemsize)
        else:
            rows = np.empty(0, ROW)
        # Numbers count from the first tail taken.
        rows["tail"] -= np.int32(begin)
        return rows, self.tails[begin:end]


class Spool:
    """Reports set down by aircraft.

    Parameters
    ----------
    folder : Path, optional
        Where segments lie; in memory when not given.
    key : str, optional
        Stands for everything but the files that the rows depend on (options, code); segments made
        under another key are removed.
    """

    def __init__(self, folder: Path | None = None, *, key: str = "") -> None:
        self.folder, self.key = folder, key
        self.audit = Audit()
        self.segments: list[Segment] = []
        self.files: dict[Identity, Audit | str] = {}
        self.octets_read = 0

    def fill(
        self,
        files: str | Path | Sequence[str | Path],
        *,
        format: Format = "auto",
        columns: ColumnMapping | None = None,
        on_bad_file: Policy = "skip",
    ) -> None:
        """Read files and set their reports down; those set down before are not read again.

        Arguments and errors as of :func:`airswing.reports.read.read_reports`.
        """
        require_format(format)
        mapping = parse_mapping(columns)
        # once, before anything is read: a file that grows meanwhile is another one to the next run
        wanted = {path: _identity(path) for path in expand(files)}
        self._take_up(set(wanted.values()))
        # small files share a segment: thousands of files of a few reports would be thousands of
        # segments
        writer, errors = _Batch(self), []
        for path, identity in wanted.items():
            if identity in self.files:
                continue
            own = Audit()
            try:
                for frame in file_frames(path, format, mapping, own):
                    writer.add(frame)
            except InputError as error:
                writer.drop(identity, error)
                if on_bad_file == "fail":
                    raise
                errors.append(error)
                continue
            self.octets_read += identity[1]
            writer.keep(identity, own)
        writer.commit()
        # after the commit: what was read stays kept, whatever is told now
        if len(errors) == len(wanted):
            raise none_read(errors)
        self._tally(wanted)
        if not self.audit.kept:
            raise none_usable(self.audit)

    def _tally(self, wanted: dict[Path, Identity]) -> None:
        for path, identity in wanted.items():
            own = self.files[identity]
            if isinstance(own, str):
                self.audit.files_skipped.append({"file": str(path), "reason": own})
            else:
                self.audit.add(own)

    def counts(self) -> dict[str, int]:
        """Reports of each tail, tails in alphabetical order."""
        total: Counter[str] = Counter()
        for one in self.segments:
            total.update(dict(zip(one.tails, np.diff(one.stop, prepend=0).tolist(), strict=True)))
        return dict(sorted(total.items()))

    def hours(self) -> dict[int, int]:
        """Reports in each hour since 1970, duplicates included."""
        total: Counter[int] = Counter()
        for one in self.segments:
            total.update(dict(one.hours))
        return dict(sorted(total.items()))

    def groups(self, limit: int) -> list[tuple[str, str]]:
        """First and last of consecutive tails with at most so many reports, or of one tail."""
        counts = self.counts()
        tails, sizes = list(counts), np.fromiter(counts.values(), np.int64, len(counts))
        groups = aircraft_groups(sizes, limit)
        return [(tails[group.start], tails[group.stop - 1]) for group in groups]

    def columns(self, first: str, last: str) -> tuple[Columns, NDArray[np.object_]]:
        """Canonical columns of the tails from one to another, both included, and those tails."""
        parts = [(one, *one.take(first, last)) for one in self.segments]
        parts = [part for part in parts if part[1].size]
        rows = np.concatenate([part[1] for part in parts])
        known = sorted({tail for part in parts for tail in part[2]})
        place = {tail: k for k, tail in enumerate(known)}
        start, labels = 0, _Labels()
        for one, own, tails in parts:
            run = slice(start, start + own.size)
            # segments number their own tails and labels: both are brought to common numbers
            rows["tail"][run] = np.array([place[tail] for tail in tails])[own["tail"]]
            rows["flight"][run] = labels.numbers(one.flights, own["flight"])
            start += own.size
        names, flight = in_alphabetical_order(list(labels.known), rows["flight"])
        columns = {str(name): np.ascontiguousarray(rows[name]) for name in ROW.names or ()}
        unlabelled = np.flatnonzero(names == "")
        # A blank label is none.
        columns["flight"] = np.where(np.isin(flight, unlabelled), -1, flight).astype(np.int32)
        return columns, np.array(known, dtype=object)

    def _take_up(self, wanted: set[Identity]) -> None:
        """Take up what earlier fillings set down and still holds; remove the rest."""
        if self.folder is None or not self.folder.is_dir():
            return
        held: set[Path] = set()
        for path in sorted(self.folder.glob("*.json")):
            try:
                content = noted(path.read_text())
            except (OSError, ValueError):
                _LOG.warning("%s: a note of kept reports is not whole, they are read again", path)
                continue
            own = {
                tuple(entry["file"]): entry["skipped"] or Audit.from_dict(entry["audit"])
                for entry in content["files"]
            }
            segments = [
                Segment(self.folder / entry["rows"], *(entry[name] for name in Segment._fields[1:]))
                for entry in content["segments"]
            ]
            # Taken up whole or not at all: one file that changed makes all of its note
            # be read again.
            holds = content["key"] == self.key and own.keys() <= wanted - self.files.keys()
            if not holds:
                continue
            if not all(_complete(one) for one in segments):
                _LOG.warning("%s: kept reports are not whole, they are read again", path)
                continue
            self.files |= own
            self.segments += segments
            held |= {path, *(Path(str(one.rows)) for one in segments)}
        for path in self.folder.iterdir():
            # segments of a run that was killed before its note have no note: they go, too
            if path not in held:
                path.unlink()


class _Labels:
    """Numbers labels as they are met."""

    def __init__(self) -> None:
        self.known: dict[str, int] = {}

    def numbers(self, labels: Sequence[str], codes: NDArray[np.integer]) -> NDArray[np.int32]:
        """Own numbers for codes of another list of labels."""
        # of thousands of labels a block uses a few
        used, index = np.unique(codes, return_inverse=True)
        found = [self.known.setdefault(labels[code], len(self.known)) for code in used]
        return np.array(found, dtype=np.int32)[index]


class _Batch:
    """Files whose segments are committed together."""

    def __init__(self, spool: Spool) -> None:
        self.spool = spool
        self._begin()

    def _begin(self) -> None:
        self.files: dict[Identity, Audit | str] = {}
        self.segments: list[Segment] = []
        self.whole: list[pd.DataFrame] = []
        self._begin_file()

    def _begin_file(self) -> None:
        self.current: list[pd.DataFrame] = []
        self.of_current: list[Segment] = []

    def add(self, frame: pd.DataFrame) -> None:
        """Take up a piece of the file under way."""
        self.current.append(frame)
        if _size(self.current) >= SEGMENT_REPORTS:
            self.of_current.append(self._set_down(self.current))
            self.current = []

    def drop(self, identity: Identity, error: InputError) -> None:
        """Forget the file under way: it cannot be read."""
        for one in self.of_current:
            # pieces of it that were full are on disk already
            if isinstance(one.rows, Path):
                one.rows.unlink()
        self._begin_file()
        self.files[identity] = str(error)

    def keep(self, identity: Identity, audit: Audit) -> None:
        """Count the file under way: it was read to its end."""
        self.segments += self.of_current
        self.whole += self.current
        self._begin_file()
        self.files[identity] = audit
        # A large file's segments are on disk already: their note is written before the
        # next begins.
        if self.segments or _size(self.whole) >= SEGMENT_REPORTS:
            self.commit()

    def commit(self) -> None:
        """Set down what is left and write the manifest."""
        if _size(self.whole):
            self.segments.append(self._set_down(self.whole))
        spool = self.spool
        # files that cannot be read alone are no reason for a note: they are tried again
        if spool.folder is not None and any(isinstance(one, Audit) for one in self.files.values()):
            self._write_manifest(spool.folder)
        spool.files |= self.files
        spool.segments += self.segments
        self._begin()

    def _write_manifest(self, folder: Path) -> None:
        content = {
            "key": self.spool.key,
            "files": [
                {
                    "file": identity,
                    "skipped": own if isinstance(own, str) else "",
                    "audit": own.as_dict() if isinstance(own, Audit) else {},
                }
                for identity, own in self.files.items()
            ],
            "segments": [
                one._asdict() | {"rows": Path(str(one.rows)).name} for one in self.segments
            ],
        }
        # after its rows: a note stands for segments that are whole
        _write(folder / f"{uuid.uuid4().hex}.json", note(content).encode())

    def _set_down(self, frames: list[pd.DataFrame]) -> Segment:
        """Sort some frames by tail and write them as one segment."""
        rows = np.empty(_size(frames), ROW)
        labels = {"tail": _Labels(), "flight": _Labels()}
        start = 0
        for frame in frames:
            run = slice(start, start + len(frame))
            for name in ROW.names or ():
                if name in labels:
                    column = frame[name].cat
                    names = [str(label) for label in column.categories]
                    rows[name][run] = labels[name].numbers(names, column.codes.to_numpy())
                else:
                    rows[name][run] = frame[name].to_numpy()
            start += len(frame)
        tails, rows["tail"] = in_alphabetical_order(list(labels["tail"].known), rows["tail"])
        flights, rows["flight"] = in_alphabetical_order(
            list(labels["flight"].known), rows["flight"]
        )
        # stable: reports of an aircraft stay in the order in which they were read
        rows = rows[np.argsort(rows["tail"], kind="stable")]
        stop = np.cumsum(np.bincount(rows["tail"], minlength=tails.size))
        kept: NDArray[np.void] | Path = rows
        if self.spool.folder is not None:
            kept = self.spool.folder / f"{uuid.uuid4().hex}.rows"
            _write(kept, rows.tobytes())
        checksum = "" if kept is rows else digest(rows.tobytes()).hex()
        return Segment(
            kept, tails.tolist(), flights.tolist(), stop.tolist(), _hours(rows), checksum
        )


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise InputError(
            "cannot keep reports that were read; those kept before are whole",
            file=path.parent,
            found=error.strerror or error,
            remedy="Free space or choose another folder with --output, then --resume",
        ) from error


def _hours(rows: NDArray[np.void]) -> list[tuple[int, int]]:
    """Hours since 1970 and how many reports fall in each."""
    known, number = np.unique(rows["time"].astype("M8[h]").astype(np.int64), return_counts=True)
    return list(zip(known.tolist(), number.tolist(), strict=True))


def _complete(one: Segment) -> bool:
    """Whether a segment's rows are all there, as they were written."""
    rows = Path(str(one.rows))
    # the size first: it costs nothing, and tells most of what is cut off
    if not rows.is_file() or rows.stat().st_size != one.stop[-1] * ROW.itemsize:
        return False
    found = hashlib.blake2b(digest_size=SEAL)
    with rows.open("rb") as file:
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest() == one.checksum


def _size(frames: list[pd.DataFrame]) -> int:
    return sum(len(frame) for frame in frames)


def _identity(path: Path) -> Identity:
    # Of a link that leads nowhere its own.
    status = path.stat() if path.exists() else path.lstat()
    return str(path), status.st_size, status.st_mtime_ns
