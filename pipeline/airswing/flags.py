"""Values of the flags in Datasets and products, and the words they are told by.

Assumes what FORMATS says of each flag; a value that is in no table does not occur. Valid for all
stages: whoever sets a flag or asks for one does it by its word here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Codes stand in products: a number keeps its meaning for as long as files of earlier versions are
# read.
PHASE = {"unknown": 0, "ascent": 1, "cruise": 2, "descent": 3}
ROLL = {"missing": 0, "good": 1, "bad": 2, "not_available": 3}
TEMPERATURE_QC = {"missing": 0, "pass": 1, "fail": 2}
WIND_QC = {"missing": 0, "pass": 1, "fail": 2}
WIND_SOURCE = {"reported": 0, "derived": 1, "derived_at_standard_temperature": 2}
PLATFORM = {"unknown": 0, "TAMDAR": 1, "AMDAR": 2, "ACARS": 3, "AIREP": 4}
ICING = {"missing": -1, "off": 0, "on": 1}
# ``ok``: a curve; ``offset_only``: one constant, for the headings flown; the others: nothing.
STATUS = {
    "ok": 0,
    "too_few_reports": 1,
    "poor_heading_coverage": 2,
    "unstable_fit": 3,
    "offset_only": 4,
    "too_few_flights": 5,
}
# ``offset_only``: corrected by one constant, which leaves whatever turns with the heading.
CORRECTION = {
    "corrected": 0,
    "no_fit": 1,
    "no_heading": 2,
    "missing_wind": 3,
    "already_corrected": 4,
    "offset_only": 5,
}
# Bits of ``screening``; their names are the rules of the audit table.
SCREENING = {
    "phase": 1,
    "roll": 2,
    "temperature_qc": 4,
    "turn": 8,
    "ground_speed": 16,
    "no_ground_vector": 32,
    "no_reference": 64,
    "missing_wind": 128,
    "wind_qc": 256,
    "gross_error": 512,
    "field_test": 1024,
}


def published(status: ArrayLike) -> NDArray[np.bool_]:
    """Whether a fit is to be trusted: a curve, or an offset alone."""
    codes: NDArray[np.generic] = np.asarray(status)
    return np.asarray((codes == STATUS["ok"]) | (codes == STATUS["offset_only"]))


def mended(applied: ArrayLike) -> NDArray[np.bool_]:
    """Whether a wind was corrected here: by a curve, or by an offset alone."""
    return np.isin(applied, (CORRECTION["corrected"], CORRECTION["offset_only"]))
