"""What only the gap needs of the collocation, in a product beside the headings: ``gap_inputs.nc``.

The diagnosis looks at the derivatives of the reference wind at every report. They come from the
same messages as the wind, so they are sampled with it once; they stand in a file of their own, so
that ``headings.nc`` holds what everyone reads. Reports, references and their order are those of the
``headings.nc`` beside it; both carry the same ``unscreened_fingerprint``, which says so, and
another screening changes neither.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import xarray as xr

from airswing.products.netcdf import as_stored, provenance
from airswing.products.ragged_product import ragged_writer
from airswing.reference.collocate import DERIVATIVES
from airswing.workflow.job import GAP_INPUTS, Blocks, Job, earlier

if TYPE_CHECKING:
    from airswing.workflow.progress import StageRecord

# Attribute of both products: hash of the reports, the references and how they were collocated.
MARK = "unscreened_fingerprint"


def set_apart(job: Job, made: Blocks, mark: str) -> Blocks:
    """Blocks without what only the gap needs, which is written to its own product as they come by.

    Parameters
    ----------
    made : Blocks
        Collocated, with the derivatives of the reference wind.
    mark : str
        Of these reports and references; empty where they are to be made again.
    """

    def each(stage: StageRecord) -> Iterator[xr.Dataset]:
        path = job.place(GAP_INPUTS)
        with ragged_writer(path, reports=made.reports, aircraft=made.aircraft) as writer:
            for block in made.each(stage):
                writer.append(as_stored(block[[*DERIVATIVES, "row_size"]]))
                yield block.drop_vars(DERIVATIVES)
            told = provenance(
                "Derivatives of the model winds at aircraft reports, for the gap diagnosis",
                config_json=job.config.model_dump_json(),
                sources=[*job.config.reports.files, *job.config.references],
            )
            writer.finish({MARK: mark, "featureType": "trajectory", **told})

    return replace(made, each=each)


def inputs_hold(job: Job, mark: str) -> bool:
    """Whether ``gap_inputs.nc`` is there and of these reports and references.

    Returns
    -------
    bool
        False without ``resume``.
    """
    found = earlier(job, job.place(GAP_INPUTS))
    if found is None:
        return False
    with found:
        return bool(mark) and found.attrs.get(MARK) == mark
