"""Whether the table in use and the one that would be sent now differ.

Assumes independent errors of the two tables: two fits of overlapping reports differ by less, so a
difference is told late rather than early. They differ where any node's difference is beyond the
95 % limit of the largest of eight (Sidak 1967, J. Am. Stat. Assoc. 62, 626-633) and beyond what the
unit can hold. Degrees to add to the indicated heading, as a unit of ``subtract_error`` has them.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import xarray as xr

from airswing.compass.correction import curve_standard_error
from airswing.compass.table import NODES, SIGNS, error_from_table
from airswing.errors import InputError
from airswing.evaluation.events_file import UnitTable
from airswing.flags import published

LARGEST_OF_EIGHT = 2.727
"""95 % point of the largest of eight standard normal numbers' sizes."""
RESOLUTION = 0.1
"""Degrees two roundings may make."""


def differ(one: UnitTable, other: UnitTable) -> tuple[bool, float]:
    """Whether two tables differ beyond the error of both, and by how much.

    Returns
    -------
    bool, float
        The second rms over the nodes, degrees.
    """
    gap = np.subtract(one.correction_deg, other.correction_deg)
    error = np.hypot(one.standard_error_deg, other.standard_error_deg)
    beyond = (np.abs(gap) > LARGEST_OF_EIGHT * error) & (np.abs(gap) > RESOLUTION)
    return bool(beyond.any()), float(np.sqrt((gap**2).mean()))


def tables_of(fits: xr.Dataset) -> dict[str, UnitTable]:
    """Tables that would be sent, by aircraft; none of fits that are not to be trusted.

    Parameters
    ----------
    fits : Dataset
        Of one reference, with tables.
    """
    if "table_correction" not in fits:
        raise InputError(
            "the fits hold no tables", field="table_correction", remedy="Call add_tables first"
        )
    correction = -error_from_table(fits).transpose("aircraft", "node").to_numpy()
    covariance = fits["deviation_covariance"].to_numpy()
    good = published(fits["status"].to_numpy()) & np.isfinite(correction).all(axis=1)
    return {
        str(fits["aircraft"].to_numpy()[k]): UnitTable(
            [round(float(value), 4) + 0.0 for value in correction[k]],
            [round(float(value), 4) for value in curve_standard_error(covariance[k], NODES)],
        )
        for k in np.flatnonzero(good)
    }


def read_tables(path: Path | str, *, reference: str) -> dict[str, UnitTable]:
    """Tables in use, from a file as a run writes it (``tables.csv``).

    Parameters
    ----------
    reference : str
        Whose rows, where the file holds those of several references.

    Returns
    -------
    dict of str to UnitTable
        Of the aircraft that have all eight nodes; rows without a number are no table.

    Raises
    ------
    InputError
        If it is not such a file.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8") as stream:
            lines = list(csv.DictReader(stream))
        known = {line["reference"] for line in lines}
        wanted = reference if reference in known else next(iter(known), reference)
        nodes: dict[str, dict[float, tuple[float, float]]] = {}
        for line in lines:
            if line["reference"] != wanted or not line["table_correction_deg"]:
                continue
            to_add = -SIGNS[line["sign"]] * float(line["table_correction_deg"])
            error = float(line["standard_error_deg"] or 0.0)
            if not (abs(to_add) <= 180.0 and 0.0 <= error <= 180.0):
                raise ValueError(f"{to_add} with error {error} at {line['aircraft']}")
            nodes.setdefault(line["aircraft"], {})[float(line["heading_deg"])] = (to_add, error)
    except (OSError, ValueError, KeyError, TypeError, UnicodeError) as err:
        raise InputError(
            "not a file of tables",
            file=path,
            found=err,
            remedy="It has the columns and rows of tables.csv, as a run writes it",
        ) from err
    whole = {
        name: [found[node] for node in NODES]
        for name, found in nodes.items()
        if set(NODES) == set(found)
    }
    return {
        name: UnitTable([value for value, _ in found], [error for _, error in found])
        for name, found in whole.items()
    }
