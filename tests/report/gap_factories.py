"""Made-up content of gap.json and gap.nc, with every optional key the page knows."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from tests.report.factories import names


def gap() -> dict[str, Any]:
    """Return the content of gap.json: two compass faults, one of them at a date."""
    return {
        "gap": {"mean_vector_disagreement_kt": 7.4, "noise_floor_kt": 6.3, "significance": 1e-4},
        "where": [
            {
                "variable": "aircraft",
                "values": ["N404", "N410"],
                "share_of_gap": 0.71,
                "q_value": 0.0002,
            },
            {
                "variable": "magnetic_heading",
                "values": ["one cycle"],
                "share_of_gap": 0.6,
                "q_value": 0.001,
            },
            {
                "variable": "level",
                "values": ["above 400 hPa"],
                "share_of_gap": 0.03,
                "q_value": 0.3,
            },
        ],
        "effects": [
            {
                "name": "hard_iron",
                "probability": 0.99,
                "tails": ["N404", "N410"],
                "parameters": {"amplitude_deg": 3.912, "phase_deg": 40.12},
                "standard_errors": {"amplitude_deg": 0.2, "phase_deg": 3.1},
                "period": None,
                "ambiguous_with": ["soft_iron"],
                "share_of_gap": 0.61,
                "would_separate": ["flights farther north, where the field is weaker"],
            },
            {
                "name": "compass_step",
                "probability": 0.97,
                "tails": ["N402"],
                "parameters": {"offset_deg": 1.5},
                "standard_errors": {"offset_deg": 0.06},
                "period": ["2009-07-20", None],
                "ambiguous_with": [],
                "share_of_gap": 0.1,
            },
        ],
        "unknown": {"present": False, "where": []},
        "closure": {
            "before": 7.4,
            "after": 6.5,
            "ci": [6.4, 6.65],
            "fraction_of_excess": 0.87,
            "held_out": True,
            "reports": 30000,
            "steps": [
                {"name": "hard_iron", "after": 6.7, "ci": [6.6, 6.8]},
                {"name": "compass_step", "after": 6.5, "ci": [6.4, 6.65]},
            ],
        },
        "evidence": [
            {"name": "hard_iron", "log_evidence": 5230.0},
            {"name": "compass_step", "log_evidence": 400.0},
            {"name": "tas_scale", "log_evidence": -2.0},
        ],
        "not_testable": {"heater_current": "no icing flag in the reports"},
        "would_tell": ["icing flags"],
    }


def maps(aircraft: int = 14, seed: int = 3) -> xr.Dataset:
    """Return the content of gap.nc with every array the page can draw."""
    rng = np.random.default_rng(seed)
    heading = np.arange(7.5, 360, 15)
    row = ("aircraft", "heading_bin")
    size = (aircraft, heading.size)
    across = rng.normal(0, 0.4, size)
    across[3] += 4 * np.sin(np.radians(heading + 40))
    level, place = ("flight_phase", "layer"), ("map_latitude", "map_longitude")
    day = np.datetime64("2009-07-01", "ns") + np.arange(45).astype("m8[D]")
    lag = np.arange(10.0, 400.0, 25.0)
    return xr.Dataset(
        {
            "residual_across_heading": (row, across),
            "residual_along_heading": (row, rng.normal(0, 0.3, size)),
            "heading_count": (row, rng.integers(0, 400, size)),
            "level_residual_along": (level, rng.normal(0, 0.3, (3, 5))),
            "level_residual_across": (level, rng.normal(0, 0.3, (3, 5))),
            "level_count": (level, rng.integers(0, 3000, (3, 5))),
            "map_eastward_residual": (place, rng.normal(0, 0.5, (16, 20))),
            "map_northward_residual": (place, rng.normal(0, 0.5, (16, 20))),
            "map_count": (place, rng.integers(0, 60, (16, 20))),
            "timeline_disagreement": (("series", "day"), rng.normal(7, 0.3, (2, 45))),
            "timeline_disagreement_half_width": (("series", "day"), np.full((2, 45), 0.4)),
            "timeline_count": (("series", "day"), np.full((2, 45), 300)),
            "aircraft_probability": (("effect", "aircraft"), rng.random((3, aircraft)) ** 9),
            "noise_correlation": ("lag", 0.8 * np.exp(-lag / 150)),
            "noise_correlation_half_width": ("lag", np.full(lag.size, 0.02)),
            "noise_correlation_model": ("lag", 0.78 * np.exp(-lag / 155)),
            "noise_pairs": ("lag", np.full(lag.size, 9000)),
            "pit_count": ("pit_bin", rng.multinomial(30000, np.full(20, 0.05))),
            "pit_count_before": ("pit_bin", rng.multinomial(30000, np.full(20, 0.05))),
        },
        coords={
            "aircraft": names(aircraft),
            "heading_bin": heading,
            "lag": lag,
            "flight_phase": ["ascent", "cruise", "descent"],
            "layer": ["1000-850", "850-700", "700-500", "500-300", "300-200"],
            "map_latitude": np.arange(30.0, 46.0),
            "map_longitude": np.arange(-95.0, -75.0),
            "series": ["N404", "rest of the fleet"],
            "day": day,
            "effect": ["hard_iron", "compass_step", "tas_scale"],
        },
    )
