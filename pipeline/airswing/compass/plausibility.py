"""Plausibility of reported quantities against model winds and the standard atmosphere.

A wrong unit or convention in a column of the reports gives winds that a fit accepts without a
message. Every reported quantity is therefore compared with an independent estimate, as reported and
under the usual mistakes; a finding names the quantity, the aircraft and the likely mistake. Each
aircraft with enough reports and flights is tested (at most `MOST` reports, evenly spread), and all
others together, because the errors of one flight are alike.

Let w be the reported wind, r the reference wind, g the ground velocity. The reference implies the
air vector ``g - r``, positions a second ground velocity, the standard atmosphere the temperature at
an altitude. Headings and winds are compared after removal of a deviation curve A to E. An angle is
implausible where one mistake makes the mean square difference `RATIO` times smaller. The scale of w
is that of its component along g, between its regression on that of r and the reverse (each is
attenuated by the noise of the other); it does not depend on errors of the airspeed, which add a
constant along g, or of the compass, which act across g. Mistakes of less than a quarter (mph for
kt) remain unnoticed. Where altitudes are wrong, so is the reference at them, and winds are tested
only after the altitudes are corrected. A clock is wrong where winds agree better with the reference
of near places 3, 6, 9 or 12 h apart, by `CLOCK_RATIO` and four standard errors; errors of 1 or 2
hours remain unnoticed.

``python -m benchmarks.units``: with any `RATIO` from 1.5 to 3 every wrong unit of every column is
named for all aircraft (by the notes of the reading where it makes values impossible), and no
correct archive has a finding (deviations of 25 degrees and winds of a third of the strength
included). Valid for aircraft that fly as airliners and commuter aircraft do, in air within 15 K of
the standard atmosphere or colder by any amount at low level. A reference in the wrong unit looks
like reports in the wrong unit, as the message states.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from airswing.flags import STATUS, WIND_SOURCE, published
from airswing.physics.atmosphere import (
    airspeed_from_calibrated,
    pressure_from_altitude,
    standard_temperature,
)
from airswing.physics.compass_deviation import deviation_basis
from airswing.physics.triangle import wrap_degrees
from airswing.products.ragged import aircraft_of_report, blocks, row_bounds
from airswing.units import EARTH_RADIUS, FOOT, KNOT, ZERO_CELSIUS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Sample = Mapping[str, NDArray[Any]]

FEWEST, MOST = 30, 2000  # reports: needed for a test, and used of an aircraft
FEWEST_OF_AIRCRAFT, FEWEST_FLIGHTS = 100, 3  # for an aircraft to be tested separately
FASTEST_CALIBRATED = 195.0  # m/s, 380 kt
RATIO = 2.0  # by which a mistake of an angle must reduce the mean square difference
LARGEST_DEVIATION = 45.0  # degrees: validity of the fit
# Share of the aircraft above which a finding applies to all, because a column has one unit.
SAME_COLUMN = 2.0 / 3.0
HIGH, SLOWEST = 3000.0, 20.0  # m, m/s: no aircraft flies so slowly at such altitudes
LOWEST, FASTEST_LOW = 600.0, 80.0  # m, m/s: no aircraft flies all its reports so low and so fast
WEAKEST = 5.0  # m/s: standard deviation of reference winds by which a scale is judged
MOST_TOGETHER = 30  # aircraft whose reports are compared with each other's reference winds
SHIFT, _MOST_SHIFTS = 3.0, 4  # h: steps of the clock errors that are tested
FEWEST_DAYS, CLOCK_RATIO = 8, 1.2
FLEET_MEAN, SCATTER = 1.0, 0.7
"""Degrees: standard deviation of the mean compass offset of a fleet, and scatter between its
aircraft: in Mode-S data of 27 types (de Haan 2016, KNMI) mean and scatter."""
EVIDENCE = float(np.log(100.0))  # log odds above which another kind of heading is stated
_VECTORS = {
    "wind": ("eastward_wind", "northward_wind"),
    "reference": ("reference_eastward_wind", "reference_northward_wind"),
    "ground": ("ground_eastward_velocity", "ground_northward_velocity"),
}
_NEEDED = (
    *("time", "latitude", "longitude", "flight", "pressure_altitude", "air_temperature"),
    *("reported_airspeed", "reported_heading", "wind_source"),
    *(name for pair in _VECTORS.values() for name in pair),
)
_KMH = 1.0 / 3.6  # m/s

_SPEED_MISTAKES = {
    "values in m/s read as kt": KNOT,
    "values in kt read as m/s": 1.0 / KNOT,
    "values in km/h read as kt": KNOT / _KMH,
    "values in kt read as km/h": _KMH / KNOT,
    "values in km/h read as m/s": 1.0 / _KMH,
    "values in m/s read as km/h": _KMH,
    "values in tenths": 10.0,
    "values ten times too small": 0.1,
}
_SPEEDS_EXPECTED = {
    "wind_speed": "those of the reference",
    "reported_airspeed": "the airspeed of ground velocity and reference wind",
    "ground_speed": "the speed between successive positions",
}
_ALTITUDE_MISTAKES = {
    "values in m read as ft": 1.0 / FOOT,
    "values in ft read as m": FOOT,
    "flight levels read as ft": 100.0,
    "flight levels read as m": 100.0 * FOOT,
}
_TEMPERATURE_MISTAKES: dict[str, Callable[[Array], Array]] = {
    "values in degrees Fahrenheit read as degrees Celsius": lambda kelvin: (
        (kelvin - ZERO_CELSIUS - 32.0) / 1.8 + ZERO_CELSIUS
    ),
    "minus signs missing": lambda kelvin: ZERO_CELSIUS - np.abs(kelvin - ZERO_CELSIUS),
}
# From an angle in degrees with the mistake to the angle without it.
_ANGLE_MISTAKES: dict[str, Callable[[Array], Array]] = {
    "values in radians read as degrees": np.degrees,
    "values in grads read as degrees": lambda angle: 0.9 * angle,
    "values in tens of degrees read as degrees": lambda angle: 10.0 * angle,
    "opposite directions": lambda angle: angle + 180.0,
    "angles anticlockwise from east, or exchanged components": lambda angle: 90.0 - angle,
    "angles anticlockwise from north": lambda angle: -angle,
}
# Offset over the declination; its name; the mistake; the remedy.
_KINDS = {
    "magnetic_for_true": (
        -1.0,
        "minus the declination",
        "headings taken for true are magnetic",
        "map their column as magnetic_heading_deg",
    ),
    "true_for_magnetic": (
        1.0,
        "the declination",
        "headings taken for magnetic are true",
        "map their column as heading_deg",
    ),
}
_PLURALS = {"mach": "Mach numbers", "ground_velocity": "ground speeds or tracks"}


@dataclass(frozen=True)
class Finding:
    """An implausible quantity."""

    quantity: str  # a variable of the reports, or position, wind_speed, track, ...
    likely: str  # the likely mistake, empty if none explains the values
    evidence: str  # what contradicts the values
    factor: float = 0.0  # by which speeds are too large or small; 0 for other quantities
    aircraft: tuple[str, ...] = ()
    share: float = 0.0  # of all aircraft

    def __str__(self) -> str:
        number = len(self.aircraft)
        shown = ", ".join(self.aircraft[:3]) + (f" and {number - 3} more" if number > 3 else "")
        every = self.share == 1.0 and number > 1
        whom = "all aircraft" if every else f"{number} aircraft ({shown})"
        cause = f"likely {self.likely}" if self.likely else "no usual mistake explains it"
        word = self.quantity.removeprefix("reported_").removeprefix("air_").replace("_", " ")
        names = _PLURALS.get(self.quantity, f"{word}s")
        return (
            f"Implausible {names} of {whom}: {self.evidence}; {cause}. Check the unit of the "
            "column, and the units of the reference"
        )


def plausibility(headings: xr.Dataset, *, references: Sequence[str] | None = None) -> list[Finding]:
    """Find implausible reported quantities in the headings of every report, in memory or lazy.

    Screened reports count too, because implausible ones are screened out. The mean wind of
    ``references`` is used, by default of all. Returns at most one finding for each quantity and
    mistake, those of the most aircraft first.
    """
    names = list(map(str, np.atleast_1d(headings["reference"].to_numpy())))
    members = [names.index(name) for name in references or names]
    few: dict[str, Sample] = {}
    together: list[Sample] = []
    aircraft: list[str] = []
    judged: list[tuple[list[str], list[Finding]]] = []
    for block in blocks(headings, _NEEDED):
        for tail, sample in _samples(block, members):
            aircraft.append(tail)
            if len(together) < MOST_TOGETHER:
                winds = (sample[name] for name in ("wind", "reference", "ground"))
                together.append({**sample, "wind": _less_deviation(*winds)})
            flights = np.unique(sample["flight"]).size
            if sample["flight"].size < FEWEST_OF_AIRCRAFT or flights < FEWEST_FLIGHTS:
                few[tail] = sample
            else:
                judged.append(([tail], findings_of(sample)))
    if few:
        samples = list(few.values())
        joint = {name: np.concatenate([sample[name] for sample in samples]) for name in samples[0]}
        judged.append(([*few], findings_of(joint)))
    groups: dict[tuple[str, str], list[tuple[str, Finding]]] = {}
    for tails, of_sample in judged:
        for finding in of_sample:
            key = finding.quantity, "" if finding.factor else finding.likely
            groups.setdefault(key, []).extend((tail, finding) for tail in tails)
    findings = [_of_fleet(group, aircraft) for group in groups.values()]
    if not findings and (shift := _clock_error(together)):
        likely = "local times, or another time zone, read as UTC"
        when = "earlier" if shift > 0 else "later"
        evidence = f"the winds agree better with the reference {abs(shift):.0f} h or more {when}"
        findings.append(Finding("time", likely, evidence, 0.0, tuple(aircraft), 1.0))
    return sorted(findings, key=lambda finding: -len(finding.aircraft))


def _clock_error(samples: Sequence[Sample]) -> float:
    """Hours by which the clocks of a fleet are ahead of UTC; 0 where they may be right."""
    from scipy.spatial import cKDTree

    names = ("wind", "reference", "time", "latitude", "longitude", "pressure_altitude")
    columns = (np.concatenate([sample[name] for sample in samples]) for name in names)
    wind, reference, time, latitude, longitude, altitude = _finite(*columns)
    if not wind.size:
        return 0.0
    phi, hours, unit = np.radians(latitude), time / 3600.0, EARTH_RADIUS / 100e3
    east = unit * np.cos(phi) * np.radians(longitude)
    place = np.stack([unit * phi, east, altitude / 400.0], axis=1)
    tree, day = cKDTree(place), np.unique(np.floor(hours / 24.0), return_inverse=True)[1]
    shape = int(day.max()) + 1, 2 * _MOST_SHIFTS + 1
    number, total = np.zeros(shape), np.zeros(shape)
    # neighbours of a few reports at a time: where flights are dense, all are millions
    tested = np.arange(0, hours.size, max(1, hours.size // 8000))
    for chunk in np.array_split(tested, -(-tested.size // 250)):
        near = tree.query_ball_point(place[chunk], 1.0)
        row = np.repeat(chunk, [len(neighbours) for neighbours in near])
        partner = np.concatenate(near).astype(np.int64)
        shift = np.round((hours[partner] - hours[row]) / SHIFT).astype(np.int64) + _MOST_SHIFTS
        inside = (shift >= 0) & (shift <= 2 * _MOST_SHIFTS)
        row, partner, cell = row[inside], partner[inside], (day[row[inside]], shift[inside])
        np.add.at(number, cell, 1.0)
        np.add.at(total, cell, np.abs(wind[row] - reference[partner]) ** 2)
    mean = pd.DataFrame(total / np.where(number >= FEWEST, number, np.nan))
    # by shift, over the days with enough pairs at that shift and at none
    gain = mean.rsub(mean[_MOST_SHIFTS], axis=0)
    days = gain.count()
    significance = gain.mean() / (gain.std() + 1e-9) * np.sqrt(days)
    shifted = mean.where(gain.notna()).mean()
    ratio = (1.0 + gain.mean() / shifted).where((days >= FEWEST_DAYS) & (significance > 4.0), 1.0)
    best = int(np.argmax(ratio))
    return SHIFT * (_MOST_SHIFTS - best) if ratio[best] > CLOCK_RATIO else 0.0


def _of_fleet(group: Sequence[tuple[str, Finding]], aircraft: Sequence[str]) -> Finding:
    """Combine the findings of one quantity and mistake."""
    tails, first = {tail for tail, _ in group}, group[0][1]
    if first.factor:
        factor = float(np.median([finding.factor for _, finding in group]))
        likely = " or ".join(filter(None, (_speed_mistake(factor), first.likely)))
        evidence = first.evidence.replace(f"{first.factor:.2f}", f"{factor:.2f}")
        first = replace(first, evidence=evidence, factor=factor, likely=likely)
    if len(tails) > SAME_COLUMN * len(aircraft):
        tails = set(aircraft)
    names = tuple(tail for tail in aircraft if tail in tails)
    return replace(first, aircraft=names, share=len(names) / len(aircraft))


def _samples(block: xr.Dataset, members: list[int]) -> Iterable[tuple[str, Sample]]:
    columns: dict[str, NDArray[Any]] = {}
    for name in _NEEDED:
        variable = block[name] if name in block else block["flight"] * np.nan
        if "reference" in variable.dims:
            variable = variable.isel(reference=members).astype(np.float64).mean("reference")
        values = variable.to_numpy()
        if name == "time":
            values = values.astype("datetime64[ns]").astype(np.int64) / 1e9
        columns[name] = values.astype(np.float64)
    for name, (east, north) in _VECTORS.items():
        columns[name] = columns.pop(east) + 1j * columns.pop(north)
    columns["chord"] = _chord(columns)
    tails = np.atleast_1d(block["aircraft"].to_numpy())
    for tail, start, stop in zip(tails, *row_bounds(block["row_size"].to_numpy()), strict=True):
        step = max(1, (stop - start) // MOST)
        yield str(tail), {name: values[start:stop:step] for name, values in columns.items()}


def _chord(columns: Mapping[str, Array]) -> Complex:
    """Velocity (m s-1) from each position to the next of its flight, 20 to 900 s later."""
    gap = np.diff(columns["time"])
    same = (np.diff(columns["flight"]) == 0) & (gap >= 20.0) & (gap <= 900.0)
    phi = np.radians(columns["latitude"])
    east = np.radians(wrap_degrees(np.diff(columns["longitude"])))
    east *= np.cos(0.5 * (phi[1:] + phi[:-1]))
    velocity = np.full(phi.size, np.nan, dtype=np.complex128)
    step = EARTH_RADIUS * (east + 1j * np.diff(phi))
    velocity[:-1][same] = step[same] / gap[same]
    return velocity


def _finite(*columns: NDArray[Any]) -> list[NDArray[Any]]:
    """Rows where all columns are finite; none if too few for a test."""
    is_finite = np.isfinite(np.sum(columns, axis=0))
    is_finite &= np.count_nonzero(is_finite) >= FEWEST
    return [values[is_finite] for values in columns]


def _direction(vector: Complex) -> Array:
    """Direction (degrees clockwise from north) to which vectors point."""
    return np.asarray(np.degrees(np.arctan2(vector.real, vector.imag)))


def _vector(length: Array, direction: Array) -> Complex:
    """Vectors of a length that point to a direction (degrees clockwise from north)."""
    return np.asarray(length * np.exp(1j * np.radians(90.0 - direction)))


def findings_of(sample: Sample) -> list[Finding]:
    """Findings of one aircraft, without its name; a finding that explains all others is alone.

    The sample holds the variables of ``headings`` that the tests use (m s-1, m, K, degrees) and,
    complex (eastward + 1j northward), ``wind``, ``reference``, ``ground`` and ``chord``; NaN where
    absent.
    """
    speed = np.abs(sample["chord"])[sample["pressure_altitude"] > HIGH]
    speed = speed[np.isfinite(speed)]
    if speed.size >= FEWEST and np.median(speed) <= SLOWEST:
        evidence = (
            f"the median speed between them at high level is {np.median(speed) / KNOT:.0f} kt"
        )
        likely = "latitudes and longitudes in radians read as degrees"
        return [Finding("position", likely, evidence)]
    levels = _level_findings(sample)
    if wrong := _ground_findings(sample):
        return levels + wrong
    motion = [*_airspeed_findings(sample), *_heading_findings(sample)]
    if motion and _derived(sample).any():  # the winds contain the mistake
        return levels + motion
    if any(finding.quantity == "pressure_altitude" or not finding.likely for finding in levels):
        return levels + motion
    return levels + motion + _wind_findings(sample)


def _derived(sample: Sample) -> NDArray[np.bool_]:
    return np.asarray(sample["wind_source"] > WIND_SOURCE["reported"])


def _level_findings(sample: Sample) -> list[Finding]:
    altitude, kelvin = _finite(sample["pressure_altitude"], sample["air_temperature"])
    if altitude.size:
        return _against_standard_atmosphere(altitude, kelvin)
    # Wrong levels may lie outside those of the reference; the ground speed is then used.
    air = sample["ground"] - sample["reference"]
    speed = np.abs(np.where(np.isnan(air), sample["ground"], air))
    altitude, speed = _finite(sample["pressure_altitude"], speed)
    if not altitude.size:
        return []

    def too_fast(factor: float) -> float:
        level = np.clip(factor * altitude, -700.0, 20_000.0)
        limit = airspeed_from_calibrated(
            FASTEST_CALIBRATED, pressure_from_altitude(level), standard_temperature(level)
        )
        return float(np.mean(speed > limit))

    low = np.quantile(altitude, 0.95) < LOWEST and np.median(speed) > FASTEST_LOW
    if too_fast(1.0) <= 0.3 and not low:
        return []
    rises = (name for name, f in _ALTITUDE_MISTAKES.items() if f > 1.0 and too_fast(f) < 0.05)
    likely = "flight levels read as ft" if low else next(rises, "")
    evidence = (
        f"{too_fast(1.0):.0%} of the airspeeds are beyond any aircraft's limit at these altitudes "
        f"(median {np.median(speed) / KNOT:.0f} kt at {np.median(altitude) / FOOT:,.0f} ft)"
    )
    return [Finding("pressure_altitude", likely, evidence)]


def _against_standard_atmosphere(altitude: Array, kelvin: Array) -> list[Finding]:
    def compared(factor: float, temperature: Array) -> tuple[float, bool]:
        """Median distance (K), and whether temperatures change as the standard atmosphere's."""
        standard = standard_temperature(np.clip(factor * altitude, -700.0, 20_000.0))
        difference = float(np.median(np.abs(temperature - standard)))
        if (spread := float(np.var(standard))) < 64.0:
            return difference, True
        slope = float(np.cov(temperature, standard, bias=True)[0, 1]) / spread
        return difference, 0.55 <= slope <= 1.5

    difference, parallel = compared(1.0, kelvin)
    if difference <= 18.0 and parallel:
        return []
    quantity, likely, best = "air_temperature", "", np.inf
    trials = [("pressure_altitude", name, f, kelvin) for name, f in _ALTITUDE_MISTAKES.items()]
    trials += [("air_temperature", n, 1.0, f(kelvin)) for n, f in _TEMPERATURE_MISTAKES.items()]
    for column, name, factor, temperature in trials:
        distance, parallel = compared(factor, temperature)
        if parallel and distance < best:
            quantity, likely, best = column, name, distance
    if best > min(12.0, 0.5 * difference):
        if difference < 60.0:  # polar winter air near the ground is 50 K colder than the standard
            return []
        quantity, likely = "air_temperature", ""
    evidence = (
        f"temperatures are {difference:.0f} K from the standard atmosphere (median "
        f"{np.median(kelvin) - ZERO_CELSIUS:.0f} degC at {np.median(altitude) / FOOT:,.0f} ft)"
    )
    return [Finding(quantity, likely, evidence)]


