"""Content of an export: the arguments, the reports, identifiers and platforms of the aircraft.

A report is exported when every screening rule let it pass, except the rules the configuration
accepts (by default ``phase`` and ``field_test``). Reports without a model wind are omitted, because
they could not be checked for gross errors; for corrected winds also reports without a correction or
corrected by a constant only. The platform comes from the configuration, else from the reports, else
it is TAMDAR; the code after ``FM-`` decides how a reader treats a report.
"""

from __future__ import annotations

import fnmatch
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.config import Handover
from airswing.errors import InputError
from airswing.flags import CORRECTION, FREE_OF_DEVIATION, PHASE, PLATFORM, SCREENING
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.physics.great_circle import central_angle
from airswing.physics.triangle import wrap_degrees
from airswing.products.netcdf import open_product, product_path
from airswing.products.ragged import aircraft_of_report, blocks
from airswing.reports.columns import LIMITS
from airswing.reports.flights import number_of_run
from airswing.units import EARTH_RADIUS

Rows = NDArray[np.void]
Mask = NDArray[np.bool_]

_FROM = {
    "latitude": "latitude",
    "longitude": "longitude",
    "pressure": "pressure",
    "temperature": "air_temperature",
    "error": "corrected_wind_standard_error",
    "phase": "phase",
}
ROW = np.dtype(
    [("time", "i8"), ("report", "i8"), ("aircraft", "i4"), ("phase", "i1")]
    + [(name, "f8") for name in (*_FROM, "u", "v") if name != "phase"]
)
"""One wind: s since 1970, number of its report (equal for the levels of a sounding), index of the
aircraft, flight phase; degrees, Pa, K, standard error of the correction (vector, m/s), m/s."""
_REQUIRED = ("time", "latitude", "longitude", "screening", "phase", "flight")
_POLE = 89.999  # degrees; nearer to a pole a reader cannot rotate a wind direction
# s since 1970; OBSPROC accepts years that begin with 19 or 20.
_FIRST_TIME, _END_TIME = (
    int(np.datetime64(year, "s").astype(np.int64)) for year in ("1900", "2100")
)
_NO_TIME = np.iinfo(np.int64).min

_LARGEST_GAP = 600  # s between reports of one sounding; in a climb they are closer
_LEAST_STEP = 2.0  # Pa between levels; OBSPROC merges levels less than 1 Pa apart
_MOST_LEVELS = 1000  # WRFDA cuts reports of more than 1001 levels

PLATFORMS = tuple(name for name in PLATFORM if name != "unknown")
CODES = {
    "TAMDAR": "FM-101 TAMDAR",
    "AMDAR": "FM-42 AMDAR",
    "ACARS": "FM-97 ACARS",
    "AIREP": "FM-97 AIREP",
}
"""Platform in LITTLE_R and ob.ascii."""
_LONGEST_IDENTIFIER = 40  # columns of LITTLE_R, ob.ascii and OBS_DOMAIN
_LARGEST_NUMBER = 99_999  # WRFDA's bias correction reads identifiers as five-digit numbers


# --- arguments ---------------------------------------------------------------------------------

Winds = Literal["corrected", "reported"]
ERRORS = "observation_errors.nc"


@dataclass(frozen=True)
class Request:
    """Arguments of one export, common to all formats."""

    corrected: xr.Dataset  # corrected reports, in memory or opened lazily
    path: Path  # file or folder to write
    folder: bool  # whether it is a folder
    settings: Handover  # of the configuration, with the options of the command
    winds: Winds = "corrected"
    window: float | None = None  # s; each window of time gets a file
    soundings: bool = False  # join every ascent and descent into one report
    overwrite: bool = False
    products: Path | None = None  # folder of the run's other products

    @property
    def aircraft(self) -> list[str]:
        """Names of all aircraft, in the order of the product."""
        return [str(name) for name in self.corrected["aircraft"].to_numpy()]


