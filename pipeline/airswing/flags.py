"""Codes of the flag variables in Datasets and products, with the name of each code.

Every stage sets and tests flags by these names. A code keeps its meaning in all versions, because
products of earlier versions are still read.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

PHASE = {"unknown": 0, "ascent": 1, "cruise": 2, "descent": 3}
ROLL = {"missing": 0, "good": 1, "bad": 2, "not_available": 3}
QC = {"missing": 0, "pass": 1, "fail": 2}  # of the wind and of the temperature
WIND_SOURCE = {"reported": 0, "derived": 1, "derived_at_standard_temperature": 2}
PLATFORM = {"unknown": 0, "TAMDAR": 1, "AMDAR": 2, "ACARS": 3, "AIREP": 4}
ICING = {"missing": -1, "off": 0, "on": 1}
# ``ok``: a deviation curve. ``offset_only``: one constant, valid for the headings flown.
# ``no_correction_needed``: a curve that is zero within its standard error, so the table is zero.
# ``implausible_reports``: the reported quantities contradict the reference (a wrong unit).
# ``no_improvement``: the curve does not bring the winds of held-out days nearer to the reference.
# Only the first three come with coefficients.
STATUS = {
    "ok": 0,
    "too_few_reports": 1,
    "poor_heading_coverage": 2,
    "unstable_fit": 3,
    "offset_only": 4,
    "too_few_flights": 5,
    "implausible_reports": 6,
    "no_improvement": 7,
    "no_correction_needed": 8,
}
# ``offset_only``: corrected by one constant; errors that vary with the heading remain.
# ``no_correction_needed``: the wind is as reported, because the deviation is zero within its error.
CORRECTION = {
    "corrected": 0,
    "no_fit": 1,
    "no_heading": 2,
    "missing_wind": 3,
    "already_corrected": 4,
    "offset_only": 5,
    "no_correction_needed": 6,
}
# Codes of ``correction_applied`` of winds without the error of the compass, as far as is known.
FREE_OF_DEVIATION = tuple(
    CORRECTION[name] for name in ("corrected", "already_corrected", "no_correction_needed")
)
# Ground vector of a report: from the chord between fixes (of the neighbours, of one side only, or
# past the neighbours), or from the reported heading and airspeed.
GROUND_VECTOR_SOURCE = {
    "none": 0,
    "chord": 1,
    "one_sided_chord": 2,
    "widened_chord": 3,
    "reported": 4,
}
# Whether the heading and airspeed that an aircraft reports are used, or why not.
REPORTED_HEADING_USE = {
    "absent": 0,
    "used": 1,
    "too_few": 2,
    "heading_is_track": 3,
    "heading_differs": 4,
    "airspeed_differs": 5,
}
# Bits of ``screening``, named by the screening rules.
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
    """Return where a fit (code of `STATUS`) has coefficients: a curve or an offset."""
    with_coefficients = ("ok", "offset_only", "no_correction_needed")
    return np.isin(status, [STATUS[name] for name in with_coefficients])


def is_corrected(applied: ArrayLike) -> NDArray[np.bool_]:
    """Return True where a wind was corrected by this package, by a curve or by an offset."""
    return np.isin(applied, (CORRECTION["corrected"], CORRECTION["offset_only"]))
