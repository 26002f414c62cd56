"""A small archive with an analytic wind field, as a headings Dataset and as a frame.

The wind is a function of time, position and ln p, so whatever the frame says about its derivatives
can be checked by evaluating the function somewhere else.
"""

import numpy as np
import xarray as xr

from airswing.gap.archive.frame import Frame

START = np.datetime64("2009-07-01T00:00:00", "ns")
TAILS = ("N401", "N402", "N403")
METRES_PER_DEGREE = 6371008.8 * np.pi / 180.0


def wind(time, latitude, longitude, lnp):
    """Eastward and northward wind, m/s, of an analytic field."""
    x = np.asarray(longitude) * METRES_PER_DEGREE * np.cos(np.radians(40.0))
    y = np.asarray(latitude) * METRES_PER_DEGREE
    wave = 2.0 * np.pi * (x / 3.0e6 + y / 4.0e6 - time / (2.0 * 86400.0))
    height = np.log(1.0e5) - lnp
    return 6.0 + 14.0 * height + 5.0 * np.sin(wave), 2.0 + 6.0 * height * np.cos(wave)


def derivative(name, time, latitude, longitude, lnp):
    """Central difference of the analytic field along one argument."""
    steps = {"t": 30.0, "x": 1.0e-3, "y": 1.0e-3, "p": 1.0e-4}
    h = steps[name]
    shift = {"t": (h, 0, 0, 0), "x": (0, 0, h, 0), "y": (0, h, 0, 0), "p": (0, 0, 0, h)}[name]
    place = (time, latitude, longitude, lnp)
    after = wind(*(a + b for a, b in zip(place, shift, strict=True)))
    before = wind(*(a - b for a, b in zip(place, shift, strict=True)))
    lengths = {"x": METRES_PER_DEGREE * np.cos(np.radians(40.0)), "y": METRES_PER_DEGREE}
    metres = lengths.get(name, 1.0)
    return tuple((b - a) / (2.0 * h * metres) for a, b in zip(before, after, strict=True))


def headings_dataset(flights=12, reports=25, seed=1, icing=True):
    """Headings Dataset of three aircraft, degrees as in the product; reported = reference wind."""
    rng = np.random.default_rng(seed)
    n = len(TAILS) * flights * reports
    flight = np.repeat(np.arange(len(TAILS) * flights), reports)
    k = np.tile(np.arange(reports), len(TAILS) * flights)
    start = (flight % flights) * 3.0 * 86400.0 + rng.uniform(0.0, 3e4, flight.max() + 1)[flight]
    seconds = START.astype(np.int64) / 1e9 + np.round(start + 180.0 * k)
    # headings wander along the flight, so that one flight sees many of them
    track = rng.uniform(0.0, 360.0, flight.max() + 1)[flight] + 6.0 * k
    phase = np.where(k < 8, 1, np.where(k < 17, 2, 3)).astype(np.int8)
    altitude = np.where(phase == 1, 1000.0 + 700.0 * k, np.where(phase == 2, 6500.0, 0.0))
    altitude = np.where(phase == 3, 6500.0 - 700.0 * (k - 16), altitude)
    speed = 110.0 + 25.0 * (phase == 2) + rng.normal(0.0, 4.0, n)
    pressure = 101325.0 * (1.0 - 2.25577e-5 * altitude) ** 5.25588
    longitude = -95.0 + 10.0 * rng.random(flight.max() + 1)[flight] + 0.25 * k * np.sin(flight)
    latitude = 38.0 + 6.0 * rng.random(flight.max() + 1)[flight] + 0.2 * k * np.cos(flight)
    place = (seconds, latitude, longitude, np.log(pressure))
    u, v = wind(*place)
    declination = -3.0 + 0.6 * (longitude + 90.0) + 0.1 * (latitude - 40.0)
    acceleration = np.where(phase == 1, 0.25, np.where(phase == 3, -0.3, 0.02))
    by_report = {
        "time": (seconds * 1e9).astype(np.int64).astype("datetime64[ns]"),
        "flight": flight.astype(np.int32),
        "latitude": latitude,
        "longitude": longitude,
        "pressure": pressure,
        "pressure_altitude": altitude,
        "eastward_wind": u,
        "northward_wind": v,
        "air_temperature": 288.0 - 0.0065 * altitude,
        "phase": phase,
        "ground_eastward_velocity": speed * np.sin(np.radians(track)) + u,
        "ground_northward_velocity": speed * np.cos(np.radians(track)) + v,
        "ground_velocity_error": np.full(n, 0.5),
        "heading": track % 360.0,
        "magnetic_heading": (track - declination) % 360.0,
        "airspeed": speed,
        "declination": declination,
        "dip": 68.0 + 0.8 * (latitude - 40.0),
        "horizontal_field": 19500.0 - 400.0 * (latitude - 40.0),
        "longitudinal_acceleration": acceleration + rng.normal(0, 0.05, n),
        "bank": rng.normal(0.0, 6.0, n),
        "climb_rate": np.where(phase == 1, 3.9, np.where(phase == 3, -3.9, 0.0)),
        "screening": np.zeros(n, np.int32),
    }
    if icing:
        by_report["icing"] = (rng.random(n) < 0.3).astype(np.int8)
    by_reference = {
        "reference_eastward_wind": [u, u + 1.0],
        "reference_northward_wind": [v, v - 1.0],
        "lead_time": [np.full(n, 3.0)] * 2,
        "grid_convergence": [0.42 * (longitude + 95.0)] * 2,
    }
    names = {"t": "tendency", "p": "lnp_derivative", "x": "x_derivative", "y": "y_derivative"}
    for name, suffix in names.items():
        for component, values in zip(("east", "north"), derivative(name, *place), strict=True):
            by_reference[f"reference_{component}ward_wind_{suffix}"] = [values] * 2
    by_aircraft = {
        "row_size": np.full(len(TAILS), flights * reports),
        "wind_speed_resolution": np.full(len(TAILS), 1852.0 / 3600.0),
        "wind_direction_resolution": np.full(len(TAILS), 1.0),
    }
    return xr.Dataset(
        {name: ("report", values) for name, values in by_report.items()}
        | {name: (("reference", "report"), np.stack(two)) for name, two in by_reference.items()}
        | {name: ("aircraft", values) for name, values in by_aircraft.items()},
        coords={"aircraft": list(TAILS), "reference": ["ruc", "rtfdaa"]},
    )


def frame(**options):
    """Frame of `headings_dataset` against its first reference: a perfect archive."""
    return Frame.from_headings(headings_dataset(**options), reference="ruc")
