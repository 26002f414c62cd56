"""Plausibility of reports: wrong units in every column, and valid archives, by number.

    python -m benchmarks.units [FOLDER ...]

A folder is one of ``airswing sample``; without one an archive is made. Printed are findings and
published fits by case, and for several values of `plausibility.RATIO` the cases with a mistake that
are named for all aircraft and the valid ones without a finding.
"""

import argparse
import json
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from airswing import collocate, derive_headings, write_archive
from airswing.compass import plausibility
from airswing.compass.fit.deviation import fit_deviation
from airswing.compass.screening import screen
from airswing.errors import InputError
from airswing.flags import published
from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    pressure_from_altitude,
    standard_temperature,
)
from airswing.reference.catalogue import build_catalogue
from airswing.reports import read_reports
from airswing.units import FOOT, KNOT

RATIOS = (1.2, 1.5, 2.0, 3.0, 5.0)
WINDS = {
    "wind_speed_kt": {
        "m/s": lambda v: (KNOT * v).round(),
        "km/h": lambda v: (1.852 * v).round(),
        "kt as m/s": lambda v: v / KNOT,
        "tenths": lambda v: 10 * v,
    },
    "wind_direction_deg": {
        "radians": np.radians,
        "grads": lambda v: (v / 0.9).round(),
        "tens": lambda v: (v / 10).round(),
        "to": lambda v: (v + 180) % 360,
        "from east": lambda v: (90 - v) % 360,
    },
    "pressure_altitude_ft": {
        "m": lambda v: (FOOT * v).round(),
        "flight levels": lambda v: (v / 100).round(),
        "ft as m": lambda v: v / FOOT,
        "ft as flight levels": lambda v: 100 * v,
    },
    "temperature_degC": {
        "K": lambda v: v + 273.15,
        "F": lambda v: 1.8 * v + 32,
        "degC as K": lambda v: v - 273.15,
    },
    "latitude": {"tenths": lambda v: 10 * v},
    "longitude": {"tenths": lambda v: 10 * v},
}
_SPEED = {"m/s": lambda v: KNOT * v, "km/h": lambda v: 1.852 * v, "kt as m/s": lambda v: v / KNOT}
_ANGLE = {"radians": np.radians, "grads": lambda v: v / 0.9, "opposite": lambda v: (v + 180) % 360}
TRIANGLE = {
    **{f"{name}_kt": _SPEED for name in ("true_airspeed", "ground_speed")},
    **{name: _ANGLE for name in ("heading_deg", "track_deg")},
    "mach": {"percent": lambda v: 100 * v, "thousandths": lambda v: 1000 * v},
    "indicated_airspeed_kt": {name: _SPEED[name] for name in ("m/s", "km/h")},
}


def triangle(headings):
    ground, wind = complex_of(headings, "ground_{}_velocity"), complex_of(headings, "{}_wind")
    air, level = ground - wind, headings["pressure_altitude"].to_numpy().astype(float)
    pressure, kelvin = pressure_from_altitude(level), standard_temperature(level)
    calibrated = np.abs(air) / airspeed_from_calibrated(100.0, pressure, kelvin) * 100.0
    table = pd.DataFrame(
        {
            "tail": np.repeat(headings["aircraft"].values, headings["row_size"].values),
            "flight": headings["flight"].values.astype(str),
            **{name: headings[name].values for name in ("time", "latitude", "longitude")},
            "pressure_altitude_ft": (level / FOOT).round(),
            "heading_deg": (90 - np.degrees(np.angle(air))) % 360,
            "true_airspeed_kt": np.abs(air) / KNOT,
            "mach": np.abs(air) / (20.0468 * np.sqrt(kelvin)),
            "indicated_airspeed_kt": calibrated / KNOT,
            "track_deg": (90 - np.degrees(np.angle(ground))) % 360,
            "ground_speed_kt": np.abs(ground) / KNOT,
        }
    )
    return table[np.isfinite(ground) & np.isfinite(air)]


def complex_of(headings, name):
    """Eastward + i northward component of a vector at the reports (first reference)."""
    parts = [headings[name.format(way)].to_numpy() for way in ("eastward", "northward")]
    east, north = (component[0] if component.ndim == 2 else component for component in parts)
    return east + 1j * north


