"""Reports as text files for WRF 4.7: OBS_DOMAIN (nudging), LITTLE_R (OBSPROC) and ob.ascii (WRFDA).

OBS_DOMAIN (share/wrf_fddaobs_in.F, formats 101 to 104). Quality 129 on both components marks the
wind as earth-relative. u = v = 0 means missing: a wind that rounds to calm gets an eastward
component of 0.001 m/s. ``is_sound`` is true for a single level too: false makes a surface report.
At 80 hPa and above no wind is used. ACARS reports are written as ``FM-97 AIREP`` with ACARS as
source, because names with ACARS overwrite each other. WRF does not use a sounding with two levels
more than 200 hPa apart: it is split there; one of less than 150 hPa would reach fewer points than
its reports and is written as single levels.

LITTLE_R (var/obsproc/src/module_decoded.F90). The wind counts as speed and direction only, the
direction in (0.001, 360] degrees and the speed at least 0.1 m/s. Pressure alone gives the level:
with a height of quality 0 OBSPROC replaces the pressure; a missing height has quality 1. The
elevation is 0: OBSGRID drops a level whose height equals the elevation. Names are unique, because
reports of one place and name are merged; so are levels less than 1 Pa apart. Quality is 0: 129
would reject the wind here.

ob.ascii (var/da/da_obs_io/da_read_obs_ascii.inc, ``ob_format = 2``). The error of the speed weighs
both components. Every error is positive and has its decimal point, also that of a missing value,
whose quality is -88. The elevation is missing: a TAMDAR report whose height equals its elevation is
a surface report.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.handover.records import MISSING, Columns, Format, speed_and_direction, write_records
from airswing.handover.selection import CODES, ERRORS, PLATFORMS, Request, Rows, selected_rows
from airswing.handover.wind_errors import WindErrors, known_errors

_CODES = [CODES[name] for name in PLATFORMS]

# --- OBS_DOMAIN --------------------------------------------------------------------------------

HIGHEST = 8000.0  # Pa; WRF takes no wind at this pressure and above
CALM = 0.001  # m/s; smallest component the format holds
LARGEST_STEP = 20_000.0  # Pa between levels; default of ``obs_max_sndng_gap`` (20 cbar)
LEAST_DEPTH = 15_000.0  # Pa; twice the reach of a single level
# Format 104: pairs of value and quality of pressure, height, temperature, u, v and humidity.
_NO_PAIR = "-888888.000 -888888.000 "
_EARTH_RELATIVE = "    129.000 "


def _domain_columns(rows: Rows, platform: NDArray[np.int8]) -> Columns:
    # Rounded to the three decimals of the format.
    calm = np.hypot(np.round(rows["u"], 3), np.round(rows["v"], 3)) == 0.0
    return {
        "quality": np.where(np.isnan(rows["temperature"]), MISSING, 0.0),
        "u": np.where(calm, CALM, rows["u"]),
        "v": np.where(calm, 0.0, rows["v"]),
    }


OBS_DOMAIN = Format(
    file_name="OBS_DOMAIN101",
    before=" %(date)14s\n  %(latitude)9.4f %(longitude)9.4f \n"
    "  %(identifier)-40s   %(name)-40s   \n"
    "  %(code)-16s  %(platform)-16s  -888888.     T     F  %(levels)5d\n",
    level=f" %(pressure)11.3f       0.000 {_NO_PAIR}%(temperature)11.3f %(quality)11.3f "
    f"%(u)11.3f {_EARTH_RELATIVE}%(v)11.3f {_EARTH_RELATIVE}{_NO_PAIR}\n",
    columns=_domain_columns,
    texts={
        "code": [CODES["AIREP" if name == "ACARS" else name] for name in PLATFORMS],
        "platform": PLATFORMS,
    },
)


def write_obs_domain(request: Request) -> dict[str, Any]:
    """Write reports for WRF's observation nudging.

    ``max_obs`` of the result is for the namelist; WRF stops at more observations than that.
    """
    domain = request.settings.domain
    match = re.fullmatch(r"OBS_DOMAIN(\d)01", request.path.name)
    if match and not request.folder and int(match[1]) != domain:
        raise InputError(
            "WRF reads a file of this name for another domain",
            file=request.path,
            found=f"domain {domain}",
            remedy=f"Name it OBS_DOMAIN{domain}01 or give --domain {match[1]}",
        )
    selected = selected_rows(
        request, above=HIGHEST, largest_step=LARGEST_STEP, least_depth=LEAST_DEPTH
    )
    result = write_records(
        request, selected, replace(OBS_DOMAIN, file_name=f"OBS_DOMAIN{domain}01")
    )
    result["max_obs"] = max(file["levels"] for file in result["files"]) + 2
    result["notes"] += [
        f"WRF namelist, &fdda: max_obs = {result['max_obs']} holds every file whole"
    ]
    return result


# --- LITTLE_R ----------------------------------------------------------------------------------

SLOWEST = 0.10001  # m/s; OBSPROC takes slower winds as missing
LEAST_DIRECTION = 0.00101  # degrees; OBSPROC takes smaller ones as missing
_NO_VALUE = "-888888.00000      0"


def _little_r_columns(rows: Rows, platform: NDArray[np.int8]) -> Columns:
    speed, direction = speed_and_direction(rows["u"], rows["v"], least=LEAST_DIRECTION)
    return {
        "height_quality": np.where(platform == PLATFORMS.index("TAMDAR"), 0, 1),
        "speed": np.maximum(speed, SLOWEST),
        "direction": direction,
    }


LITTLE_R = Format(
    file_name="obs.little_r",
    # Latitude, longitude, identifier, name, platform, source, elevation; numbers of fields, errors,
    # warnings, order, duplicates; sounding, bogus, discarded; seconds since a date and a Julian day
    # that no reader uses, the date, 13 surface values.
    before="%(latitude)20.5f%(longitude)20.5f%(identifier)-40s%(name)-40s%(code)-40s%(source)-40s"
    f"{'0.00000':>20}%(levels)10d{0:10}{0:10}%(number)10d{0:10}{'T':>10}{'F':>10}{'F':>10}"
    f"{-888888:10}{-888888:10}{'':6}%(date)14s{_NO_VALUE * 13}\n",
    # Pairs of a value (F13.5) and its quality (I7): pressure, height, temperature, dew point,
    # speed, direction, u, v, humidity, thickness.
    level="%(pressure)13.5f      0-888888.00000%(height_quality)7d%(temperature)13.5f      0"
    f"{_NO_VALUE}%(speed)13.5f      0%(direction)13.5f      0{_NO_VALUE * 4}\n",
    after=f"{'-777777.00000      0' * 2}%(levels)13.5f      0{_NO_VALUE * 7}\n"
    f"%(levels)7d{0:7}{0:7}\n",
    columns=_little_r_columns,
    texts={"code": _CODES},
)


def write_little_r(request: Request) -> dict[str, Any]:
    """Write reports for OBSPROC or OBSGRID."""
    source = [f"airswing {request.winds} {name}" for name in PLATFORMS]
    form = replace(LITTLE_R, texts={**LITTLE_R.texts, "source": source})
    result = write_records(request, selected_rows(request), form)
    most = max(file["reports"] for file in result["files"])
    result["notes"] += [
        f"OBSPROC namelist, &record3: max_number_of_obs of {most} or more; its exit status "
        "is always 0: compare the TOTAL in its output"
    ]
    if request.soundings:
        result["notes"] += [
            "OBSPROC namelist, &record4: qc_test_convective_adj = .FALSE., or it changes the "
            "temperatures of soundings"
        ]
    return result


# --- ob.ascii ----------------------------------------------------------------------------------

_KINDS = (
    "SYNOP METAR SHIP BUOY BOGUS TEMP",
    "AMDAR AIREP TAMDAR PILOT SATEM SATOB",
    "GPSPW GPSZD GPSRF GPSEP SSMT1 SSMT2",
    "TOVS QSCAT PROFL AIRSR OTHER",
)
_FORMATS = (
    "INFO  = PLATFORM, DATE, NAME, LEVELS, LATITUDE, LONGITUDE, ELEVATION, ID.\n"
    "SRFC  = SLP, PW (DATA,QC,ERROR).\n"
    "EACH  = PRES, SPEED, DIR, HEIGHT, TEMP, DEW PT, HUMID (DATA,QC,ERROR)*LEVELS.\n"
    "INFO_FMT = (A12,1X,A19,1X,A40,1X,I6,3(F12.3,11X),6X,A40)\n"
    "SRFC_FMT = (F12.3,I4,F7.2,F12.3,I4,F7.3)\n"
    "EACH_FMT = (3(F12.3,I4,F7.2),11X,3(F12.3,I4,F7.2),11X,3(F12.3,I4,F7.2))\n"
    f"#{78 * '-'}#\n"
)
_GAP = f"{'':11}"
# Range of F7.2 with a blank before it; an error of zero would have infinite weight.
LEAST_ERROR, LARGEST_ERROR = 0.01, 999.99


def write_ob_ascii(request: Request) -> dict[str, Any]:
    """Write reports for WRFDA."""
    selected, table = selected_rows(request), None
    if request.products is not None and (request.products / ERRORS).exists():
        table = known_errors(request, required=False)
    errors = WindErrors(request, selected.rows, table)

    def columns(rows: Rows, platform: NDArray[np.int8]) -> Columns:
        # A smaller direction would be written as 0.000.
        speed, direction = speed_and_direction(rows["u"], rows["v"], least=0.0005)
        error = errors.of(rows)
        # The angle of the component error across the wind.
        angle = np.degrees(np.arctan2(error, speed))
        return {
            "speed": speed,
            "error": np.clip(error, LEAST_ERROR, LARGEST_ERROR),
            "direction": direction,
            "angle": np.clip(angle, LEAST_ERROR, LARGEST_ERROR),
            "quality": np.where(np.isnan(rows["temperature"]), -88, 0),
        }

    form = Format(
        file_name="ob.ascii",
        header=_ob_ascii_header,
        before=f"%(code)-12s %(date_text)19s %(name)-40s %(levels)6d%(latitude)12.3f{_GAP}"
        f"%(longitude)12.3f{_GAP} -888888.000{_GAP}{'':6}%(identifier)-40s\n"
        " -888888.000 -88 200.00 -888888.000 -88  0.200\n",
        # Value, quality and error by EACH_FMT. Errors other than that of the wind are those of
        # var/obsproc/obserr.txt: 200 Pa, 1 K, 10 %.
        level="%(pressure)12.3f   0 200.00%(speed)12.3f   0%(error)7.2f"
        f"%(direction)12.3f   0%(angle)7.2f{_GAP} -888888.000 -88  10.00"
        f"%(temperature)12.3f%(quality)4d   1.00 -888888.000 -88   1.00{_GAP}"
        " -888888.000 -88  10.00\n",
        columns=columns,
        texts={"code": [code[:12] for code in _CODES]},
    )
    result = write_records(request, selected, form)
    result["errors_from"] = errors.source
    unknown = table is not None and errors.source != ERRORS
    result["notes"] += [
        f"errors of the winds from {errors.source}"
        + ", with the uncertainty of each correction" * (request.winds == "corrected")
        + f" ({ERRORS} holds none for these)" * unknown,
        "WRFDA namelist: ob_format = 2; its gross check rejects a component that departs from the "
        "first guess by more than max_error_uv (5.0) times the report's error",
    ]
    return result


def _ob_ascii_header(numbers: dict[str, int]) -> str:
    kinds = dict(numbers)
    # WRFDA counts FM-97 as AIREP.
    kinds["AIREP"] += kinds.pop("ACARS")
    lines = [
        "".join(f"{kind:<6}={kinds.get(kind, 0):7}, " for kind in line.split()) for line in _KINDS
    ]
    total = f"TOTAL ={sum(kinds.values()):7}, MISS. =-888888.,"
    return "\n".join([total, *lines, _FORMATS])
