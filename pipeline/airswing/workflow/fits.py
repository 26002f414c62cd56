"""From headings to corrected winds: fit, table, correct.

Takes ``headings.nc`` and writes ``fits.nc``, the tables and swing cards, and ``corrected.nc``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.flags import published
from airswing.products.atomic import replacing
from airswing.products.checked import note, noted
from airswing.products.fingerprint import code_digest
from airswing.products.ragged import blocks
from airswing.products.ragged_product import still_in_file
from airswing.vocabulary import describe
from airswing.workflow.job import (
    CORRECTED,
    FITS,
    FITTING,
    HEADINGS,
    Blocks,
    Job,
    main_reference,
    product,
    ragged_product,
    ready,
    require_kept,
)

if TYPE_CHECKING:
    from airswing.evaluation.results import Content
    from airswing.workflow.progress import StageRecord


@dataclass(frozen=True)
class Seen:
    """What fits and tables are made of, however the reports were looked at."""

    fits: xr.Dataset  # of :func:`airswing.compass.fit.deviation.fit_deviation`
    # (aircraft, 360): of :func:`airswing.compass.table.heading_histogram`
    histogram: NDArray[np.int64]
    # (aircraft,): of :func:`airswing.compass.heading_kind.mean_declination`
    declination: NDArray[np.float64]
    changes: list[Content]


def _look_at_all(job: Job, headings: xr.Dataset) -> Seen:
    """Fit the reports, and count what else their tables need."""
    from airswing.compass.fit.deviation import fit_deviation
    from airswing.compass.heading_kind import mean_declination
    from airswing.compass.table import heading_histogram
    from airswing.evaluation.monitoring import watch_compasses

    config = job.config
    abscissa = config.fit.abscissa
    return Seen(
        fit_deviation(headings, pools=config.pools(), **config.fit.model_dump()),
        heading_histogram(headings, abscissa=abscissa),
        mean_declination(headings),
        watch_compasses(
            headings, members=config.pools()[main_reference(config)], abscissa=abscissa
        ).changes,
    )


def make_fits(
    job: Job,
    headings: xr.Dataset | None = None,
    look: Callable[[Job, xr.Dataset], Seen] = _look_at_all,
    *,
    near: float = 0.0,
) -> xr.Dataset:
    """Deviation fits and 8-point tables: ``fits.nc``, ``tables.csv`` and the swing cards.

    Parameters
    ----------
    headings : Dataset, optional
        Read from the output folder when not given.
    look : callable, optional
        How the reports are looked at.
    near : float, default 0.0
        As for :func:`draw_cards`.
    """
    from airswing.compass.table import add_tables
    from airswing.evaluation.monitoring import add_changes

    config, screened = job.config, ready(job, headings, HEADINGS)
    require_kept(screened)

    def make() -> xr.Dataset:
        with job.progress.stage("fit") as stage:
            seen = look(job, screened)
            resolution = math.degrees(config.table.resolution)
            fits = add_tables(
                seen.fits, seen.histogram, resolution=resolution, sign=config.table.sign
            )
            fits = describe(fits.assign(mean_declination=("aircraft", seen.declination)))
            fits = add_changes(fits, seen.changes)
            good = int(published(fits["status"]).sum())
            stage.note = f"{good} of {fits['status'].size} fits to be trusted"
            if regions := fits.attrs.get("shared_error_regions"):
                stage.note += f"; the references' error was worked in {regions} regions"
        return fits

    fits = product(
        job,
        FITS,
        make,
        title="Compass deviation per aircraft and 8-point correction tables",
        depends=(
            config.model_dump(include={"fit", "table", "pool"}),
            screened.attrs["uuid"],
            code_digest(*FITTING),
        ),
        sources=(screened,),
    )
    draw_cards(job, fits, near=near)
    return fits


def draw_cards(job: Job, fits: xr.Dataset, *, near: float = 0.0) -> None:
    """Tables as CSV, and the swing cards that are not there yet.

    Parameters
    ----------
    fits : Dataset
        With tables.
    near : float, default 0.0
        Standard errors that the coefficients of a card's curve may have moved since it was drawn,
        its table and status being the same; with 0 a card says all that its fit does.
    """
    from airswing.compass.tables_csv import write_swing_cards, write_tables_csv

    folder, reference = job.output / "swing_cards", main_reference(job.config)
    kept_note = folder / ".drawn_of.json"
    code = code_digest("airswing.compass.tables_csv")
    with job.progress.stage("swing cards") as stage:
        write_tables_csv(fits, job.output / "tables.csv")
        before, now = _noted(kept_note, code), _drawn_from(fits.sel(reference=reference))
        stand = {
            name: str(old["card"])
            for name, old in before.items()
            if name in now
            and _stands(old, now[name], near)
            and (folder / str(old["card"])).is_file()
        }
        written = write_swing_cards(fits, folder, reference=reference, stand=stand)
        names = [name for name, one in now.items() if published(np.array(one["status"]))]
        cards = dict(zip(names, written, strict=True))
        for old in {str(old["card"]) for old in before.values()} - {
            card.name for card in cards.values()
        }:
            (folder / old).unlink(missing_ok=True)  # of aircraft that are gone
        drawn = {
            name: before[name] if stand.get(name) == card.name else now[name] | {"card": card.name}
            for name, card in cards.items()
        }
        if drawn != before:
            with replacing(kept_note) as temporary:
                temporary.write_text(note({"code": code, "cards": drawn}))
        stage.note = f"{len(cards)} of {fits.sizes['aircraft']} aircraft"
        if same := sum(drawn[name] is before.get(name) for name in drawn):
            stage.note += f", {same} as drawn before"


def _drawn_from(chosen: xr.Dataset) -> dict[str, dict[str, object]]:
    """What every aircraft's card is drawn from: a hash of all, and what tells whether it moved."""
    columns = [
        np.moveaxis(one.to_numpy(), one.dims.index("aircraft"), 0)
        for _, one in sorted(chosen.variables.items(), key=lambda item: str(item[0]))
        if "aircraft" in one.dims
    ]
    head = f"{chosen['reference'].item()} {chosen.attrs.get('table_sign')}".encode()
    square = np.diagonal(chosen["deviation_covariance"].transpose("aircraft", ...), 0, 1, 2)
    found = {}
    for k, name in enumerate(chosen["aircraft"].to_numpy().astype(str)):
        digest = hashlib.blake2b(head, digest_size=16)
        for column in columns:
            own = column[k]
            digest.update(repr(own).encode() if column.dtype == object else own.tobytes())
        found[str(name)] = {
            "mark": digest.hexdigest(),
            "status": int(chosen["status"][k]),
            "table": np.nan_to_num(chosen["table_correction"].to_numpy()[k]).tolist(),
            "curve": np.nan_to_num(chosen["deviation"].to_numpy()[k]).tolist(),
            "error": np.sqrt(np.nan_to_num(np.maximum(square[k], 0.0))).tolist(),
        }
    return found


