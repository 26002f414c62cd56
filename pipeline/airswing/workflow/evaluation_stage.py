"""What judges the corrections: profiles, the field test, the dependence on the reference.

Takes the products and writes ``error_profiles.nc``, ``field_test.json`` and ``sensitivity.json``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import xarray as xr

from airswing.config import FieldTest
from airswing.errors import ConfigError
from airswing.evaluation.results import Evaluation
from airswing.products.findings import findings
from airswing.products.netcdf import write_product
from airswing.products.whole_files import write_json
from airswing.workflow.job import (
    FIELD_TEST,
    HEADINGS,
    OBSERVATION_ERRORS,
    PROFILES,
    SENSITIVITY,
    Job,
    main_reference,
    ready,
)
from airswing.workflow.ranking_stage import make_ranking, make_stability, make_virtual

INNOVATIONS = "innovation_statistics.nc"

if TYPE_CHECKING:
    from airswing.evaluation.results import Content


def make_evaluation(
    job: Job, headings: xr.Dataset, fits: xr.Dataset, corrected: xr.Dataset
) -> Evaluation:
    """Everything that judges the corrections, as far as the configuration allows it.

    Returns
    -------
    Evaluation
        ``field_test`` and ``sensitivity`` where there are groups and more than one reference.
    """
    config = job.config
    return Evaluation(
        profiles=make_profiles(job, headings, corrected),
        innovations=make_innovations(job, headings, corrected),
        observation_errors=make_observation_errors(job, headings, corrected),
        stability=make_stability(job, headings, fits),
        # named here: the virtual field test below takes it up
        ranking=(ranking := make_ranking(job, headings, fits)),
        virtual=make_virtual(job, headings, fits, ranking),
        field_test=None if config.field_test is None else make_field_test(job, headings),
        sensitivity=make_sensitivity(job, headings) if len(config.references) > 1 else None,
    )


def make_profiles(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Error profiles by phase of flight and level: ``error_profiles.nc``."""
    from airswing.evaluation.error_profiles import error_profiles

    with job.progress.stage("profiles"):
        profiles = error_profiles(headings, corrected, pools=job.config.pools())
        write_product(
            profiles,
            job.output / PROFILES,
            title="Wind error by phase of flight and level, as reported and as corrected",
            config_json=job.config.model_dump_json(),
            source_uuids=[headings.attrs["uuid"], corrected.attrs["uuid"]],
        )
    return profiles