def _speed_mistake(factor: float) -> str:
    """Mistakes of a speed's unit that give a factor, the nearest first; at most two."""
    distance = {
        name: abs(float(np.log(factor / true))) + (0.05 if name.endswith("km/h") else 0.0)
        for name, true in _SPEED_MISTAKES.items()
    }
    near = sorted((away, name) for name, away in distance.items() if away < 0.25)
    return " or ".join(name for _, name in near[:2])


def _scaled(quantity: str, factor: float) -> Finding:
    evidence = f"they are {factor:.2f} times {_SPEEDS_EXPECTED[quantity]}"
    return Finding(quantity, "", evidence, factor)


def _reported_ground(sample: Sample) -> Complex:
    """Ground velocity of rows with derived winds, else NaN; as in the sample if there are none."""
    derived = _derived(sample)
    if not derived.any():
        return np.asarray(sample["ground"])
    air = _vector(sample["reported_airspeed"], sample["reported_heading"])
    return np.where(derived, sample["wind"] + air, np.nan)


def _ground_findings(sample: Sample) -> list[Finding]:
    chord = np.where(np.abs(sample["chord"]) > 20.0, sample["chord"], np.nan)
    chord, ground = _finite(chord, _reported_ground(sample))
    if not chord.size:
        return []
    factor = float(np.median(np.abs(ground) / np.abs(chord)))
    findings = [] if 0.8 <= factor <= 1.25 else [_scaled("ground_speed", factor)]
    return findings + _angle_findings(
        "track", _direction(ground) % 360.0, _direction(chord), curve=False
    )


