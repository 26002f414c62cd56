"""One table of every variable airswing writes: name, unit, CF standard name, meaning, type.

Assumes SI units inside a Dataset except where the field speaks otherwise (angles in degrees,
magnetic field in nanotesla, lead time in hours). A variable that is not in the table cannot be
written: :func:`describe` refuses it, so every product carries the same names and units.

Valid for the Datasets of the stages and for the NetCDF products (CF-1.11).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr

from airswing.flags import (
    CORRECTION,
    GROUND_VECTOR_SOURCE,
    ICING,
    PHASE,
    PLATFORM,
    REPORTED_HEADING_USE,
    ROLL,
    SCREENING,
    STATUS,
    TEMPERATURE_QC,
    WIND_QC,
    WIND_SOURCE,
)


@dataclass(frozen=True)
class Variable:
    """What one variable is."""

    name: str  # its name in every Dataset and product
    units: str  # UDUNITS string; empty where the variable has no unit (strings, flags)
    long_name: str  # what it is, for a person
    dims: tuple[str, ...]  # its dimensions
    dtype: str = "f4"  # type on disk
    standard_name: str = ""  # CF standard name where one exists
    flags: Mapping[str, int] | None = None  # meanings of a flag variable
    bits: bool = False  # the flags are bits that may be set together

    def attributes(self) -> dict[str, object]:
        """CF attributes of the variable."""
        found: dict[str, object] = {"long_name": self.long_name}
        if self.units:
            found["units"] = self.units
        if self.standard_name:
            found["standard_name"] = self.standard_name
        if self.standard_name == "air_temperature":
            found["units_metadata"] = "temperature: on_scale"
        if self.flags is not None:
            codes = np.array(list(self.flags.values()), dtype=self.dtype)
            found["flag_masks" if self.bits else "flag_values"] = codes
            found["flag_meanings"] = " ".join(self.flags)
        return found


_R, _A, _RR, _RA = ("report",), ("aircraft",), ("reference", "report"), ("reference", "aircraft")
_RAC = ("reference", "aircraft", "coefficient")
_V = Variable

_REPORTS = [
    _V("aircraft", "", "aircraft identifier (tail number)", _A, "str", "platform_id"),
    _V("row_size", "1", "number of reports of the aircraft", _A, "i4"),
    _V("platform", "", "kind of reports the aircraft sends", _A, "i1", "", PLATFORM),
    _V("time", "", "time of the report", _R, "datetime64[ns]", "time"),
    _V("latitude", "degrees_north", "latitude", _R, "f8", "latitude"),
    _V("longitude", "degrees_east", "longitude", _R, "f8", "longitude"),
    _V("pressure", "Pa", "air pressure", _R, "f4", "air_pressure"),
    _V(
        "pressure_altitude",
        "m",
        "pressure altitude (ICAO standard atmosphere)",
        _R,
        "f4",
        "barometric_altitude",
    ),
    _V("eastward_wind", "m s-1", "reported eastward wind", _R, "f4", "eastward_wind"),
    _V("northward_wind", "m s-1", "reported northward wind", _R, "f4", "northward_wind"),
    _V("air_temperature", "K", "reported air temperature", _R, "f4", "air_temperature"),
    _V("roll_flag", "", "roll angle flag", _R, "i1", "", ROLL),
    _V("temperature_qc", "", "quality of the temperature", _R, "i1", "", TEMPERATURE_QC),
    _V("wind_qc", "", "quality of the wind given by the source", _R, "i1", "", WIND_QC),
    _V("phase", "", "phase of flight", _R, "i1", "", PHASE),
    _V("icing", "", "icing protection", _R, "i1", "", ICING),
    _V(
        "wind_source",
        "",
        "whether the wind was reported, or derived from heading, airspeed and ground vector",
        _R,
        "i1",
        "",
        WIND_SOURCE,
    ),
    _V("flight", "1", "number of the flight, unique over the archive", _R, "i4"),
    _V(
        "reported_airspeed",
        "m s-1",
        "true airspeed as reported",
        _R,
        "f4",
        "platform_speed_wrt_air",
    ),
    _V("reported_heading", "degree", "true heading as reported", _R, "f4", "platform_orientation"),
    _V("position_resolution", "degree", "resolution of position found in the data", _A, "f8"),
    _V("time_resolution", "s", "resolution of time found in the data", _A, "f8"),
    _V("wind_speed_resolution", "m s-1", "resolution of wind speed found in the data", _A, "f8"),
    _V(
        "wind_direction_resolution",
        "degree",
        "resolution of wind direction found in the data",
        _A,
        "f8",
    ),
]

_WINDS = [
    _V("reference", "", "reference model or pool of models", ("reference",), "str"),
    _V(
        "reference_eastward_wind",
        "m s-1",
        "reference eastward wind at the report",
        _RR,
        "f4",
        "eastward_wind",
    ),
    _V(
        "reference_northward_wind",
        "m s-1",
        "reference northward wind at the report",
        _RR,
        "f4",
        "northward_wind",
    ),
    _V("lead_time", "h", "lead time of the reference wind", _RR, "f4"),
    *[
        _V(f"reference_{way}_wind_{kind}", units, f"{text} of the reference {way} wind", _RR)
        for way in ("eastward", "northward")
        for kind, units, text in (
            ("tendency", "m s-2", "time derivative"),
            ("lnp_derivative", "m s-1", "derivative by the logarithm of pressure"),
            ("x_derivative", "s-1", "eastward derivative"),
            ("y_derivative", "s-1", "northward derivative"),
        )
    ],
    _V("grid_convergence", "degree", "angle from the model grid's north to true north", _RR),
    _V("unread_messages", "1", "problems met in reading the reference", ("reference",), "i4"),
    _V("decoded_messages", "1", "messages read for the reference", ("reference",), "i8"),
    _V("decoded_bytes", "byte", "length of the messages read", ("reference",), "i8"),
    _V("decoding_seconds", "s", "time spent reading, summed over threads", ("reference",), "f8"),
]

_HEADINGS = [
    _V("ground_speed", "m s-1", "ground speed", _R, "f4", "platform_speed_wrt_ground"),
    _V(
        "track",
        "degree",
        "track over ground, clockwise from true north",
        _R,
        "f4",
        "platform_course",
    ),
    _V("ground_eastward_velocity", "m s-1", "eastward ground velocity", _R),
    _V("ground_northward_velocity", "m s-1", "northward ground velocity", _R),
    _V("ground_velocity_error", "m s-1", "standard error of each ground velocity component", _R),
    _V("turn", "degree", "change of track at the report", _R),
    _V("longitudinal_acceleration", "m s-2", "acceleration along the track", _R),
    _V("climb_rate", "m s-1", "rate of change of pressure altitude", _R),
    _V(
        "bank",
        "degree",
        "bank angle of a coordinated turn at the report's turn rate",
        _R,
        "f4",
        "platform_roll",
    ),
    _V(
        "heading",
        "degree",
        "indicated heading, clockwise from true north",
        _R,
        "f4",
        "platform_orientation",
    ),
    _V(
        "heading_standard_error",
        "degree",
        "standard error of the indicated heading at the report",
        _R,
    ),
    _V("magnetic_heading", "degree", "indicated magnetic heading", _R),
    _V("airspeed", "m s-1", "true airspeed the unit used", _R, "f4", "platform_speed_wrt_air"),
    _V("heading_error", "degree", "indicated minus reference heading", _RR),
    _V(
        "heading_error_standard_error",
        "degree",
        "standard error of the heading error from the ground velocity",
        _RR,
    ),
    _V("airspeed_error", "m s-1", "indicated minus reference airspeed", _RR),
    _V(
        "ground_vector_source",
        "",
        "origin of the ground vector of the report",
        _R,
        "i1",
        "",
        GROUND_VECTOR_SOURCE,
    ),
    _V(
        "reported_heading_use",
        "",
        "whether reported heading and airspeed give the ground vector, or why not",
        _A,
        "i1",
        "",
        REPORTED_HEADING_USE,
    ),
    _V("declination", "degree", "magnetic declination (IGRF), east positive", _R),
    _V("horizontal_field", "nT", "horizontal intensity of the magnetic field (IGRF)", _R),
    _V("dip", "degree", "magnetic dip (IGRF), downward positive", _R),
    _V(
        "screening",
        "",
        "why a report was left out; 0 where it was kept",
        _R,
        "i4",
        "",
        SCREENING,
        True,
    ),
]

_FITS = [
    _V("coefficient", "", "Archibald Smith coefficient", ("coefficient",), "str"),
    _V("coefficient_2", "", "Archibald Smith coefficient", ("coefficient_2",), "str"),
    _V("component", "", "wind component", ("component",), "str"),
    _V(
        "deviation",
        "degree",
        "coefficients of the heading error A + B sin m + C cos m + "
        "D sin 2m + E cos 2m, m the indicated magnetic heading",
        _RAC,
        "f8",
    ),
    _V(
        "deviation_covariance",
        "degree2",
        "covariance of the coefficients, clustered by day (by flight without shared error)",
        (*_RAC, "coefficient_2"),
        "f8",
    ),
    _V("offset", "degree", "offset of the sinusoid offset + amplitude sin(m + phase)", _RA, "f8"),
    _V("amplitude", "degree", "amplitude of the sinusoid", _RA, "f8"),
    _V("offset_standard_error", "degree", "standard error of the offset", _RA, "f8"),
    _V("amplitude_standard_error", "degree", "standard error of the amplitude", _RA, "f8"),
    _V("phase_standard_error", "degree", "standard error of the phase", _RA, "f8"),
    _V("harmonics", "1", "number of cycles fitted", _RA, "i1"),
    _V("airspeed_scale", "1", "relative error of the airspeed", _RA, "f8"),
    _V("airspeed_scale_standard_error", "1", "standard error of the airspeed scale", _RA, "f8"),
    _V(
        "reference_bias",
        "m s-1",
        "bias of the reference wind common to the fleet",
        ("reference", "component"),
        "f8",
    ),
    _V(
        "reference_bias_standard_error",
        "m s-1",
        "standard error of the reference bias",
        ("reference", "component"),
        "f8",
    ),
    _V("report_count", "1", "reports used", _RA, "i4"),
    _V("flight_count", "1", "flights used", _RA, "i4"),
    _V("compass_points", "1", "occupied compass points of eight", _RA, "i1"),
    _V("condition_number", "1", "condition number of the heading design", _RA, "f8"),
    _V("residual_rms_before", "degree", "rms heading error before the fit", _RA, "f8"),
    _V("residual_rms_after", "degree", "rms heading error after the fit", _RA, "f8"),
    _V(
        "mean_horizontal_field",
        "nT",
        "mean horizontal intensity of the magnetic field over the reports used: the one-cycle "
        "coefficients B and C are those at this field and scale with its inverse",
        _RA,
        "f8",
    ),
    _V(
        "held_out_improvement",
        "m2 s-2",
        "decrease of the mean square vector disagreement with the reference on held-out days, "
        "the reference's bias removed",
        _RA,
        "f8",
    ),
    _V(
        "held_out_improvement_standard_error",
        "m2 s-2",
        "standard error of the improvement on held-out days, clustered by day",
        _RA,
        "f8",
    ),
    _V(
        "shared_error_regions",
        "1",
        "regions into which the shared error of the reference was divided",
        ("reference",),
        "i2",
    ),
    _V("mean_declination", "degree", "mean declination over the reports used", _A, "f8"),
    _V("status", "", "whether the fit is to be trusted, or why not", _RA, "i1", "", STATUS),
    _V(
        "table_heading", "degree", "indicated magnetic heading of the table's node", ("node",), "f8"
    ),
    _V("table_correction", "degree", "correction at the table's node", (*_RA, "node"), "f8"),
    _V("table_residual_rms", "degree", "rms difference of table and fitted curve", _RA, "f8"),
    _V("change_count", "1", "changes of the compass within the fitted period", _A, "i1"),
    _V(
        "change_p_value",
        "1",
        "expected number of changes as clear as this aircraft's in a fleet without any, at most 1",
        _A,
        "f8",
    ),
    _V("change_rms", "degree", "rms over the compass of the largest change", _A, "f8"),
    _V("change_date", "", "first day after the largest change", _A, "datetime64[ns]"),
    _V("change_date_low", "", "earliest such day, 95 % interval", _A, "datetime64[ns]"),
    _V("change_date_high", "", "latest such day, 95 % interval", _A, "datetime64[ns]"),
]

_CORRECTED = [
    _V("corrected_eastward_wind", "m s-1", "corrected eastward wind", _R, "f4", "eastward_wind"),
    _V("corrected_northward_wind", "m s-1", "corrected northward wind", _R, "f4", "northward_wind"),
    _V(
        "corrected_wind_standard_error",
        "m s-1",
        "standard error of the corrected wind, as a vector, against a right compass's report",
        _R,
    ),
    _V("corrected_heading", "degree", "corrected heading, clockwise from true north", _R),
    _V(
        "correction_applied",
        "",
        "whether the correction was applied, or why not",
        _R,
        "i1",
        "",
        CORRECTION,
    ),
]

_P4 = ("reference", "state", "flight_phase", "layer")
_PROFILES = [
    _V("state", "", "whether the wind is as reported or as corrected", ("state",), "str"),
    _V("flight_phase", "", "phase of flight", ("flight_phase",), "str"),
    *[
        _V(f"{name}_rms{suffix}", units, f"{text}rms error of the {what}", _P4)
        for name, units, what in (
            ("eastward", "m s-1", "eastward wind"),
            ("northward", "m s-1", "northward wind"),
            ("direction", "degree", "wind direction where the reference wind is 5 m/s or more"),
        )
        for suffix, text in (("", ""), ("_standard_error", "standard error of the "))
    ],
    _V("profile_count", "1", "reports in the cell", _P4, "i4"),
    _V("profile_flights", "1", "flights in the cell", _P4, "i4"),
    _V("layer_bottom_pressure", "Pa", "pressure at the bottom of the layer", ("layer",)),
    _V("layer_top_pressure", "Pa", "pressure at the top of the layer", ("layer",)),
]

_MAPS = [
    ("heading_map", "degree", "mean heading error", ("aircraft", "octant")),
    ("level_map_cross", "m s-1", "mean residual across the heading", ("phase", "level")),
    ("level_map_along", "m s-1", "mean residual along the heading", ("phase", "level")),
    ("region_map_u", "m s-1", "mean eastward residual", ("latitude", "longitude")),
    ("region_map_v", "m s-1", "mean northward residual", ("latitude", "longitude")),
    ("time_line", "degree", "mean heading error of the week", ("aircraft", "week")),
    (
        "time_line_along",
        "m s-1",
        "mean residual along the heading of the week",
        ("aircraft", "week"),
    ),
]
_GAP = [
    *[
        _V(name + suffix, units, text + meaning, dims, "f8")
        for name, units, meaning, dims in _MAPS
        for suffix, text in (("", ""), ("_standard_error", "standard error of the "))
    ],
    _V("octant", "degree", "magnetic heading at the middle of the octant", ("octant",), "f8"),
    _V("phase", "", "phase of flight", ("phase",), "str"),
    _V("level", "hPa", "pressure at the middle of the layer", ("level",), "f8"),
    _V("latitude", "degrees_north", "latitude of the box", ("latitude",), "f8", "latitude"),
    _V("longitude", "degrees_east", "longitude of the box", ("longitude",), "f8", "longitude"),
    _V("week", "1", "weeks since the first report", ("week",), "i4"),
    _V("day", "", "day of the statistics", ("day",), "datetime64[ns]", "time"),
    _V("core_column", "", "design column of the catalogue", ("core_column",), "str"),
    _V("core_column_2", "", "design column of the catalogue", ("core_column_2",), "str"),
    _V("score", "1", "whitened score of a design column", ("aircraft", "day", "core_column"), "f8"),
    _V(
        "information",
        "1",
        "whitened products of design columns",
        ("aircraft", "core_column", "core_column_2"),
        "f8",
    ),
    _V("report_count", "1", "reports of the day", ("aircraft", "day"), "f8"),
    _V("clipped_count", "1", "residuals clipped at five robust standard deviations", _A, "f8"),
    _V("gross_error_count", "1", "residuals taken as gross errors", _A, "f8"),
    _V("effect", "", "candidate effect", ("effect",), "str"),
    _V(
        "log_evidence",
        "1",
        "log evidence at its best, each effect found taken out in turn",
        ("effect",),
        "f8",
    ),
    _V(
        "aircraft_probability",
        "1",
        "probability that the effect acts on the aircraft",
        ("effect", "aircraft"),
        "f8",
    ),
    _V("distance", "km", "distance along the flight", ("distance",), "f8"),
    _V("noise_distance", "km", "distance along the flight", ("distance",), "f8"),
    _V("noise_autocovariance", "m2 s-2", "autocovariance of the residual", ("distance",), "f8"),
    _V(
        "noise_autocovariance_model",
        "m2 s-2",
        "autocovariance of the noise model",
        ("distance",),
        "f8",
    ),
    _V("noise_level", "hPa", "pressure of the noise model's node", ("noise_level",), "f8"),
    _V(
        "noise_level_factor", "1", "noise of the level relative to the mean", ("noise_level",), "f8"
    ),
    _V("pit_bin", "1", "lower edge of the bin", ("pit_bin",), "f8"),
    _V("pit_count", "1", "held-out reports in the bin, effects in", ("pit_bin",), "i4"),
    _V(
        "pit_count_before", "1", "held-out reports in the bin, effects left out", ("pit_bin",), "i4"
    ),
]

_PLS = ("flight_phase", "layer", "state")
_OBSERVATION_ERRORS = [
    *[
        _V(f"{name}{kind}", units, f"{before}{text}", (*dims, *more), "f8")
        for name, units, text, dims in (
            (
                "observation_error",
                "m s-1",
                "standard error of a wind component of the reports alone",
                _PLS,
            ),
            (
                "fleet_observation_error",
                "m s-1",
                "standard error of a wind component of the reports alone, over all reports",
                ("state",),
            ),
            (
                "observation_error_by_method",
                "m s-1",
                "standard error of a wind component of the reports alone, by way of separating it",
                ("way", *_PLS),
            ),
            (
                "fleet_observation_error_by_method",
                "m s-1",
                "standard error of a wind component over all reports, by way of separating it",
                ("way", "state"),
            ),
            (
                "aircraft_observation_error",
                "m s-1",
                "standard error of a wind component of the aircraft's reports alone",
                ("aircraft", "state"),
            ),
            (
                "weight_gain",
                "1",
                "reported winds that a corrected one weighs as in an analysis",
                _PLS[:2],
            ),
            (
                "fleet_weight_gain",
                "1",
                "reported winds that a corrected one weighs as, over all reports",
                (),
            ),
            (
                "reference_error_covariance",
                "m2 s-2",
                "covariance of the errors of two references, a component, from neighbours",
                (),
            ),
        )
        for kind, before, more in (("", "", ()), ("_interval", "95 % interval: ", ("bound",)))
    ],
    _V(
        "observation_error_filled",
        "m s-1",
        "observation_error, and where it is not known that of the layer, else of all reports",
        _PLS,
        "f8",
    ),
    _V("way", "", "how the reports' error was separated", ("way",), "str"),
    _V("observation_count", "1", "reports in the cell", _PLS[:2], "i8"),
    _V("disagreement_rms", "m s-1", "rms disagreement of a component with the reference", _PLS),
    _V("median_wind_speed", "m s-1", "median speed of the reference wind", ("layer",)),
    _V("wrfda_tamdar_error", "m s-1", "wind error WRFDA uses for TAMDAR", ("layer",)),
    _V("wrfda_airep_error", "m s-1", "wind error WRFDA uses for AIREP and AMDAR", ("layer",)),
    _V("nam_tamdar_error", "m s-1", "wind error NAM used for TAMDAR", ("layer",)),
    _V("nam_mdcrs_error", "m s-1", "wind error NAM used for MDCRS", ("layer",)),
]
_CELL = ("reference", "state", "aircraft", "flight_phase", "layer")
_CLASSES = ("reference", "state", "eastward_class", "northward_class")
_INNOVATIONS = [
    *[
        _V(
            f"innovation_{name}_{kind}",
            units,
            f"{text} of the {what}, observation minus reference",
            _CELL,
        )
        for name, units, what in (
            ("speed", "m s-1", "wind speed"),
            ("direction", "degree", "wind direction where the reference wind is 5 m/s or more"),
            ("eastward", "m s-1", "eastward wind"),
            ("northward", "m s-1", "northward wind"),
        )
        for kind, text in (
            ("bias", "mean innovation"),
            ("standard_deviation", "standard deviation of the innovation"),
            ("rms", "root mean square innovation"),
        )
    ],
    *[
        _V(f"innovation_{name}_count", "1", f"innovations of the {name} in the cell", _CELL, "i4")
        for name in ("speed", "direction", "eastward", "northward")
    ],
    *[
        _V(
            f"daily_innovation_{name}",
            "degree" if name == "direction" else "m s-1",
            f"mean innovation of the {name} on the day",
            (*_CELL[:3], "day"),
        )
        for name in ("speed", "direction", "eastward", "northward")
    ],
    _V("daily_innovation_count", "1", "innovations of the day", (*_CELL[:3], "day"), "i4"),
    _V("innovation_histogram", "1", "reports by the innovation of both components", _CLASSES, "i8"),
    *[
        _V(
            f"{name}_class",
            "m s-1",
            f"lower edge of the class of {name} innovations",
            (f"{name}_class",),
            "f8",
        )
        for name in ("eastward", "northward")
    ],
]
_STATIONS = ("variable", "station", "forecast_reference_time", "lead")
_SCORED = ("variable", "period", "correction")
_POSTPROCESS = [
    _V("variable", "", "variable that is forecast and observed", ("variable",), "str"),
    _V("variable_units", "", "unit of the variable's values and errors", ("variable",), "str"),
    _V("station", "", "station", ("station",), "str", "platform_id"),
    _V("latitude", "degrees_north", "latitude of the station", ("station",), "f8", "latitude"),
    _V("longitude", "degrees_east", "longitude of the station", ("station",), "f8", "longitude"),
    _V("altitude", "m", "altitude of the station", ("station",), "f8", "altitude"),
    _V("pressure", "Pa", "pressure at the middle of the layer", ("station",), "f8", "air_pressure"),
    _V(
        "forecast_reference_time",
        "",
        "start of the forecast",
        ("forecast_reference_time",),
        "datetime64[ns]",
        "forecast_reference_time",
    ),
    _V("lead", "h", "lead time of the forecast", ("lead",), "f8", "forecast_period"),
    _V(
        "valid_time",
        "",
        "valid time of the forecast",
        ("forecast_reference_time", "lead"),
        "datetime64[ns]",
        "time",
    ),
    _V("forecast", "", "forecast, in variable_units", _STATIONS),
    _V("observation", "", "observation at the valid time, in variable_units", _STATIONS),
    _V(
        "corrected_forecast",
        "",
        "forecast less the bias a Kalman filter knew when it started, in variable_units",
        _STATIONS,
    ),
    _V(
        "running_mean_forecast",
        "",
        "forecast less the mean error of the last days when it started, in variable_units",
        _STATIONS,
    ),
    _V(
        "mean_of_pairs_forecast",
        "",
        "forecast less the mean error of the last pairs known at its start, in variable_units",
        _STATIONS,
    ),
    _V(
        "held_out",
        "1",
        "1 where the day took no part in choosing the ratio",
        ("forecast_reference_time",),
        "i1",
    ),
    _V(
        "ratio",
        "1",
        "ratio of variances of the filter: of the bias's daily change to noise; 0: not corrected",
        ("variable",),
        "f8",
    ),
    _V("ratio_chosen", "1", "1 where the training days chose the ratio", ("variable",), "i1"),
    _V("period", "", "days that are scored", ("period",), "str"),
    _V("correction", "", "how the forecast was corrected", ("correction",), "str"),
    _V("bound", "", "end of the 95 % interval", ("bound",), "str"),
    _V("pair_count", "1", "pairs of forecast and observation", ("variable", "period"), "i8"),
    *[
        _V(
            f"{name}{suffix}{kind}",
            "1" if name == "skill" else "",
            f"{before}{text}{after}",
            (*dims, *more),
            "f8",
        )
        for name, text in (
            ("forecast_error_mean", "mean error of the forecast, in variable_units"),
            ("forecast_error_centred_rms", "rms of the error less its mean, in variable_units"),
            ("forecast_error_rms", "rms error of the forecast, in variable_units"),
            ("skill", "one minus mean square error over that of the raw forecast"),
        )
        for suffix, after, dims in (
            ("", "", _SCORED),
            ("_by_lead", ", by lead", (*_SCORED, "lead")),
            (
                "_by_station",
                ", by station, on the days held out",
                ("variable", "correction", "station"),
            ),
        )
        for kind, before, more in (("", "", ()), ("_interval", "95 % interval: ", ("bound",)))
    ],
]

_PHASE_ANGLE = _V("phase", "degree", "phase of the sinusoid", _RA, "f8")
_EVERY = [
    *_REPORTS,
    *_WINDS,
    *_HEADINGS,
    *_FITS,
    _PHASE_ANGLE,
    *_CORRECTED,
    *_PROFILES,
    *_INNOVATIONS,
    *_GAP,
    *_POSTPROCESS,
    *_OBSERVATION_ERRORS,
]

# Every variable by name; where one name serves several dimensions, its first meaning.
VARIABLES: dict[str, Variable] = {entry.name: entry for entry in reversed(_EVERY)}


def lookup(name: str, dims: tuple[Hashable, ...] = ()) -> Variable:
    """Entry of a variable.

    Parameters
    ----------
    dims : tuple of str, optional
        Tells the phase of a fit (reference, aircraft) from the phase of flight (report), and a
        report's latitude from a map's.

    Raises
    ------
    KeyError
        If the table has no such variable.
    """
    if name not in VARIABLES:
        raise KeyError(f"{name!r} is not in airswing.vocabulary; add it there first")
    same = (entry for entry in _EVERY if entry.name == name and entry.dims == tuple(dims))
    return next(same, VARIABLES[name])


def describe(ds: xr.Dataset) -> xr.Dataset:
    """Write units, names and flag meanings on every variable of a Dataset.

    Returns
    -------
    Dataset
        The same data with the table's attributes; other attributes are kept.

    Raises
    ------
    KeyError
        If a variable is not in the table.
    """
    ds = ds.copy()
    for name, variable in ds.variables.items():
        variable.attrs = {**variable.attrs, **lookup(str(name), variable.dims).attributes()}
    return ds
