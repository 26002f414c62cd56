"""What the gap says of errors that neither the catalogue nor the blind check's draw was made of.

    python -m benchmarks.gap_kinds [--headings DIR] [--kinds NAME ...]
    python -m benchmarks.gap_kinds --look DIR ...

A null archive of the blind check is written and its headings made by ``airswing gap`` (or those of
DIR are taken: headings.nc and gap_inputs.nc of an archive without an effect). Each kind of error is
put into the winds of three aircraft, or of all, and `airswing.diagnose`'s search asked what is
missing. A row is printed for each: all that is told, on how many of its aircraft and of others, and
what is stated to close against the truth, the same reports without the error. Exit status 1 where
a kind that has a name or a variable is told otherwise or on other aircraft; those that the
diagnosis does not tell yet are printed as open.

With ``--look`` nothing is put in: of archives as they are it prints how far the two looks at
headings reach without such errors, the largest k on the declination and mean cosine of steps, and
how much larger errors are across the heading than along it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.blind_check.check_run import Plan
from airswing.gap.archive.flight_time import flight_time
from airswing.gap.archive.frame import Frame
from airswing.gap.archive.heading_lattice import step_cosines
from airswing.gap.archive.other_winds import without
from airswing.gap.as_sent.magnetic_north import KNOWN, declination_slopes
from airswing.gap.diagnose import diagnose
from airswing.gap.noise.residual_statistics import directional_sd, remove_smooth_effects
from airswing.gap.result.schema import GapReport
from airswing.physics.atmosphere import STANDARD_PRESSURE, STANDARD_TEMPERATURE
from airswing.synthetic.sealed.sealed_archives import Archivist
from airswing.units import KNOT, ZERO_CELSIUS

Floats = NDArray[np.float64]

SEED = 734561
"""Of the null archive."""
STRUCK = (2, 5, 8)
"""Aircraft that err, by number."""


@dataclass(frozen=True)
class Kind:
    """An error, and what should be told of it: a name, or a variable of an unknown; "": open."""

    change: Callable[[Frame], Floats]  # of the wind sent, (n, 2), m/s
    told: str
    everyone: bool = False


def air(airspeed: Floats, heading: Floats) -> Floats:
    """Air vector, (n, 2), m/s."""
    return airspeed[:, None] * np.stack([np.sin(heading), np.cos(heading)], -1)


def heading_off(error: Callable[[Frame], Floats]) -> Callable[[Frame], Floats]:
    """What a heading error (rad) makes of the wind."""
    return lambda f: air(f.airspeed, f.heading) - air(f.airspeed, f.heading + error(f))


def airspeed_off(error: Callable[[Frame], Floats]) -> Callable[[Frame], Floats]:
    """What an airspeed error (m/s) makes of the wind."""
    return lambda f: air(f.airspeed, f.heading) - air(f.airspeed + error(f), f.heading)


def turned(angle: Callable[[Frame], Floats]) -> Callable[[Frame], Floats]:
    """What turning the wind sent to the right by an angle (rad) makes of it."""

    def change(f: Frame) -> Floats:
        sine, cosine = np.sin(angle(f)), np.cos(angle(f))
        u, v = f.u_rep, f.v_rep
        return np.stack([cosine * u + sine * v - u, cosine * v - sine * u - v], -1)

    return change


def in_steps(degrees: float) -> Callable[[Frame], Floats]:
    """Error of a heading in steps, rad."""
    step = np.radians(degrees)
    return lambda f: step * np.round(f.magnetic_heading / step) - f.magnetic_heading


def density_ratio_root(f: Frame) -> Floats:
    """Indicated over true airspeed."""
    return np.sqrt(f.pressure / STANDARD_PRESSURE * STANDARD_TEMPERATURE / f.temperature)


def by_sun(f: Frame) -> Floats:
    """A degree, by the heading and the hour, rad."""
    azimuth = 2 * np.pi * (f.time / 3600.0 - 6.0) / 24.0 + np.pi
    return np.radians(1.0) * np.cos(f.heading - azimuth)


def shifted(east: float) -> Callable[[Frame], Floats]:
    """Winds with an eastward part too much, m/s."""
    return lambda f: np.stack([np.full(f.size, east), np.zeros(f.size)], -1)


KINDS = {
    "heading_against_magnetic_north": Kind(
        heading_off(lambda f: -f.declination), "declination_error"
    ),
    "the_same_on_all": Kind(heading_off(lambda f: -f.declination), "declination_error", True),
    "declination_turned_round": Kind(
        heading_off(lambda f: -2 * f.declination), "declination_error"
    ),
    "direction_against_magnetic_north": Kind(turned(lambda f: -f.declination), "longitude"),
    "heading_in_steps_of_5": Kind(heading_off(in_steps(5.0)), "heading_coding"),
    "heading_in_steps_of_10": Kind(heading_off(in_steps(10.0)), "heading_coding"),
    "heading_drifts_in_flight": Kind(
        heading_off(lambda f: np.radians(1.0) * flight_time(f) / 60.0), "flight_time"
    ),
    "airspeed_warms_up": Kind(
        airspeed_off(lambda f: 2.0 * np.exp(-flight_time(f) / 15.0)), "flight_time"
    ),
    "heading_by_the_sun": Kind(heading_off(by_sun), "magnetic_heading"),
    "airspeed_wrong_in_the_cold": Kind(
        airspeed_off(lambda f: 0.01 * f.airspeed * (f.temperature < ZERO_CELSIUS - 20.0)),
        "temperature",
    ),
    "airspeed_indicated": Kind(
        airspeed_off(lambda f: f.airspeed * (density_ratio_root(f) - 1.0)), "altitude"
    ),
    "shifted_east": Kind(shifted(0.8), ""),
    "turned_by_4_degrees": Kind(turned(lambda f: np.full(f.size, np.radians(4.0))), ""),
    "eastward_part_without_sign": Kind(
        lambda f: np.stack([np.abs(f.u_rep) - f.u_rep, np.zeros(f.size)], -1), "", True
    ),
}


def null_headings(folder: Path) -> Path:
    """Headings of an archive without an effect, as the command makes them."""
    (case,) = Plan(cases=1, nulls=1, seed=SEED, rungs=(1,)).drawn()
    Archivist(folder).write(case)
    made = folder / "made"
    command = [sys.executable, "-m", "airswing", "gap", f"{folder}/cases/{case.name}/config.yaml"]
    subprocess.run([*command, "--output", str(made), "--quiet"], check=True)
    return made


def frame_of(folder: Path) -> Frame:
    """Reports against the pool of all references, as the command takes them of such archives."""
    headings = xr.open_dataset(folder / "headings.nc")
    inputs = xr.open_dataset(folder / "gap_inputs.nc")
    both = headings.assign(inputs.drop_vars("row_size").data_vars).load()
    return Frame.from_headings(both, reference=[str(one) for one in both["reference"].values])


def told_of(report: GapReport, fleet: Sequence[str]) -> list[tuple[str, list[str]]]:
    """All that is told, names first: name or variables, and aircraft."""
    names = [(one.name, list(one.tails)) for one in report.effects]
    places = report.unknown.where
    return names + [(" x ".join(p.variables), list(p.tails) or list(fleet)) for p in places]


def row(name: str, kind: Kind, null: Frame) -> tuple[str, bool]:
    """Line of a kind, and whether it is told as it should be."""
    struck = range(len(null.tails)) if kind.everyone else STRUCK
    own = np.isin(null.aircraft, struck)
    change = np.where(own[:, None], kind.change(null), 0.0)
    frame = without(null, null.residual + change)
    lengths = [float(np.hypot(*one.residual.T).mean()) for one in (frame, null)]
    report = diagnose(frame).report
    told = told_of(report, null.tails)
    closes = report.closure.reduction
    closes += report.unknown.closure.reduction if report.unknown.closure is not None else 0.0
    true = {null.tails[a] for a in struck}
    words = "; ".join(
        f"{what} ({len(true & set(who))} of {len(true)}, {len(set(who) - true)} others)"
        for what, who in told
    )
    right = bool(told) and kind.told in told[0][0] and set(told[0][1]) == true
    state = "open" if not kind.told else "told" if right else "MISSED"
    stated = f"{closes:7.3f} of {(lengths[0] - lengths[1]) / KNOT:7.3f} kt"
    return f"{name:34} {state:7} {stated}  {words or 'nothing'}", right or not kind.told


def looks(frame: Frame) -> tuple[float, ...]:
    """Largest |k| of headings and of directions known well, mean cosine to 5 degrees, and of 10.

    And errors across the heading over those along it, smooth effects of heading taken off.
    """
    slopes = [
        max((abs(k) for k, error in one.values() if error <= KNOWN), default=0.0)
        for _, one in declination_slopes(frame)
    ]
    norths = [frame.magnetic_heading, frame.heading]
    cosines = {
        step: max(
            float(step_cosines(heading[frame.aircraft == a], step).mean())
            for heading in norths
            for a in np.unique(frame.aircraft)
        )
        for step in (2.0, 5.0, 10.0)
    }
    smooth = remove_smooth_effects(frame.residual, frame.aircraft, frame.heading, frame.airspeed)
    along, across = directional_sd(smooth, frame.heading)
    return *slopes, max(cosines[2.0], cosines[5.0]), cosines[10.0], across / along


def look(folders: Sequence[Path]) -> None:
    """Print the looks at archives as they are, and the largest of all."""
    print("k of headings, of directions; mean cosine of steps to 5 degrees, of 10; across / along")
    told = np.array([looks(frame_of(folder)) for folder in folders])
    names = [*(folder.name for folder in folders), f"largest of {len(folders)}"]
    for name, values in zip(names, [*told, told.max(axis=0)], strict=True):
        print(f"{name:20}" + "".join(f"{value:8.3f}" for value in values))


def main() -> int:
    """Print a row a kind; 1 where one that should be told is not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--headings", type=Path, help="folder of a null's headings")
    parser.add_argument("--kinds", nargs="*", choices=sorted(KINDS), default=list(KINDS))
    parser.add_argument("--look", nargs="+", type=Path, help="folders of headings to look at")
    given = parser.parse_args()
    if given.look:
        look(given.look)
        return 0
    with tempfile.TemporaryDirectory() as made:
        null = frame_of(given.headings or null_headings(Path(made)))
    missed = 0
    for name in given.kinds:
        line, right = row(name, KINDS[name], null)
        print(line, flush=True)
        missed += not right
    return int(missed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
