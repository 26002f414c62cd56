"""Statistics of an archive too large to hold: aircraft after aircraft, in two passes.

Assumptions: a piece is all reports of one aircraft. What a design column takes from the fleet (the
large-scale wind of a day) is summed over all pieces first; what only sets a scale (knots, means,
the noise model, the hour at which days start) is taken from a sample of the fleet spread over the
archive. Whatever else a frame takes from all of its reports (bank and acceleration of an ordinary
turn or climb), a piece takes from its own aircraft.

Validity: with a sample of everything the sums are those of the archive in one frame, and they are
the same bit for bit whatever the number of workers. Memory: the sums, and one piece per worker.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.gap.archive.frame import REPORT_FIELDS, Frame
from airswing.gap.archive.headings_columns import middle_longitude
from airswing.gap.design.basis import DictionaryPlan, plan_dictionary
from airswing.gap.design.exogenous import LargeScale, centre_of, day_sums, exogenous
from airswing.gap.design.heading_uncertainty import heading_doubt
from airswing.gap.design.layout import make_layout
from airswing.gap.noise.model import NoiseFit, fit_noise, fitted_gains, flown
from airswing.gap.sums.accumulate import Statistics, add_reports, day_of_report, empty_statistics

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Result = TypeVar("Result")

MOST = 200_000
"""Reports of the sample, about."""


@dataclass(frozen=True)
class Pieces:
    """An archive as one frame per aircraft.

    Attributes
    ----------
    count : int
    size : int
        Reports, about.
    frame : callable
        (number of the piece, first, last share of its time) -> Frame or None where it has no
        report. All frames have the same tails, epoch and reference field.
    """

    count: int
    size: int
    frame: Callable[[int, float, float], Frame | None]


def pieces_of_headings(ds: xr.Dataset, *, reference: str | Sequence[str], **options: Any) -> Pieces:
    """Cut a headings Dataset into its aircraft; a lazy one is read piece by piece.

    Parameters
    ----------
    ds : xarray.Dataset
        As `Frame.from_headings` takes it.
    reference : str or sequence of str
    **options
        Further arguments of `Frame.from_headings`.

    Returns
    -------
    Pieces
    """
    counts = np.asarray(ds["row_size"].values, dtype=np.int64)
    starts = np.r_[0, np.cumsum(counts)]
    flown = ds["time"].isel(report=starts[:-1][counts > 0]).values  # in order of time in each
    options = {
        "epoch": float(flown.min().astype("datetime64[ns]").astype(np.int64)) / 1e9
    } | options
    every = slice(None, None, max(1, int(starts[-1]) // MOST))
    if "meridian" not in options:
        options["meridian"] = middle_longitude(ds["longitude"][every].values.astype(float))
    if "horizontal_field" in ds and "reference_field" not in options:
        options["reference_field"] = float(np.nanmedian(ds["horizontal_field"][every].values))

    def frame(number: int, first: float, last: float) -> Frame | None:
        own = starts[number] + np.round(counts[number] * np.array([first, last])).astype(np.int64)
        part = ds.isel(report=slice(int(own[0]), int(own[1])))
        rows = np.where(np.arange(counts.size) == number, own[1] - own[0], 0)
        part = part.assign(row_size=(ds["row_size"].dims, rows))
        try:
            made = Frame.from_headings(part, reference=reference, **options)
        except InputError as error:
            if error.field == "reports":
                return None  # no report of this aircraft is usable
            raise
        return replace(made, report=made.report + own[0])

    return Pieces(counts.size, int(starts[-1]), frame)


@dataclass(frozen=True)
class Prepared:
    """What a pass over the pieces needs to know of the whole archive.

    Attributes
    ----------
    sample : Frame
        As reported.
    winds : LargeScale
    noise : NoiseFit
        Of the sample.
    plan : DictionaryPlan
    days : (D,) int
        All days with reports.
    day_shift : float
        Hour UTC at which they start.
    """

    sample: Frame
    winds: LargeScale
    noise: NoiseFit
    plan: DictionaryPlan
    days: Integers
    day_shift: float


def prepare(pieces: Pieces, *, workers: int = 1, most: int = MOST, seed: int = 0) -> Prepared:
    """First pass: the day's winds from all reports, everything else from a sample.

    Parameters
    ----------
    pieces : Pieces
    workers : int
        Threads.
    most : int
        Reports of the sample, about.
    seed : int
        Of the noise fit's draw.

    Returns
    -------
    Prepared

    Raises
    ------
    InputError
        No report is usable.
    """
    share = min(1.0, most / max(pieces.size, 1))
    sample = _joined(_in_turn(pieces, lambda frame: frame, workers=workers, share=share))
    _, shift = day_of_report(sample)
    centre = centre_of(sample)
    days: set[int] = set()

    def sums(frame: Frame) -> tuple[Integers, tuple[Integers, Floats]]:
        return np.unique(day_of_report(frame, shift=shift)[0]), day_sums(frame, centre)

    parts = []
    for own, part in _in_turn(pieces, sums, workers=workers):
        days.update(own.tolist())
        parts.append(part)
    winds = LargeScale.solved(parts, float(sample.epoch), centre)
    columns = exogenous(sample, winds)
    noise = fit_noise(sample.residual, flown(columns, heading_doubt(sample, columns)), seed=seed)
    return Prepared(sample, winds, noise, plan_dictionary(columns), np.array(sorted(days)), shift)


def statistics_of_pieces(
    pieces: Pieces,
    ready: Prepared,
    *,
    effects: Mapping[str, Any],
    workers: int = 1,
    clip: float = 5.0,
    progress: Callable[[float], None] | None = None,
) -> Statistics:
    """Second pass: whiten and sum every piece.

    Parameters
    ----------
    pieces : Pieces
    ready : Prepared
        From :func:`prepare`.
    effects : mapping
        Name -> effect.
    workers : int
        Threads, each with a piece of its own.
    clip : float
        As in `airswing.gap.sums.accumulate.accumulate`.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    Statistics
    """
    layout = make_layout(effects, ready.plan, ready.sample)
    out = empty_statistics(layout, ready.sample.tails, ready.days, ready.day_shift)

    def add(frame: Frame) -> int:
        columns = exogenous(frame, ready.winds)
        noise = fitted_gains(
            ready.noise, frame.residual, flown(columns, heading_doubt(frame, columns))
        )
        add_reports(
            out, columns, frame.residual, noise=noise, effects=effects, plan=ready.plan, clip=clip
        )
        return frame.size

    done = 0
    for size in _in_turn(pieces, add, workers=workers):
        done += size
        if progress is not None:
            progress(done / pieces.size)
    return out


def _in_turn(
    pieces: Pieces, work: Callable[[Frame], Result], *, workers: int, share: float = 1.0
) -> Iterator[Result]:
    """Yield what the work makes of every piece, in order, a piece to each thread.

    With a share under 1 each piece gives that part of its time, each another part.
    """

    def one(number: int) -> Result | None:
        first = (1.0 - share) * (number + 0.5) / pieces.count
        frame = pieces.frame(number, first, first + share)
        return None if frame is None else work(frame)

    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        for result in pool.map(one, range(pieces.count)):
            if result is not None:
                yield result


def _joined(frames: Iterator[Frame]) -> Frame:
    """One frame of several of the same archive."""
    parts = list(frames)
    if not parts:
        raise InputError(
            "no report has a wind, a ground vector and a reference wind at once", field="reports",
            remedy="check that reports and references overlap in time, space and level",
        )  # fmt: skip
    fields: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in REPORT_FIELDS
    }
    return replace(parts[0], **fields)
