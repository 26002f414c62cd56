"""Which times each model file holds, known without reading it again.

Assumes a file that keeps its name, size and time of change keeps its content. Files that are new
are catalogued once, by themselves; a note keeps the first and last valid time of each.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from airswing.errors import InputError
from airswing.products.fingerprint import code_digest, file_identities, fingerprint
from airswing.workflow.collocating import catalogues
from airswing.workflow.job import Job

if TYPE_CHECKING:
    from airswing.reference.geometry.wind_profiles import Catalogue

NOTHING = [1, 0]
"""Span of a file without a usable wind."""


class Spans:
    """First and last valid time (ns since 1970) of every model file.

    Parameters
    ----------
    known : dict of str to dict
        Of each reference that is read from files: ``name|size|time`` -> [first, last].
    """

    def __init__(self, known: dict[str, dict[str, list[int]]]) -> None:
        self.known = known

    @property
    def names(self) -> list[str]:
        """References that are read from files."""
        return list(self.known)

    def of(self, name: str, start: np.datetime64, stop: np.datetime64) -> list[str]:
        """Files of a reference with a valid time from one to another.

        Returns
        -------
        list of str
            ``name|size|time`` of each, in order.
        """
        first, last = (int(when.astype("M8[ns]").astype(np.int64)) for when in (start, stop))
        return [
            one
            for one, (begin, end) in sorted(self.known[name].items())
            if begin <= end and begin <= last and end >= first
        ]

    @staticmethod
    def still_there(files: list[str]) -> list[str]:
        """Paths of those that have not gone away."""
        paths = [one.rsplit("|", 2)[0] for one in files]
        return [path for path in paths if Path(path).exists()]


def model_spans(job: Job, before: Mapping[str, object]) -> tuple[Spans, dict[str, object]]:
    """Find out which times every model file holds; only what is new is looked at.

    Parameters
    ----------
    before : dict
        The note of the last time; empty where there is none.

    Returns
    -------
    Spans
    dict
        The note for the next time.
    """
    key = fingerprint(
        job.config.model_dump(include={"references"}), code_digest("airswing.reference.catalogues")
    )
    noted = before.get("spans") if before.get("key") == key else None
    kept = noted if isinstance(noted, Mapping) else {}
    found: dict[str, dict[str, list[int]]] = {}
    for name, asked in job.config.references.items():
        if asked.engine == "fleet":
            continue
        now = {f"{path}|{size}|{when}": path for path, size, when in file_identities(asked.files)}
        own = {one: kept.get(name, {})[one] for one in now if one in kept.get(name, {})}
        new = {one: path for one, path in now.items() if one not in own}
        if new:
            held = _looked_at(job, name, list(new.values()))
            own |= {one: held.get(_plain(path), NOTHING) for one, path in new.items()}
        found[name] = own
    return Spans(found), {"key": key, "spans": found}


def _looked_at(job: Job, name: str, paths: list[str]) -> dict[str, list[int]]:
    """First and last valid time of each of some files that has a usable wind."""
    try:
        model = catalogues(job, [name], only={name: paths})[name]
    except InputError as err:
        if job.config.references[name].on_bad_file == "fail":
            raise
        job.progress.say(f"  {name}: {err}")
        return {}
    return _spans(model)


def _spans(model: Catalogue) -> dict[str, list[int]]:
    time = np.repeat(model.valid, np.diff(model.bounds))
    found: dict[str, list[int]] = {}
    for table in (model.u, model.v):
        for number in np.unique(table["file"]):
            own = time[table["file"] == number]
            path = _plain(str(model.files[number].path))
            low, high = found.get(path, [int(own.min()), int(own.max())])
            found[path] = [min(low, int(own.min())), max(high, int(own.max()))]
    return found


def _plain(path: str) -> str:
    return str(Path(path).expanduser().absolute())
