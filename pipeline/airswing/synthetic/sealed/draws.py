"""One effect at unit strength, drawn at random: whom it strikes, when, with which signs and phases.

Assumptions
-----------
Effects are written as the mappings `airswing.synthetic.aircraft.faults` takes. A *unit* draw is
later scaled so that it changes the wind by a stated root mean square where it acts (`strength`);
effects that live in the variance alone (coding) or in rare reports (gross errors) have a ladder of
steps instead.

Validity: archives of a week and more; two aircraft and more.

Units: those of the parameters' names; m/s for strengths.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

__all__ = [
    "CATALOGUE_NAMES",
    "LADDER",
    "SCALED",
    "SIZES",
    "Drawn",
    "draw_effect",
    "scaled",
    "variants",
]

Effect = dict[str, Any]
SIZES = (0.2, 0.4, 0.8, 1.6)
"""Strengths where an effect acts, m/s root mean square."""

SCALED: dict[str, tuple[str, ...]] = {
    "compass_offset": ("offset_deg",),
    "hard_iron": ("amplitude_deg",),
    "soft_iron": ("amplitude_deg",),
    "compass_step": ("offset_deg", "amplitude_deg"),
    "compass_drift": ("rate_deg_per_day",),
    "heater_current": ("offset_deg", "amplitude_deg"),
    "acceleration_error": ("amplitude_deg",),
    "turn_error": ("amplitude_deg",),
    "declination_error": ("mean_deg",),
    "tas_scale": ("scale_percent",),
    "tas_offset": ("offset_m_s",),
    "reference_speed_bias": ("bias_percent",),
    "reference_time_offset": ("offset_h",),
    "reference_grid_relative": ("fraction",),
    "altitude_offset": ("offset_ft",),
    "time_lag": ("offset_s",),
    "tail_swap": ("amplitude_deg",),
}
"""Parameters that a strength multiplies."""

LADDER: dict[str, tuple[dict[str, float], ...]] = {
    "wind_coding": (
        {"step": 2.0, "direction_step_deg": 2.0},
        {"step": 2.0, "direction_step_deg": 5.0},
        {"step": 5.0, "direction_step_deg": 5.0},
        {"step": 5.0, "direction_step_deg": 10.0},
    ),
    "position_coding": ({"step": 0.5}, {"step": 1.0}, {"step": 2.0}, {"step": 5.0}),
    "outliers": (
        {"fraction": 0.005},
        {"fraction": 0.01},
        {"fraction": 0.02},
        {"fraction": 0.04},
    ),
}
"""Steps that stand for the four sizes where no root mean square is meant."""

LIMITS = {"reference_grid_relative": 1.0}
"""Largest value of a scaled parameter: a rotation cannot be missed more than wholly."""

FLEET = (
    "declination_error",
    "reference_speed_bias",
    "reference_time_offset",
    "reference_grid_relative",
)
CATALOGUE_NAMES = tuple(sorted({*SCALED, *LADDER}))
"""Effects of the published catalogue."""


@dataclass(frozen=True)
class Drawn:
    """One effect before or after scaling.

    Parameters
    ----------
    name : str
        Effect the case is about.
    effects : tuple of mapping
        What the generator is told; for a swap, the two deviations that make it visible as well.
    """

    name: str
    effects: tuple[Effect, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names at work, each once, the case's own first."""
        return tuple(dict.fromkeys([self.name, *(effect["name"] for effect in self.effects)]))

    @property
    def tails(self) -> tuple[str, ...] | None:
        """Aircraft it acts on; None for all."""
        own = next(effect for effect in self.effects if effect["name"] == self.name)
        return None if own["tails"] is None else tuple(own["tails"])


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _phase(rng: np.random.Generator) -> float:
    return round(float(rng.uniform(-180, 180)), 1)


def _cycle(rng: np.random.Generator) -> dict[str, Any]:
    return {"amplitude_deg": 1.0, "phase_deg": _phase(rng)}


def _both(rng: np.random.Generator) -> dict[str, Any]:
    share = float(rng.uniform(0.0, 1.0))
    return {
        "offset_deg": _sign(rng) * (1.0 - 0.5 * share),
        "amplitude_deg": share,
        "phase_deg": _phase(rng),
    }


def _signed(key: str, value: float = 1.0) -> Callable[[np.random.Generator], dict[str, Any]]:
    return lambda rng: {key: value * _sign(rng)}


def _declination(rng: np.random.Generator) -> dict[str, Any]:
    if rng.uniform() < 0.5:
        return {"factor": float(rng.choice([0.0, 0.5, 1.5])), "mean_deg": _sign(rng)}
    return {"epoch_year": float(rng.integers(1960, 1996)), "mean_deg": _sign(rng)}


def _speed_bias(rng: np.random.Generator) -> dict[str, Any]:
    above = None if rng.uniform() < 0.5 else float(rng.choice([500.0, 600.0, 700.0]))
    return {"bias_percent": 5.0 * _sign(rng), "above_hPa": above}


def _band(rng: np.random.Generator) -> dict[str, Any]:
    """Return the heater's band of temperature: within what icing protection is used in."""
    low = float(rng.choice([-20.0, -15.0, -10.0]))
    return {"between_degC": [low, low + float(rng.choice([10.0, 15.0]))]}


def _below(rng: np.random.Generator) -> dict[str, Any]:
    return {"above_hPa": None, "below_hPa": float(rng.choice([600.0, 700.0, 800.0]))}