def product_of_run(request: Request, name: str, *, why: str) -> xr.Dataset:
    """Open another product of the same run lazily; ``why`` it is needed is part of the message."""
    if request.products is None:
        raise InputError(
            f"the product {name} is needed: {why}",
            field="corrected",
            remedy="Give the path of a run's corrected winds instead of a Dataset",
        )
    path = product_path(request.products, name)
    if not path.exists():
        raise InputError(
            f"no such product, and it is needed: {why}",
            file=path,
            remedy="Run `airswing run` with the same configuration first",
        )
    return open_product(path)


def refuse_existing(request: Request, *targets: Path) -> None:
    """Raise InputError where a file would be replaced without ``overwrite``."""
    for target in targets:
        if target.is_dir() or (target.exists() and not request.overwrite):
            raise InputError(
                "already exists",
                file=target,
                remedy="Choose another name with -o, or give --overwrite",
            )


# --- reports -----------------------------------------------------------------------------------


@dataclass
class Selected:
    """Reports to export, and counts of those omitted or moved."""

    rows: Rows  # of `ROW`
    order: NDArray[np.int64]  # of the rows by time, report and descending pressure
    left_out: Counter[str]  # reports by reason
    soundings: Counter[str]  # joined, split, shallow
    farthest: float = 0.0  # m that joining moved a report
    longest: float = 0.0  # s that joining moved a report


def selected_rows(
    request: Request, *, above: float = 0.0, largest_step: float = np.inf, least_depth: float = 0.0
) -> Selected:
    """Select the reports of an archive and put them in order of time; InputError if none remains.

    Reports at the pressure ``above`` and lower ones are left out as ``above_80_hPa``. A joined
    sounding is split where levels differ by more than ``largest_step``; one shallower than
    ``least_depth`` is written as single levels (all Pa).
    """
    prefix = "corrected_" if request.winds == "corrected" else ""
    winds = f"{prefix}eastward_wind", f"{prefix}northward_wind"
    present = set(map(str, request.corrected.variables))
    for name in (*winds, *_REQUIRED, *(("correction_applied",) if prefix else ())):
        if name not in present:
            raise InputError(
                "the reports lack a variable that the export needs",
                field=name,
                remedy="Export the corrected product of a run, or the result of airswing.correct "
                "for screened headings",
            )
    if not {"pressure", "pressure_altitude"} & present:
        raise InputError("the reports have no level", field="pressure")
    size = request.corrected.sizes["report"]
    selected = Selected(np.empty(size, ROW), np.zeros(0, int), Counter(), Counter())
    number_of_rows = first_aircraft = 0
    names = (*_REQUIRED, *winds, *_FROM.values(), "pressure_altitude", "correction_applied")
    for block in blocks(request.corrected, tuple(dict.fromkeys(names))):
        rows = _all_rows(block, winds)
        rows["aircraft"] = aircraft_of_report(block) + first_aircraft
        first_aircraft += block.sizes["aircraft"]
        reasons = _reasons(rows, block, request)
        # Rounded as written, since WRF compares the value in the file.
        reasons["above_80_hPa"] = np.round(rows["pressure"], 3) <= above
        is_left = np.ones(rows.size, dtype=bool)
        for reason, bad in reasons.items():  # a report counts under the first reason that holds
            selected.left_out[reason] += int(np.count_nonzero(is_left & bad))
            is_left &= ~bad
        rows = rows[is_left]
        rows["report"] = np.arange(number_of_rows, number_of_rows + rows.size)
        if request.soundings and rows.size:
            flight = block["flight"].to_numpy()[is_left]
            _join_soundings(rows, flight, largest_step, least_depth, selected)
        selected.rows[number_of_rows : number_of_rows + rows.size] = rows
        number_of_rows += rows.size
    selected.left_out = +selected.left_out
    if not number_of_rows:
        counts = ", ".join(f"{reason} {n:,}" for reason, n in selected.left_out.items())
        raise InputError(
            "no report is left to export",
            found=counts or "no reports",
            remedy="See the reasons: fit more aircraft, choose another period, or --winds reported",
        )
    rows = selected.rows = selected.rows[:number_of_rows]
    selected.order = np.lexsort((-rows["pressure"], rows["report"], rows["time"]))
    return selected


