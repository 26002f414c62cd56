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
    number = corrected + controls
    treated = np.arange(number) < corrected
    spread = rng.gamma(20.0, 1.0 / 20.0, number)
    day = np.repeat(np.arange(sum(days)), flights * reports)
    during = day >= days[0]
    sd = np.where(during, noise_kt[1], noise_kt[0]) / np.sqrt(3.0)
    shared = rng.normal(size=(sum(days), 2))[day]
    pieces, true = [], {key: [] for key in ("cb", "cd", "kb", "kd")}
    for aircraft in range(number):
        flight = np.repeat(np.arange(sum(days) * flights), reports)
        of_flight = rng.normal(size=(flight.max() + 1, 2))[flight]
        white = rng.normal(size=(day.size, 2))
        first, last = compass_kt[:2] if treated[aircraft] else compass_kt[2:]
        size = np.where(during, last, first) * spread[aircraft]
        angle = rng.uniform(0, 2 * np.pi, day.size)
        compass = size[:, None] * np.column_stack([np.sin(angle), np.cos(angle)])
        pieces.append(sd[:, None] * (shared + of_flight + white) + compass)
        name = "c" if treated[aircraft] else "k"
        true[name + "b"].append(
            rice.mean(first * spread[aircraft] / noise_kt[0], scale=noise_kt[0])
        )
        true[name + "d"].append(rice.mean(last * spread[aircraft] / noise_kt[1], scale=noise_kt[1]))
    error = np.concatenate(pieces) * KNOT
    names = [f"N{i:03d}" for i in range(number)]
    origin = np.datetime64(START - timedelta(days=days[0]))
    hour = np.tile(np.linspace(1.0, 23.0, flights * reports), sum(days))
    time = (
        origin
        + np.tile(day, number).astype("m8[D]")
        + (np.tile(hour, number) * 3600).astype("m8[s]")
    )
    size = day.size
    zeros = np.zeros((1, error.shape[0]))
    headings = xr.Dataset(
        {
            "row_size": ("aircraft", np.full(number, size)),
            "time": ("report", time.astype("M8[ns]")),
            "eastward_wind": ("report", error[:, 0]),
            "northward_wind": ("report", error[:, 1]),
            "reference_eastward_wind": (("reference", "report"), zeros),
            "reference_northward_wind": (("reference", "report"), zeros),
            "heading": ("report", rng.uniform(0, 360, error.shape[0])),
            "roll_flag": ("report", np.full(error.shape[0], ROLL["good"], np.int8)),
            "temperature_qc": ("report", np.full(error.shape[0], TEMPERATURE_QC["pass"], np.int8)),
            "screening": ("report", np.zeros(error.shape[0], np.int32)),
        },
        coords={"aircraft": names, "reference": ["rr"]},
    )
    mean = {key: float(np.mean(value)) for key, value in true.items()}
    return Fleet(
        headings,
        names[:corrected],
        names[corrected:],
        {"corrected": mean["cb"], "controls": mean["kb"]},
        {"corrected": mean["cd"], "controls": mean["kd"]},
    )
