"""An archive on the bench: its tables weighed beside those of simulated archives of its paths.

Assumptions: a table that stands on the path alone (position, hour, heading ...) has the same
columns in the real archive and in the simulated ones. One that stands on the reported wind itself
holds the noise of the report, which by itself makes errors depend on it (regression towards the
mean): its sums are those of the real archive less the mean of the simulated ones, each with its own
reported winds, coded as the unit codes them.

Validity: simulated archives hold the noise, the day fields and the climatology the real one shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import OF_THE_REPORT, Variable, record, values_of
from airswing.gap.archive.value_tables import Grid, axis_of, change_of
from airswing.gap.design.basis import DictionaryPlan
from airswing.gap.held_out.share_held import BLOCK
from airswing.gap.noise.model import NoiseFit
from airswing.gap.simulation.forward import Coding
from airswing.gap.sums.problem import Problem
from airswing.gap.sums.variance_components import Variances
from airswing.gap.witness.cell_means import CellModel, CellSums, Weights
from airswing.gap.witness.ground import Ground, Left, Sums, plain_sums, prepare
from airswing.gap.witness.null import drawn_errors, shown_share, small_scale_slope
from airswing.gap.witness.scan import Weighed, evidence, weigh

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Persistent error allowed for in single aircraft's tables, m/s.
PERSISTENT = 0.04
#: The same of the fleet's, of a table that the climatology takes up wholly.
FLEET_PERSISTENT = 0.12
#: The same in one region and not in the next: a season's mean does not tell it from an effect of
#: the whole fleet in that region.
REGION_PERSISTENT = 0.4
REGION = ("longitude", "latitude")
#: The same of tables by the reported wind: what simulated archives have otherwise than real ones.
REPORTED_PERSISTENT = 0.25
#: The same of the fleet by drift, which holds a part of the wind's error: 0.2 to 0.3 m/s on nulls.
DRIFT_PERSISTENT = 0.25
#: Least factor by which their scatter between blocks counts where cells are of the reported wind:
#: aircraft turn about it, so that errors of a place cancel in it. By what goes with the place, as
#: track does, they last, and blocks that are alike tell nothing (2 false tables of 20 short toys).
LEAST_FACTOR = 0.4


@dataclass
class _Made:
    """What stands on the paths alone, once it was asked for."""

    cell_models: dict[bool, CellModel] = field(default_factory=dict)  # by whether of half days
    ground: Ground | None = None
    record: dict[str, Variable] | None = None


@dataclass(frozen=True)
class Setting:
    """What stays the same while residuals change."""

    # frame, quiet: reports, and the same with heading, airspeed and wind free of the residual's
    # noise
    frame: Frame
    quiet: Frame
    noise: NoiseFit
    plan: DictionaryPlan
    variances: Variances
    day: Integers  # (n,): index of each report's day
    errors: Floats  # (B, n, 2): errors of the reference drawn for simulated archives, m/s
    followed: Floats  # (n, 2): what reports follow of the reference's small scales, m/s
    share: float  # part of the residual's mean square it makes
    made: _Made = field(default_factory=_Made, repr=False)

    @classmethod
    def of(cls, problem: Problem, *, draws: int = 4) -> Setting:
        """Draw the errors of this many simulated archives."""
        noise, plan, variances = problem.noise, problem.plan, problem.base.variances
        errors = drawn_errors(
            problem.context,
            draws,
            noise=noise,
            plan=plan,
            variances=variances,
            day=problem.day,
            rng=np.random.default_rng(problem.seed),
        )
        frame, quiet = problem.archive, problem.context
        followed, share = small_scale_slope(frame, quiet, frame.residual, ~noise.gross)
        return cls(frame, quiet, noise, plan, variances, problem.day, errors, followed, share)

    @property
    def half_day(self) -> Integers:
        """Number of each report's half of its day, (n,): every other flight."""
        # by turns, so that the way out is not in one half and the way back in the other
        return np.asarray(2 * self.day + (self.frame.flight + self.day) % 2)

    def cell_model_of(self, halves: bool) -> CellModel:
        """Fields of days, or of each half's own, and climatology beside which tables are fitted."""
        known = self.made.cell_models
        if halves not in known:
            known[halves] = CellModel.of(
                self.quiet,
                self.plan,
                noise=self.noise,
                variances=self.variances,
                day=self.half_day if halves else self.day,
            )
        return known[halves]

    @property
    def ground(self) -> Ground:
        """Whitened columns of everything the reference does."""
        if self.made.ground is None:
            self.made.ground = prepare(
                self.quiet,
                noise=self.noise,
                plan=self.plan,
                variances=self.variances,
                day=self.day,
            )
        return self.made.ground

    @property
    def alike(self) -> Setting:
        """The same with simulated reports that vary and regress as the real ones do.

        What they follow holds a part of an effect that all days share, so that tables, which take
        their mean off, would lose it: those meet errors that know nothing of the archive's winds.
        """
        errors = self.followed + np.sqrt(1 - self.share) * self.errors
        return replace(self, errors=errors, followed=np.zeros_like(self.followed), share=0.0)


