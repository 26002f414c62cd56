"""From headings to corrected winds: fit, table, correct.

Takes ``headings.nc`` and writes ``fits.nc``, the tables and swing cards, and ``corrected.nc``.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.flags import published
from airswing.products.atomic import replacing
from airswing.products.checked import note, noted
from airswing.products.fingerprint import code_digest, fingerprint
from airswing.products.monthly import FLIGHTS
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
    from airswing.workflow.progress import StageRecord


@dataclass(frozen=True)
class Seen:
    """What fits and tables are made of, however the reports were looked at.

    Parameters
    ----------
    fits : Dataset
        Of :func:`airswing.compass.fit.deviation.fit_deviation`.
    histogram : array of int, shape (aircraft, 360)
        Of :func:`airswing.compass.table.heading_histogram`.
    declination : array, shape (aircraft,)
        Of :func:`airswing.compass.heading_kind.mean_declination`.
    changes : list of dict
        Of :func:`airswing.evaluation.compass_changes.stability.find_changes`.
    """

    fits: xr.Dataset
    histogram: NDArray[np.int64]
    declination: NDArray[np.float64]
    changes: list[dict[str, Any]]


def look_at_all(job: Job, headings: xr.Dataset) -> Seen:
    """Fit the reports, and count what else their tables need.

    Parameters
    ----------
    job : Job
    headings : Dataset

    Returns
    -------
    Seen
    """
    from airswing.compass.fit.deviation import fit_deviation
    from airswing.compass.heading_kind import mean_declination
    from airswing.compass.table import heading_histogram
    from airswing.evaluation.compass_changes.stability import find_changes

    config = job.config
    abscissa = config.fit.abscissa
    return Seen(
        fit_deviation(headings, pools=config.pools(), **config.fit.model_dump()),
        heading_histogram(headings, abscissa=abscissa),
        mean_declination(headings),
        find_changes(headings, members=config.pools()[main_reference(config)], abscissa=abscissa),
    )


def make_fits(
    job: Job,
    headings: xr.Dataset | None = None,
    look: Callable[[Job, xr.Dataset], Seen] = look_at_all,
) -> xr.Dataset:
    """Deviation fits and 8-point tables: ``fits.nc``, ``tables.csv`` and the swing cards.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.
    look : callable, optional
        How the reports are looked at.

    Returns
    -------
    Dataset
    """
    from airswing.compass.table import add_tables
    from airswing.evaluation.compass_changes.stability import add_changes

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
    draw_cards(job, fits)
    return fits


def draw_cards(job: Job, fits: xr.Dataset) -> None:
    """Tables as CSV, and swing cards of aircraft with a table unless those of these fits are there.

    Parameters
    ----------
    job : Job
    fits : Dataset
        With tables.
    """
    from airswing.compass.tables_csv import write_swing_cards, write_tables_csv

    folder, reference = job.output / "swing_cards", main_reference(job.config)
    kept_note = folder / ".drawn_of.json"
    mark = fingerprint(_content(fits), reference, code_digest("airswing.compass.tables_csv"))
    with job.progress.stage("swing cards") as stage:
        write_tables_csv(fits, job.output / "tables.csv")
        before, drawn = _noted(kept_note)
        if before == mark and all((folder / name).is_file() for name in drawn):
            stage.note = f"{len(drawn)} aircraft, as drawn before"
            return
        cards = [c.name for c in write_swing_cards(fits, folder, reference=reference)]
        for name in set(drawn) - set(cards):
            (folder / name).unlink(missing_ok=True)  # of aircraft that are gone
        with replacing(kept_note) as temporary:
            temporary.write_text(note({"mark": mark, "cards": cards}))
        stage.note = f"{len(cards)} of {fits.sizes['aircraft']} aircraft"


def _content(fits: xr.Dataset) -> str:
    """Hash of what the fits say, whichever run they are of."""
    digest = hashlib.blake2b(repr(fits.attrs.get("table_sign")).encode(), digest_size=16)
    for name in sorted(str(name) for name in fits.variables):
        values = fits[name].to_numpy()
        digest.update(f"{name} {values.dtype} {values.shape}".encode())
        digest.update(
            repr(values.tolist()).encode() if values.dtype == object else values.tobytes()
        )
    return digest.hexdigest()


def _noted(path: Path) -> tuple[str, list[str]]:
    """Mark and names of the cards an earlier run drew; nothing where that is not whole."""
    try:
        told = noted(path.read_text())
        return str(told["mark"]), [Path(name).name for name in told["cards"]]
    except (OSError, ValueError, TypeError, KeyError):
        return "", []


def make_corrected(
    job: Job, headings: xr.Dataset | None = None, fits: xr.Dataset | None = None
) -> xr.Dataset:
    """The archive with corrected winds: ``corrected.nc``.

    Parameters
    ----------
    job : Job
    headings, fits : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Dataset
    """
    from airswing.compass.correction import KEPT, NEEDED, correct

    screened, fitted = ready(job, headings, HEADINGS), ready(job, fits, FITS)
    reference = main_reference(job.config)
    kept = screened[[name for name in KEPT if name in screened and "report" in screened[name].dims]]

    def make() -> Blocks:
        attrs: dict[str, Any] = {k: v for k, v in screened.attrs.items() if k == FLIGHTS}
        carried = kept if still_in_file(kept) else None

        def each(stage: StageRecord) -> Iterator[xr.Dataset]:
            for block in blocks(screened, NEEDED if carried is not None else KEPT):
                mended = correct(block, fitted, reference=reference)
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
            screened.attrs["uuid"],
            fitted.attrs["uuid"],
            code_digest("airswing.compass.correction"),
        ),
        sources=(screened, fitted),
    )