def deviated(headings, amplitude, strength):
    """Headings of compasses with a deviation (degrees), in winds of another strength."""
    changed = headings.copy(deep=True)
    names = ("reference_eastward_wind", "reference_northward_wind")
    changed.update({name: strength * headings[name] for name in names})
    error = complex_of(headings, "{}_wind") - complex_of(headings, "reference_{}_wind")
    ground = complex_of(headings, "ground_{}_velocity")
    air = ground - (complex_of(changed, "reference_{}_wind") + error)
    turned = ground - air * np.exp(-1j * np.radians(amplitude) * np.cos(np.angle(air)))
    changed["eastward_wind"][:], changed["northward_wind"][:] = turned.real, turned.imag
    return changed


class Archive:
    """A sample archive and its reference; headings of changed tables of it."""

    def __init__(self, folder):
        files = sorted((folder / "reports").glob("*.csv"))
        self.winds = pd.concat([pd.read_csv(path, dtype={"flight": str}) for path in files])
        self.model = build_catalogue([str(folder / "ruc/*.grb")], name="ruc")
        self._known = {}
        self.sound = self.headings(self.winds)
        self.triangle = triangle(self.sound)

    def headings(self, table):
        """Headings of a table; winds of the model are sampled once for equal places."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "reports.csv"
            table.to_csv(path, index=False)
            reports = read_reports(path)
        place = [reports[name].values for name in ("time", "latitude", "pressure_altitude")]
        key = hash(b"".join(values.tobytes() for values in place))
        if key not in self._known:
            self._known[key] = collocate(reports, {"ruc": self.model}).compute()
        return derive_headings(reports, self._known[key])

    def cases(self):
        """Whether a case has a mistake, and its headings, by name."""
        cases = {
            f"{table} {column} {name}": (True, partial(self._changed, table, column, change))
            for table, columns in (("winds", WINDS), ("triangle", TRIANGLE))
            for column, changes in columns.items()
            for name, change in changes.items()
        }
        for amplitude in (0.0, 15.0, 25.0):
            for strength in (1.0, 0.3):
                name = f"deviation {amplitude:.0f} winds {strength}"
                cases[name] = False, partial(deviated, self.sound, amplitude, strength)
        for column in ("true_airspeed_kt", "mach", "indicated_airspeed_kt"):
            name = f"triangle {column}"
            cases[name] = False, partial(self._changed, "triangle", column, lambda v: v)
        return cases

    def _changed(self, name, column, change):
        table = self.winds if name == "winds" else self.triangle
        airspeeds = {"true_airspeed_kt", "mach", "indicated_airspeed_kt"}
        used = column if column in airspeeds else "true_airspeed_kt"
        table = table.drop(columns=airspeeds.intersection(table) - {used})
        return self.headings(table.assign(**{column: change(table[column])}))


def judged(headings):
    phases = ("ascent", "cruise", "descent", "unknown")
    findings = plausibility.plausibility(headings)
    fits = fit_deviation(screen(headings, phases=phases)).compute()
    fits = plausibility.with_implausible(fits, findings)
    return findings, int(published(fits["status"]).sum())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path)
    folders = parser.parse_args().folders
    with tempfile.TemporaryDirectory() as temporary:
        if not folders:
            folders = [Path(temporary) / "sample"]
            write_archive(folders[0], days=25, aircraft=8, seed=11)
        judge(folders)


def judge(folders):
    named, silent = dict.fromkeys(RATIOS, 0), dict.fromkeys(RATIOS, 0)
    wrong = sound = 0
    usual = plausibility.RATIO
    for folder in folders:
        for name, (mistake, make) in Archive(folder).cases().items():
            wrong, sound = wrong + mistake, sound + (not mistake)
            try:
                headings = make()
            except InputError as error:
                print(f"{folder.name} {name}: refused, {error.what}", flush=True)
                named = {ratio: number + mistake for ratio, number in named.items()}
                continue
            named_first, fits = judged(headings)
            print(
                f"{folder.name} {name}: {fits} fits; {'; '.join(map(str, named_first))}", flush=True
            )
            # impossible values are named by the reading
            notes = json.loads(headings.attrs["reading_audit"])["notes"]
            for ratio in RATIOS:
                plausibility.RATIO = ratio
                findings = plausibility.plausibility(headings)
                of_all = any(item.likely and item.share == 1.0 for item in findings)
                named[ratio] += mistake and (of_all or bool(notes))
                silent[ratio] += not mistake and not findings
            plausibility.RATIO = usual
    for ratio in RATIOS:
        print(f"ratio {ratio}: {named[ratio]} of {wrong} named, {silent[ratio]} of {sound} silent")


if __name__ == "__main__":
    main()
