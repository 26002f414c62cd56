"""Coverage of the 95 % intervals of the fit, and bias of B and C, over many simulated fleets.

    python -m benchmarks.coverage --fleets 200

Fleets differ in deviations, model bias (0.5 m/s and more), day and flight errors of the model and
airspeed scales; 1 % of the winds are reversed. Exit status 1 where coverage is outside 93-97 % or
the bias of B or C reaches 0.02 degrees.
"""

import argparse
import sys

import numpy as np
from tests.compass.flown import Setting, fleet_deviations, fly, wrap

import airswing  # noqa: F401
from airswing.compass.fit.deviation import COEFFICIENTS, fit_deviation

NAMES = (*COEFFICIENTS, "offset", "amplitude", "phase")


def one_fleet(setting, seed, pools):
    """Errors and standard errors of one fleet, (aircraft, 8) each."""
    rng = np.random.default_rng([seed, 1])
    deviation = fleet_deviations(setting.aircraft, rng, two_cycles=0.7)
    ds, _ = fly(deviation, setting, seed)
    fits = fit_deviation(ds, pools=pools).isel(reference=-1)
    amplitude = np.hypot(deviation[:, 1], deviation[:, 2])
    phase = np.degrees(np.arctan2(deviation[:, 2], deviation[:, 1]))
    error = np.column_stack(
        [
            fits["deviation"].to_numpy() - deviation,
            fits["offset"].to_numpy() - deviation[:, 0],
            fits["amplitude"].to_numpy() - amplitude,
            wrap(fits["phase"].to_numpy() - phase),
        ]
    )
    spread = np.column_stack(
        [
            np.sqrt(np.diagonal(fits["deviation_covariance"].to_numpy(), axis1=1, axis2=2)),
            *[fits[f"{name}_standard_error"].to_numpy() for name in NAMES[5:]],
        ]
    )
    return error, spread


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--fleets", type=int, default=200)
    parser.add_argument("--aircraft", type=int, default=6)
    parser.add_argument("--days", type=int, default=40)
    parser.add_argument("--references", type=int, default=1)
    parser.add_argument("--hub-and-spoke", action="store_true")
    options = parser.parse_args()
    setting = Setting(
        aircraft=options.aircraft,
        days=options.days,
        flights_a_day=4,
        references=options.references,
        day_error=0.5,
        outliers=0.01,
        hub_and_spoke=options.hub_and_spoke,
    )
    pools = {"pool": ["ruc", "rtfdaa"]} if options.references > 1 else {}
    fleets = [one_fleet(setting, seed, pools) for seed in range(options.fleets)]
    error, spread = (np.concatenate(column) for column in zip(*fleets, strict=True))
    fitted = np.isfinite(error[:, 0])
    print(f"{options.fleets} fleets, {fitted.sum()} of {fitted.size} aircraft fitted")
    good = True
    for k, name in enumerate(NAMES):
        e, s = error[fitted, k], spread[fitted, k]
        inside = np.mean(np.abs(e) <= 1.96 * s)
        good &= 0.93 <= inside <= 0.97 and (name not in "BC" or abs(e.mean()) < 0.02)
        print(
            f"{name:10s} covered {100 * inside:5.1f} %   mean {e.mean():+.4f}   "
            f"rms {np.sqrt(np.mean(e**2)):.4f}   mean standard error {s.mean():.4f}"
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
