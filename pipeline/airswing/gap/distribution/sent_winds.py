"""Speeds and directions that are sent too often or never: floors, ceilings, holes, steps.

Counts of reported speeds and directions are compared with those of simulated reports (docs/gap.md,
section 6). A smooth ratio of the two is the weather's; a cell that differs from its neighbours is
the unit's. The closure is the disagreement that the map of speeds, or the step of directions, adds
to simulated reports; of directions without a step it is not known.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from airswing.gap.archive.frame import Frame
from airswing.gap.archive.lattices import DirectionLattice, direction_lattice
from airswing.gap.arrays import Booleans, Floats, Integers
from airswing.gap.distribution.entries import closes, place_of
from airswing.gap.effects.empirical import speed_ratio
from airswing.gap.model.sums import GATE, days_of
from airswing.gap.result.schema import ClosesEntry, CurveEntry, PlaceEntry, StepsEntry
from airswing.gap.simulation.forward import Coding
from airswing.units import KNOT

#: Least contrast of the log ratio of a cell: 15 % of its reports.
LEAST_CONTRAST = 0.15


def simulated_winds(frame: Frame, residual: Floats, rng: np.random.Generator) -> Floats:
    """Reference winds plus the residual of another report of its level, coded alike, (n, 2)."""
    levels = 8
    level = np.argsort(np.argsort(frame.pressure)) * levels // frame.size
    wind = np.stack([frame.u_ref, frame.v_ref], -1)
    for k in range(levels):
        index = np.flatnonzero(level == k)
        wind[index] += residual[rng.permutation(index)]
    u, v = Coding.of_archive(frame).apply(wind[:, 0], wind[:, 1])
    return np.stack([u, v], -1)


def _classes(wind: Floats, top: int) -> dict[str, Integers]:
    speed = np.hypot(*wind.T) / KNOT
    direction = np.mod(np.degrees(np.arctan2(-wind[:, 0], -wind[:, 1])), 360.0)
    return {
        "wind_speed": np.clip(np.round(speed).astype(np.int64) // 2, 0, top),
        "wind_direction": (direction // 10.0).astype(np.int64) % 36,
    }


def contrasts(real: Floats, simulated: Floats, periodic: bool) -> tuple[Floats, Floats]:
    """Contrast of each cell with a smooth ratio: z by day, and the log ratio; (D, k) counts."""
    total, expected = real.sum(axis=0), simulated.sum(axis=0)
    k = total.size
    used = expected > 50.0  # fewer are too uncertain
    x = np.arange(k)
    if periodic:
        waves = [f(2 * np.pi * j * x / k) for j in (1, 2, 3) for f in (np.sin, np.cos)]
        design = np.stack([np.ones(k), *waves], -1)
    else:
        design = np.polynomial.legendre.legvander(2 * x / max(k - 1, 1) - 1, min(6, k - 1))
    ratio = np.log((total + 1) / (expected + 1))
    weight = usual = np.sqrt(np.where(used, expected, 0.0))
    contrast = ratio
    for _ in range(8):  # cells far off must not bend the smooth ratio
        smooth = design @ np.linalg.lstsq(design * weight[:, None], ratio * weight, rcond=None)[0]
        contrast = ratio - smooth
        spread = 1.48 * np.median(np.abs(contrast[used])) + 1e-3 if used.any() else 1.0
        weight = usual * np.minimum(1, 2 * spread / np.maximum(np.abs(contrast), 1e-9))
    differences = real - simulated * np.exp(np.clip(smooth, -5.0, 5.0))
    z = differences.sum(axis=0) / np.sqrt((differences**2).sum(axis=0) + 1)
    return np.where(used, z, 0.0), np.where(used, contrast, 0.0)


def find_sent_winds(
    frame: Frame, residual: Floats, *, without: Collection[int] = (), gross: Booleans, seed: int = 0
) -> tuple[PlaceEntry, tuple[int, ...]] | None:
    """Winds sent otherwise than simulated ones, where the evidence passes the gate.

    ``residual`` (n, 2) is without the effects found; aircraft (``without``) whose coding has a name
    are left out. Also returns the numbers of the affected aircraft.
    """
    rng = np.random.default_rng(seed)
    days, day, _ = days_of(frame)
    use = ~np.isin(frame.aircraft, list(without)) & ~gross
    if days.size < 7 or use.sum() < 2000:
        return None  # the scatter between days is not known
    # real reports as they are, simulated ones without the effects on means
    real = np.stack([frame.u_rep, frame.v_rep], -1)
    drawn = [simulated_winds(frame, residual, rng) for _ in range(6)]
    top = int(np.quantile(np.hypot(*real.T) / KNOT, 0.95)) // 2 + 1
    cells = [_classes(wind, top) for wind in (real, *drawn)]
    best: tuple[float, str, int, int] | None = None
    number, aircraft = days.size, len(frame.tails)
    counted: dict[str, tuple[Floats, Floats]] = {}
    for name, size in (("wind_speed", top + 1), ("wind_direction", 36)):
        key = (frame.aircraft * number + day) * size
        counts = [
            np.bincount(key[use] + cell[name][use], minlength=aircraft * number * size)
            .reshape(aircraft, number, size)
            .astype(float)
            for cell in cells
        ]
        actual, simulated = counts[0], np.mean(counts[1:], axis=0)
        if name == "wind_speed":  # calm and the open class at the end have no neighbours
            actual, simulated = actual[:, :, 1:-1], simulated[:, :, 1:-1]
        counted[name] = actual, simulated
        for a in (-1, *range(aircraft)):
            total, expected = (x.sum(axis=0) if a < 0 else x[a] for x in (actual, simulated))
            z, contrast = contrasts(total, expected, name == "wind_direction")
            z = np.where(np.abs(contrast) > LEAST_CONTRAST, z, 0.0)
            # likelihood of the mean of D normal days of unknown variance (Student's law)
            evidence = -0.5 * number * np.log1p(-(z**2) / number)
            k = int(np.argmax(evidence))
            price = np.log(2.0 * size) + (0.0 if a < 0 else np.log(2.0 * aircraft))
            score = float(evidence[k] - price)
            if score > GATE and (best is None or score > best[0]):
                best = score, name, k, a
    if best is None:
        return None
    score, name, k, a = best
    tails = _aircraft_of(*counted[name], k, name == "wind_direction", a)
    rows = np.isin(frame.aircraft, tails) & use
    speeds, sent = _speed_map(real, drawn, rows)
    count = [np.bincount(cell["wind_direction"][rows], minlength=36) for cell in cells]
    directions = count[0] / np.maximum(np.mean(count[1:], axis=0), 1.0) - 1.0
    component, rms = "reported_direction", 0.0
    closure = closes(0.0, 0.0)
    grid = direction_lattice(*real[rows].T) if name == "wind_direction" else None
    if grid is not None:
        sent_instead = [_on_lattice(wind, grid) for wind in drawn]
        closure = _closure(frame, drawn, sent_instead, rows, day)
    percent = (100.0 * directions).tolist()
    curve = CurveEntry([f"{10 * k}" for k in range(36)], percent, unit="percent")
    if name == "wind_speed" and (speeds != sent).any():
        component = "reported_speed"
        rms = float(np.sqrt(np.mean((sent - speeds) ** 2)))
        ratios = [speed_ratio(np.hypot(*wind.T), speeds, sent) for wind in drawn]
        sent_instead = [wind * ratio[:, None] for wind, ratio in zip(drawn, ratios, strict=True)]
        closure = _closure(frame, drawn, sent_instead, rows, day)
        labels, values = [f"{speed:.3g}" for speed in speeds], sent.tolist()
        curve = CurveEntry(labels, values, "m/s", [name], ["m/s"], [speeds.tolist()], values)
    place = place_of(component, name, tails, frame.tails, score, rms, curve, closure)
    place = replace(place, settled_by="the unit's winds before coding and those it sends")
    if grid is not None:
        place = replace(place, steps=StepsEntry(grid.step, grid.below / KNOT, grid.share))
    return place, tails


def _aircraft_of(
    real: Floats, simulated: Floats, cell: int, periodic: bool, first: int
) -> tuple[int, ...]:
    signs = np.zeros(real.shape[0])
    for a in range(real.shape[0]):
        z, contrast = contrasts(real[a], simulated[a], periodic)
        signs[a] = z[cell] * min(1.0, abs(contrast[cell]) / LEAST_CONTRAST)
    top = first if first >= 0 else int(np.argmax(np.abs(signs)))
    # two standard errors, and the sign of the clearest
    has = np.sign(signs) == np.sign(signs[top])
    has &= np.abs(signs) > max(2.0, 0.25 * abs(signs[top]))
    has[top] = True
    return tuple(int(a) for a in np.flatnonzero(has))


def _speed_map(real: Floats, drawn: list[Floats], rows: Booleans) -> tuple[Floats, Floats]:
    """Speeds and the speeds that are reported instead, (m,) each, m/s."""
    levels = (np.arange(80) + 0.5) / 80
    simulated = np.stack([np.quantile(np.hypot(*wind[rows].T), levels) for wind in drawn])
    speeds = simulated.mean(axis=0)
    sent = np.quantile(np.hypot(*real[rows].T), levels)
    same = np.abs(sent - speeds) < KNOT  # the step of a knot in which winds are coded
    sent = np.maximum.accumulate(np.where(same, speeds, sent))
    speeds = np.maximum.accumulate(speeds + 1e-6 * np.arange(levels.size))
    return speeds, np.where(same, speeds, sent)


def _on_lattice(wind: Floats, grid: DirectionLattice) -> Floats:
    speed, direction = np.hypot(*wind.T), np.arctan2(*wind.T)
    step = np.radians(grid.step)
    on = np.where(speed <= grid.below, step * np.round(direction / step), direction)
    return np.stack([speed * np.sin(on), speed * np.cos(on)], -1)


def _closure(
    frame: Frame, drawn: list[Floats], sent: list[Floats], rows: Booleans, day: Integers
) -> ClosesEntry:
    reference = np.stack([frame.u_ref, frame.v_ref], -1)
    added = np.zeros(frame.size)
    for before, after in zip(drawn, sent, strict=True):
        longer = np.hypot(*(after - reference).T) - np.hypot(*(before - reference).T)
        added += np.where(rows, longer, 0.0) / len(drawn) / KNOT
    by_day, count = np.bincount(day, added), np.bincount(day)
    value = float(added.mean())
    spread = float(np.sqrt(((by_day - value * count) ** 2).sum()) / frame.size)
    # winds cannot come nearer by it: a value below zero is an error of the simulated distribution
    return closes(max(value, 0.0), float(np.hypot(spread, max(0.16 * value, -value))))
