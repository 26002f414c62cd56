"""Wind errors that assimilation systems use for reports from aircraft.

Values are of one wind component, m/s, by pressure. WRFDA: ``var/obsproc/obserr.txt`` of WRF 4.7.1
(interpolated in pressure, constant beyond its ends). NAM: the error table of the regional system of
NCEP, TAMDAR and MDCRS.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Pressures, hPa, and errors.
USED = {
    "wrfda_tamdar": (
        (150, 200, 250, 300, 350, 400, 450, 500, 550, 600, 650, 700, 750, 800, 850, 900),
        (3.6, 3.2, 3.2, 3.2, 3.2, 3.0, 3.0, 2.9, 2.9, 2.7, 2.7, 2.7, 2.7, 2.5, 2.5, 2.3),
    ),
    "wrfda_airep": ((500,), (3.6,)),
    "nam_tamdar": ((300, 400, 500, 700, 850, 1000), (5.30, 5.12, 4.93, 4.80, 4.33, 3.75)),
    "nam_mdcrs": ((300, 400, 500, 700, 850, 1000), (3.41, 2.87, 2.62, 2.73, 2.79, 2.39)),
}


def used_error(name: str, pressure: ArrayLike) -> NDArray[np.float64]:
    """Error a system uses.

    Parameters
    ----------
    name : str
        Of `USED`.
    pressure : array_like
        Pa.

    Returns
    -------
    array
        m/s.
    """
    levels, errors = USED[name]
    return np.asarray(np.interp(np.asarray(pressure) / 100.0, levels, errors))
