"""What neighbours do not foretell of single reports, beside simulated archives that may jitter.

Assumptions: simulated archives fly the same paths through the noise model's noise and code it as
the unit does; an instrument that jitters adds an error drawn anew for every report. Logarithms of
squares are compared: a few gross errors hardly move their means.

Validity: that of the noise model. The same draws serve every simulated archive, so that two differ
by their jitter alone.

Units: m/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.reported_variables import OF_THE_REPORT, Variable, record, values_of
from airswing.gap.archive.value_tables import Grid
from airswing.gap.noise.beside_neighbours import even_interpolation_errors
from airswing.gap.noise.model import NoiseFit
from airswing.gap.simulation.forward import Coding, draw_noise

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Simulated archives.
DRAWS = 3
#: Squares that are told apart from nothing: keeps logarithms of coded zeros finite.
LEAST_SQUARE = 0.01
#: Rounds in which simulated archives learn to jitter as the real one does.
ROUNDS = 4


class Scene:
    """The archive's paths, and simulated archives along them."""

    def __init__(
        self, frame: Frame, quiet: Frame, noise: NoiseFit, rng: np.random.Generator
    ) -> None:
        self.frame, self.quiet, self.noise = frame, quiet, noise
        self.variables: Mapping[str, Variable] = record(frame, quiet)
        self.errors = np.stack([draw_noise(frame, noise.model, rng=rng) for _ in range(DRAWS)], 1)
        self.jitter = rng.standard_normal(self.errors.shape)
        self.told: list[dict[str, Floats]] = []

    def log_squares(self, residuals: Floats) -> Floats:
        """Logarithm of what neighbours do not foretell, squared, (n, c); NaN where left out.

        Parameters
        ----------
        residuals : (n, c, 2) float
        """
        count, number, _ = residuals.shape
        flat = residuals.reshape(count, 2 * number)
        errors, precision = even_interpolation_errors(flat, self.noise.order, self.noise.gains)
        square = precision[:, None] * (errors.reshape(residuals.shape) ** 2).sum(axis=2) / 2
        out = np.log(square + LEAST_SQUARE)
        out[precision <= 0] = np.nan
        return np.asarray(out)

    def simulated(self, sizes: Floats, number: int = DRAWS) -> Floats:
        """The same of simulated archives whose reports jitter by so much, (n, number)."""
        frame, coding, told = self.frame, Coding.as_found(self.frame), []
        sent = []
        for k in range(number):
            error = self.errors[:, k] + sizes[:, None] * self.jitter[:, k]
            u, v = coding.apply(frame.u_ref + error[:, 0], frame.v_ref + error[:, 1])
            made = replace(frame, u_rep=u, v_rep=v)
            told.append({name: values_of(made, self.quiet, name) for name in OF_THE_REPORT})
            sent.append(made.residual)
        self.told = told
        return self.log_squares(np.stack(sent, axis=1))

    def cells(self, grid: Grid, k: int | None = None) -> Integers:
        """Cells of the real archive's reports, or of those of a simulated one."""
        own = {} if k is None else self.told[k]
        name = grid.variables[0]
        return grid.cells((own.get(name, self.variables[name].values),))

    def means(self, values: Floats, cells: Integers, size: int) -> tuple[Floats, Floats]:
        """Sums and counts of known values by aircraft and cell, (aircraft, size) each."""
        use = np.isfinite(values) & (cells >= 0)
        place = self.frame.aircraft[use] * size + cells[use]
        shape = len(self.frame.tails), size
        whole = shape[0] * shape[1]
        total = np.bincount(place, values[use], minlength=whole).astype(np.float64)
        count = np.bincount(place, minlength=whole).astype(np.float64)
        return total.reshape(shape), count.reshape(shape)


def jitter_showing(scene: Scene, wanted: Floats, cells: Integers, beyond: float) -> Floats:
    """Jitter of each cell, m/s, by which ln variance in a simulated archive grows as wanted.

    Parameters
    ----------
    wanted : (m,) float
        Growth of ln variance in each cell; 0 for none.
    cells : (n,) int
        -1 outside all.
    beyond : float
        What all reports of the real archive have beyond simulated ones: it jitters by as much more.
    """
    inside = cells >= 0
    own = np.maximum(cells, 0)

    def mean(values: Floats) -> Floats:
        use = inside & np.isfinite(values)
        count = np.maximum(np.bincount(own[use], minlength=wanted.size), 1)
        return np.asarray(np.bincount(own[use], values[use], minlength=wanted.size) / count)

    start = mean(scene.simulated(np.zeros(cells.size), 1)[:, 0])
    square = np.where(wanted > 0, np.expm1(wanted) * scene.noise.model.white_sd**2, 0.0)
    for _ in range(ROUNDS):
        sizes = np.where(inside, np.sqrt(square)[own], 0.0)
        grown = mean(scene.simulated(sizes, 1)[:, 0]) - start
        # at most fivefold a round: scatter of one simulated archive must not throw a cell out of
        # reach
        square *= np.clip(np.expm1(wanted) / np.maximum(np.expm1(grown), 1e-3), 0.2, 5.0)
    return np.asarray(np.sqrt(square) * np.exp(beyond / 2))
