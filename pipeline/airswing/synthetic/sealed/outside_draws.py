"""Outside effects drawn at random: which component, by which variables, in which shape, on whom.

Assumptions
-----------
* Shapes are dealt by the caller, so that each comes as often as any other; everything else is drawn
  evenly. Pairs of variables that determine each other (a heading and the track it makes) are not
  multiplied: the product would be a function of one.
* What stands in the published catalogue in so many words (a heading error that steps or grows with
  the date, or acts while icing protection is on) is not drawn; what a catalogue explains in effect
  is found on the archive (`airswing.synthetic.sealed.nearness`), and drawn again.
* The size of a scatter effect is what it comes to; it is measured on the archive.

Units: m/s for sizes; kt and degrees where a name says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from airswing.synthetic.aircraft.outside_effects import (
    COMPONENTS,
    CYCLIC,
    FLAGS,
    SCATTER,
    SHAPES,
    VARIABLES,
)
from airswing.synthetic.sealed.labels import Injected

__all__ = ["ALIKE", "OUTSIDE_SHAPES", "SCOPES", "draw_outside"]

# Shapes dealt: of one variable, of two, and what moves no mean.
OUTSIDE_SHAPES = (*SHAPES, "product", "threshold", "scatter")
SCOPES = ("one", "some", "all")
# Variables that tell much the same: never multiplied with each other.
ALIKE: tuple[frozenset[str], ...] = (
    frozenset({"magnetic_heading", "heading", "track"}),
    frozenset({"altitude", "temperature"}),
    frozenset({"airspeed", "ground_speed"}),
    frozenset({"wind_speed", "drift"}),
)
_PHASES = (1.0, 2.0, 3.0)
# Widths drawn, as fractions of the turn or of the range.
_SPREAD = {"sector": (0.04, 0.125), "bump": (0.05, 0.12), "saw": (0.26, 0.52)}
# Where they begin, as quantiles: acting on most reports they would be an offset.
_SPANS = {"step": (0.65, 0.9), "hinge": (0.5, 0.85)}
# Share of outside effects that begin in the last week.
_LAST_WEEK = 0.1


def draw_outside(
    rng: np.random.Generator,
    *,
    shape: str,
    tails: Sequence[str],
    start: datetime,
    days: int,
    size: float,
) -> Injected:
    """Draw one outside effect.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the draw.
    shape : str
        Of `OUTSIDE_SHAPES`.
    start : datetime
        First day, UTC.
    days : int
        Length of the archive.
    size : float
        Root mean square of the change where it acts, m/s.

    Returns
    -------
    dict
        ``name`` (``outside``), ``tails, parameters, period``.
    """
    chosen = _tails(rng, tails)
    parameters = _scatter(rng, size) if shape == "scatter" else _moving(rng, shape, size)
    period = None
    if days > 14 and rng.uniform() < _LAST_WEEK:
        period = [(start + timedelta(days=days - 7)).isoformat(), None]
    return {"name": "outside", "tails": chosen, "parameters": parameters, "period": period}


def _tails(rng: np.random.Generator, tails: Sequence[str]) -> list[str] | None:
    scope = str(rng.choice(SCOPES))
    if scope == "all":
        return None
    number = 1 if scope == "one" else int(rng.integers(2, max(3, len(tails) // 2) + 1))
    return sorted(str(tail) for tail in rng.choice(list(tails), number, replace=False))


def _moving(rng: np.random.Generator, shape: str, size: float) -> dict[str, object]:
    """Draw component and parts of an effect on the mean."""
    component = str(rng.choice(COMPONENTS))
    first = _variable(rng, component, shape)
    if shape == "product":
        second = _variable(rng, component, shape, beside=first)
        parts = [_part(rng, first, "linear"), _part(rng, second, "linear")]
    elif shape == "threshold":
        second = _variable(rng, component, shape, beside=first, flags=True)
        acting = str(rng.choice(["hinge", "bump", "saw"]))
        opened = str(rng.choice(["step", "sector"]))
        parts = [_part(rng, first, acting), _part(rng, second, opened)]
    else:
        parts = [_part(rng, first, shape)]
    return {
        "component": component,
        "parts": parts,
        "shape": shape,
        "size_m_s": float(size),
        "sign": float(rng.choice([-1.0, 1.0])),
    }


def _variable(
    rng: np.random.Generator,
    component: str,
    shape: str,
    *,
    beside: str | None = None,
    flags: bool = False,
) -> str:
    """Draw a variable that makes sense with the shape, the component and the other variable."""
    able = [name for name in VARIABLES if name not in FLAGS or flags or shape == "step"]
    if component == "across_heading":
        able = [name for name in able if name != "icing" and not (_dated(shape) and name == "date")]
    for group in ALIKE:
        if beside in group:
            able = [name for name in able if name not in group]
    return str(rng.choice([name for name in able if name != beside]))


def _dated(shape: str) -> bool:
    """Whether a shape makes of the date what a catalogue calls a step or a drift."""
    return shape in ("step", "hinge", "sector")


def _part(rng: np.random.Generator, variable: str, shape: str) -> dict[str, object]:
    """Draw where and how wide."""
    if variable in FLAGS:
        value = 1.0 if variable == "icing" else float(rng.choice(_PHASES))
        return {"variable": variable, "shape": "flag", "equals": value}
    span = (0.0, 1.0) if variable in CYCLIC else _SPANS.get(shape, (0.25, 0.75))
    low, high = _SPREAD.get(shape, (0.1, 0.1))
    return {
        "variable": variable,
        "shape": shape,
        "at": round(float(rng.uniform(*span)), 3),
        "width": round(float(rng.uniform(low, high)), 3),
    }


def _scatter(rng: np.random.Generator, size: float) -> dict[str, object]:
    """Draw an effect that moves no mean."""
    kind = str(rng.choice(list(SCATTER)))
    values: dict[str, object] = {"kind": kind, "shape": "scatter", "component": "scatter"}
    if kind == "floor":
        values |= {"limit_kt": float(rng.integers(6, 16)), "parts": []}
    elif kind == "ceiling":
        values |= {"limit_kt": float(rng.integers(38, 56)), "parts": []}
    elif kind == "hole":
        low = float(rng.integers(8, 26))
        values |= {"between_kt": [low, low + float(rng.integers(6, 13))], "parts": []}
    elif kind == "lattice":
        values |= {
            "limit_kt": float(rng.integers(15, 31)),
            "parts": [],
            "direction_step_deg": float(rng.choice([30.0, 45.0, 90.0])),
        }
    else:
        variable = _variable(rng, "scatter", "step")
        shape = str(rng.choice(["step", "sector"]))
        values["parts"] = [_part(rng, variable, shape)]
        spread = {"size_m_s": 2.0 * size} if kind == "jitter" else {"fraction": 0.02 * (1 + size)}
        values |= spread
    return values
