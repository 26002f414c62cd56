"""Made-up content of gap.json, gap.nc and the details, in the shapes the diagnosis gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from tests.report.factories import names


def gap() -> dict[str, Any]:
    """Return the content of gap.json: two compass faults, one of them at a date."""
    rival = {
        "name": "soft_iron",
        "difference_nats": 2.1,
        "separated_by": "headings in more compass points",
    }
    return {
        "gap": {"mean_vector_disagreement_kt": 7.4, "noise_floor_kt": 6.3, "significance": 1e-4},
        "where": [
            slice_entry("aircraft", ["N404", "N410"], 0.71, 0.0002),
            slice_entry("magnetic_heading", ["one cycle"], 0.6, 0.001) | {"component": "cross"},
            slice_entry("level", ["above 400 hPa"], 0.03, 0.3),
        ],
        "effects": [
            {
                "name": "hard_iron",
                "probability": 0.99,
                "tails": ["N404", "N410"],
                "parameters": {"amplitude_deg": 3.912, "phase_deg": 40.12},
                "standard_errors": {"amplitude_deg": 0.2, "phase_deg": 3.1},
                "period": None,
                "scope": "aircraft",
                "ambiguous_with": ["soft_iron"],
                "ambiguity": [rival],
                "share_of_gap": 0.61,
            },
            {
                "name": "compass_step",
                "probability": 0.97,
                "tails": ["N402"],
                "parameters": {"offset_deg": 1.5},
                "standard_errors": {"offset_deg": 0.06},
                "period": ["2009-07-20", None],
                "scope": "aircraft",
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
            "reduction": 0.9,
            "reduction_ci": [0.8, 1.0],
        },
    }


def slice_entry(variable: str, values: list[str], share: float, q_value: float) -> dict[str, Any]:
    """Return one slice of the gap."""
    return {
        "variable": variable,
        "component": "both",
        "values": values,
        "share_of_gap": share,
        "q_value": q_value,
    }


def unknown_place() -> dict[str, Any]:
    """Return the place of an effect that the catalogue does not hold."""
    return {
        "component": "cross",
        "variable": "icing",
        "variables": ["icing", "magnetic_heading"],
        "tails": ["N403"],
        "curve": {"labels": ["on", "on sin", "on cos"], "m_s": [0.1, 1.4, -0.3]},
    }


def details(aircraft: int = 14) -> dict[str, Any]:
    """Return what the diagnosis tells beside gap.json."""
    posterior = [0.01] * aircraft
    distance = np.arange(10.0, 400.0, 25.0)

    def row(name: str, nats: float, instead: str | None, **extra: Any) -> dict[str, Any]:
        return {
            "name": name,
            "tempered_nats": nats,
            "instead_of": instead,
            "known": True,
            "scope": "aircraft",
            "posterior": posterior,
        } | extra

    return {
        "waterfall": [
            {"label": "reports as they are", "kt": 7.4, "step_ci": None},
            {"label": "hard_iron", "kt": 6.7, "step_ci": [0.6, 0.8]},
            {"label": "compass_step", "kt": 6.5, "step_ci": [0.15, 0.25]},
            {"label": "noise floor", "kt": 6.3, "step_ci": None},
        ],
        "evidence": [
            row("hard_iron", 5230.0, "hard_iron", posterior=[*posterior[:-1], 0.99]),
            row("soft_iron", 320.0, "hard_iron"),
            row("compass_step", 400.0, "compass_step"),
            row("hard_iron", 12.0, "compass_step"),
            row("tas_scale", -2.0, None, scope="fleet", posterior=[]),
            row("cross:icing*heading", 9000.0, None, known=False),
        ],
        "noise": {
            "correlated_sd_m_s": 2.3,
            "white_sd_m_s": 1.0,
            "length_km": 155.0,
            "distance_km": distance.tolist(),
            "autocovariance": (5.2 * np.exp(-distance / 150)).tolist(),
            "autocovariance_model": (5.3 * np.exp(-distance / 155)).tolist(),
        },
        "untestable": {"heater_current": "no icing flag in the reports"},
        "counts": {"reports": 130_000, "flights": 2400},
    }


def maps(aircraft: int = 14, seed: int = 3) -> xr.Dataset:
    """Return the content of gap.nc with every array the page can draw."""
    rng = np.random.default_rng(seed)
    octant = np.arange(8) * 45.0
    row, level, place = ("aircraft", "octant"), ("phase", "level"), ("latitude", "longitude")
    heading = rng.normal(0, 0.3, (aircraft, 8))
    heading[3] += 3 * np.sin(np.radians(octant + 40))
    cross = rng.normal(0, 0.3, (4, 6))
    cross[0] = np.nan
    return xr.Dataset(
        {
            "heading_map": (row, heading),
            "heading_map_standard_error": (row, np.full((aircraft, 8), 0.25)),
            "level_map_cross": (level, cross),
            "level_map_along": (level, cross / 2),
            "region_map_u": (place, rng.normal(0, 0.5, (8, 10))),
            "region_map_v": (place, rng.normal(0, 0.5, (8, 10))),
            "time_line": (("aircraft", "week"), rng.normal(0, 0.4, (aircraft, 7))),
            "pit_count": ("pit_bin", rng.multinomial(30000, np.full(20, 0.05))),
            "pit_count_before": ("pit_bin", rng.multinomial(30000, np.full(20, 0.05))),
        },
        coords={
            "aircraft": names(aircraft),
            "octant": octant,
            "phase": ["unknown", "ascent", "cruise", "descent"],
            "level": [200.0, 450.0, 550.0, 650.0, 775.0, 975.0],
            "latitude": np.linspace(30, 46, 8),
            "longitude": np.linspace(-95, -75, 10),
            "week": np.arange(7),
            "day": np.datetime64("2009-07-01", "ns") + np.arange(45).astype("m8[D]"),
        },
    )