def make_innovations(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Statistics of observation minus reference: ``innovation_statistics.nc``."""
    from airswing.evaluation.innovations import innovation_statistics

    with job.progress.stage("innovations"):
        found = innovation_statistics(headings, corrected, pools=job.config.pools())
        write_product(
            found,
            job.output / INNOVATIONS,
            title="Statistics of observation minus reference by aircraft, phase and level",
            config_json=job.config.model_dump_json(),
            source_uuids=[headings.attrs["uuid"], corrected.attrs["uuid"]],
        )
    return found


def make_observation_errors(job: Job, headings: xr.Dataset, corrected: xr.Dataset) -> xr.Dataset:
    """Error of the reports alone, by phase of flight and layer: ``observation_errors.nc``."""
    from airswing.evaluation.report_errors.observation_errors import observation_errors

    with job.progress.stage("observation errors") as stage:
        found = observation_errors(
            headings,
            corrected,
            pools=job.config.pools(),
            reference=main_reference(job.config),
            covariance=job.config.observation_errors.reference_covariance,
        )
        write_product(
            found,
            job.output / OBSERVATION_ERRORS,
            title="Standard error of a wind component of the reports alone",
            config_json=job.config.model_dump_json(),
            source_uuids=[headings.attrs["uuid"], corrected.attrs["uuid"]],
        )
        stage.note = found.attrs["believed"] or found.attrs["believed_because"]
    return found


def make_field_test(
    job: Job, headings: xr.Dataset | None = None, *, expected: Content | None = None
) -> Content:
    """The field test of the configuration: ``field_test.json``.

    Parameters
    ----------
    headings : Dataset, optional
        Read from the output folder when not given.
    expected : Content, optional
        Of :func:`expected_reduction`, where ``headings`` is of the test's own dates alone.

    Raises
    ------
    ConfigError
        If the configuration has no ``field_test``.
    """
    from airswing.evaluation.field_test import field_test

    config, test = job.config, asked_field_test(job)
    with job.progress.stage("field test") as stage:
        screened = ready(job, headings, HEADINGS)
        found = field_test(
            screened,
            pools=config.pools(),
            reference=main_reference(config),
            **test.model_dump(),
        )
        # an update hands it in: its headings begin with the test, and the fits are of what was
        # before
        told = expected_reduction(job, screened) if expected is None else expected
        content: Content = {**found, **told}
        result = findings(content)
        write_json(job.output / FIELD_TEST, result)
        low, high = result["adjusted_reduction_ci_kt"]
        stage.note = (
            f"adjusted reduction {result['adjusted_reduction_kt']:.2f} kt ({low:.2f} to {high:.2f})"
        )
    return result


def asked_field_test(job: Job) -> FieldTest:
    """The field test of the configuration.

    Raises
    ------
    ConfigError
        If it has none.
    """
    if job.config.field_test is None:
        raise ConfigError(
            "there is no field test to evaluate",
            field="field_test",
            remedy="Add field_test with start, before_start, corrected and controls",
        )
    return job.config.field_test


def expected_reduction(job: Job, headings: xr.Dataset) -> Content:
    """What the fits before the field test expected of it.

    Parameters
    ----------
    job : Job
        With a field test.
    headings : Dataset
        With all reports before its start.

    Returns
    -------
    Expected
        Of :func:`airswing.evaluation.backtest.virtual_field_test.predicted_reduction`.
    """
    from airswing.evaluation.backtest.virtual_field_test import predicted_reduction

    config, test = job.config, asked_field_test(job)
    return predicted_reduction(
        headings,
        start=test.start,
        corrected=test.corrected,
        pools=config.pools(),
        reference=main_reference(config),
        **config.fit.model_dump(),
    )


def make_sensitivity(
    job: Job, headings: xr.Dataset | None = None, *, intervals: bool = False
) -> Content:
    """Every reference and pool fitted on the same reports: ``sensitivity.json``.

    Parameters
    ----------
    headings : Dataset, optional
        Read from the output folder when not given.
    intervals : bool, default False
        Also say what hourly references would lose every three and six hours, which reads some of
        their files again. With one reference this is all there is to say.
    """
    from airswing.evaluation.reference_comparison.sensitivity import compare

    config = job.config
    found = ready(job, headings, HEADINGS)
    costs = _interval_costs(job, found) if intervals else {}
    if costs and len(config.references) == 1:
        # one reference has nothing to be compared with
        alone: Content = {"time_interval": costs}
        write_json(job.output / SENSITIVITY, alone)
        return alone
    with job.progress.stage("compare") as stage:
        result = compare(
            found,
            pools=config.pools(),
            never_pool=config.never_pool,
            **config.fit.model_dump(),
        )
        if costs:
            result["time_interval"] = costs
        write_json(job.output / SENSITIVITY, result)
        verdicts = (
            f"{' and '.join(pair['references'])}: "
            + ("poolable" if pair["poolable"] else "not poolable")
            for pair in result["pairs"]
        )
        stage.note = "; ".join(verdicts)
    return result


def _interval_costs(job: Job, headings: xr.Dataset) -> dict[str, list[Content]]:
    """What hourly references would lose every three and six hours, and say so."""
    from airswing.evaluation.reference_comparison.time_interval import interval_cost
    from airswing.workflow.collocating import catalogues

    # a wind of the fleet itself has no files that could be read more seldom
    own = [name for name, one in job.config.references.items() if one.engine != "fleet"]
    models = catalogues(job, own)
    with job.progress.stage("time interval") as stage:
        costs = {name: interval_cost(headings, model) for name, model in models.items()}
        found = {name: rows for name, rows in costs.items() if rows}
        stage.note = "; ".join(
            f"{name} every {row['interval_h']} h: {row['rms_vector_difference_m_s']:.2f} m/s, "
            f"{row['rms_vector_difference_at_middle_m_s'] or float('nan'):.2f} at the middle"
            for name, rows in found.items()
            for row in rows
        )
    return found
