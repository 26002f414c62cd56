"""From headings to corrected winds: ``fits.nc``, ``tables.csv``, swing cards, ``corrected/``."""

from __future__ import annotations

import math

import xarray as xr

from airswing.flags import published
from airswing.products.netcdf import open_product, product_path
from airswing.vocabulary import describe
from airswing.workflow.job import (
    CORRECTED,
    FITS,
    HEADINGS,
    Job,
    main_reference,
    ready,
    require_kept,
)


def make_fits(job: Job, headings: xr.Dataset | None = None) -> xr.Dataset:
    """Deviation fits and 8-point tables: ``fits.nc``, ``tables.csv`` and the swing cards.

    Parameters
    ----------
    job : Job
    headings : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Dataset
        As written to ``fits.nc``.

    Raises
    ------
    InputError
        Screening left no report.
    """
    from airswing.compass.fit.deviation import fit_deviation
    from airswing.compass.plausibility import mean_declination, plausibility, with_implausible
    from airswing.compass.table import add_tables, write_tables_csv
    from airswing.evaluation.monitoring.changes import add_changes, watch_compasses
    from airswing.report.run.swing_cards import write_swing_cards

    config, screened = job.config, ready(job, headings, HEADINGS)
    require_kept(screened)
    abscissa, reference = config.fit.abscissa, main_reference(config)
    with job.progress.stage("fit") as stage:
        fits = add_tables(
            fit_deviation(screened, pools=config.pools(), **config.fit.model_dump()),
            screened,
            resolution=math.degrees(config.table.resolution),
            sign=config.table.sign,
        ).compute()
        fits = describe(fits.assign(mean_declination=("aircraft", mean_declination(screened))))
        members = config.pools()[reference]
        fits = with_implausible(fits, plausibility(screened, references=members))
        watch = watch_compasses(screened, members=members, abscissa=abscissa)
        job.shared["compass_watch"] = watch
        fits = add_changes(fits, watch.changes)
        stage.note = f"{int(published(fits['status']).sum())} of {fits['status'].size} fits usable"
        if (regions := int(fits["shared_error_regions"].max())) > 1:
            stage.note += f"; the references' shared error in {regions} regions"
        job.write(
            fits,
            FITS,
            title="Compass deviation per aircraft and 8-point correction tables",
            sources=(screened,),
        )
    fits = open_product(job.output / FITS).load()
    with job.progress.stage("swing cards") as stage:
        write_tables_csv(fits, job.output / "tables.csv")
        path = job.output / "swing_cards.pdf"
        number = write_swing_cards(fits, screened, path, reference=reference, units=config.units)
        stage.note = f"{number} of {fits.sizes['aircraft']} aircraft"
    return fits


def make_corrected(
    job: Job, headings: xr.Dataset | None = None, fits: xr.Dataset | None = None
) -> xr.Dataset:
    """The archive with corrected winds, month by month: ``corrected/2008-07.nc``.

    Parameters
    ----------
    job : Job
    headings, fits : Dataset, optional
        Read from the output folder when not given.

    Returns
    -------
    Dataset
        Of all months, lazy.
    """
    from airswing.compass.correction import correct

    fitted = ready(job, fits, FITS)
    reference, method = main_reference(job.config), job.config.correction.method
    folder = product_path(job.output, HEADINGS)
    if not folder.exists():
        ready(job, None, HEADINGS)  # says what is missing
    months = sorted(folder.glob("*.nc")) if folder.is_dir() else [folder]
    with job.progress.stage("correct") as stage:
        for path in months:
            with open_product(path) as month:
                corrected = correct(month, fitted, reference=reference, method=method)
                job.write(
                    corrected,
                    f"{CORRECTED}/{path.name}",
                    title="Aircraft reports with winds corrected for compass deviation",
                    sources=(month, fitted),
                )
                stage.reports += month.sizes["report"]
        for path in (job.output / CORRECTED).glob("*.nc"):
            if path.name not in {month.name for month in months}:
                path.unlink()
    return open_product(job.output / CORRECTED)