def _angle_findings(quantity: str, angle: Array, expected: Array, *, curve: bool) -> list[Finding]:
    """Findings for angles (degrees) that agree with the expected ones only under a mistake."""

    def misfit(angle: Array) -> float:
        difference = wrap_degrees(angle - expected)
        if curve:
            difference = difference - _curve(difference, angle)
        return float(np.mean(np.sin(np.radians(difference / 2.0)) ** 2))

    likely = _angle_mistake(angle, misfit)
    if not likely and float(np.mean(np.cos(np.radians(angle - expected)))) >= 0.7:
        return []
    evidence = (
        f"they lie between {np.quantile(angle % 360.0, 0.01):.0f} and "
        f"{np.quantile(angle % 360.0, 0.99):.0f} degrees and do not agree with the "
        + ("headings of ground velocity and reference wind" if curve else "positions")
    )
    return [Finding(quantity, likely, evidence)]


def _angle_mistake(angle: Array, misfit: Callable[[Array], float]) -> str:
    """Mistake that makes the mean square difference of angles much smaller; empty if none does."""
    trials = {name: misfit(corrected(angle)) for name, corrected in _ANGLE_MISTAKES.items()}
    best = min(trials, key=lambda name: trials[name])
    return best if misfit(angle) > RATIO * trials[best] else ""