def _all_rows(block: xr.Dataset, winds: tuple[str, str]) -> Rows:
    rows = np.zeros(block.sizes["report"], dtype=ROW)
    time = block["time"].to_numpy().astype("datetime64[ms]").astype(np.int64)
    # To the nearest second: no format holds parts of one.
    rows["time"] = np.where(time == _NO_TIME, time, (time + 500) // 1000)
    for name, variable in (_FROM | dict(zip("uv", winds, strict=True))).items():
        rows[name] = block[variable].to_numpy() if variable in block else np.nan
    if "pressure_altitude" in block:
        unknown = np.isnan(rows["pressure"])
        altitude = block["pressure_altitude"].to_numpy()[unknown]
        rows["pressure"][unknown] = pressure_from_altitude(altitude)
    with np.errstate(invalid="ignore"):  # an infinite longitude becomes NaN
        rows["longitude"] = wrap_degrees(rows["longitude"])
    low, high = LIMITS["air_temperature"]
    possible = (rows["temperature"] >= low) & (rows["temperature"] <= high)
    rows["temperature"][~possible] = np.nan
    return rows


def _reasons(rows: Rows, block: xr.Dataset, request: Request) -> dict[str, Mask]:
    start, end = request.settings.start, request.settings.end
    accepted = request.settings.accept
    time, pressure = rows["time"], rows["pressure"]
    reasons = {
        "no_time": time == _NO_TIME,
        "impossible_time": (time < _FIRST_TIME) | (time >= _END_TIME),
    }
    if start is not None:
        reasons["before_the_period"] = time < start.timestamp()
    if end is not None:
        reasons["after_the_period"] = time >= end.timestamp()
    with np.errstate(invalid="ignore"):
        latitude, speed = np.abs(rows["latitude"]), np.hypot(rows["u"], rows["v"])
        low, high = LIMITS["pressure"]
        reasons |= {
            "no_position": ~(latitude <= 90.0) | np.isnan(rows["longitude"]),
            "at_a_pole": latitude > _POLE,
            "no_wind": np.isnan(speed),
            "impossible_wind": speed > LIMITS["wind_speed"][1],
            "no_level": np.isnan(pressure),
            "impossible_level": (pressure < low) | (pressure > high),
        }
    if request.winds == "corrected":
        applied = block["correction_applied"].to_numpy()
        for name, code in CORRECTION.items():
            if code not in FREE_OF_DEVIATION and name not in accepted:
                reasons[f"not_corrected_{name}"] = applied == code
    screening = block["screening"].to_numpy()
    for name, bit in SCREENING.items():
        if name not in accepted:
            reasons[f"screened_out_{name}"] = (screening & bit) > 0
    return reasons


def _join_soundings(
    rows: Rows,
    flight: NDArray[np.int64],
    largest_step: float,
    least_depth: float,
    selected: Selected,
) -> None:
    """Give the levels of each sounding one report number, place and time, in place.

    A sounding is a run of reports of one flight in ascent or in descent without a gap over
    `_LARGEST_GAP`. It has the place and time of its middle report, since the formats hold one for
    all levels. A second report at the same pressure (level flight), a run of one report, and a
    sounding of less than ``least_depth`` remain single reports. Rows are whole aircraft in order of
    aircraft and time.
    """
    run = _runs(rows, flight)
    order = np.lexsort((np.arange(rows.size), -rows["pressure"], run))
    members, run = order, run[order]
    step = -np.diff(rows["pressure"][members])
    # If levels are too close to each other, the earlier report keeps the level.
    repeated = np.r_[False, (np.diff(run) == 0) & (step < _LEAST_STEP)]
    members, run = members[~repeated], run[~repeated]
    pressure = rows["pressure"][members]
    parted = np.r_[False, (np.diff(run) == 0) & (-np.diff(pressure) > largest_step)]
    selected.soundings["split"] += int(np.count_nonzero(parted))
    run = run + np.cumsum(parted)
    begins = np.flatnonzero(np.diff(run, prepend=-1))
    levels = np.diff(begins, append=members.size)
    depth = pressure[begins] - pressure[begins + levels - 1]
    shallow = (levels > 1) & (depth < least_depth)
    selected.soundings["shallow"] += int(np.count_nonzero(shallow))
    selected.soundings["joined"] += int(np.count_nonzero((levels > 1) & ~shallow))
    members = members[np.lexsort((members, run))]  # in order of time within a sounding
    middle = np.repeat(members[begins + (levels - 1) // 2], levels)
    joined = np.repeat(~shallow, levels)
    members, middle = members[joined], middle[joined]
    if members.size:
        places = (
            np.radians(rows[name][index])
            for index in (members, middle)
            for name in ("latitude", "longitude")
        )
        moved_by = EARTH_RADIUS * float(central_angle(*places).max())
        selected.farthest = max(selected.farthest, moved_by)
        waiting = np.abs(rows["time"][members] - rows["time"][middle])
        selected.longest = max(selected.longest, float(waiting.max()))
    for name in ("report", "time", "latitude", "longitude"):
        rows[name][members] = rows[name][middle]


def _runs(rows: Rows, flight: NDArray[np.int64]) -> NDArray[np.int32]:
    """Number of the run each report belongs to, from 0 in order."""
    phase, time = rows["phase"], rows["time"]
    climbing = (phase == PHASE["ascent"]) | (phase == PHASE["descent"])
    place = np.arange(rows.size)
    gaps = np.cumsum(np.diff(time, prepend=time[0]) > _LARGEST_GAP)
    run = number_of_run(phase, flight, rows["aircraft"], np.where(climbing, -1, place), gaps)
    start = np.flatnonzero(np.diff(run, prepend=-1))[run]
    return number_of_run(run, (place - start) // _MOST_LEVELS)


# --- aircraft ----------------------------------------------------------------------------------


def identifiers(request: Request) -> list[str]:
    """Identifier of every aircraft in the files: its name, or a number of five digits.

    An aircraft whose name is a number keeps it; the others get unused numbers. A name that is too
    long or not printable is refused: changed it could be that of another aircraft.
    """
    names = request.aircraft
    for name in names:
        if len(name) > _LONGEST_IDENTIFIER or not (name.isascii() and name.isprintable() and name):
            raise InputError(
                f"the format takes an aircraft identifier of 1 to {_LONGEST_IDENTIFIER} characters "
                "of printable ASCII",
                field="aircraft",
                found=ascii(name[:120]),
                remedy="Give the aircraft a shorter name in the reports and run again",
            )
    if request.settings.identifiers == "tail":
        return names
    if len(names) > _LARGEST_NUMBER:
        raise InputError("more aircraft than numbers of five digits", found=len(names))
    holder: dict[int, str] = {}
    for name in names:
        if name.isdigit() and 0 < int(name) <= _LARGEST_NUMBER:
            holder.setdefault(int(name), name)
    number_of = {name: number for number, name in holder.items()}
    free = (number for number in range(1, _LARGEST_NUMBER + 1) if number not in holder)
    return [f"{number_of.get(name) or next(free):05d}" for name in names]


def platforms(request: Request) -> NDArray[np.int8]:
    """Platform of every aircraft, as index (aircraft,) of `PLATFORMS`."""
    asked, names = request.settings, request.aircraft
    reported = [PLATFORM["unknown"]] * len(names)
    if "platform" in request.corrected:
        reported = request.corrected["platform"].to_numpy().tolist()
    words = {code: name for name, code in PLATFORM.items()} | {PLATFORM["unknown"]: "TAMDAR"}
    patterns = [(glob, platform) for platform, globs in asked.aircraft.items() for glob in globs]
    codes = []
    for name, code in zip(names, reported, strict=True):
        default = words[code] if asked.platform == "auto" else str(asked.platform)
        matched = (platform for glob, platform in patterns if fnmatch.fnmatchcase(name, glob))
        codes.append(PLATFORMS.index(next(matched, default)))
    return np.array(codes, dtype=np.int8)
