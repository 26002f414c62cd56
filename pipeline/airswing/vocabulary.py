"""Every variable that airswing writes: name, unit, CF standard name, meaning, type.

The table is ``vocabulary.csv`` next to this module, a line a variable. Columns: ``name``;
``dimensions`` and ``type`` (on disk); ``log2_step`` (derived variables of every report are rounded
to this power of two, far below their errors, which halves the file); ``units`` (UDUNITS; empty for
strings and flags); ``standard_name`` (CF, where one exists); ``flags``, the name of the codes in
:mod:`airswing.flags`; ``long_name``. Where one name has several meanings, it has a line for each of
its dimensions.

Units inside a Dataset are SI units except where the field uses others (angles in degrees, magnetic
field in nanotesla, lead time in hours). A variable without a line cannot be written, so that every
product has the same names and units. Valid for the Datasets of the stages and for the NetCDF
products (CF-1.11).
"""

from __future__ import annotations

import csv
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from airswing import flags

TABLE = Path(__file__).with_suffix(".csv")


@dataclass(frozen=True)
class Variable:
    """One line of the table."""

    name: str
    units: str
    long_name: str
    dims: tuple[str, ...]
    dtype: str
    step: float | None  # to which values are rounded before they are written
    standard_name: str
    flags: Mapping[str, int] | None

    def attributes(self) -> dict[str, object]:
        """CF attributes of the variable."""
        attributes: dict[str, object] = {"long_name": self.long_name}
        if self.units:
            attributes["units"] = self.units
        if self.standard_name:
            attributes["standard_name"] = self.standard_name
        if self.standard_name == "air_temperature":
            attributes["units_metadata"] = "temperature: on_scale"
        if self.dtype.startswith("datetime64"):
            attributes["units_metadata"] = "leap_seconds: none"
        if self.flags is not None:
            # The bits of ``screening`` may be set together; other flags have one value.
            kind = "flag_masks" if self.flags is flags.SCREENING else "flag_values"
            attributes[kind] = np.array(list(self.flags.values()), dtype=self.dtype)
            attributes["flag_meanings"] = " ".join(self.flags)
        return attributes


with TABLE.open(encoding="ascii", newline="") as _file:
    _LINES = [
        Variable(
            name=row["name"],
            units=row["units"],
            long_name=row["long_name"],
            dims=tuple(row["dimensions"].split()),
            dtype=row["type"],
            step=2.0 ** int(row["log2_step"]) if row["log2_step"] else None,
            standard_name=row["standard_name"],
            flags=getattr(flags, row["flags"]) if row["flags"] else None,
        )
        for row in csv.DictReader(_file)
    ]
VARIABLES: dict[str, Variable] = {line.name: line for line in reversed(_LINES)}
"""Every variable by name; the first of several lines of one name."""
_BY_DIMS = {(line.name, line.dims): line for line in reversed(_LINES)}


def lookup(name: str, dims: tuple[Hashable, ...] = ()) -> Variable:
    """Find the line of a variable: with these dimensions if there is one, else the first.

    The dimensions distinguish the phase of a fit (reference, aircraft) from the phase of flight
    (report), and a report's latitude from a map's.
    """
    if name not in VARIABLES:
        raise KeyError(f"{name!r} is not in airswing/vocabulary.csv; add it there first")
    return _BY_DIMS.get((name, tuple(map(str, dims))), VARIABLES[name])


def describe(ds: xr.Dataset) -> xr.Dataset:
    """Write units, names and flag meanings on every variable of a Dataset; others are kept."""
    ds = ds.copy()
    for name, variable in ds.variables.items():
        variable.attrs = {**variable.attrs, **lookup(str(name), variable.dims).attributes()}
    return ds