def _curve(difference: Array, heading: Array) -> Array:
    """Deviation curve A to E (degrees) fitted to differences of headings, at most 45 degrees."""
    design = deviation_basis(np.radians(heading)).T
    is_finite = np.isfinite(difference)
    coefficients = np.linalg.lstsq(design[is_finite], difference[is_finite], rcond=1e-6)[0]
    return np.asarray(np.clip(design @ coefficients, -LARGEST_DEVIATION, LARGEST_DEVIATION))


def _airspeed_findings(sample: Sample) -> list[Finding]:
    reported = np.where(sample["reported_airspeed"] > 0.0, sample["reported_airspeed"], np.nan)
    implied = np.abs(sample["ground"] - sample["reference"])
    implied = np.where(implied > 20.0, implied, np.nan)
    altitude = np.clip(np.nan_to_num(sample["pressure_altitude"]), -700.0, 20_000.0)
    reported, implied, altitude = _finite(reported, implied, altitude)
    if not implied.size:
        return []
    factor = float(np.median(reported / implied))
    as_true = airspeed_from_calibrated(
        reported, pressure_from_altitude(altitude), standard_temperature(altitude)
    )
    finding = _scaled("reported_airspeed", factor)
    if abs(float(np.median(as_true / implied)) - 1.0) < 0.06 and abs(factor - 1.0) > 0.12:
        return [replace(finding, likely="indicated airspeeds", factor=0.0)]
    return [] if 0.8 <= factor <= 1.25 else [finding]


