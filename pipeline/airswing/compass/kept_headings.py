"""Headings of an earlier run taken up, piece by piece, where nothing they follow from changed.

A piece is the reports of one aircraft's flights that begin in one calendar month (UTC), or on one
day where all of its flights are of one month: a month under way grows day by day. It is known by a
hash of all that its headings follow from: every column of its reports and of its model winds,
where its flights begin, its aircraft's name and resolutions, the code. The headings are taken from
the earlier run's product itself, so that nothing is kept twice; a small record says which of its
rows are which piece. A piece derived alone and one derived within a whole archive are the same to
the last bit, so that a product does not tell which pieces were taken up.

Assumptions
-----------
* Headings of different flights do not depend on each other, but for one thing: whether an
  aircraft's own headings and airspeeds are believed is judged over all its reports
  (:mod:`airswing.compass.ground_vector`). An aircraft that tells any is one piece, however long.
* The product holds what was derived but for the rounding of
  :func:`airswing.products.netcdf.as_stored`, which changes nothing when it is done again.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.headings import DERIVED, derive_columns, with_columns
from airswing.compass.reported_motion import Account, sum_of_accounts
from airswing.products.atomic import replacing
from airswing.products.checked import note, noted
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.ragged import aircraft_of_report
from airswing.vocabulary import VARIABLES

_LOG = logging.getLogger("airswing.compass")
# Columns whose numbers depend on other aircraft; what they say of a piece is hashed by itself.
_OF_THE_FLEET = {"flight", "row_size", "aircraft"}


class Pieces(NamedTuple):
    """Consecutive pieces of a ragged Dataset, all its reports."""

    start: NDArray[np.int64]  # first report of each, (piece,)
    stop: NDArray[np.int64]  # one past its last
    aircraft: NDArray[np.int64]  # row of its aircraft

    def rows(self, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Reports of some of the pieces, in order."""
        return np.flatnonzero(np.repeat(chosen, self.stop - self.start))

    def apart(self, ds: xr.Dataset, chosen: NDArray[np.bool_]) -> xr.Dataset:
        """Some of the pieces as a ragged Dataset, each an aircraft of its own."""
        rows = slice(None) if chosen.all() else self.rows(chosen)
        found = ds.isel({"report": rows, "aircraft": self.aircraft[chosen]}, missing_dims="ignore")
        if "row_size" in ds:
            found["row_size"] = ("aircraft", (self.stop - self.start)[chosen])
        return found


class Record(NamedTuple):
    """Which piece lies where in a product."""

    product: str  # its ``uuid``
    marks: list[str]  # in the order of the product
    sizes: list[int]  # reports of each piece
    evidence: list[Account]  # ``ground_vector_evidence`` of each piece

    @classmethod
    def read(cls, path: Path) -> Record | None:
        """The record of an earlier run; None where there is none that is whole."""
        try:
            return cls(**noted(path.read_text()))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError) as error:
            # torn, or of another version: what is kept saves time and is never needed
            _LOG.warning("%s: a note of kept headings is not whole, they are made again", path)
            _LOG.debug("%s", error)
            return None

    def write(self, path: Path) -> None:
        """Write the record, whole or not at all."""
        with replacing(path, lasting=False) as temporary:
            temporary.write_text(note(self._asdict()))


def cut(reports: xr.Dataset) -> Pieces:
    """Cut canonical reports into pieces; those of an aircraft depend on its own reports alone."""
    aircraft, flight = aircraft_of_report(reports), reports["flight"].to_numpy()
    other = (np.diff(flight) != 0) | (np.diff(aircraft) != 0)
    begins = np.flatnonzero(np.r_[True, other][: flight.size])
    owner = aircraft[begins]
    day = reports["time"].to_numpy()[begins].astype("M8[D]")
    month, span = day.astype("M8[M]").astype(np.int64), day.astype(np.int64)
    edges = np.flatnonzero(np.r_[True, np.diff(owner) != 0][: begins.size])
    last = np.append(edges[1:], begins.size)[: edges.size] - 1
    several = np.repeat(month[edges] != month[last], last + 1 - edges)
    span[several] = month[several]
    # One span for all: such an aircraft is one piece.
    span[_judged_as_one(reports, aircraft)[owner]] = 0
    first = np.r_[True, (np.diff(span) != 0) | (np.diff(owner) != 0)][: begins.size]
    start = begins[first]
    return Pieces(start, np.append(start[1:], flight.size)[: start.size], owner[first])


