"""Where real reports differ from simulated ones: the slices of docs/gap.md, section 8.

Cross-fitted energies theta_A' G theta_B have expectation zero where nothing is there. Significance
is a chi-squared test of the score with the slice's noise factor (q values: Benjamini and Hochberg
1995).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2, false_discovery_control

from airswing.gap.archive.reported_variables import CATEGORIES
from airswing.gap.arrays import Booleans, Floats
from airswing.gap.model.candidates import CYCLES, Curve
from airswing.gap.model.evidence import common_variance
from airswing.gap.model.refit import fold_of_day
from airswing.gap.model.terms import Model
from airswing.gap.result.schema import CurveEntry, SliceEntry


def score_test(information: Floats, score: Floats, factor: float) -> tuple[float, Floats]:
    """Chi-squared p value of a score, and the estimate, (m,)."""
    values, vectors = np.linalg.eigh(information)
    retained = values > 1e-3 * max(values[-1], 1e-300)  # directions of hardly any information
    half = vectors[:, retained] / np.sqrt(values[retained])
    projected = half.T @ score
    p_value = float(chi2.sf(float(projected @ projected) / factor, int(retained.sum())))
    return p_value, np.asarray(half @ projected)


def cross_fitted(information: Floats, by_day: Floats, half: Booleans) -> float:
    """Energy theta_A' G theta_B of two halves of the days."""
    m = information.shape[0]
    inner = 0.5 * information + 1e-3 * np.trace(information) / m * np.eye(m)
    first = np.linalg.solve(inner, by_day[half].sum(axis=0))
    second = np.linalg.solve(inner, by_day[~half].sum(axis=0))
    return float(first @ information @ second)


def slices(model: Model) -> list[SliceEntry]:
    """All slices of an archive given the climatology alone, largest share of the gap first."""
    sums = model.sums
    half = fold_of_day(sums.D)[sums.first_day] % 2 == 0
    if half.all() or not half.any():
        half = np.arange(sums.T) % 2 == 0
    rows: list[SliceEntry] = []
    for group in (g for g in sums.candidates.groups if g.kind == "table" and g.form == (0,)):
        stats = model.statistics(group)
        score = model.day_score[:, :, group.columns] @ group.transform
        knots = knots_in_words(sums.candidates.table_of(group).curves[0])
        if group.name == "magnetic_heading|heading_angle":
            for a, tail in enumerate(sums.frame.tails):
                information = stats.information[a]
                if np.trace(information) <= 0:
                    continue
                factor = max(1.0, float(stats.factor[a]))
                p_value, estimate = score_test(information, score[a].sum(axis=0), factor)
                energy = cross_fitted(information, score[a], half)
                curve = CurveEntry(knots, estimate.tolist())
                entry = SliceEntry("aircraft", "both", [tail], 0.0, 1.0, p_value, energy, "", curve)
                rows.append(entry)
        information = stats.fleet_information
        if np.trace(information) <= 1e-9:
            continue
        # the lasting error of the reference counts as noise of the fleet's coefficients
        variance, given_back = common_variance(stats)
        variance = variance - given_back + stats.fleet_inverse
        total_score = score.sum(axis=(0, 1))
        coefficients = stats.fleet_inverse @ total_score
        spread = np.linalg.solve(variance, coefficients)
        p_value = float(chi2.sf(float(coefficients @ spread), coefficients.size))
        _, estimate = score_test(information, total_score, 1.0)
        energy = cross_fitted(information, score.sum(axis=0), half)
        curve = CurveEntry(knots, (group.transform @ estimate).tolist())
        variable, component, name = group.variables[0], group.component, group.name
        rows.append(SliceEntry(variable, component, knots, 0.0, 1.0, p_value, energy, name, curve))
    quality = false_discovery_control([row.p_value for row in rows]) if rows else np.zeros(0)
    aircraft = sum(max(row.energy, 0.0) for row in rows if row.variable == "aircraft")
    total = max(aircraft, max((row.energy for row in rows), default=0.0), 1e-9)
    out = [
        replace(row, q_value=float(q), share_of_gap=float(np.clip(row.energy / total, 0, 1)))
        for row, q in zip(rows, quality, strict=True)
    ]
    return sorted(out, key=lambda row: -row.share_of_gap)


def knots_in_words(curve: Curve) -> list[str]:
    """Knots of a variable in its unit, categories by name, cycles as ``sin2``."""
    if curve.variable == "magnetic_heading" and curve.knots.size == 1:
        return ["constant", *(f"{f}{k}" for k in range(1, CYCLES + 1) for f in ("sin", "cos"))]
    if curve.variable in CATEGORIES:
        return [CATEGORIES[curve.variable][int(knot)] for knot in curve.knots]
    return [f"{knot:.5g}" for knot in curve.knots]
