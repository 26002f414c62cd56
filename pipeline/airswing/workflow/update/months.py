"""The archive cut into months: which of them hold something new, and their headings.

A month (UTC) has the flights whose first report lies in it, whole: it is made from the reports of
the month and `MARGIN` around it, with the stages of :mod:`airswing.workflow` as they are. Beside
each stands a note of what it was made from: parts of the set-down reports (by checksum), what their
reports hold once they are in order, model files (name, size, time), settings and code. Nothing of a
month whose note still holds is read.

Assumptions
-----------
* No flight lasts longer than `MARGIN`: what is longer is cut there.
* Where an aircraft's own headings and airspeeds are believed, and how finely its reports are
  coded, is judged month by month.
* A model file that went away takes no wind away: a month is made anew for files that are new.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airswing.products.atomic import replacing
from airswing.products.checked import note, noted
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.workflow.collocating import Sources, catalogues, written_to
from airswing.workflow.headings_stage import make_headings
from airswing.workflow.job import COLLOCATING, HEADINGS, Job, earlier
from airswing.workflow.update.model_spans import Spans

if TYPE_CHECKING:
    from airswing.reference.geometry.wind_profiles import Catalogue
    from airswing.reports.report_blocks import Archive
    from airswing.reports.staging_store import Spool
    from airswing.reports.time_window import Between

MARGIN = np.timedelta64(48, "h")
"""Reports around a month that its flights may have."""


def months_of(hours: Iterable[int]) -> list[str]:
    """Months that some hours since 1970 lie in.

    Returns
    -------
    list of str
        As ``2025-07``, in order of time.
    """
    known = np.unique(np.fromiter(hours, dtype=np.int64).astype("M8[h]").astype("M8[M]"))
    return [str(month) for month in known]


def span_of(month: str) -> tuple[np.datetime64, np.datetime64]:
    """Where a month begins and the next one does.

    Returns
    -------
    start, stop : datetime64[ns]
    """
    begin = np.datetime64(month, "M")
    return begin.astype("M8[ns]"), (begin + 1).astype("M8[ns]")


Note = dict[str, Any]
"""What an update keeps as JSON: read back in the shape that its writer gave it."""


def kept_note(path: Path) -> Note:
    """A note of an earlier update.

    Returns
    -------
    dict
        Empty where there is none that is whole.
    """
    try:
        found = noted(path.read_text())
    except (OSError, ValueError):
        # no note, or a torn one: the month is made anew
        return {}
    return found if isinstance(found, dict) else {}


def keep_note(path: Path, content: dict[str, object]) -> None:
    """Write a note, whole or not at all."""
    with written_to(path.parent), replacing(path) as temporary:
        temporary.write_text(note(content))


@dataclass(frozen=True)
class Month:
    """One month of an update."""

    job: Job  # of this month
    spool: Spool  # reports of the whole archive
    spans: Spans  # of the model files

    @property
    def note(self) -> Path:
        """What the month was made from."""
        return self.job.output / ".update" / f"{self.job.month}.json"

    @cached_property
    def before(self) -> Note:
        """The note of the last time; empty where the month is new."""
        return kept_note(self.note) if self.job.place(HEADINGS).exists() else {}

    @cached_property
    def window(self) -> tuple[np.datetime64, np.datetime64]:
        """Times whose reports the month's flights may have."""
        start, stop = span_of(self.job.month)
        return start - MARGIN, stop + MARGIN

    @cached_property
    def reports(self) -> Between:
        """Reports in the window, as they were set down."""
        from airswing.reports.time_window import Between

        return Between(self.spool, *self.window)

    @property
    def parts(self) -> list[str]:
        """Checksums of the parts of the archive with reports in the window."""
        return self.reports.marks

    @cached_property
    def files(self) -> dict[str, list[str]]:
        """Model files of each reference the month's flights need."""
        gap = np.timedelta64(int(self.job.config.collocation.max_time_gap), "s")
        start, stop = span_of(self.job.month)[0] - gap, self.until + gap
        found = {name: self.spans.of(name, start, stop) for name in self.spans.names}
        before: dict[str, list[str]] = self.before.get("files", {})
        return {
            name: before[name]
            if name in before and all(one in before[name] for one in own)
            else own
            for name, own in found.items()
        }

    @cached_property
    def archive(self) -> Archive:
        """Reports of the month's flights, in order."""
        from airswing.reports.report_blocks import Archive

        with self.job.progress.stage(f"reports {self.job.month}") as stage:
            with written_to(self.job.store):
                found = Archive(
                    self.reports,
                    self.job.store / "blocks",
                    interval=self.job.config.reports.interval,
                    begins=span_of(self.job.month),
                )
            stage.note = f"{found.reports:,} reports of {found.aircraft} aircraft"
            stage.reports = found.reports
        return found

    @cached_property
    def same_reports(self) -> bool:
        """Whether the reports are those of the last time, told without reading them."""
        read = self.before.get("settings", {}).get("reading")
        return self.before.get("parts") == self.parts and read == self._settings["reading"]

    @cached_property
    def content(self) -> str:
        """Checksum of the reports of the month's flights; empty without any."""
        if self.same_reports:
            return str(self.before["content"])
        # empty: nobody took off in this month, and its products are taken away
        return self.archive.content if self.archive.reports else ""

    @cached_property
    def until(self) -> np.datetime64:
        """End of the hour of the last report of the month's flights."""
        last = self.before["until"] if self.same_reports else max(self.archive.hours) + 1
        found: np.datetime64 = np.datetime64(int(last), "h").astype("M8[ns]")
        return found

    @cached_property
    def _settings(self) -> dict[str, str]:
        """Hash of every section the month depends on."""
        config = self.job.config
        of = {name: config.model_dump(include={name}) for name in ("references", "collocation")}
        screening = config.model_dump(include={"screening", "field_test"})
        return {
            "reading": self.spool.key + str(config.reports.interval),
            **{name: fingerprint(own) for name, own in of.items()},
            "code": code_digest(*COLLOCATING),
            "screening": fingerprint(screening, code_digest("airswing.compass.screening")),
        }

    @property
    def changed(self) -> list[str]:
        """Sections of settings or code that are not those of the last time."""
        before = self.before.get("settings", {})
        return [name for name, own in self._settings.items() if before and before.get(name) != own]

    @property
    def untouched(self) -> bool:
        """Whether nothing it was made from is other than the last time."""
        return self.same_reports and self.before == self._now()

    @property
    def _whole(self) -> bool:
        """Whether the headings that stand can be read; said where they cannot."""
        found = earlier(self.job, self.job.place(HEADINGS))
        if found is not None:
            found.close()
        return found is not None

    def make(self) -> bool:
        """Make the month's headings where something it is made from is new.

        Returns
        -------
        bool
            Whether it has any; False without flights, or while a reference has no file for it.
        """
        # the cheap question first: whether it can be read is asked of what would stay
        if self.untouched and self._whole:
            return True
        if not self.content:
            return False
        missing = [name for name, own in self.files.items() if not own]
        if missing:
            told = f"{self.job.month}: no model winds of {', '.join(missing)} yet, left for later"
            self.job.progress.say(told)
            return False
        # of what the flights hold, not of the files they came in: a file cut otherwise makes
        # nothing anew
        mark = fingerprint(self.content, self.files)
        make_headings(self.job, Sources(mark, self._opened)).close()
        keep_note(self.note, self._now())
        return True

    def remove(self) -> None:
        """Take the month's products away: its reports are no longer there."""
        for name in ("headings", "gap_inputs", "corrected"):
            (self.job.output / name / f"{self.job.month}.nc").unlink(missing_ok=True)
        self.note.unlink(missing_ok=True)

    def _now(self) -> dict[str, object]:
        return {
            "parts": self.parts,
            "files": self.files,
            "settings": self._settings,
            "content": self.content,
            "until": int(self.until.astype("M8[h]").astype(np.int64)),
        }

    def _opened(self) -> tuple[Archive, dict[str, Catalogue]]:
        only = {name: self.spans.still_there(own) for name, own in self.files.items()}
        names = list(self.job.config.references)
        store = self.job.store
        return self.archive, catalogues(self.job, names, self.archive, store, only=only)