def _stands(old: dict[str, object], now: dict[str, object], near: float) -> bool:
    """Whether a card that was drawn is as good as one drawn now."""
    if old["mark"] == now["mark"]:
        return True
    if not near or any(old[key] != now[key] for key in ("status", "table")):
        return False
    apart = np.abs(np.array(old["curve"]) - np.array(now["curve"]))
    return bool(np.all(apart <= near * np.array(now["error"])))


def _noted(path: Path, code: str) -> dict[str, dict[str, object]]:
    """The cards an earlier run drew; none where that is not whole, or of other code."""
    try:
        told = noted(path.read_text())
        # a name alone: a note must not lead to a file of another folder
        cards = {
            str(name): dict(one) | {"card": Path(str(one["card"])).name}
            for name, one in told["cards"].items()
        }
        if told["code"] != code:
            return {name: one | {"mark": "", "status": -1} for name, one in cards.items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        # no record, or a torn one: all cards are drawn anew
        return {}
    return cards


def make_corrected(
    job: Job, headings: xr.Dataset | None = None, fits: xr.Dataset | None = None
) -> xr.Dataset:
    """The archive with corrected winds: ``corrected.nc``.

    Parameters
    ----------
    headings, fits : Dataset, optional
        Read from the output folder when not given.
    """
    from airswing.compass.correction import KEPT, NEEDED, correct

    screened, fitted = ready(job, headings, HEADINGS), ready(job, fits, FITS)
    reference, method = main_reference(job.config), job.config.correction.method
    kept = screened[[name for name in KEPT if name in screened and "report" in screened[name].dims]]

    def make() -> Blocks:
        attrs = dict(screened.attrs)  # a month without reports has no block that brings them
        carried = kept if still_in_file(kept) else None

        def each(stage: StageRecord) -> Iterator[xr.Dataset]:
            for block in blocks(screened, NEEDED if carried is not None else KEPT):
                mended = correct(block, fitted, reference=reference, method=method)
                attrs.update(mended.attrs)
                yield mended
            stage.reports = screened.sizes["report"]

        sizes = screened.sizes
        return Blocks(sizes["report"], sizes["aircraft"], each, "correct", attrs, carried=carried)

    return ragged_product(
        job,
        CORRECTED,
        make,
        title="Aircraft reports with winds corrected for compass deviation",
        depends=(
            reference,
            method,
            screened.attrs["uuid"],
            fitted.attrs["uuid"],
            code_digest("airswing.compass.correction"),
        ),
        sources=(screened, fitted),
    )