def _heading_findings(sample: Sample) -> list[Finding]:
    air = _direction(sample["ground"] - sample["reference"])
    heading, expected = _finite(sample["reported_heading"], air)
    if not heading.size:
        return []
    if findings := _angle_findings("reported_heading", heading, expected, curve=True):
        return findings
    track = np.where(_derived(sample), _direction(_reported_ground(sample)), np.nan)
    heading, track, air = _finite(sample["reported_heading"], track, air)
    if not heading.size:
        return []
    drift = wrap_degrees(track - air)
    same = float(np.mean(np.abs(wrap_degrees(heading - track)) < 0.3))
    if same < 0.9 or np.sqrt(np.mean(drift**2)) < 2.0:
        return []
    evidence = f"{same:.0%} of them equal the tracks"
    return [Finding("reported_heading", "tracks mapped as headings", evidence)]


def _wind_findings(sample: Sample) -> list[Finding]:
    ground = np.where(np.abs(sample["ground"]) > 20.0, sample["ground"], np.nan)
    wind, reference, ground, flight = _finite(
        sample["wind"], sample["reference"], ground, sample["flight"]
    )
    if not np.any(wind) or np.sqrt(np.mean(np.abs(reference) ** 2)) < 5.0:
        return []
    derived = bool(_derived(sample).any())
    if not derived and (wrong := _wind_directions(wind, reference, ground)):
        return wrong
    corrected = _less_deviation(wind, reference, ground)
    along = ground.conj() / np.abs(ground)
    along_wind, along_reference = (corrected * along).real, (reference * along).real
    anomaly, expected = along_wind - along_wind.mean(), along_reference - along_reference.mean()
    slopes = []
    if np.std(expected) >= WEAKEST and np.any(anomaly):
        slopes = [_slope(anomaly, expected, flight), _slope(expected, anomaly, flight)]
    if any(slope - 3.0 * error > 1.25 for slope, error in slopes):
        factor = float(np.std(anomaly) / np.std(expected))
        finding = _scaled("wind_speed", factor)
        if _finite(sample["air_temperature"])[0].size:
            return [finding] if _speed_mistake(factor) else []
        levels = "altitudes in m read as ft" if factor > 1.0 else "altitudes in ft read as m"
        return [replace(finding, likely=levels)]
    agreement = float(np.corrcoef(along_wind, along_reference)[0, 1])
    if agreement < 0.2 and wind.size >= 200 and np.std(along_reference) >= WEAKEST:
        evidence = f"their correlation with the reference's winds is {agreement:.2f}"
        return [Finding("ground_velocity" if derived else "wind_direction", "", evidence)]
    return []