_FORMS: dict[str, Callable[[np.random.Generator], dict[str, Any]]] = {
    "heater_current": _band,
    "acceleration_error": lambda rng: {"by_phase": True, "amplitude_deg": 10.0 * _sign(rng)},
    "reference_speed_bias": _below,
}
"""Other forms of an effect: what they add to the parameters."""
_DATED = ("compass_step", "compass_drift", "tail_swap")
"""Effects that can begin in the last week."""


def variants(name: str) -> tuple[str, ...]:
    """Return the variants an effect comes in.

    Parameters
    ----------
    name : str
        Effect of the catalogue.

    Returns
    -------
    tuple of str
        ``plain``; ``fleet`` (all aircraft); ``form`` (another form of it); ``last week``.
    """
    out = ["plain"]
    if name not in FLEET and name != "tail_swap":
        out.append("fleet")
    if name in _FORMS:
        out.append("form")
    if name in _DATED:
        out.append("last week")
    return tuple(out)


_UNIT: dict[str, Callable[[np.random.Generator], dict[str, Any]]] = {
    "compass_offset": _signed("offset_deg"),
    "hard_iron": _cycle,
    "soft_iron": _cycle,
    "compass_step": _both,
    "compass_drift": _signed("rate_deg_per_day", 0.05),
    "heater_current": _both,
    "acceleration_error": _signed("amplitude_deg", 20.0),
    "turn_error": _signed("amplitude_deg", 10.0),
    "declination_error": _declination,
    "tas_scale": _signed("scale_percent"),
    "tas_offset": _signed("offset_m_s"),
    "reference_speed_bias": _speed_bias,
    "reference_time_offset": _signed("offset_h"),
    "reference_grid_relative": _signed("fraction"),
    "altitude_offset": _signed("offset_ft", 300.0),
    "time_lag": lambda rng: {"offset_s": 60.0},
}


def draw_effect(
    name: str,
    rng: np.random.Generator,
    *,
    tails: Sequence[str],
    start: datetime,
    days: int,
    step: int = 1,
    among: Sequence[str] | None = None,
    variant: str = "plain",
) -> Drawn:
    """Draw whom, when and which way, at unit strength.

    Parameters
    ----------
    name : str
        Effect.
    rng : numpy.random.Generator
        Source of the draw.
    tails : sequence of str
        The fleet.
    start : datetime
        First day, UTC.
    days : int
        Length of the archive.
    step : int
        Rung of the ladder for effects that have one.
    among : sequence of str, optional
        Aircraft it acts on; by default they are drawn.
    variant : str
        Of `variants`.

    Returns
    -------
    Drawn
    """
    last = variant == "last week"
    if name == "tail_swap":
        return _swap(rng, list(tails), _date(rng, start, days, last=last))
    chosen = None if name in FLEET else list(among or _aircraft(rng, list(tails)))
    if variant == "fleet":
        chosen = sorted(tails)
    parameters = dict(LADDER[name][step]) if name in LADDER else _UNIT[name](rng)
    if variant == "form":
        parameters |= _FORMS[name](rng)
    effect: Effect = {"name": name, "tails": chosen, "parameters": parameters, "period": None}
    if name == "compass_step" or last:
        effect["period"] = [_date(rng, start, days, last=last), None]
    return Drawn(name, (effect,))


def _aircraft(rng: np.random.Generator, tails: list[str]) -> list[str]:
    """Return one to a third of the aircraft."""
    number = int(rng.integers(1, max(2, len(tails) // 3) + 1))
    return sorted(str(tail) for tail in rng.choice(tails, min(number, len(tails)), replace=False))


def _date(rng: np.random.Generator, start: datetime, days: int, *, last: bool = False) -> str:
    """Return a day in the middle half of the archive, or two to six days before its end."""
    day = round(float(rng.uniform(0.25, 0.75)) * days)
    if last:
        day = days - int(rng.integers(2, 7))
    return (start + timedelta(days=day)).isoformat()


def _swap(rng: np.random.Generator, tails: list[str], date: str) -> Drawn:
    """Return two aircraft with opposite deviations that exchange names at a date."""
    pair = sorted(str(tail) for tail in rng.choice(tails, 2, replace=False))
    phase = _phase(rng)
    deviations = [
        {
            "name": "hard_iron",
            "tails": [tail],
            "parameters": {"amplitude_deg": 0.5, "phase_deg": phase + turn},
            "period": None,
        }
        for tail, turn in zip(pair, (0.0, 180.0), strict=True)
    ]
    swap = {
        "name": "tail_swap",
        "tails": pair,
        "parameters": {"pair": pair},
        "period": [date, None],
    }
    return Drawn("tail_swap", (*deviations, swap))


def scaled(drawn: Drawn, factor: float) -> Drawn:
    """Multiply the strength of an effect.

    Parameters
    ----------
    drawn : Drawn
        An effect.
    factor : float
        What its scaled parameters are multiplied by.

    Returns
    -------
    Drawn
        The same object for effects with a ladder.
    """
    if drawn.name in LADDER:
        return drawn
    keys = SCALED[drawn.name]
    limit = LIMITS.get(drawn.name, np.inf)
    out = []
    for effect in drawn.effects:
        parameters: Mapping[str, Any] = effect["parameters"]
        changed = {
            key: float(f"{np.clip(factor * value, -limit, limit):.5g}") if key in keys else value
            for key, value in parameters.items()
        }
        out.append({**effect, "parameters": changed})
    return Drawn(drawn.name, tuple(out))
