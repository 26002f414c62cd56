"""Small made-up stage Datasets, with the shape and the names of the real ones.

Aircraft fly straight legs between hubs over the Great Lakes; each compass errs by a known
curve, the references by white noise.  Enough for figures and pages, no good for accuracy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

REFERENCES = ("ruc", "rtfdaa")
POOL = "ruc+rtfdaa"
HUBS = np.array([[-87.9, 42.0], [-83.3, 42.2], [-90.0, 35.1], [-84.4, 33.6], [-93.2, 44.9]])
KNOT = 1852 / 3600


def names(aircraft: int) -> list[str]:
    """Return tail numbers N401, N402, ..."""
    return [f"N{401 + i}" for i in range(aircraft)]


def coefficients(aircraft: int, seed: int = 1) -> np.ndarray:
    """Return the true A, B, C, D, E (aircraft, 5), degrees."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, [1.0, 2.2, 2.2, 0.6, 0.6], (aircraft, 5))


def curve(values: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Heading error (degrees) of A..E at headings (degrees)."""
    m = np.radians(heading)
    basis = np.stack([np.ones_like(m), np.sin(m), np.cos(m), np.sin(2 * m), np.cos(2 * m)], -1)
    return (basis * values).sum(-1)


def headings(
    *, aircraft: int = 6, reports: int = 400, seed: int = 1, shift: float = 0.0
) -> xr.Dataset:
    """Return a HEADINGS Dataset; `shift` moves the fleet in longitude (degrees)."""
    rng = np.random.default_rng(seed)
    n = aircraft * reports
    which = np.repeat(np.arange(aircraft), reports)
    flight = np.repeat(np.arange(n // 20 + 1), 20)[:n]
    legs = rng.integers(0, len(HUBS), (flight.max() + 1, 2))
    legs[:, 1] = (legs[:, 0] + rng.integers(1, len(HUBS), len(legs))) % len(HUBS)
    along = np.tile(np.linspace(0.03, 0.97, 20), n // 20 + 1)[:n]
    start, end = HUBS[legs[flight, 0]], HUBS[legs[flight, 1]]
    place = start + along[:, None] * (end - start) + rng.normal(0, 0.12, (n, 2))
    way = (end - start) * [np.cos(np.radians(39)), 1.0]
    heading = (np.degrees(np.arctan2(way[:, 0], way[:, 1])) + rng.normal(0, 9, n)) % 360
    declination = -3.0 + 0.4 * (place[:, 0] + 87)
    magnetic = (heading - declination) % 360
    airspeed = rng.normal(128, 8, n)
    u, v = rng.normal(14, 7, n), rng.normal(2, 7, n)
    error = curve(coefficients(aircraft)[which], magnetic)
    radians = np.radians(heading)
    pushed = airspeed * np.radians(error)
    u_rep, v_rep = u - pushed * np.cos(radians), v + pushed * np.sin(radians)
    noise = rng.normal(0, 2.2, (len(REFERENCES), 2, n))
    phase = np.where(along < 0.2, 1, np.where(along > 0.8, 3, 2)).astype(np.int8)
    level = np.where(phase == 2, 45000.0, 70000.0) + rng.normal(0, 4000, n)
    screening = np.zeros(n, np.int32)
    screening[phase != 2] |= 1
    screening[rng.random(n) < 0.05] |= 8
    screening[rng.random(n) < 0.02] |= 2
    report = ("report",)
    pair = ("reference", "report")
    psi_err = error[None] + np.degrees(
        (noise[:, 0] * np.cos(radians) - noise[:, 1] * np.sin(radians)) / airspeed
    )
    return xr.Dataset(
        {
            "row_size": ("aircraft", np.full(aircraft, reports)),
            "time": (
                report,
                np.datetime64("2009-07-01", "ns")
                + (np.tile(np.arange(reports), aircraft) * 600).astype("m8[s]"),
            ),
            "latitude": (report, place[:, 1]),
            "longitude": (report, (place[:, 0] + shift + 180) % 360 - 180),
            "pressure": (report, level),
            "eastward_wind": (report, u_rep),
            "northward_wind": (report, v_rep),
            "phase": (report, phase),
            "flight": (report, flight.astype(np.int32)),
            "heading": (report, heading),
            "magnetic_heading": (report, magnetic),
            "airspeed": (report, airspeed),
            "screening": (report, screening),
            "heading_error": (pair, psi_err),
            "heading_error_standard_error": (pair, np.full((len(REFERENCES), n), 1.1)),
            "reference_eastward_wind": (pair, u + noise[:, 0]),
            "reference_northward_wind": (pair, v + noise[:, 1]),
            "lead_time": (pair, np.full((len(REFERENCES), n), 1.0)),
        },
        coords={"aircraft": names(aircraft), "reference": list(REFERENCES)},
        attrs={
            "reading_audit": '{"reports_read": 2500, "dropped": {"duplicate": 12, '
            '"impossible_position": 3}, "repaired": {"longitude_wrapped": 40}, "files": 1}'
        },
    )


def fits(*, aircraft: int = 6, seed: int = 2) -> xr.Dataset:
    """Return a FITS Dataset near the truth of :func:`headings`; the last fit is refused."""
    rng = np.random.default_rng(seed)
    reference = [*REFERENCES, POOL]
    shape = (len(reference), aircraft)
    truth = coefficients(aircraft)
    values = truth[None] + rng.normal(0, 0.06, (*shape, 5))
    covariance = np.broadcast_to(np.eye(5) * 0.06**2, (*shape, 5, 5)).copy()
    nodes = np.arange(0.0, 360.0, 45.0)
    table = -np.round(curve(values[:, :, None, :], nodes), 1)
    status = np.zeros(shape, np.int8)
    status[:, -1] = 2
    pair = ("reference", "aircraft")
    amplitude = np.hypot(values[..., 1], values[..., 2])
    whole = {
        name: (pair, np.full(shape, value))
        for name, value in {
            "report_count": 2000,
            "flight_count": 110,
            "compass_points": 8,
            "harmonics": 2,
        }.items()
    }
    reals = {
        name: (pair, np.full(shape, value))
        for name, value in {
            "offset_standard_error": 0.06,
            "amplitude_standard_error": 0.07,
            "phase_standard_error": 2.0,
            "airspeed_scale": 0.003,
            "airspeed_scale_standard_error": 0.001,
            "condition_number": 2.4,
            "residual_rms_before": 3.1,
            "residual_rms_after": 1.2,
            "table_residual_rms": 0.06,
        }.items()
    }
    return xr.Dataset(
        {
            "deviation": ((*pair, "coefficient"), values),
            "deviation_covariance": ((*pair, "coefficient", "coefficient_2"), covariance),
            "offset": (pair, values[..., 0]),
            "amplitude": (pair, amplitude),
            "phase": (pair, np.degrees(np.arctan2(values[..., 2], values[..., 1]))),
            "status": (pair, status),
            "table_heading": ("node", nodes),
            "table_correction": ((*pair, "node"), table),
            "reference_bias": (("reference", "component"), np.zeros((len(reference), 2))),
            **whole,
            **reals,
        },
        coords={
            "aircraft": names(aircraft),
            "reference": reference,
            "coefficient": list("ABCDE"),
            "coefficient_2": list("ABCDE"),
        },
    )


def corrected(source: xr.Dataset) -> xr.Dataset:
    """Return a CORRECTED Dataset: the compass curve taken out, but for the last aircraft."""
    row_size = source["row_size"].to_numpy()
    which = np.repeat(np.arange(row_size.size), row_size)
    truth = coefficients(row_size.size)
    error = curve(truth[which], source["magnetic_heading"].to_numpy())
    pushed = source["airspeed"].to_numpy() * np.radians(error)
    radians = np.radians(source["heading"].to_numpy())
    flag = np.zeros(which.size, np.int8)
    flag[which == row_size.size - 1] = 1
    done = flag == 0
    u = source["eastward_wind"].to_numpy() + np.where(done, pushed * np.cos(radians), np.nan)
    v = source["northward_wind"].to_numpy() - np.where(done, pushed * np.sin(radians), np.nan)
    return source[["time", "latitude", "longitude", "row_size", "flight"]].assign(
        corrected_eastward_wind=("report", u),
        corrected_northward_wind=("report", v),
        corrected_heading=("report", (source["heading"].to_numpy() - error) % 360),
        correction_applied=("report", flag),
    )


def field_test() -> dict[str, Any]:
    """Return the seed's Table 1 in the shape of field_test.json."""
    return {
        "groups": {
            "controls": {
                "aircraft": 17,
                "before_kt": 6.96,
                "during_kt": 8.19,
                "reduction_kt": -1.23,
                "reports_before": 21000,
                "reports_during": 9000,
            },
            "corrected": {
                "aircraft": 19,
                "before_kt": 8.86,
                "during_kt": 7.62,
                "reduction_kt": 1.24,
                "reports_before": 24000,
                "reports_during": 9900,
            },
        },
        "adjusted_reduction_kt": 2.47,
        "adjusted_reduction_ci_kt": [2.1, 2.8],
        "adjusted_reduction_quadrature_kt": 2.24,
    }


def full_field_test(seed: int = 5) -> dict[str, Any]:
    """Return :func:`field_test` with intervals, single aircraft and a permutation test."""
    rng = np.random.default_rng(seed)
    found = field_test()
    for entry in found["groups"].values():
        for key in ("before", "during", "reduction"):
            entry[f"{key}_ci_kt"] = [entry[f"{key}_kt"] - 0.3, entry[f"{key}_kt"] + 0.3]
    found["adjusted_reduction_quadrature_ci_kt"] = [1.9, 2.6]
    rows = [
        {"aircraft": f"N{i}", "group": group, "before_kt": before, "during_kt": before + change}
        for i in range(36)
        for group, level, change in [("corrected", 8.9, -1.3) if i < 19 else ("controls", 7.0, 1.2)]
        for before in [float(rng.normal(level, 0.9))]
    ]
    null = rng.normal(0, 0.5, 500)
    found["by_aircraft"] = rows
    found["permutation"] = {
        "effect_kt": 2.31,
        "p_value": 0.0005,
        "draws": 2000,
        "null_effects_kt": null.tolist(),
    }
    found["regression_to_the_mean"] = {"spurious_reduction_kt": 0.12, "rule": "the 19 worst"}
    found["matched_controls"] = {"adjusted_reduction_kt": 2.2, "mean_distance_kt": 0.8}
    return found


def sensitivity(aircraft: int = 6, seed: int = 7) -> dict[str, Any]:
    """Return a comparison of three references in the shape of sensitivity.json."""
    rng = np.random.default_rng(seed)

    def pair(one: str, two: str, *, shift: float, slice_name: str | None = None) -> dict[str, Any]:
        values = rng.normal(shift, 0.03, 5)
        fleet = {
            "aircraft": aircraft,
            "difference": dict(zip("ABCDE", values.tolist(), strict=True)),
            "standard_error": dict.fromkeys("ABCDE", 0.05),
            "curve_rms_deg": float(np.abs(values).mean()),
            "p_value": 0.4 if shift < 0.1 else 1e-5,
        }
        rows = []
        for name in names(aircraft):
            entry: dict[str, Any] = {"aircraft": name, "p_value": 0.3}
            for quantity, scale in (("offset", 0.1), ("amplitude", 0.12), ("phase", 3.0)):
                value = float(rng.normal(shift, scale / 2))
                entry[quantity] = {
                    "difference": value,
                    "standard_error": scale / 2,
                    "ci": [value - scale, value + scale],
                }
            rows.append(entry)
        found = {
            "references": [one, two],
            "reports": 9000,
            "mean_vector_difference_m_s": 2.1,
            "fleet": fleet,
            "aircraft": rows,
            "regions": [],
            "poolable": shift < 0.1,
            "why": "the curves do not differ beyond error"
            if shift < 0.1
            else "nam is in never_pool",
        }
        if slice_name:
            found["slice"] = slice_name
            found.pop("aircraft")
        return found

    return {
        "reports": 9000,
        "references": ["ruc", "rtfdaa", "nam"],
        "pairs": [
            pair("ruc", "rtfdaa", shift=0.0),
            pair("ruc", "nam", shift=0.4),
            pair("rtfdaa", "nam", shift=0.4),
        ],
        "by_phase": [pair("ruc", "rtfdaa", shift=0.0, slice_name="cruise")],
        "three_way": [
            {
                "references": ["ruc", "rtfdaa", "nam"],
                "reports": 9000,
                "errors": [
                    {"reference": "ruc", "component_rms": 1.4},
                    {"reference": "rtfdaa", "component_rms": 1.6},
                    {"reference": "nam", "component_rms": None},
                ],
            }
        ],
    }
