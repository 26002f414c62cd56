"""Whether reports and a reference meet at all, in time, in space and between the levels.

Assumes plans of :mod:`airswing.reference.planning`. A reference that serves no report is refused,
with both spans.
"""

from __future__ import annotations

from collections.abc import Mapping

from airswing.errors import InputError
from airswing.reference.planning import Plan


def require_overlap(plans: Mapping[str, Plan]) -> None:
    """Refuse a run in which a reference serves no report at all; names both spans."""
    for name, one in plans.items():
        if one.matched:
            continue
        field = f"references.{name}"
        if one.without_time == one.reports:
            raise _untimed(one, field)
        if one.outside_levels == 0:
            raise InputError(
                "no overlap in space between reports and model winds",
                field=field,
                found=f"reports {_place(one.report_box)}, model {_place(one.model_box)}",
            )
        levels = " to ".join(f"{level:g}" for level in dict.fromkeys(one.model_levels))
        raise InputError(
            "no report lies between the model's levels",
            field=field,
            found=f"{one.outside_levels} reports above the highest or below the lowest level "
            f"({levels} hPa)",
            remedy="Check the unit of the reports' altitude or pressure column"
            if len(set(one.model_levels)) > 1
            else "Winds are interpolated between levels: two are needed",
        )


def _untimed(one: Plan, field: str) -> InputError:
    """No report has a model time on both sides: the spans are apart, or the gaps too wide."""
    reports, model = one.report_times, one.model_span
    apart = reports[1] < model[0] or model[1] < reports[0]
    if apart or not all((*reports, *model)):
        what = "no overlap in time between reports and model winds"
    elif model[0] == model[1]:
        what = "the model has a single valid time; a report needs one before and one after it"
    else:
        what = "no report lies between two model times that are close enough together"
    return InputError(
        what,
        field=field,
        found=f"reports {' to '.join(reports)}, model {' to '.join(model)}",
        remedy="Two valid times around a report may be at most max_time_gap apart",
    )


def _place(box: tuple[float, float, float, float]) -> str:
    return f"latitude {box[0]:g} to {box[1]:g}, longitude {box[2]:g} to {box[3]:g}"
