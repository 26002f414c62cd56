"""Report tables for the tests: one plain row, and whole flights, in canonical columns."""

import json

import numpy as np
import pandas as pd


def row(**values):
    """One good report with some values replaced."""
    return {
        "tail": "N412XJ",
        "time": "2009-01-05T12:00:00Z",
        "latitude": 41.5,
        "longitude": -87.25,
        "pressure_altitude_ft": 20000,
        "wind_direction_deg": 270,
        "wind_speed_kt": 40,
        "temperature_degC": -20.0,
        "roll_flag": "G",
        "temperature_qc": "pass",
        **values,
    }


def flight(
    *,
    start="2009-01-05T12:00:00",
    seconds=None,
    longitude=-87.0,
    speed=120.0,
    altitude_ft=20000.0,
    **values,
):
    """Reports of a flight due east at a steady speed (m/s), in canonical columns."""
    seconds = np.arange(10) * 180.0 if seconds is None else np.asarray(seconds, dtype=float)
    degrees = longitude + speed * seconds / (111_195.0 * np.cos(np.radians(41.5)))
    return pd.DataFrame(
        {
            "tail": "N412XJ",
            "time": pd.Timestamp(start) + pd.to_timedelta(np.round(seconds), unit="s"),
            "latitude": 41.5,
            "longitude": (degrees + 180.0) % 360.0 - 180.0,
            "pressure_altitude_ft": altitude_ft,
            "wind_direction_deg": 270,
            "wind_speed_kt": 40,
            **values,
        }
    )


def write(path, rows):
    """Write rows as CSV; an absent value is an empty field."""
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def audit_of(reports):
    """Counts of the reading of a Dataset."""
    return json.loads(reports.attrs["reading_audit"])