def _less_deviation(wind: Complex, reference: Complex, ground: Complex) -> Complex:
    """Winds after removal of a deviation curve fitted to their difference."""
    air = ground - wind
    heading = _direction(air)
    error = wrap_degrees(heading - _direction(ground - reference))
    return np.asarray(ground - air * np.exp(1j * np.radians(_curve(error, heading))))


def _wind_directions(wind: Complex, reference: Complex, ground: Complex) -> list[Finding]:
    comes_from, speed = _direction(-wind) % 360.0, np.abs(wind)

    def misfit(angle: Array) -> float:
        corrected = _less_deviation(-_vector(speed, angle), reference, ground)
        return float(np.mean(np.abs(corrected - reference) ** 2))

    low, high = (float(value) for value in np.quantile(comes_from, [0.01, 0.99]))
    evidence = f"they lie between {low:.0f} and {high:.0f} degrees"
    if likely := _angle_mistake(comes_from, misfit):
        return [Finding("wind_direction", likely, f"{evidence} and contradict the reference's")]
    of_reference = _direction(-reference) % 360.0
    share = float(np.mean((of_reference < low - 20.0) | (of_reference > high + 20.0)))
    inside = (of_reference >= low) & (of_reference <= high)
    # Inside that part winds agree; a mistake of the direction does not change the speeds.
    scale = float(np.sqrt(np.mean(speed**2) / np.mean(np.abs(reference) ** 2)))
    complete = share < 0.15 or high - low > 270.0 or not 0.8 <= scale <= 1.25
    if complete or np.count_nonzero(inside) < FEWEST:
        return []
    x, y = wind[inside], reference[inside]
    correlation = np.sum((x * y.conj()).real) / np.linalg.norm(x) / np.linalg.norm(y)
    if correlation < 0.8:
        return []
    missing = f"{evidence}, {share:.0%} of the reference's do not"
    return [Finding("wind_direction", "a part of the circle missing", missing)]