def _judged_as_one(reports: xr.Dataset, aircraft: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Aircraft that tell a heading and an airspeed of their own in any report."""
    names = ("reported_airspeed", "reported_heading")
    told = np.zeros(aircraft.size, dtype=bool)
    if all(name in reports for name in names):
        told = np.isfinite(reports[names[0]].to_numpy() + reports[names[1]].to_numpy())
    return np.bincount(aircraft[told], minlength=reports.sizes["aircraft"]) > 0


def _marks_of(reports: xr.Dataset, winds: xr.Dataset, pieces: Pieces) -> list[str]:
    """Hash of all that the headings of each piece follow from."""
    of_report, of_aircraft = _hashed_columns(reports, winds)
    tails = reports["aircraft"].to_numpy()
    common = fingerprint(
        [(name, str(values.dtype)) for name, values in [*of_report, *of_aircraft]],
        [str(name) for name in winds["reference"].to_numpy()],
        code_digest("airswing.compass.kept_headings", "airswing.products.netcdf"),
    )
    found = []
    for start, stop, row in zip(*pieces, strict=True):
        digest = hashlib.blake2b(f"{common}\0{tails[row]}\0{stop - start}\0".encode())
        for _, values in of_aircraft:
            # Names and types are in `common`: what follows is octets of a known order.
            digest.update(values[row : row + 1].data)
        for _, values in of_report:
            digest.update(values[start:stop].data)
        # 128 bits: no two of any number of reports share them
        found.append(digest.hexdigest()[:32])
    return found


def _hashed_columns(
    reports: xr.Dataset, winds: xr.Dataset
) -> tuple[list[tuple[str, NDArray[np.generic]]], list[tuple[str, NDArray[np.generic]]]]:
    """Name and values of every column, those of reports and those of aircraft."""
    flight = reports["flight"].to_numpy()
    begins = np.r_[True, np.diff(flight) != 0][: flight.size]
    # The first report of an aircraft begins a flight, whatever number the one before it ended on.
    size = reports["row_size"].to_numpy()
    begins[(np.cumsum(size) - size)[size > 0]] = True
    of_report, of_aircraft = [("flight begins", _plain(begins))], []
    for ds in (reports, winds):
        for name in sorted({str(name) for name in ds.variables} - _OF_THE_FLEET):
            if "aircraft" in ds[name].dims:
                of_aircraft.append((name, _plain(ds[name].to_numpy())))
            elif "report" in ds[name].dims:
                rows = ds[name].transpose(..., "report").to_numpy()
                of_report += [(name, _plain(row)) for row in np.atleast_2d(rows)]
    return of_report, of_aircraft


def _plain(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Values whose octets can be looked at: times have none of their own."""
    values = np.ascontiguousarray(values)
    return values.view(np.int64) if values.dtype.kind in "mM" else values


class KeptHeadings:
    """Derives headings block by block and takes up those of an earlier run that still hold.

    Parameters
    ----------
    product : Dataset, optional
        Of the earlier run, opened lazily.
    record : Record, optional
        Of it; one that is of another product counts for nothing.

    Attributes
    ----------
    taken_up : int
        Reports whose headings were taken up so far.
    """

    def __init__(self, product: xr.Dataset | None = None, record: Record | None = None) -> None:
        self._product, self.taken_up = product, 0
        self._known: dict[str, tuple[int, int, Account]] = {}
        self._marks: list[str] = []
        self._sizes: list[int] = []
        self._evidence: list[Account] = []
        if product is not None and record is not None and record.product == product.attrs["uuid"]:
            stop = np.cumsum(record.sizes).tolist()
            for mark, size, end, told in zip(
                record.marks, record.sizes, stop, record.evidence, strict=True
            ):
                self._known[mark] = (end - size, end, told)

    def derive(self, reports: xr.Dataset, winds: xr.Dataset) -> xr.Dataset:
        """Headings of the next block, as :func:`airswing.compass.headings.derive_headings` gives.

        As they are once written, and without ``ground_vector_evidence``.
        """
        pieces = cut(reports)
        marks = _marks_of(reports, winds, pieces)
        taken = self._taken(marks)
        known = np.array([mark in self._known for mark in marks], dtype=bool)
        derived: dict[str, xr.DataArray] = {}
        told: list[Account] = []
        if not known.all():
            derived, told = derive_columns(
                pieces.apart(reports, ~known), pieces.apart(winds, ~known)
            )
        new, old = iter(told), (self._known[mark][2] for mark in marks if mark in self._known)
        self._evidence += [next(old) if kept else next(new) for kept in known]
        self._marks += marks
        self._sizes += (pieces.stop - pieces.start).tolist()
        rows = pieces.rows(known)
        self.taken_up += rows.size
        columns = {
            name: _merged(name, derived.get(name), taken.get(name), rows, reports.sizes["report"])
            for name in DERIVED
        }
        return with_columns(reports, winds, columns)

    @property
    def evidence(self) -> Account:
        """``ground_vector_evidence`` of all blocks so far."""
        return sum_of_accounts(self._evidence)

    def record(self, product: str) -> Record:
        """Which piece lies where, once all blocks are written under a ``uuid``."""
        return Record(product, self._marks, self._sizes, self._evidence)

    def _taken(self, marks: Sequence[str]) -> dict[str, NDArray[np.generic]]:
        """Headings of the pieces that are known, piece after piece; none where unreadable."""
        places = [self._known[mark][:2] for mark in marks if mark in self._known]
        if not places or self._product is None:
            return {}
        first, last = min(place[0] for place in places), max(place[1] for place in places)
        rows = np.concatenate([np.arange(*place) for place in places]) - first
        part = self._product.isel(report=slice(first, last))
        try:
            return {
                name: part[name].transpose(..., "report").to_numpy()[..., rows] for name in DERIVED
            }
        except (OSError, RuntimeError) as error:
            _LOG.warning("kept headings cannot be read (%s), they are made again", error)
            self._known.clear()
            return {}


def _merged(
    name: str,
    new: xr.DataArray | None,
    old: NDArray[np.generic] | None,
    rows: NDArray[np.int64],
    size: int,
) -> tuple[tuple[str, ...], NDArray[np.generic]]:
    """One column of a block, from what was derived and what stands at the rows taken up."""
    dims = VARIABLES[name].dims
    if new is not None:
        fresh = new.transpose(*dims).to_numpy()
        if old is None:
            return dims, fresh
        values = np.empty((*fresh.shape[:-1], size), dtype=fresh.dtype)
        chosen = np.ones(size, dtype=bool)
        chosen[rows] = False
        values[..., chosen] = fresh
        values[..., rows] = old
        return dims, values
    if old is None:
        raise ValueError(f"{name}: neither derived nor kept")
    return dims, old
