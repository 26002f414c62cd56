"""Standard error of a wind component, report by report, for formats that carry one.

Assumes that errors of reports are known by flight phase and layer where ``observation_errors.nc``
stands beside the reports. Where it does not, the error is that of WRFDA's own table for the type
of report (var/obsproc/obserr.txt of WRF 4.7, wind components, interpolated in pressure), which is
meant for winds as reported and is generous for corrected ones. To either is added, in quadrature,
what the aircraft's correction leaves uncertain: ``corrected_wind_standard_error`` is that of the
wind vector, half of its square is a component's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from airswing.handover.records.platforms import PLATFORMS

Array = NDArray[np.float64]

TAMDARS = (
    (150, 200, 350, 400, 450, 500, 550, 600, 750, 800, 850, 900),
    (3.6, 3.2, 3.2, 3.0, 3.0, 2.9, 2.9, 2.7, 2.7, 2.5, 2.5, 2.3),
)
"""hPa, m/s: where the table's steps begin and end; constant beyond."""
AIREPS = 3.6
"""m/s, at all levels."""


def table_error(pressure: Array, platform: NDArray[np.int8]) -> Array:
    """Error of a wind component by WRFDA's table.

    Parameters
    ----------
    pressure : array, shape (n,)
        Pa.
    platform : array of int8, shape (n,)
        Numbers of `PLATFORMS`; AMDAR and ACARS count as AIREPS, as WRFDA takes them.

    Returns
    -------
    array, shape (n,)
        m/s.
    """
    tamdar = np.interp(pressure / 100.0, *TAMDARS)
    return np.where(platform == PLATFORMS.index("TAMDAR"), tamdar, AIREPS)


def component_errors(rows: NDArray[np.void], platform: NDArray[np.int8]) -> Array:
    """Error of a wind component of every report.

    Parameters
    ----------
    rows : array of :data:`airswing.handover.records.eligible.ROW`
    platform : array of int8, shape (n,)

    Returns
    -------
    array, shape (n,)
        m/s.
    """
    own = np.nan_to_num(rows["error"].astype(np.float64), nan=0.0)
    return np.asarray(np.hypot(table_error(rows["pressure"], platform), own / np.sqrt(2.0)))
