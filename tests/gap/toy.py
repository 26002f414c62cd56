"""Frames of small simulated archives; the generator shares no code with the effects."""

import numpy as np
import pytest

from airswing.gap.archive.frame import AIRCRAFT_FIELDS, Frame
from airswing.synthetic import archive
from airswing.synthetic.fields import sample_reference
from airswing.synthetic.flights import fly
from airswing.synthetic.observe import Coding

START = np.datetime64("2009-03-01")
EXACT = Coding(
    direction_deg=1e-7, speed_kt=1e-7, position_arcmin=1e-6, airspeed_noise=0.0, heading_noise=0.0
)
SAME = ("u_ref", "v_ref", "u_before", "v_before", "u_after", "v_after", "ground_u", "ground_v")
SAME += ("flight", "latitude", "longitude", "pressure", "declination", "dip")
SAME += ("acceleration", "bank", "temperature", "phase", "icing")
SMALL = {"references": ("ruc",), "columns": 24, "rows": 18, "spacing_km": 80.0}
SMALL |= {"levels": (1000, 850, 700, 550, 400, 350)}
SMALL |= {"climb_seconds": 180.0, "cruise_seconds": 180.0}


def effect(name, aircraft=None, day=None, **values):
    """Fault of some aircraft by their numbers, or of all, from a day on."""
    tails = None if aircraft is None else [f"N{401 + number}" for number in aircraft]
    period = None if day is None else [str(START + day), None]
    return {"name": name, "tails": tails, "parameters": values, "period": period}


FLOWN = {}


def flown(table, wind, *, seed):
    """Flights, which no effect changes: half of the time of an archive."""
    key = seed, table.departure.tobytes()
    if key not in FLOWN:
        FLOWN[key] = fly(table, wind, seed=seed)
    return FLOWN[key]


def make_frame(*, seed=0, aircraft=8, days=20, effects=(), noise=1.0):
    """Build an archive with `effects` and with noise of the reported winds, m/s."""
    size = {"aircraft": aircraft, "days": days} | SMALL
    scenario = archive.Scenario(seed=seed, effects=effects, coding=EXACT, **size)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(archive, "fly", flown)
        table, references, _ = archive.simulate(scenario)
    place = [table[name].to_numpy() for name in ("latitude", "longitude", "pressure")]
    place[2] = place[2] / 100.0
    for name, later in (("before", -1.0), ("ref", 0.0), ("after", 1.0)):
        hours = table["hours"].to_numpy() + later
        wind = sample_reference(references["ruc"], *place, hours)
        table[f"u_{name}"], table[f"v_{name}"] = wind
    table = table.dropna(subset=[f"u_{name}" for name in ("before", "ref", "after")])
    columns = {name: table[name].to_numpy() for name in table}
    n, rng = len(table), np.random.default_rng(1)
    reported = np.stack([columns["u"], columns["v"]]) + rng.normal(0, noise, (2, n))
    air = np.stack([columns["ground_u"], columns["ground_v"]]) - reported
    heading = np.arctan2(*air)
    seconds = START.astype("datetime64[s]").astype(float) + 3600.0 * columns["hours"]
    gradients = {f"d{c}d{x}": (2e-4 if x == "t" else 2e-5) for x in "txy" for c in "uv"}
    return Frame(
        tails=tuple(scenario.tails),
        epoch=float(seconds.min()),
        reference_field=float(np.median(columns["horizontal"])),
        report=np.arange(n),
        aircraft=table["tail"].str[1:].astype(int).to_numpy() - 401,  # as reported
        time=seconds,
        **{name: columns[name] for name in SAME},
        u_rep=reported[0],
        v_rep=reported[1],
        heading=heading,
        magnetic_heading=heading - columns["declination"],
        airspeed=np.hypot(*air),
        horizontal_field=columns["horizontal"],
        heading_error=np.zeros(n),
        climb_rate=np.choose(columns["phase"], [0.0, 5.0, 0.0, -5.0]),
        **{name: rng.normal(0, size, n) for name, size in gradients.items()},
        dudlnp=-columns["u_ref"],
        dvdlnp=-columns["v_ref"],
        grid_convergence=np.radians((columns["longitude"] + 95) * 0.42),
        lead_time=np.ones(n),
        **dict.fromkeys(AIRCRAFT_FIELDS, np.full(aircraft, np.nan)),
    )
