"""Sums of the aircraft of one period as a handful of plain arrays, for a file and back.

Assumes sums of one group of references, made with the same options: what one aircraft has, all
have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.compass.fit.acceptance import AircraftSums
from airswing.compass.fit.aircraft import AircraftFit
from airswing.compass.fit.normal_equations import PassSums, Scatter
from airswing.compass.fleet.flight_segments import Cut, Places
from airswing.compass.kept_sums.period_sums import Base, PeriodSums

Arrays = dict[str, NDArray[np.generic]]
Stored = Mapping[str, NDArray[Any]]  # as a file gives them, each of its own type
_TOTALS = ("weight", "slope", "before2", "after2", "square")
_WHERE = ("latitude", "longitude", "pressure", "time")
_OF_FIT = ("theta", "free", "normal", "flight", "day", "day_number", "freedom", "flight_order")
_NUMBERS = ("kappa", "converged", "rms_before", "rms_after")


def packed_bases(bases: Mapping[str, Base]) -> Arrays:
    """Bases of some aircraft as arrays."""
    every = list(bases.values())
    if not every:
        return {"aircraft": np.empty(0, dtype="U1")}
    free = np.zeros((len(every), every[0].theta.size), dtype=np.bool_)
    for row, one in zip(free, every, strict=True):
        # as flags: aircraft have free coefficients of different number, and an array has one width
        row[one.free] = True
    return {
        "aircraft": np.array(list(bases), dtype=np.str_),
        "theta": np.array([one.theta for one in every]),
        "free": free,
        "scatter": np.array([[(s.along, s.cross, s.part) for s in one.scatters] for one in every]),
        "field": np.array([one.field for one in every]),
        "duration": np.array([one.durations for one in every]),
        "few": np.array([one.few for one in every]),
        "rms": np.array([one.rms for one in every]),
        "reports": np.array([one.reports for one in every]),
    }


def unpacked_bases(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, Base]:
    """Undo :func:`packed_bases`."""
    return {
        str(name): Base(
            arrays["theta"][k],
            np.flatnonzero(arrays["free"][k]),
            [Scatter(*map(float, one)) for one in arrays["scatter"][k]],
            float(arrays["field"][k]),
            arrays["duration"][k].tolist(),
            bool(arrays["few"][k]),
            float(arrays["rms"][k]),
            int(arrays["reports"][k]),
        )
        for k, name in enumerate(arrays["aircraft"])
    }


def packed_sums(sums: Mapping[str, AircraftSums]) -> Arrays:
    """Sums of aircraft without a curve as arrays, but for blocks, which are for curves alone."""
    every = list(sums.values())
    counts = [(one.reports, one.flights, one.compass_points, one.status) for one in every]
    found: Arrays = {
        "aircraft": np.array(list(sums), dtype=np.str_),
        # of no aircraft it would be of one dimension
        "counts": np.array(counts, dtype=np.int64).reshape(-1, 4),
        "field": np.array([one.field for one in every], dtype=np.float64),
    }
    for part in ("fit", "constant"):
        fits = [getattr(one, part) for one in every]
        known = [fit for fit in fits if fit is not None]
        found[f"{part}/known"] = np.array([fit is not None for fit in fits], dtype=np.bool_)
        numbers = [[float(getattr(fit, name)) for name in _NUMBERS] for fit in known]
        found[f"{part}/numbers"] = np.array(numbers).reshape(-1, len(_NUMBERS))
        for name in _OF_FIT if known else ():
            values = [getattr(fit, name) for fit in known]
            # end to end with their shapes: matrices of fits differ in size, and .npz holds no
            # objects unpickled
            found[f"{part}/{name}"] = np.concatenate([one.ravel() for one in values])
            found[f"{part}/{name}/shape"] = np.array([one.shape for one in values])
    return found


def unpacked_sums(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, AircraftSums]:
    """Undo :func:`packed_sums`."""
    fit, constant = (_unpacked_fits(arrays, part) for part in ("fit", "constant"))
    found = {}
    for k, name in enumerate(arrays["aircraft"]):
        reports, flights, points, status = map(int, arrays["counts"][k])
        field = float(arrays["field"][k])
        found[str(name)] = AircraftSums(
            reports, flights, points, fit[k], status, field, constant[k]
        )
    return found


def _unpacked_fits(
    arrays: Mapping[str, NDArray[np.generic]], part: str
) -> list[AircraftFit | None]:
    known, numbers = arrays[f"{part}/known"], arrays[f"{part}/numbers"]
    columns = []
    for name in _OF_FIT if known.any() else ():
        shapes, values = arrays[f"{part}/{name}/shape"], arrays[f"{part}/{name}"]
        parts = _slices(shapes.prod(axis=1))
        columns.append(
            [values[own].reshape(shape) for own, shape in zip(parts, shapes, strict=True)]
        )
    found: list[AircraftFit | None] = [None] * known.size
    for row, k in enumerate(np.flatnonzero(known)):
        own = dict(zip(_OF_FIT, (column[row] for column in columns), strict=True))
        told = dict(zip(_NUMBERS, map(float, numbers[row]), strict=True))
        # numbers were stored as floats, whether it converged among them
        fit = AircraftFit(**own, **told)  # type: ignore[arg-type]
        found[k] = replace(fit, converged=bool(fit.converged))
    return found


def packed(periods: Mapping[str, PeriodSums]) -> Arrays:
    """Sums of some aircraft as arrays."""
    every = list(periods.values())
    found: Arrays = {"aircraft": np.array(list(periods), dtype=np.str_)}
    if not every:
        return found
    found |= {
        "reports": np.array([one.reports for one in every]),
        "field": np.array([one.field for one in every]),
        "points": np.array([one.points for one in every]),
        "flights": np.array([one.day.size for one in every]),
        "day": np.concatenate([one.day for one in every]),
    }
    for k in range(len(every[0].parts)):
        parts = [one.parts[k] for one in every]
        own: Arrays = {
            "normal": np.array([part.normal for part in parts]),
            "score": np.array([part.score for part in parts]),
            "totals": np.array([[getattr(part, name) for name in _TOTALS] for part in parts]),
            "scatter": np.array([_numbers(part.scatter) for part in parts]),
            "flight_score": np.concatenate([part.flight_score for part in parts]),
            "speeds": np.array([one.speeds[k] for one in every]),
        }
        # only aircraft of few flights keep matrices by flight: they end where `few` says so
        with_normals = [part.flight_normal for part in parts if part.flight_normal is not None]
        own["few"] = np.array([part.flight_normal is not None for part in parts])
        if with_normals:
            own["flight_normal"] = np.concatenate(with_normals)
        if every[0].cuts:
            own |= _packed_blocks(parts, [one.cuts[k] for one in every])
        found |= {f"{k}/{name}": values for name, values in own.items()}
    return found


def unpacked(arrays: Stored) -> dict[str, PeriodSums]:
    """Undo :func:`packed`."""
    names = [str(name) for name in arrays["aircraft"]]
    if not names:
        return {}
    # each member of a pool has sums of its own, numbered from 0
    members = sum(name.endswith("/normal") for name in arrays)
    flights = _slices(arrays["flights"])
    each = [_unpacked_member(arrays, k, flights) for k in range(members)]
    return {
        name: PeriodSums(
            int(arrays["reports"][row]),
            float(arrays["field"][row]),
            arrays["points"][row],
            arrays["day"][flights[row]],
            [member[row][0] for member in each],
            [cut for member in each if (cut := member[row][1]) is not None],
            [arrays[f"{k}/speeds"][row] for k in range(members)],
        )
        for row, name in enumerate(names)
    }


def _numbers(scatter: Scatter | None) -> tuple[float, float, float]:
    if scatter is None:
        raise ValueError("a period was summed without a scatter")
    return scatter.along, scatter.cross, scatter.part


def _packed_blocks(parts: list[PassSums], cuts: list[Cut]) -> Arrays:
    """Sums of blocks, an aircraft after the other."""
    sums = [part.block for part in parts if part.block is not None]
    return {
        "block": np.concatenate(sums, axis=1),
        "blocks": np.array([cut.count.size for cut in cuts]),
        **{
            name: np.concatenate([getattr(cut, name) for cut in cuts])
            for name in ("count", "segment", "opens")
        },
        **{name: np.concatenate([getattr(cut.middle, name) for cut in cuts]) for name in _WHERE},
    }


def _unpacked_member(
    arrays: Stored, k: int, flights: list[slice]
) -> list[tuple[PassSums, Cut | None]]:
    own = {
        name.split("/", 1)[1]: values for name, values in arrays.items() if name.startswith(f"{k}/")
    }
    blocks = _slices(own["blocks"]) if "blocks" in own else None
    few, place = own["few"], 0
    found = []
    for row, flight in enumerate(flights):
        normals = None
        if few[row]:
            number = flight.stop - flight.start
            normals = own["flight_normal"][place : place + number]
            place += number
        some = None if blocks is None else blocks[row]
        part = PassSums(
            own["normal"][row],
            own["score"][row],
            own["flight_score"][flight],
            normals,
            **dict(zip(_TOTALS, map(float, own["totals"][row]), strict=True)),
            block=None if some is None else own["block"][:, some],
            scatter=Scatter(*map(float, own["scatter"][row])),
        )
        found.append((part, None if some is None else _cut(own, some)))
    return found


def _cut(own: Stored, some: slice) -> Cut:
    middle = Places(*(own[name][some] for name in _WHERE))
    return Cut(own["count"][some], middle, own["segment"][some], own["opens"][some])


def _slices(sizes: NDArray[np.generic]) -> list[slice]:
    stop = np.cumsum(sizes).tolist()
    return [
        slice(end - size, end) for end, size in zip(stop, np.asarray(sizes).tolist(), strict=True)
    ]