def _slope(y: Array, x: Array, flight: Array) -> tuple[float, float]:
    """Slope of the regression of y on x without a constant, and its error by flight."""
    slope = float(y @ x / (x @ x))
    influence = np.bincount(np.unique(flight, return_inverse=True)[1], weights=(y - slope * x) * x)
    return slope, float(np.linalg.norm(influence) / (x @ x))


def with_implausible(fits: xr.Dataset, findings: Sequence[Finding]) -> xr.Dataset:
    """Set the status of aircraft with implausible reports, and store the findings as JSON.

    The status becomes ``implausible_reports`` where the fit would be published or does not improve
    the winds; the attribute ``implausible_reports`` holds the findings of :func:`plausibility`.
    """
    status = fits["status"]
    tails = [tail for finding in findings for tail in finding.aircraft]
    named = status["aircraft"].astype(str).isin(tails)
    # winds that a correction does not improve are a consequence of implausible reports
    affected = named & (published(status) | (status == STATUS["no_improvement"]))
    marked = status.where(~affected, STATUS["implausible_reports"]).astype(status.dtype)
    return fits.assign(status=marked).assign_attrs(
        implausible_reports=json.dumps([asdict(finding) for finding in findings])
    )


def plausibility_warnings(fits: xr.Dataset) -> list[str]:
    """Return one sentence for each finding stored by :func:`with_implausible`."""
    stored = json.loads(str(fits.attrs.get("implausible_reports", "[]")))
    return [str(Finding(**fields | {"aircraft": tuple(fields["aircraft"])})) for fields in stored]


