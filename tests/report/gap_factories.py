"""A small made-up diagnosis, and its maps."""

import numpy as np
import xarray as xr
from pydantic import TypeAdapter

from airswing.gap.result.schema import GapReport

TAILS = [f"N{401 + k}" for k in range(14)]


def effect(name, *tails, **changes):
    """Return an effect found on aircraft."""
    return {
        "name": name,
        "probability": 0.99,
        "tails": list(tails),
        "parameters": {},
        "standard_errors": {},
        "period": None,
        "scope": "aircraft",
        "evidence_nats": 90.0,
    } | changes


def iron(*tails, **changes):
    """Return a hard iron on aircraft."""
    return effect(
        "hard_iron",
        *tails,
        parameters={"amplitude_deg": 3.912, "phase_deg": 40.0},
        standard_errors={"amplitude_deg": 0.2, "phase_deg": 1.0},
        **changes,
    )


def place(**changes):
    """Return an error by temperature that no catalogue effect explains."""
    cells = {"edges": [np.linspace(-60.0, 10.0, 9).tolist()], "labels": [], "m_s": []}
    cells |= {"values": np.linspace(-1.0, 1.0, 8).tolist(), "unit": "m/s"}
    return {
        "component": "across_heading",
        "variable": "temperature",
        "variables": ["temperature"],
        "tails": ["N403", "N404", "N405"],
        "scope": "aircraft",
        "group": "fleet",
        "evidence_nats": 90.0,
        "size_m_s": 1.0,
        "curve": cells | {"variable_units": ["°C"]},
        "closure": {"reduction": 3.3, "reduction_ci": [3.0, 3.6]},
        "probability": 0.97,
        "nearest_effect": "tas_scale",
        "nearest_effect_share": 0.22,
        "settled_by": "a recording of the raw sensors",
        "title": "linear in temperature",
    } | changes


def share(of_gap, q_value):
    """Return numbers of one slice of the gap."""
    numbers = {"share_of_gap": of_gap, "q_value": q_value, "p_value": q_value, "energy": 1.0}
    return {"component": "both", "group": "", "curve": {"labels": [], "m_s": []}} | numbers


def counts(days=45, aircraft=14):
    """Return numbers of reports, days and aircraft."""
    none = dict.fromkeys(("flights", "gross"), 0)
    return {"reports": 30600, "days": days, "aircraft": aircraft} | none


def content(*effects, **changes):
    """Return a diagnosis."""
    places = changes.pop("places", [])
    closure = {"before": 8.31, "after": 6.27, "ci": [6.1, 6.4], "held_out": True}
    closure |= {"fraction_of_excess": 1.0, "reduction": 2.04, "reduction_ci": [1.9, 2.2]}
    row = {"scope": "aircraft", "known": True, "posterior": [0.01] * 14, "subset": []}
    sections = {
        "gap": {"mean_vector_disagreement_kt": 8.31, "noise_floor_kt": 6.2, "significance": 1e-9},
        "where": [{"variable": "aircraft", "values": ["N401", "N402"]} | share(0.71, 2e-4)],
        "slices": [{"variable": "level", "values": ["above 400 hPa"]} | share(0.03, 0.3)],
        "effects": list(effects),
        "unknown": {"present": bool(places), "where": places},
        "closure": closure | changes.pop("closure", {}),
        "counts": counts(),
        "untestable": {"altitude_offset": "too few climbs <and> descents"},
        "evidence": [
            row | {"name": "hard_iron", "instead_of": "hard_iron", "evidence_nats": 5230.0},
            row | {"name": "soft_iron", "instead_of": "hard_iron", "evidence_nats": 320.0},
            row | {"name": "table", "instead_of": None, "evidence_nats": 9e3, "known": False},
        ],
        "noise": {
            "correlated_sd_m_s": 1.5,
            "white_sd_m_s": 2.0,
            "length_km": 120.0,
            "across_heading": 1.1,
            "along_heading": 0.9,
            "distance_km": [0.0, 100.0, None],
            "autocovariance": [2.2, 1.0, None],
            "autocovariance_model": [2.2, 0.9, 0.1],
            "height_ln_p": 0.1,
            **{f"{name}_sd_m_s": () for name in ("day_field", "climatology")},
            **{f"level_{name}": () for name in ("hPa", "factor")},
        },
    }
    return TypeAdapter(GapReport).validate_python(sections | changes)


def maps():
    """Return the maps of gap.nc."""
    rng = np.random.default_rng(1)
    heading = rng.normal(0, 2, (14, 8))
    heading[3, 2] = np.nan
    cells = {
        "heading_map": (("aircraft", "octant"), heading),
        "heading_map_standard_error": (("aircraft", "octant"), np.full((14, 8), 0.4)),
        "level_map_cross": (("phase", "level"), rng.normal(0, 1, (4, 6))),
        "level_map_along": (("phase", "level"), rng.normal(0, 1, (4, 6))),
        "region_map_u": (("latitude", "longitude"), rng.normal(0, 1, (3, 4))),
        "region_map_v": (("latitude", "longitude"), rng.normal(0, 1, (3, 4))),
        "time_line": (("aircraft", "week"), rng.normal(0, 1, (14, 5))),
        "pit_count": ("pit_bin", np.full(20, 100)),
        "pit_count_before": ("pit_bin", np.arange(20) * 10),
        "day": ("day_number", np.datetime64("2009-07-01", "ns") + np.arange(30) * 86400 * 10**9),
    }
    coords = {
        "aircraft": TAILS,
        "octant": np.arange(8) * 45.0,
        "phase": ["unknown", "ascent", "cruise", "descent"],
        "level": [200.0, 450.0, 550.0, 650.0, 775.0, 975.0],
        "latitude": [40.0, 42.0, 44.0],
        "longitude": [-90.0, -88.0, -86.0, -84.0],
        "week": np.arange(5),
    }
    return xr.Dataset(cells, coords=coords)
