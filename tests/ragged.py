"""Datasets of reports made of plain arrays."""

import numpy as np
import xarray as xr


def ragged(columns, row_size=None, aircraft=None, reference=None, **attrs):
    """Reports of aircraft: arrays of one dimension by report, of two by reference and report."""
    axes = {1: "report", 2: ("reference", "report")}
    ds = xr.Dataset({name: (axes[np.ndim(v)], v) for name, v in columns.items()}, attrs=attrs)
    if row_size is not None:
        names = [f"N{k}" for k in range(len(row_size))] if aircraft is None else list(aircraft)
        ds = ds.assign(row_size=("aircraft", np.asarray(row_size))).assign_coords(aircraft=names)
    return ds if reference is None else ds.assign_coords(reference=list(reference))
