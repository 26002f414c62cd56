"""Simulated headings for the evaluation: compasses that change, references with known errors."""

import numpy as np
from scipy.signal import lfilter

from tests.compass.flown import Setting, fleet_deviations, fly, wrap
from tests.ragged import ragged

ORIGIN = np.datetime64("2008-07-01")
SIZE = {"aircraft": 8, "days": 90, "flights_a_day": 3, "reports_a_flight": 5}
LASTING_ERRORS = Setting(references=2, bias_spread=0.0, day_error=0.3, **SIZE)
"""Two references whose errors last for days, over eight aircraft without a bias."""


def day_number(ds):
    return (ds["time"].to_numpy() - ORIGIN).astype("timedelta64[D]").astype(int)


def fleet(seed, setting, **options):
    """Headings of a fleet with drawn deviations, and those deviations (degrees)."""
    deviation = fleet_deviations(setting.aircraft, np.random.default_rng([seed, 7]), **options)
    return flown(deviation, setting, seed), deviation


def with_change(seed, setting, *, day, change, until=None):
    """Headings of a fleet whose deviations change by ``change`` (aircraft, 5) on a day."""
    rng, days = np.random.default_rng([seed, 7]), np.arange(setting.days)[:, np.newaxis]
    changed = (days >= day) & (days < (until or setting.days))
    deviation = fleet_deviations(setting.aircraft, rng, amplitude=4.0)[:, np.newaxis]
    return flown(deviation + changed * change[:, np.newaxis], setting, seed)


def with_reference_error(ds, reference, du, dv):
    """Headings with errors (du, dv), m/s by report, added to the wind of a reference."""
    k = list(ds["reference"].to_numpy()).index(reference)
    psi, airspeed = np.radians(ds["heading"].to_numpy()), ds["airspeed"].to_numpy()
    error = np.radians(ds["heading_error"].to_numpy())
    # The air vector the reference implies falls by (du, dv).
    speed = airspeed - ds["airspeed_error"].to_numpy()
    east, north = speed * np.sin(psi - error), speed * np.cos(psi - error)
    east[k] -= du
    north[k] -= dv
    u, v = (ds[f"reference_{way}ward_wind"].to_numpy().copy() for way in ("east", "north"))
    u[k] += du
    v[k] += dv
    columns = {
        "heading_error": wrap(np.degrees(psi - np.arctan2(east, north))),
        "airspeed_error": airspeed - np.hypot(east, north),
        "reference_eastward_wind": u,
        "reference_northward_wind": v,
    }
    return ds.assign(ragged(columns))


def flown(deviation, setting, seed):
    """Headings of a fleet with known deviations (degrees); a place, level and lead by flight."""
    ds, rng = fly(deviation, setting, seed)[0], np.random.default_rng([seed, 13])
    flight = ds["flight"].to_numpy()
    number = int(flight.max()) + 1
    columns = {
        "latitude": rng.uniform(38, 48, number)[flight],
        "longitude": rng.uniform(-98, -75, number)[flight],
        "pressure": rng.uniform(4.2e4, 8e4, number)[flight],
        "phase": np.full(flight.size, 2, np.int8),
        "lead_time": np.tile(rng.integers(1, 7, number)[flight] * 1.0, (ds.sizes["reference"], 1)),
    }
    return ds.assign(ragged(columns))


def references(seed, setting, *, size=1.2, persistence=0.5, regional=None):
    """Headings against references of equal truth, with errors autoregressive from day to day.

    ``regional`` adds an eastward bias (m/s) to a reference west of 88 W.
    """
    ds, _ = fleet(seed, setting, amplitude=4.0)
    day = day_number(ds)
    west = ds["longitude"].to_numpy() < -88.0
    for k, name in enumerate(ds["reference"].to_numpy().tolist()):
        rng = np.random.default_rng([seed + 1000 * (k + 1), 11])
        shock = rng.normal(0, size * np.sqrt(1 - persistence**2), (setting.days + 60, 2))
        error = lfilter([1.0], [1.0, -persistence], shock, axis=0)[60 + day]
        bias = (regional or {}).get(name, 0.0) * west
        ds = with_reference_error(ds, name, error[:, 0] + bias, error[:, 1])
    return ds
