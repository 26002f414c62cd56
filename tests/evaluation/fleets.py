"""Simulated field tests with a known answer, shared by tests and benchmarks.

The wind error of a report is the sum of a day's model error shared by the fleet, the flight's,
white noise, and a vector of fixed length per aircraft that represents the compass error; the
expected mean magnitude is then that of a Rice distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np
import xarray as xr
from scipy.stats import rice

from airswing.flags import ROLL, TEMPERATURE_QC
from airswing.units import KNOT

BEFORE_START = date(2009, 7, 20)
START = date(2009, 10, 20)


@dataclass
class Fleet:
    """One simulated fleet and its true adjusted reduction (kt)."""

    headings: xr.Dataset
    corrected: list[str]
    controls: list[str]
    true_before: dict[str, float]
    true_during: dict[str, float]

    @property
    def true_adjusted(self) -> float:
        fall = {
            group: self.true_before[group] - self.true_during[group] for group in self.true_before
        }
        return fall["corrected"] - fall["controls"]


def simulate_fleet(
    seed: int,
    *,
    corrected: int = 19,
    controls: int = 17,
    days: tuple[int, int] = (60, 60),
    flights: int = 3,
    reports: int = 6,
    noise_kt: tuple[float, float] = (5.4, 6.4),
    compass_kt: tuple[float, float, float, float] = (5.0, 2.6, 1.5, 1.5),
) -> Fleet:
    """Draw a fleet; ``compass_kt`` is corrected before, during, controls before, during."""
    rng = np.random.default_rng(seed)
    number, per_day = corrected + controls, flights * reports
    names = [f"N{i:03d}" for i in range(number)]
    day = np.repeat(np.arange(sum(days)), per_day)
    during = (day >= days[0]).astype(int)
    shape = (number, day.size, 2)
    # the day's error of the fleet, that of the flight, and that of the report
    error = rng.normal(size=(sum(days), 2))[day] + rng.normal(size=shape)
    flight = np.repeat(np.arange(sum(days) * flights), reports)
    error += rng.normal(size=(number, flight[-1] + 1, 2))[:, flight]
    error *= np.array(noise_kt)[during][:, None] / np.sqrt(3.0)
    # a vector of fixed length (aircraft, window) in a random direction
    size = np.repeat([compass_kt[:2], compass_kt[2:]], [corrected, controls], axis=0)
    size = size * rng.gamma(20.0, 1.0 / 20.0, (number, 1))
    angle = rng.uniform(0, 2 * np.pi, shape[:2])
    error += size[:, during, None] * np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    east, north = error.reshape(-1, 2).T * KNOT
    hour = np.tile(np.linspace(1.0, 23.0, per_day), sum(days))
    time = np.datetime64(START - timedelta(days=days[0]), "s") + (
        day * 86400 + (hour * 3600).astype(int)
    ).astype("m8[s]")
    zeros = np.zeros((1, east.size))
    headings = xr.Dataset(
        {
            "row_size": ("aircraft", np.full(number, day.size)),
            "time": ("report", np.tile(time, number).astype("M8[ns]")),
            "eastward_wind": ("report", east),
            "northward_wind": ("report", north),
            "reference_eastward_wind": (("reference", "report"), zeros),
            "reference_northward_wind": (("reference", "report"), zeros),
            "heading": ("report", rng.uniform(0, 360, east.size)),
            "roll_flag": ("report", np.full(east.size, ROLL["good"], np.int8)),
            "temperature_qc": ("report", np.full(east.size, TEMPERATURE_QC["pass"], np.int8)),
            "screening": ("report", np.zeros(east.size, np.int32)),
        },
        coords={"aircraft": names, "reference": ["rr"]},
    )
    true = rice.mean(size / noise_kt, scale=noise_kt)  # (aircraft, window)
    before, fall = (
        {"corrected": float(part[:corrected].mean()), "controls": float(part[corrected:].mean())}
        for part in true.T
    )
    return Fleet(headings, names[:corrected], names[corrected:], before, fall)
