"""Products: pairs of variables that together move the whole fleet's winds, and neither does alone.

Assumptions: of an effect that needs two variables a part is a product of a smooth shape of each:
one or two waves of a direction or hour, a ramp, a bend and a turn of a range, a flag. With q the
residual's score beside the days and the climatology (:mod:`airswing.gap.witness.cell_means`), every
report alike, and f a shape,

    s_d = sum_(i of day d) f_a(i) f_b(i) q_i'd_i

tells it without a table, by Student's t of the days' sums: they scatter independently, whatever the
noise. What else goes with a large effect tells as surely, so of those that tell that one leads
which explains most, (sum_d s_d)^2 over the sum of w f_a^2 f_b^2. All pairs are one product of
matrices a day, where a table of each would cost an hour.

Validity: effects all aircraft have. The reference's large-scale wind stands for the reported one,
which holds the residual. Drift is left out: the one flown holds the wind's error, and goes with
heading on every archive.

Units: standard errors, of a normal law as unlikely.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from airswing.gap.archive.reported_variables import CATEGORIES, Variable
from airswing.gap.archive.value_tables import COMPONENTS
from airswing.gap.witness.bench import Bench

Floats = NDArray[np.float64]

#: Variables that hold the error itself.
HOLDS_ERROR = ("drift",)
#: Standard errors from which a pair is weighed as a table: the largest of 1,900 products on four
#: archives without effect and sixteen simulated ones was 4.2.
TELLS = 4.8
#: Pairs at most.
MOST = 3

Product = tuple[float, str, tuple[str, str]]
"""What it explains (in squares of the noise), component, variables."""


def products(bench: Bench, alike: tuple[tuple[str, ...], ...] = ()) -> list[Product]:
    """Pairs of variables that tell, those that explain most first, at most :data:`MOST`.

    Parameters
    ----------
    alike : tuple of tuple of str
        Variables that tell each other: no pairs are made of these.
    """
    names, shapes = _all_shapes(bench)
    group = {name: number for number, own in enumerate(alike) for name in own}
    owner = np.array([group.get(name, -1) for name in names])
    same = np.equal.outer(np.array(names), np.array(names))
    same |= np.equal.outer(owner, owner) & (owner >= 0)
    model = bench.setting.cell_model_of(False)
    score = model.score(model.weigh(bench.residuals[0]))
    found: dict[tuple[str, str], Product] = {}
    for component in COMPONENTS:
        pulled = np.einsum("nc,nc->n", score, bench.direction(component))
        told = deviations(shapes, pulled, bench.setting.day)
        told[same] = 0.0
        weight = model.weight * (bench.direction(component) ** 2).sum(axis=1)
        least = (shapes**2).T @ (weight[:, None] * shapes**2)
        explains = (shapes.T @ (pulled[:, None] * shapes)) ** 2 / least
        for i, j in zip(*np.nonzero(np.triu(told) >= TELLS), strict=True):
            pair = names[i], names[j]
            if explains[i, j] > found.get(pair, (0.0,))[0]:
                found[pair] = float(explains[i, j]), component, pair
    return sorted(found.values(), reverse=True)[:MOST]


def deviations(shapes: Floats, pulled: Floats, day: NDArray[np.int64]) -> Floats:
    """Standard errors by which the product of every two shapes tells, (m, m), of either sign.

    Parameters
    ----------
    shapes : (n, m) float
    pulled : (n,) float
        Score of every report.
    day : (n,) int
    """
    total, square = np.zeros((2, shapes.shape[1], shapes.shape[1]))
    order = np.argsort(day, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(day[order])) + 1):
        part = shapes[own]
        each = part.T @ (pulled[own, None] * part)
        total += each
        square += each**2
    number = np.unique(day).size
    # the scatter about nothing holds the sum's own square: of few days alone t could not be large
    ratio = np.divide(total**2, square, out=np.zeros_like(total), where=square > 0)
    told = np.sqrt(ratio * (number - 1) / np.maximum(number - ratio, 1e-9))
    return np.asarray(norm.isf(t.sf(told, number - 1)))


def _all_shapes(bench: Bench) -> tuple[list[str], Floats]:
    """Names of the variables and their shapes, (n, m), of mean square one."""
    names, made = [], []
    quiet = bench.setting.quiet
    large = {
        "wind_direction": np.degrees(np.arctan2(-quiet.u_ref, -quiet.v_ref)),
        "wind_speed": np.hypot(quiet.u_ref, quiet.v_ref),
    }
    for name, variable in bench.variables.items():
        if name in HOLDS_ERROR:
            continue
        for shape in shapes_of(variable, large.get(name, variable.values)):
            names.append(name)
            made.append(shape)
    return names, np.stack(made, -1)


def shapes_of(variable: Variable, values: Floats) -> list[Floats]:
    """Smooth shapes of a variable, (n,) each: of mean nothing and mean square one, 0 if unknown."""
    known = np.isfinite(values)
    if variable.kind == "circular":
        turn = 2 * np.pi * values / variable.period
        told = [wave(k * turn) for k in (1, 2) for wave in (np.sin, np.cos)]
    elif variable.kind == "linear":
        place = np.searchsorted(np.sort(values[known]), values) / known.sum() * 2 - 1
        told = list(np.polynomial.legendre.legvander(place, 3).T[1:])
    else:
        told = [np.equal(values, k) * 1.0 for k in range(len(CATEGORIES[variable.name]))]
    out = []
    for shape in told:
        apart = np.where(known, shape, 0.0)
        apart[known] -= apart[known].mean()
        size = float(np.sqrt((apart**2).mean()))
        if size > 0:
            out.append(apart / size)
    return out