def taken_for(offset: ArrayLike, standard_error: ArrayLike, declination: ArrayLike) -> str:
    """Whether the headings of a fleet are of another kind than assumed.

    From offsets of the headings, their standard errors and mean declinations, (aircraft,), degrees:
    ``magnetic_for_true``, ``true_for_magnetic``, or empty: as assumed, or not known. Two normal
    hypotheses are weighed: compass offsets proper differ from aircraft to aircraft and have a mean.
    Where the declination is small (under 3 degrees all over; under 4 with a single aircraft)
    nothing can be decided.
    """
    error, wide, angle = (
        np.asarray(values, dtype=np.float64) for values in (offset, standard_error, declination)
    )
    if not error.size:
        return ""
    # offsets share a mean of variance FLEET_MEAN^2 and scatter by SCATTER^2 about it
    inverse = np.linalg.inv(np.diag(SCATTER**2 + wide**2) + FLEET_MEAN**2)
    odds = {}
    for name, (sign, *_) in _KINDS.items():
        # log likelihood ratio: the same covariance with the declination subtracted
        rest = error - sign * angle
        odds[name] = 0.5 * float(error @ inverse @ error - rest @ inverse @ rest)
    best = max(odds, key=lambda name: odds[name])
    return best if odds[best] > EVIDENCE else ""


def mean_declination(headings: xr.Dataset) -> Array:
    """Mean declination (aircraft,) of the reports used, degrees; NaN without a report."""
    means = []
    for block in blocks(headings, ["declination", "screening"]):
        used = block["declination"].where(block["screening"] == 0).to_numpy()
        mean = pd.Series(used.astype(np.float64)).groupby(aircraft_of_report(block)).mean()
        means.append(mean.reindex(range(block.sizes["aircraft"])).to_numpy(np.float64))
    return np.concatenate(means)


def heading_kind_warnings(fits: xr.Dataset, reference: str) -> list[str]:
    """One sentence if the offsets of the fits suggest the other kind of heading.

    ``fits`` hold ``mean_declination`` (aircraft).
    """
    implausible = '"reported_heading"' in str(fits.attrs.get("implausible_reports", ""))
    if "mean_declination" not in fits or implausible:
        return []
    fit = fits.sel(reference=reference)
    offset, angle = fit["offset"].to_numpy(), fit["mean_declination"].to_numpy()
    good = published(fit["status"]) & np.isfinite(offset) & np.isfinite(angle)
    kind = taken_for(offset[good], fit["offset_standard_error"].to_numpy()[good], angle[good])
    if not kind:
        return []
    _, like, mistake, remedy = _KINDS[kind]
    if kind == "magnetic_for_true":
        remedy += (
            " (if the unit computed its winds along a magnetic heading, the unit must be corrected)"
        )
    return [
        f"The heading offsets of {np.count_nonzero(good)} aircraft (median "
        f"{np.median(offset[good]):+.1f} degrees) are {like} where they flew "
        f"({np.median(angle[good]):+.1f} degrees): it seems that {mistake}; {remedy}"
    ]
