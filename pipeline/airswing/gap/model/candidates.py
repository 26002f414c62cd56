"""Candidates of the model (docs/gap.md, section 3): effects of the catalogue and tables.

The raw columns X (n, 2, k) of a candidate are multiplied by a matrix T (k, m) such that X T z, with
z standard normal, is an effect of 1 m/s root mean square where it acts. Edges in pressure of the
catalogue's effects are softened by half the distance of model levels. No column contains the
report's own noise: heading and airspeed are those of `airswing.gap.design`, and tables of the
reported wind are averages (Berkson 1950: blurred, with unbiased coefficients).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import (
    KINDS,
    KNOTS,
    PERIOD,
    record,
    reliabilities,
    values_of,
)
from airswing.gap.arrays import Floats, Singles
from airswing.gap.design import climatology_columns
from airswing.gap.effects.base import Effect, HeadingEffect
from airswing.gap.effects.empirical import change_of

#: Components of a table, in the names of the effect ``empirical``, and the size of one unit of its
#: columns: degrees of heading and of wind direction, m/s along the heading and along the wind.
COMPONENTS = ("heading_angle", "along_heading", "wind_angle", "along_wind")
#: Quantity in error by component, where it is not the wind.
PARTS = {
    "heading_angle": "heading",
    "across_heading": "heading",
    "along_heading": "airspeed",
    "airspeed_factor": "airspeed",
}
#: Cycles of a table of the magnetic heading: a flux valve's error holds five at most.
CYCLES = 5
#: Coefficients of its simple forms: a constant, and one cycle with it.
SIMPLE = (1, 3)
#: Correlation length of neighbouring coefficients, in knots, and the share that is independent.
LENGTH, FREE = 1.3, 0.1
#: Correlation length of smooth curves, a share of the range (a parabola, one cycle), and the share
#: of their variance from which a direction is kept.
SMOOTH, NEGLIGIBLE = 0.3, 0.01
#: Quantiles between which knots lie: single values far out must not stretch the curve.
INNER = (0.005, 0.995)
#: Differences drawn to average a table of the reported wind over, and levels of their spread.
DRAWS, LEVELS = 16, 8
#: Reports on which the size of a candidate is measured, and all of them.
SAMPLED, ALL = slice(None, None, 7), slice(None)
#: Knots of the functions by which pairs of variables are screened.
SCREENED = 7
#: Variables that depend on the reported wind.
OF_WIND = {"wind_direction", "wind_speed"}


@dataclass(frozen=True, eq=False)
class Group:
    """A candidate: columns with a common prior."""

    name: str  # effect of the catalogue, or ``variable|component`` of a table
    kind: str  # ``name``, ``table``, ``nuisance``
    columns: slice  # raw columns
    transform: Floats  # (k, m): T of the module
    scopes: str  # ``a``: separate coefficients for each aircraft, ``f``: the same for all
    prior: float  # log prior weight
    # which coefficients of the effect; of a table (0,), (1,) if refined, (2,) if smooth, and (0, k)
    # with k coefficients if simple
    form: tuple[int, ...] = ()
    reliability: float = 1.0  # squared correlation of the columns with the true ones
    # the quantity in error: ``heading``, ``airspeed`` (with all effects that reverse with the
    # direction of flight) or ``wind``
    quantity: str = "wind"
    dated: bool = False  # whether it acts in a period

    @property
    def size(self) -> int:
        """Number of coefficients m."""
        return int(self.transform.shape[1])

    @property
    def named(self) -> bool:
        """Whether it is an effect of the catalogue."""
        return self.kind == "name"

    @property
    def refined(self) -> bool:
        """Whether it is a table made for a term."""
        return self.kind == "table" and self.form == (1,)

    @property
    def simple(self) -> bool:
        """Whether it is a constant, or one cycle of the magnetic heading with it."""
        return self.kind == "table" and len(self.form) == 2

    @property
    def variables(self) -> tuple[str, ...]:
        """Variables of a table; of one that acts in a period, the date as well."""
        if self.dated and self.size == 1:
            return ("date",)
        return (*self.name.partition("|")[0].split(" x "), *["date"] * self.dated)

    @property
    def component(self) -> str:
        """Component of a table."""
        return self.name.partition("|")[2]


@dataclass(frozen=True)
class Curve:
    """Functions of one variable: how columns follow from its values."""

    variable: str
    knots: Floats

    def functions(self, values: Floats) -> Floats:
        """Functions at values, (n, k); zero where a value is unknown."""
        if self.variable == "magnetic_heading" and self.knots.size == 1:
            angle = np.radians(np.nan_to_num(values))
            waves = [f(j * angle) for j in range(1, CYCLES + 1) for f in (np.sin, np.cos)]
            return np.stack([np.ones_like(angle), *waves], -1)
        finite = np.isfinite(values)
        filled = np.where(finite, values, self.knots[0])
        if KINDS[self.variable][0] == "category":
            out = (filled[:, None] == self.knots).astype(float)
        elif KINDS[self.variable][0] == "circular":
            period, count = PERIOD.get(self.variable, 360.0), self.knots.size
            distance = np.abs(np.mod(filled, period)[:, None] / period * count - np.arange(count))
            out = np.maximum(0.0, 1.0 - np.minimum(distance, count - distance))
        else:
            number = np.arange(self.knots.size)
            place = np.interp(filled, self.knots, number)
            out = np.maximum(0.0, 1.0 - np.abs(place[:, None] - number))
        return np.asarray(out * finite[:, None])

    @property
    def constant(self) -> Floats:
        """Coefficients (k,) of a curve that is one everywhere."""
        fourier = self.variable == "magnetic_heading" and self.knots.size == 1
        return np.eye(2 * CYCLES + 1)[0] if fourier else np.ones(self.knots.size)

    @property
    def covariance(self) -> Floats:
        """Prior covariance of the coefficients, (k, k)."""
        if self.variable == "magnetic_heading" and self.knots.size == 1:
            # a cycle's amplitude falls off as the root of its number
            falling = np.repeat(1.0 / np.sqrt(np.arange(1, CYCLES + 1)), 2)
            return np.asarray(np.diag(np.r_[1.0, falling] ** 2))
        if KINDS[self.variable][0] == "category":
            return 0.5 * np.eye(self.knots.size) + 0.5
        near = np.exp(-0.5 * (self._knot_distances / LENGTH) ** 2)
        return np.asarray((1 - FREE) * near + FREE * np.eye(len(near)))

    @property
    def _knot_distances(self) -> Floats:
        number = np.arange(self.knots.size)
        distance = np.abs(np.subtract.outer(number, number))
        if KINDS[self.variable][0] == "circular":
            distance = np.minimum(distance, self.knots.size - distance)
        return np.asarray(distance, np.float64)

    @property
    def smooth_root(self) -> Floats:
        """Root (k, m) of the prior covariance of a curve that varies over its whole range only."""
        length = SMOOTH * self.knots.size
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (self._knot_distances / length) ** 2))
        retained = values > NEGLIGIBLE * values.sum()
        return np.asarray(vectors[:, retained] * np.sqrt(values[retained]))


def curve_of(name: str, values: Floats, count: int | None = None) -> Curve:
    """Curve of a variable with knots at some of its values; ``count`` knots at most.

    They are equal steps of rank plus value apart: a long tail with few reports has knots as well.
    """
    if name == "magnetic_heading" and count is None:
        return Curve(name, np.zeros(1))
    number = count or KNOTS[name]
    if KINDS[name][0] == "category":
        return Curve(name, np.unique(values[np.isfinite(values)]))
    if KINDS[name][0] == "circular":
        return Curve(name, np.arange(number) * PERIOD.get(name, 360.0) / number)
    ordered = np.sort(values[np.isfinite(values)])
    low, high = np.quantile(ordered, INNER)
    inner = ordered[(ordered >= low) & (ordered <= high)]
    spread = float(high - low)
    place = np.linspace(0, 1, inner.size) + (inner - low) / (spread or 1.0)
    nearest = np.searchsorted(place, np.linspace(0, 2, number)).clip(max=inner.size - 1)
    knots = [float(inner[0])]
    for knot in inner[nearest[1:]]:
        if knot - knots[-1] > 0.3 * spread / number:
            knots.append(float(knot))
    return Curve(name, np.array(knots))


@dataclass
class Table:
    """Variables and component of a table."""

    curves: tuple[Curve, ...]
    component: str


class Candidates:
    """Raw columns, built in blocks, and the groups made of them.

    ``context`` is the frame with exogenous heading, airspeed and large-scale wind; ``tables`` also
    looks for effects outside the catalogue.
    """

    def __init__(
        self, frame: Frame, context: Frame, effects: Mapping[str, Effect], *, tables: bool = True
    ) -> None:
        self.frame, self.context, self.effects = frame, context, effects
        self.groups: list[Group] = []
        self.tables: dict[int, Table] = {}
        self.curved: dict[str, Singles] = {}  # `curvature` of effects that have one
        self._builders: dict[int, Callable[[Frame], Singles]] = {}
        self._unit_changes: dict[str, Floats] = {}
        self._pending: list[slice] = []
        self.width = 0
        self.wind = np.stack([context.u_ref, context.v_ref], -1)
        self.variables = record(frame, context)
        self.reliability = reliabilities(frame, self.variables)
        self._add_climatology()
        self._add_names()
        if tables:
            self.drawn = {name: self._drawn_values(name) for name in OF_WIND}
            for name in self.variables:
                curve = self.curve(name)
                if curve.knots.size > 1 or name == "magnetic_heading":
                    for table in (Table((curve,), component) for component in COMPONENTS):
                        self.add_table(table, self.log_prior(table))

    # ------------------------------------------------------------------------------------ columns
    def _block(self, build: Callable[[Frame], Singles], columns: Singles) -> slice:
        where = slice(self.width, self.width + columns.shape[2])
        self._builders[where.start] = build
        self._pending.append(where)
        self.width = where.stop
        return where

    def pending(self) -> list[slice]:
        """Columns added since the last call, to be summed; they are built again, one by one."""
        out, self._pending = self._pending, []
        return out

    def raw(self, where: slice, at: Frame | None = None) -> Singles:
        """Raw columns (n, 2, k) of a group, built again.

        They are evaluated at the heading, airspeed and winds of ``at``, by default those without
        the reports' noise.
        """
        return self._builders[where.start](self.context if at is None else at)

    def _group(
        self, columns: Singles, group: Group, pick: Sequence[int] | None = None
    ) -> Group | None:
        """Add a group, scaled so that X T z has 1 m/s rms where it acts; None if nowhere.

        ``columns`` are those of `SAMPLED`; ``pick`` are the columns of the block that its transform
        is for, all by default.
        """
        full = np.zeros((columns.shape[2], group.size))
        full[slice(None) if pick is None else list(pick)] = group.transform
        used = np.flatnonzero(full.any(axis=1))
        effect = columns[:, :, used] @ full[used].astype(np.float32)
        energy = (effect * effect).sum(axis=(1, 2))
        # some parts in a million of the largest: where hat functions end, an effect acts no more
        if energy.size == 0 or not energy.max() > 1e-6:
            return None
        size = np.sqrt(float(energy[energy > 1e-6 * energy.max()].mean()))
        self.groups.append(replace(group, transform=np.asarray(full / size)))
        return self.groups[-1]

    def _add_climatology(self) -> None:
        def build(at: Frame) -> Singles:
            return climatology_columns(self.context).astype(np.float32)

        columns = build(self.context)
        size = 1 / np.sqrt((columns**2).sum(1).mean(0))
        where = self._block(build, columns)
        self.groups.append(Group("climatology", "nuisance", where, np.diag(size), "f", 0.0))

    def _add_names(self) -> None:
        usable = [e for e in self.effects.values() if e.kind in ("mean", "drift", "step")]
        for effect in usable:
            build = partial(self._effect_columns, effect)
            columns = build(self.context)
            where = self._block(build, columns)
            every = tuple(range(columns.shape[2]))
            forms = [(form, False) for form in effect.alternatives or (every,)]
            if effect.kind == "step":
                forms = [((0,), True), ((1, 2), True), ((0, 1, 2), True)]
            elif effect.kind == "drift":
                forms.append(((0, 1), True))
            # between winds of the reference, which those of the context are not
            curved = self.curvature(effect.name, self.frame)
            if curved is not None:
                self.curved[effect.name] = curved
            quantity = "airspeed" if effect.stage == "sensor" or effect.reverses else "wind"
            quantity = "heading" if isinstance(effect, HeadingEffect) else quantity
            # the ordinary form is as likely as all others together
            shares = [0.5] + [0.5 / (len(forms) - 1)] * (len(forms) - 1) if forms[1:] else [1.0]
            for (form, dated), share in zip(forms, shares, strict=True):
                group = Group(
                    effect.name,
                    "name",
                    where,
                    np.eye(1) if len(form) == 1 else effect.tied(form),
                    scopes="f" if effect.scope in ("reference", "fleet") else "af",
                    prior=float(np.log(share / (2 * len(usable)))),
                    form=tuple(form),
                    reliability=effect.reliability if curved is None else 1.0,
                    quantity=quantity,
                    dated=dated,
                )
                self._group(columns[SAMPLED], group, form)

    def _effect_columns(self, effect: Effect, at: Frame) -> Singles:
        raw = effect.softened_columns(at)
        return np.asarray(np.moveaxis(raw, 0, -1) * effect.column_scales, np.float32)

    def curvature(self, name: str, at: Frame) -> Singles | None:
        """Columns (n, 2, k) of the squared coefficients of an effect's raw columns."""
        effect = self.effects.get(name)
        raw = None if effect is None else effect.curvature(at)
        if effect is None or raw is None:
            return None
        return np.asarray(np.moveaxis(raw, 0, -1) * effect.column_scales**2, np.float32)

    # --------------------------------------------------------------------------------- tables
    @cached_property
    def _likely_winds(self) -> Floats:
        """Winds that might have been reported given the large-scale wind, (draws, n, 2).

        A draw is one standardised difference from the large-scale wind for all reports, so that
        averages over draws vary within a flight as the large-scale wind does; its mean and spread
        vary with pressure.
        """
        frame = self.frame
        difference = np.stack([frame.u_rep, frame.v_rep], -1) - self.wind
        levels = [rows for rows in np.array_split(np.argsort(frame.pressure), LEVELS) if rows.size]
        at = [np.median(frame.pressure[rows]) for rows in levels]

        def smooth(values: Floats) -> Floats:
            return np.stack([np.interp(frame.pressure, at, column) for column in values.T], -1)

        mean = smooth(np.array([difference[rows].mean(axis=0) for rows in levels]))
        spread = smooth(np.array([difference[rows].std(axis=0) + 1e-6 for rows in levels]))
        picks = np.random.default_rng(0).integers(0, frame.size, DRAWS)
        drawn = ((difference - mean) / spread)[picks]
        drawn = (drawn - drawn.mean(axis=0)) / (drawn.std(axis=0) + 1e-6)
        return np.asarray(self.wind + mean + spread * drawn[:, np.newaxis])

    def _drawn_values(self, name: str) -> Floats:
        """Values of a variable with each of the likely winds, (draws, n)."""
        winds = np.moveaxis(self._likely_winds, 2, 1)
        reported = (replace(self.frame, u_rep=u, v_rep=v) for u, v in winds)
        return np.stack([values_of(frame, self.context, name) for frame in reported])

    def unit_change(self, component: str) -> Floats:
        """Change (n, 2) of the wind by one unit of a component, averaged over likely winds, m s-1.

        The direction of a weak wind may be any: that of the large-scale wind, which turns about
        where it is calm, would be so wrong a column that the fit of a curve loses its level.
        """
        if component not in self._unit_changes:
            draws = [self._change(component, wind) for wind in self._likely_winds]
            self._unit_changes[component] = np.mean(draws, axis=0)
        return self._unit_changes[component]

    def _change(self, component: str, wind: Floats) -> Floats:
        at, (u, v) = self.context, wind.T
        return change_of(component, heading=at.heading, airspeed=at.airspeed, u=u, v=v)

    def columns_of(self, table: Table, at: Frame, rows: slice = ALL) -> Singles:
        """Columns (n, 2, k) of a table.

        Those that depend on the reported wind are averages over likely winds, unless they are
        evaluated at the reports themselves.
        """
        if at is not self.context:
            change = change_of(
                table.component, heading=at.heading, airspeed=at.airspeed, u=at.u_rep, v=at.v_rep
            )
            values = [values_of(at, at, curve.variable)[rows] for curve in table.curves]
            return _products(table, change[rows], values)
        if OF_WIND & {curve.variable for curve in table.curves}:
            return np.asarray(
                sum(self._drawn_columns(table, rows, k) for k in range(DRAWS)) / DRAWS, np.float32
            )
        values = [self.variables[curve.variable].values[rows] for curve in table.curves]
        return _products(table, self.unit_change(table.component)[rows], values)

    def _drawn_columns(self, table: Table, rows: slice, k: int) -> Singles:
        """Columns of a table with the k-th likely wind."""
        values = [
            self.drawn[c.variable][k]
            if c.variable in OF_WIND
            else self.variables[c.variable].values
            for c in table.curves
        ]
        change = self._change(table.component, self._likely_winds[k])
        return _products(table, change[rows], [value[rows] for value in values])

    def table_of(self, group: Group) -> Table:
        """Table of a group."""
        return self.tables[group.columns.start]

    def constant(self, group: Group) -> Floats:
        """Coefficients (m,) of a table that is one everywhere."""
        ones: Floats = np.ones(1)
        for curve in self.table_of(group).curves:
            ones = np.asarray(np.kron(ones, curve.constant), np.float64)
        return np.asarray(np.linalg.lstsq(group.transform, ones, rcond=None)[0], np.float64)

    def log_prior(self, table: Table) -> float:
        """Log prior of a table: names and tables, variables and components are equally likely."""
        number = len(self.variables)
        return -float(np.log(2 * len(COMPONENTS)) + len(table.curves) * np.log(number))

    def add_table(self, table: Table, weight: float, *, refined: bool = False) -> Group | None:
        """Add a table; None where it acts nowhere."""
        columns = self.columns_of(table, self.context, SAMPLED)
        covariance: Floats = np.eye(1)
        for curve in table.curves:
            covariance = np.asarray(np.kron(covariance, curve.covariance), np.float64)
        label = " x ".join(curve.variable for curve in table.curves)
        name = f"{label}|{table.component}"
        spread = covariance + 1e-9 * np.eye(len(covariance))
        root: Floats = np.asarray(np.linalg.cholesky(spread), np.float64)
        where = self._block(partial(self.columns_of, table), columns)
        quantity = PARTS.get(table.component, "wind")
        # share of the energy of one likely wind that averages over all of them hold
        drawn = self._drawn_columns(table, SAMPLED, 0)
        reliability = min(float((columns**2).sum() / max((drawn**2).sum(), 1e-12)), 1.0)
        for curve in table.curves:
            reliability *= self.reliability.get(curve.variable, 1.0)
        self.tables[where.start] = table
        form = (int(refined),)
        group = Group(name, "table", where, root, "af", weight, form, reliability, quantity)
        if refined or KINDS[table.curves[0].variable][0] == "category":
            return self._group(columns, group)
        weight -= float(np.log(2))
        if table.curves[0].variable == "magnetic_heading":
            self._add_simple(columns, group, weight - float(np.log(2 * len(SIMPLE))))
        else:
            smooth = table.curves[0].smooth_root
            self._group(columns, replace(group, transform=smooth, form=(2,), prior=weight))
        return self._group(columns, replace(group, prior=weight))

    def _add_simple(self, columns: Singles, group: Group, weight: float) -> None:
        """Add a constant, and one cycle with it, from the first day on or from a later one."""
        for size in SIMPLE:
            root = group.transform[:size, :size]
            simple = replace(group, transform=root, prior=weight, form=(0, size))
            for dated in (False, True):
                self._group(columns, replace(simple, dated=dated), range(size))

    @cached_property
    def contrasts(self) -> dict[str, Floats]:
        """Functions (n, k) of each variable whose products screen the pairs.

        They are orthonormal, zero on average and where the variable is unknown: the first cycle of
        a circular variable, linear and quadratic functions of the rank of a linear one, differences
        between categories. Those of the reported wind are averages over likely winds.
        """
        out = {}
        for name, variable in self.variables.items():
            curve = self.pair_curve(name, SCREENED)
            number = np.arange(curve.knots.size)
            angle = 2 * np.pi * number / number.size
            shapes = {
                "circular": [np.sin(angle), np.cos(angle)],
                "linear": [number, number**2],
                "category": list(np.eye(number.size)[1:]),
            }[variable.kind]
            values = self.drawn[name] if name in OF_WIND else [variable.values]
            functions = np.mean([curve.functions(x) for x in values], axis=0)
            basis = np.linalg.qr(functions @ np.stack([np.ones(number.size), *shapes], -1))[0]
            out[name] = np.asarray(basis[:, 1:] * np.sqrt(len(basis)), np.float64)
        return out

    def pair_curve(self, name: str, knots: int) -> Curve:
        """Curve of a variable in a table of two; a circular variable has one knot more."""
        return self.curve(name, knots + (KINDS[name][0] == "circular"))

    def forget(self, groups: Sequence[Group]) -> None:
        """Remove groups; the last columns built are free again where they are theirs."""
        gone = {id(group) for group in groups}
        self.groups = [group for group in self.groups if id(group) not in gone]
        for group in groups:
            self._builders.pop(group.columns.start, None)
        self.width = max(group.columns.stop for group in self.groups)

    def curve(self, name: str, knots: int | None = None) -> Curve:
        """Curve of a variable, with the usual number of knots by default."""
        return curve_of(name, self.variables[name].values, knots)


def _products(table: Table, change: Floats, values: Sequence[Floats]) -> Singles:
    """Products (n, 2, k) of the component's unit change and functions of the variables' values."""
    functions: Singles = np.ones((len(change), 1), np.float32)
    for curve, of_reports in zip(table.curves, values, strict=True):
        factors = curve.functions(of_reports).astype(np.float32)
        functions = (functions[:, :, None] * factors[:, None, :]).reshape(len(change), -1)
    return np.asarray(change.astype(np.float32)[:, :, None] * functions[:, None, :])