@dataclass(frozen=True)
class Bench:
    """Residuals of the real archive and of simulated ones, ready for tables."""

    setting: Setting
    # (1 + B, n, 2): residual of the real archive and of each simulated one, what was found taken
    # off, m/s
    residuals: Floats
    # (n,) each: reported winds (u, v) of each, m/s
    winds: tuple[tuple[Floats, Floats], ...]
    variables: dict[str, Variable]  # name -> variable of the real archive
    # name -> values of the variables of the reported wind, of each simulated archive
    simulated: tuple[dict[str, Floats], ...]
    # share of the simulated archives' dependence on their own reported winds that the real one
    # shows: 1 where all error is the report's beside the reference, 0 the other way round
    regression: float
    made: dict[object, Floats] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, setting: Setting, rest: Floats) -> Bench:
        """Put a residual on the bench.

        Parameters
        ----------
        rest : (n, 2) float
            m/s.
        """
        frame, quiet = setting.frame, setting.quiet
        explained = frame.residual - rest
        coding = Coding.of_archive(frame)
        told, values = [rest], []
        winds = [(frame.u_rep, frame.v_rep)]
        for error in setting.errors:
            met = error + explained
            u, v = coding.apply(frame.u_ref + met[:, 0], frame.v_ref + met[:, 1])
            sent = replace(frame, u_rep=u, v_rep=v)
            told.append(sent.residual - explained)
            winds.append((u, v))
            values.append({name: values_of(sent, quiet, name) for name in OF_THE_REPORT})
        if setting.made.record is None:
            setting.made.record = record(frame, quiet)
        variables = setting.made.record
        bench = cls(setting, np.stack(told), tuple(winds), variables, tuple(values), 1.0)
        return replace(bench, regression=regression_share(bench))

    @cached_property
    def left(self) -> Left:
        """The real residual with everything the reference does taken out."""
        return self.setting.ground.solved(self.residuals[:1])

    @cached_property
    def weighed_residuals(self) -> dict[tuple[int, bool], Weights]:
        """Sums of residuals beside the days and the climatology, once they were asked for."""
        return {}

    @property
    def alike(self) -> Bench:
        """The same residual beside archives whose reports vary and regress as the real ones do."""
        return Bench.of(self.setting.alike, self.residuals[0])

    def direction(self, component: str, of_wind: int | None = None) -> Floats:
        """Change of the wind by one unit of a component, (n, 2), m/s.

        Parameters
        ----------
        of_wind : int, optional
            Across and along the wind as reported in this archive (0: the real one), not its
            large-scale part.
        """
        if of_wind is None or "wind" not in component:
            key: object = component
            u, v = self.setting.quiet.u_ref, self.setting.quiet.v_ref
        else:
            key = component, of_wind
            u, v = self.winds[of_wind]
        if key not in self.made:
            quiet = self.setting.quiet
            self.made[key] = change_of(
                component, heading=quiet.heading, airspeed=quiet.airspeed, u=u, v=v
            )
        return self.made[key]

    def direction_for(self, grid: Grid, component: str) -> Floats:
        """Change of the real archive's wind by one unit, as a table's variables ask for it."""
        return self.direction(component, 0 if stands_on_report(grid) else None)

    def cells(self, grid: Grid) -> Integers:
        """Cells of the real archive, (n,)."""
        return grid.cells(tuple(self.variables[name].values for name in grid.variables))

    def sums(self, grid: Grid, component: str) -> tuple[Sums, float]:
        """Sums of a table, the simulated archives' mean taken off where they have their own.

        Returns
        -------
        sums : Sums
        spread : float
            What the subtraction multiplies variances by.
        """
        if not stands_on_report(grid):
            ground, direction = self.setting.ground, self.direction(component)
            return ground.sums(self.cells(grid), grid.size, direction, self.left), 1.0
        setting, count = self.setting, len(self.simulated)
        told = [self.cells(grid), *(grid.cells(self.told(grid, k)) for k in range(count))]
        made = []
        for k, cells in enumerate(told):
            direction = self.direction(component, k)
            values = np.einsum("nc,nc->n", self.residuals[k], direction)
            values[setting.noise.gross] = 0.0
            made.append(
                plain_sums(
                    values[None],
                    (direction**2).sum(axis=1),
                    cells,
                    grid.size,
                    aircraft=setting.frame.aircraft,
                    day=setting.day,
                )
            )
        found, *alike = made
        scores = np.stack([sums.score[0] for sums in alike])
        mean = scores.mean(axis=0)
        others = (count * mean - scores) / max(count - 1, 1)
        score = np.concatenate([found.score - self.regression * mean, scores - others])
        # what all aircraft share is the weather's: one aircraft's is what parts from it
        weight = np.maximum(found.gram.sum(axis=0).diagonal(), 1e-12)
        common = score.sum(axis=(1, 2)) / weight
        apart = score - found.day_diagonal * common[:, None, None]
        return replace(found, score=score, apart=apart), 1 + 1 / count

    def beside_others(self, grid: Grid, component: str, own: Sequence[int]) -> bool:
        """Whether a table by date is set beside other aircraft of the same days.

        Of heading and airspeed alone: in the frame of the wind weather of a region, which flights
        of a day share, passes for an error of the aircraft that fly there.

        Its flights can then be left out in place of whole days: what is common to the aircraft of a
        day is not in it, and no other day would tell what a cell between two jumps holds.
        """
        some = len(own) < len(self.setting.frame.tails)
        return some and "date" in grid.variables and "wind" not in component

    def cell_sums(self, grid: Grid, component: str, own: Sequence[int], fold: Integers) -> CellSums:
        """Sums of the values of a table of some aircraft, every report counting alike.

        Parameters
        ----------
        fold : (D,) or (2 D,) int
            Of the days, or of their halves (:meth:`beside_others`).
        """
        here = np.isin(self.setting.frame.aircraft, own)
        beside_others = self.beside_others(grid, component, own)
        whole_days = "date" in grid.variables and not beside_others
        model = self.setting.cell_model_of(beside_others)

        def of(k: int) -> CellSums:
            cells = self.cells(grid) if k == 0 else grid.cells(self.told(grid, k - 1))
            direction = self.direction(component, k if stands_on_report(grid) else None)
            key = k, beside_others
            if key not in self.weighed_residuals:
                self.weighed_residuals[key] = model.weigh(self.residuals[k])
            weights = self.weighed_residuals[key]
            return model.sums(
                np.where(here, cells, -1),
                grid.size,
                direction,
                weights=weights,
                fold=fold,
                whole_days=whole_days,
            )

        if not stands_on_report(grid):
            return of(0)
        simulated = tuple(of(k) for k in range(1, len(self.winds)))
        return replace(of(0), simulated=simulated, share=self.regression)

    def told(self, grid: Grid, k: int) -> tuple[Floats, ...]:
        """Values of a table's variables in the ``k``-th simulated archive."""
        own = self.simulated[k]
        return tuple(
            own[name] if name in own else self.variables[name].values for name in grid.variables
        )

    def weigh(self, grid: Grid, component: str) -> tuple[Weighed, Sums]:
        """Weigh a table.

        Returns
        -------
        Weighed, Sums
        """
        sums, spread = self.sums(grid, component)
        own = REPORTED_PERSISTENT if stands_on_report(grid) else PERSISTENT
        shared = max(own, DRIFT_PERSISTENT) if "drift" in grid.variables else own
        fleet = np.hypot(shared, FLEET_PERSISTENT * np.sqrt(sums.lasting_share))
        prior = self.prior(grid, component, sums)
        return weigh(sums, prior, fleet_error=float(fleet), error=own, spread=spread), sums

    def weigh_means(self, grid: Grid, component: str) -> float:
        """Evidence of a table of the whole fleet from its cells' means, nats.

        What changes along a flight tells little of an effect in the frame of the wind, whose
        direction hardly does; from day to day it turns, as errors fixed in place do not.
        """
        days = np.arange(int(self.setting.day.max()) + 1)
        fleet = range(len(self.setting.frame.tails))
        sums = self.cell_sums(grid, component, fleet, days // BLOCK)
        gram, score = sums.of_table(np.ones(sums.score.shape[0], bool))
        own = DRIFT_PERSISTENT if "drift" in grid.variables else PERSISTENT
        least = LEAST_FACTOR if stands_on_report(grid) else 1.0
        found, _ = evidence(
            gram,
            score[None],
            np.asarray(grid.prior()) / self.scale(component) ** 2,
            error=float(np.hypot(own, lasting_of_fleet(grid, sums.lasting_share))),
            factor=np.array([max(sums.factor, least)]),
        )
        return float(found[0])

    def persistent(self, grid: Grid, tails: Sequence[int]) -> float:
        """Error of the reference that lasts in a table of some aircraft or of all, m/s."""
        if stands_on_report(grid):
            return REPORTED_PERSISTENT
        whole = len(tails) == len(self.setting.frame.tails)
        return float(np.hypot(PERSISTENT, FLEET_PERSISTENT)) if whole else PERSISTENT

    def prior(self, grid: Grid, component: str, sums: Sums) -> Floats:
        """Prior correlation of a table's values, in squares of the component's unit.

        A mean by which the wind as reported is too strong or turned everywhere is the reference's:
        it is not in the table.
        """
        prior = grid.prior() / self.scale(component) ** 2
        if sums.apart is None:
            return np.asarray(prior)
        share = sums.count.sum(axis=0) / max(float(sums.count.sum()), 1.0)
        centred = np.eye(grid.size) - share
        return np.asarray(centred @ prior @ centred.T)

    def scale(self, component: str) -> float:
        """Root mean square of a component's directions, m/s per unit of a value."""
        return float(np.sqrt((self.direction(component) ** 2).sum(axis=1).mean()))


def stands_on_report(grid: Grid) -> bool:
    """Whether a table stands on the reported wind itself."""
    return bool(set(grid.variables) & set(OF_THE_REPORT))


def lasting_of_fleet(grid: Grid, share: float) -> float:
    """Error of the reference that lasts for the whole fleet in cells of means or runs, m/s.

    Parameters
    ----------
    grid : Grid
        The cells.
    share : float
        Part of them that the climatology can take up, 0 to 1.
    """
    if set(grid.variables) & set(REGION):
        return REGION_PERSISTENT
    return float(FLEET_PERSISTENT * np.sqrt(share))


def regression_share(bench: Bench) -> float:
    """Share of the simulated dependence on the reported wind that the real archive shows, 0 to 1.

    Of direction across the wind and of speed along it.
    """
    told = (("wind_direction", "across_wind"), ("wind_speed", "along_wind"))
    return shown_share(
        [
            _sums_by_reported(bench, name, component)
            for name, component in told
            if name in bench.variables and bench.simulated
        ]
    )


def _sums_by_reported(bench: Bench, name: str, component: str) -> Floats:
    """Sums over cells of the reported wind of the real archive and of each simulated one.

    In units of their noise, (1 + B, cells).
    """
    # cells of 15 degrees, and as many of speed
    grid = Grid((axis_of(bench.variables[name], 24),))
    told = [bench.cells(grid)]
    told += [grid.cells(bench.told(grid, k)) for k in range(len(bench.simulated))]
    count = np.maximum(np.bincount(told[0], minlength=grid.size), 1.0)
    sums = []
    for k, cells in enumerate(told):
        values = np.einsum("nc,nc->n", bench.residuals[k], bench.direction(component, k))
        values[bench.setting.noise.gross] = 0.0
        sums.append(np.bincount(cells, values, minlength=grid.size))
    return np.asarray(np.stack(sums) / np.sqrt(count))
