"""Content of gap.nc: maps of the residual, statistics by day, evidence and noise.

Assumptions: those of the modules that made them; the sums by day are of the core columns alone.

Validity: as the diagnosis; winds in m/s, distances in km, levels in hPa.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from airswing.gap.evidence.localisation import residual_maps
from airswing.gap.result.assembled import aircraft_probability, best_scores
from airswing.gap.search.stepwise import Found
from airswing.gap.sums.problem import Problem


def diagnosis_dataset(problem: Problem, found: Found) -> xr.Dataset:
    """Maps, evidence table and statistics as one Dataset."""
    frame, stats, noise = problem.archive, problem.base.stats, problem.noise
    out = residual_maps(frame)
    core = stats.layout.core
    names = np.array(
        [
            f"{n}[{i}]"
            for n, b in stats.layout.blocks.items()
            if b.stop <= core
            for i in range(b.stop - b.start)
        ],
        dtype=object,
    )
    out["core_column"] = ("core_column", names)
    out["core_column_2"] = ("core_column_2", names)
    begins = (stats.days * stats.clock.hours * 3600).astype("datetime64[s]")
    out["day"] = ("day", begins.astype("datetime64[ns]"))
    out["score"] = (("aircraft", "day", "core_column"), stats.day_score[:, :, :core])
    out["information"] = (
        ("aircraft", "core_column", "core_column_2"),
        stats.day_gram.sum(axis=1, dtype=float),
    )
    out["report_count"] = (("aircraft", "day"), stats.day_count)
    out["clipped_count"] = (("aircraft",), stats.clipped)
    out["gross_error_count"] = (("aircraft",), stats.gross)
    best = best_scores(found)
    out["effect"] = ("effect", np.array([s.candidate.name for s in best], dtype=object))
    out["log_evidence"] = ("effect", np.array([s.tempered for s in best], float))
    shares = [aircraft_probability(s) for s in best]
    out["aircraft_probability"] = (
        ("effect", "aircraft"),
        np.reshape(shares, (len(best), len(frame.tails))),
    )
    out["noise_distance"] = (("distance",), noise.distance_km)
    out["noise_autocovariance"] = (("distance",), noise.autocovariance)
    out["noise_autocovariance_model"] = (("distance",), noise.autocovariance_model)
    out["noise_level_factor"] = (("noise_level",), noise.model.level_factors)
    out["noise_level"] = (("noise_level",), np.exp(noise.model.level_nodes) / 100)
    return out
