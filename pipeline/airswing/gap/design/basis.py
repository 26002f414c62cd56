"""Nonparametric columns: what the residual could depend on, without any physics.

Assumptions: a dependence not in the catalogue is a smooth function of something a report carries.
The columns come in named groups, each a small family of hat functions, categories or harmonics of
one variable, on one component (cross-track or along-track of the indicated heading, or u and v),
plain or times sine and cosine of the magnetic heading (docs/gap.md section 5). The simplest of them
(a constant, one cycle) stand in for an effect that the catalogue in use does not hold: beside it
they would only take its place. What the weather and the model do by themselves is not here but in
:mod:`airswing.gap.design.weather`.

Validity: hats have their knots at fixed quantiles of the archive (:func:`plan_dictionary`), so
chunks of an archive give the same columns. A variable that is absent or constant gives no group.
Columns are dimensionless factors times a unit vector: a coefficient is in m s-1.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.physics.splines import hats
from airswing.units import DAY

Floats = NDArray[np.float64]

#: Variables whose groups exist, with the number of hats and whether products with the sine and
#: cosine of the heading are made.
VARIABLES: dict[str, tuple[int, bool]] = {
    "altitude": (3, True),
    "temperature": (3, True),
    "airspeed": (3, True),
    "bank": (3, True),
    "acceleration": (3, True),
    "hour": (4, True),
    "date": (3, True),
    "latitude": (3, True),
    "longitude": (3, True),
    "wind_speed": (3, False),
    "drift": (3, False),
}


#: Levels at which a wind of the reference may begin to be too strong or too weak, hPa.
LAYERS = (850, 700, 500)
#: Width of their edges in ln p: what begins at a level begins between two of the model's.
LAYER_EDGE = 0.16

#: Groups that say what effects of the catalogue say -> those effects.
STANDS_FOR: dict[str, tuple[str, ...]] = {
    "cross:constant": ("compass_offset",),
    "cross:magnetic_heading 1 cycles": ("hard_iron",),
    "cross:magnetic_heading 2 cycles": ("soft_iron",),
    "along:constant": ("tas_offset", "tas_scale"),
    "wind:stretched": ("reference_speed_bias",),
    **{f"wind:stretched_above_{level}_hPa": ("reference_speed_bias",) for level in LAYERS},
}


@dataclass(frozen=True)
class Group:
    """One family of columns."""

    name: str  # ``component:variable`` or ``component:variable*heading``
    component: str  # ``cross``, ``along`` or ``wind``
    variable: str
    labels: tuple[str, ...]  # one per column


@dataclass(frozen=True)
class DictionaryPlan:
    """Knots and groups of one archive."""

    knots: dict[str, Floats]  # variable -> (k,) knots in its own unit
    groups: tuple[Group, ...]
    # name -> (mean, scale) of latitude, longitude and ln p, for the day fields
    centre: dict[str, tuple[float, float]]
    # variable -> (k,) mean of its hats over the archive
    means: dict[str, Floats] = field(default_factory=dict)
    flags: frozenset[str] = field(default_factory=frozenset)

    @property
    def size(self) -> int:
        """Number of columns."""
        return sum(len(g.labels) for g in self.groups)


def variable(frame: Frame, name: str) -> Floats:
    """Value of a dictionary variable of every report, in its display unit.

    Parameters
    ----------
    name : str
        One of :data:`VARIABLES`, ``phase``, ``icing`` or ``magnetic_heading``.

    Returns
    -------
    (n,) float
        altitude in units of minus ln(p/1000 hPa); temperature K; airspeed and wind_speed m s-1;
        bank degree; acceleration m s-2; hour UTC; date days since the archive began; degrees.
    """
    getters: dict[str, Callable[[], Floats]] = {
        "altitude": lambda: -np.log(frame.pressure / 1e5),
        "temperature": lambda: frame.temperature,
        "airspeed": lambda: frame.airspeed,
        "bank": lambda: np.degrees(frame.bank),
        "acceleration": lambda: frame.acceleration,
        "hour": lambda: np.mod(frame.time / 3600.0, 24.0),
        "date": lambda: (frame.time - frame.epoch) / DAY,
        "latitude": lambda: frame.latitude,
        "longitude": lambda: frame.longitude,
        "wind_speed": lambda: np.hypot(frame.u_ref, frame.v_ref),
        "drift": lambda: np.degrees(
            (frame.u_ref * np.cos(frame.heading) - frame.v_ref * np.sin(frame.heading))
            # slower is no flight: a report without an airspeed must not have a drift of any size
            / np.maximum(frame.airspeed, 30.0)
        ),
        "phase": lambda: frame.phase.astype(float),
        "icing": lambda: np.where(frame.icing > 0, 1.0, 0.0),
        "magnetic_heading": lambda: np.mod(np.degrees(frame.magnetic_heading), 360.0),
    }
    return getters[name]()


def variables(name: str) -> list[str]:
    """Variables that a group depends on, the first its own.

    Parameters
    ----------
    name : str
        Name of the group.
    """
    own = name.partition(":")[2].split(" ")[0]
    if own == "turned":
        return [own, "wind_direction"]
    if own.startswith(("stretched", "wind_by_height")):
        return [own, "wind_speed", *(["altitude"] if own != "stretched" else [])]
    stem = own.removesuffix("*heading")
    return [stem, "magnetic_heading"] if stem != own else [stem]


def plan_dictionary(frame: Frame, known: Collection[str] | None = None) -> DictionaryPlan:
    """Knots, groups and centring constants for an archive.

    Parameters
    ----------
    frame : Frame
        The whole archive (a large sample of it will do).
    known : collection of str, optional
        Effects that are tested beside the dictionary; the whole catalogue by default.
    """
    knots: dict[str, Floats] = {}
    for name, (count, _) in VARIABLES.items():
        values = variable(frame, name)
        finite = values[np.isfinite(values)]
        # known on fewer reports, a curve would stand for who sends the variable
        if finite.size < 0.5 * values.size or finite.size == 0:
            continue
        if name == "hour":
            knots[name] = np.arange(count) * 24.0 / count
            continue
        # the outer knots a little inside: beyond them few reports would carry a knot of their own
        edges = np.quantile(finite, np.linspace(0.04, 0.96, count))
        spread = edges[-1] - edges[0]
        # one value on all reports (but for rounding): its hats would be a constant, which is there
        if spread <= 1e-6 * max(1.0, abs(float(edges[0]))):
            continue
        # a variable that mostly has one value puts several quantiles on it: they are one knot
        distinct = np.r_[True, np.diff(edges) > 0.02 * spread]
        if distinct.sum() >= 2:
            knots[name] = edges[distinct]
    flags = set()
    if np.unique(frame.phase[frame.phase > 0]).size > 1:
        flags.add("phase")
    # a state met less often tells of the few flights that met it
    if (frame.icing == 1).sum() >= 30 and (frame.icing == 0).sum() >= 30:
        flags.add("icing")
    centre = {
        "latitude": _centre(frame.latitude),
        "longitude": _centre(frame.longitude),
        "log_pressure": _centre(np.log(frame.pressure)),
    }
    groups = tuple(
        group
        for group in _groups(knots, flags)
        if group.name not in STANDS_FOR
        or (known is not None and not set(STANDS_FOR[group.name]) & set(known))
    )
    means = {}
    for name, points in knots.items():
        values = variable(frame, name)
        rows = _hour_hats(values, points) if name == "hour" else hats(values, points)
        means[name] = rows.mean(axis=1)
    return DictionaryPlan(knots, groups, centre, means, frozenset(flags))


def _centre(values: Floats) -> tuple[float, float]:
    spread = float(np.std(values))
    return float(np.mean(values)), spread if spread > 0 else 1.0


def _groups(knots: dict[str, Floats], flags: set[str]) -> tuple[Group, ...]:
    out = []
    for component in ("cross", "along"):
        out.append(Group(f"{component}:constant", component, "constant", ("always",)))
        waves = ((1,), (2,), (3,), (4,), (5, 6)) if component == "cross" else ((1,), (2,), (3, 4))
        for numbers in waves:
            labels = tuple(f"{f}{k}" for k in numbers for f in ("sin", "cos"))
            name = f"{component}:magnetic_heading {'+'.join(map(str, numbers))} cycles"
            out.append(Group(name, component, "magnetic_heading", labels))
        for name, points in knots.items():
            labels = tuple(f"{x:.4g}" for x in points[1:])
            out.append(Group(f"{component}:{name}", component, name, labels))
            if VARIABLES[name][1]:
                pair = ("sin1", "cos1")
                out.append(Group(f"{component}:{name}*heading", component, name, pair))
        for name in sorted(flags):
            labels = ("ascent", "descent") if name == "phase" else ("on",)
            out.append(Group(f"{component}:{name}", component, name, labels))
            pairs = tuple(f"{x} {h}" for x in labels for h in ("sin1", "cos1", "sin2", "cos2"))
            out.append(Group(f"{component}:{name}*heading", component, name, pairs))
    taylor = (
        ("tendency", ("dw/dt",)),
        ("advection", ("V.grad w",)),
        ("shear", ("dw/dlnp",)),
        ("turned", ("across wind",)),
        ("wind_by_height", ("along wind", "across wind")),
        ("stretched", ("along wind",)),
        *((f"stretched_above_{level}_hPa", ("along wind",)) for level in LAYERS),
    )
    out += [Group(f"wind:{name}", "wind", name, labels) for name, labels in taylor]
    return tuple(out)


def unit_vectors(heading: Floats) -> tuple[Floats, Floats]:
    """Cross-track (right of the heading) and along-track unit vectors, each (n, 2) of (u, v)."""
    sine, cosine = np.sin(heading), np.cos(heading)
    return np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)


def dictionary_columns(frame: Frame, plan: DictionaryPlan) -> Floats:
    """Columns of the dictionary for some reports.

    Returns
    -------
    (n, 2, p) float
        In the order of ``plan.groups``.
    """
    out = np.empty((plan.size, 2, frame.size))
    fill_dictionary(out, frame, plan)
    return out.T


def fill_dictionary(out: NDArray[np.floating], frame: Frame, plan: DictionaryPlan) -> None:
    """Write the columns of the dictionary for some reports, one column after the other.

    Parameters
    ----------
    out : (p, 2, n) float
        Overwritten; its type is that of the arithmetic.
    """
    kind = out.dtype
    sine, cosine = np.sin(frame.heading).astype(kind), np.cos(frame.heading).astype(kind)
    vectors = {"cross": (cosine, -sine), "along": (sine, cosine)}
    waves = _Waves(frame.magnetic_heading)
    made: dict[str, Floats] = {}
    start = 0
    for group in plan.groups:
        block = out[start : start + len(group.labels)]
        start += len(group.labels)
        if group.component == "wind":
            block[...] = _known(_taylor(frame, plan, group)).T
            continue
        which = f"{group.name.partition(':')[2]} {group.labels}"  # of both components alike
        if which not in made:
            made[which] = _known(_factors(frame, plan, group, waves)).astype(kind)
        for k in range(2):
            np.multiply(made[which], vectors[group.component][k], out=block[:, k])


def _known(values: Floats) -> Floats:
    """Values with 0 for what is not known; most know all, and a sum tells it in one pass."""
    return values if np.isfinite(values.sum()) else np.nan_to_num(values)


class _Waves:
    """Sine and cosine of cycles of an angle, each computed once."""

    def __init__(self, angle: Floats) -> None:
        self._angle = angle
        self._made: dict[str, Floats] = {}

    def __call__(self, name: str) -> Floats:
        if name not in self._made:
            function = np.sin if name.startswith("sin") else np.cos
            self._made[name] = np.asarray(function(int(name[3:]) * self._angle))
        return self._made[name]


def _factors(frame: Frame, plan: DictionaryPlan, group: Group, waves: _Waves) -> Floats:
    """Scalar factors (k, n) of a heading-frame group."""
    if group.variable == "constant":
        return np.ones((1, frame.size))
    if group.variable == "magnetic_heading":
        return np.stack([waves(name) for name in group.labels])
    if group.variable == "phase":
        base = np.stack([frame.phase == 1, frame.phase == 3]).astype(float)
    elif group.variable == "icing":
        base = (frame.icing == 1).astype(float)[None]
    else:
        values, points = variable(frame, group.variable), plan.knots[group.variable]
        if not group.name.endswith("*heading"):
            rows = _hour_hats(values, points) if group.variable == "hour" else hats(values, points)
            return _centred(rows, plan.means[group.variable])
        middle, half = (points[0] + points[-1]) / 2, (points[-1] - points[0]) / 2
        # straight on for half as far again, then level: a few extremes must not turn the line
        base = np.clip((values - middle) / half, -1.5, 1.5)[None]
    if not group.name.endswith("*heading"):
        return base
    names = [label.rpartition(" ")[2] for label in group.labels[: len(group.labels) // len(base)]]
    return np.stack([row * waves(name) for row in base for name in names])


def _centred(rows: Floats, means: Floats) -> Floats:
    """Hats but the first, each less its mean over the archive: the constant is not among them."""
    known = rows.sum(axis=0) > 0
    return np.asarray((rows[1:] - means[1:, None]) * known)


def _hour_hats(values: Floats, points: Floats) -> Floats:
    """Periodic hats over the day."""
    # midnight stands at both ends: its two halves are one hat
    extended = np.r_[points, 24.0]
    rows = hats(values, extended)
    rows[0] += rows[-1]
    return rows[:-1]


def _taylor(frame: Frame, plan: DictionaryPlan, group: Group) -> Floats:
    """Columns (n, 2, k) made of the reference wind and its derivatives, of order 1."""
    # Each column is about 1 m/s of wind where its group matters (10 m/s of wind, an hour, a
    # twentieth of the pressure, a minute of flight), so that one prior scale serves all.
    wind = np.stack([frame.u_ref, frame.v_ref], -1) / 10.0
    turned = np.stack([-wind[:, 1], wind[:, 0]], -1)
    if group.variable == "turned":
        return turned[..., None]
    if group.variable.startswith("stretched"):
        return (wind * _above(frame.pressure, group.variable))[..., None]
    if group.variable == "wind_by_height":
        # nothing to 700 hPa, all of it from 470 hPa on, about the middle
        high = np.clip((np.log(7e4) - np.log(frame.pressure)) / 0.4, 0, 1)[:, None] - 0.5
        return np.stack([wind * high, turned * high], -1)
    if group.variable == "tendency":
        # the change in an hour, and below over 0.05 of ln p, some 400 m: of a size with other
        # columns
        return (np.stack([frame.dudt, frame.dvdt], -1) * 3600.0)[..., None]
    if group.variable == "shear":
        return (np.stack([frame.dudlnp, frame.dvdlnp], -1) * 0.05)[..., None]
    move_u = frame.ground_u * frame.dudx + frame.ground_v * frame.dudy
    move_v = frame.ground_u * frame.dvdx + frame.ground_v * frame.dvdy
    return (np.stack([move_u, move_v], -1) * 60.0)[..., None]


def _above(pressure: Floats, name: str) -> Floats:
    """Factor (n, 1): 1 above the level that ends a group's name, 0 below; 1 where it names none."""
    found = [level for level in LAYERS if f"_{level}_" in name]
    if not found:
        return np.ones((pressure.size, 1))
    return np.clip(0.5 + np.log(100.0 * found[0] / pressure) / LAYER_EDGE, 0, 1)[:, None]
