"""Small archives of corrected reports, in memory, for tests of the exports."""

import numpy as np

from airswing.flags import CORRECTION, PHASE
from airswing.vocabulary import describe
from tests.ragged import ragged

NOON = np.datetime64("2008-07-15T12:00:00", "ns")


def corrected(sizes, **columns):
    """Corrected reports of some aircraft, all fit for export unless columns say otherwise.

    ``sizes`` are reports by aircraft; a column is one value for all reports, or one for each.
    """
    count = sum(sizes.values())
    ds = {
        "time": NOON + np.timedelta64(60, "s") * np.arange(count),
        "latitude": np.linspace(40.0, 45.0, count),
        "longitude": np.linspace(-95.0, -85.0, count),
        "pressure": np.full(count, 50000.0),
        "air_temperature": np.full(count, 258.15),
        "eastward_wind": np.full(count, 19.0),
        "northward_wind": np.full(count, 1.0),
        "corrected_eastward_wind": np.full(count, 20.0),
        "corrected_northward_wind": np.full(count, -3.0),
        "corrected_wind_standard_error": np.full(count, 0.3),
        "correction_applied": np.full(count, CORRECTION["corrected"], dtype=np.int8),
        "phase": np.full(count, PHASE["cruise"], dtype=np.int8),
        "flight": np.repeat(np.arange(len(sizes)), list(sizes.values())).astype(np.int32),
        "screening": np.zeros(count, dtype=np.int32),
    }
    for name, values in columns.items():
        ds[name] = np.broadcast_to(np.asarray(values, dtype=ds[name].dtype), (count,)).copy()
    return describe(ragged(ds, np.array(list(sizes.values()), dtype=np.int32), sizes))
