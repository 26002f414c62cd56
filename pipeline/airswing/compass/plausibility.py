"""Plausibility of reported quantities against model winds and the standard atmosphere.

A wrong unit or convention in a column of the reports gives winds that a fit takes without a word.
Here every reported quantity of each aircraft is compared with what it must agree with, and with
what it would be under the usual mistakes. A finding names the quantity, the aircraft and the likely
mistake.

Tests
-----
Of each aircraft with at least 100 reports and 3 flights (at most 2,000 reports, evenly spread), and
of all other aircraft together, because the errors of one flight are alike. Let w be the reported
wind, r the reference wind, g the ground velocity.

* Altitude and temperature: the median of ``|T - T_ISA(z)|`` is above 18 K, or T changes by less
  than 0.55 or more than 1.5 times T_ISA; and under one mistake of z or T neither is so and the
  median is below 12 K and less than half. Without temperatures: more than 30 % of the airspeeds
  ``|g - r|`` exceed 195 m/s calibrated airspeed (380 kt; no airliner is certified for more than
  365 kt).
* Ground speed: the median of ``|g|`` over the speed between positions is outside 0.8 to 1.25.
* Airspeed: the median of ``TAS / |g - r|`` is outside 0.8 to 1.25, or is that of indicated
  airspeeds.
* Heading: the mean cosine of the angle between heading and ``g - r`` is below 0.7.
* Kind of heading: the offsets of the headings from ``g - r`` are minus the declination (magnetic
  headings mapped as true) or the declination (the reverse), by the odds of
  :mod:`airswing.compass.heading_kind`. This is said, but the fits are kept, because an offset that
  is constant over the area of flight is corrected like any other.
* Ground velocity in winds: the regression of ``w - r`` on g is beyond 0.2 on either side. A compass
  error acts across g only, and an airspeed scale error of 5 % gives 0.05.
* Wind speed: regression of w on r gives the lower bound of the scale of w, that of r on w the upper
  bound (each is attenuated by the noise of the other). Implausible where 1 is outside by more than
  a quarter; mistakes of less than that (mph for kt) remain unnoticed.
* Wind direction: the vector correlation of w and r is below 0.6, and above 0.75 (and 0.3 more)
  under one mistake; or the directions reach only a part of the circle where the reference's do not;
  or the correlation is below 0.2 over 200 reports.

The last three need reference winds of at least 5 m/s (root mean square; 8 m/s for "unrelated").

Validity
--------
Aircraft that fly as airliners and commuter aircraft do, in air within 15 K of the standard
atmosphere or colder by any amount at low level. A reference in the wrong unit looks like reports in
the wrong unit; the sentence says so.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.compass.heading_kind import taken_for
from airswing.flags import STATUS, WIND_SOURCE, published
from airswing.physics.airspeed import airspeed_from_calibrated
from airswing.physics.atmosphere import pressure_from_altitude, standard_temperature
from airswing.physics.great_circle import central_angle
from airswing.physics.triangle import wrap_degrees
from airswing.products.ragged import blocks, row_bounds
from airswing.units import EARTH_RADIUS, FOOT, KNOT, ZERO_CELSIUS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Sample = Mapping[str, Array]

FEWEST, MOST = 30, 2000  # reports: needed for a test, and used of an aircraft
FEWEST_OF_AIRCRAFT, FEWEST_FLIGHTS = 100, 3  # for an aircraft to be judged by itself
FASTEST_CALIBRATED = 195.0  # m/s, 380 kt
_NEEDED = (
    "time",
    "latitude",
    "longitude",
    "flight",
    "eastward_wind",
    "northward_wind",
    "reference_eastward_wind",
    "reference_northward_wind",
    "ground_eastward_velocity",
    "ground_northward_velocity",
    "pressure_altitude",
    "air_temperature",
    "reported_airspeed",
    "reported_heading",
    "declination",
    "wind_source",
)
_SAMPLED = (*_NEEDED, "chord_speed")
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
# Of a direction in degrees: what it would be without the mistake.
_DIRECTION_MISTAKES: dict[str, Callable[[Array], Array]] = {
    "values in radians read as degrees": np.degrees,
    "values in tens of degrees read as degrees": lambda angle: 10.0 * angle,
    "opposite directions": lambda angle: angle + 180.0,
    "angles anticlockwise from east, or exchanged components": lambda angle: 90.0 - angle,
    "angles anticlockwise from north": lambda angle: -angle,
}
_NAMES = {
    "pressure_altitude": "pressure altitudes",
    "air_temperature": "temperatures",
    "reported_airspeed": "true airspeeds",
    "reported_heading": "headings",
    "ground_speed": "ground speeds",
    "ground_velocity": "ground speeds or tracks",
    "wind_speed": "wind speeds",
    "wind_direction": "wind directions",
}


@dataclass(frozen=True)
class Finding:
    """An implausible quantity.

    Attributes
    ----------
    quantity : str
        ``wind_speed, wind_direction, pressure_altitude, air_temperature, reported_airspeed,
        reported_heading, ground_speed`` or ``ground_velocity``.
    likely : str
        The likely mistake, empty where none explains the values.
    evidence : str
        What contradicts the values.
    factor : float
        By which speeds are too large or small; 0 for other quantities.
    aircraft : tuple of str
    share : float
        Of all aircraft.
    refused : bool
        Whether fits of these aircraft are not published.
    """

    quantity: str
    likely: str
    evidence: str
    factor: float = 0.0
    aircraft: tuple[str, ...] = ()
    share: float = 0.0
    refused: bool = True

    def __str__(self) -> str:
        number = len(self.aircraft)
        shown = ", ".join(self.aircraft[:3]) + (f" and {number - 3} more" if number > 3 else "")
        whom = (
            "all aircraft" if self.share == 1.0 and number > 1 else f"{number} aircraft ({shown})"
        )
        cause = f"likely {self.likely}" if self.likely else "no usual mistake explains it"
        advice = ". Check the unit of the column, and the reference's" if self.refused else ""
        return f"implausible {_NAMES[self.quantity]} of {whom}: {self.evidence}; {cause}{advice}"


def plausibility(headings: xr.Dataset, *, references: Sequence[str] | None = None) -> list[Finding]:
    """Find implausible reported quantities.

    Parameters
    ----------
    headings : Dataset
        Headings of every report (``headings/``), in memory or lazy. Screened reports count too,
        because implausible ones are screened out.
    references : sequence of str, optional
        References whose mean wind is used; by default all.

    Returns
    -------
    list of Finding
        At most one for each quantity and mistake, those of the most aircraft first.
    """
    names = list(map(str, np.atleast_1d(headings["reference"].to_numpy())))
    members = [names.index(name) for name in references or names]
    found: dict[tuple[str, str], list[tuple[str, Finding]]] = {}
    few: dict[str, Sample] = {}
    aircraft: list[str] = []
    offsets: dict[str, tuple[float, float, float]] = {}

    def note(tails: Iterable[str], sample: Sample) -> None:
        for finding in findings_of(sample):
            key = finding.quantity, "" if finding.factor else finding.likely
            found.setdefault(key, []).extend((tail, finding) for tail in tails)

    for block in blocks(headings, _NEEDED):
        for tail, sample in _samples(block, members):
            aircraft.append(tail)
            if (offset := _heading_offset(sample)) is not None:
                offsets[tail] = offset
            flights = np.unique(sample["flight"]).size
            if sample["flight"].size < FEWEST_OF_AIRCRAFT or flights < FEWEST_FLIGHTS:
                few[tail] = sample
            else:
                note([tail], sample)
    if few:
        # Errors of one flight are alike: such aircraft are judged together.
        note(few, {name: np.concatenate([one[name] for one in few.values()]) for name in _SAMPLED})
    findings = []
    for group in found.values():
        tails = {tail for tail, _ in group}
        first = group[0][1]
        if first.factor:
            factor = float(np.median([finding.factor for _, finding in group]))
            likely = _speed_mistake(factor)
            first = replace(
                _scaled(first.quantity, factor),
                likely=" or ".join(filter(None, (likely, first.likely))),
            )
        kept = tuple(tail for tail in aircraft if tail in tails)
        findings.append(replace(first, aircraft=kept, share=len(kept) / len(aircraft)))
    findings += _kind_of_heading(offsets, len(aircraft))
    return sorted(findings, key=lambda finding: -len(finding.aircraft))


def _samples(block: xr.Dataset, members: list[int]) -> Iterable[tuple[str, Sample]]:
    size = block.sizes["report"]
    columns: dict[str, Array] = {}
    for name in _NEEDED:
        values = block[name].to_numpy() if name in block else np.full(size, np.nan)
        if values.ndim == 2:
            known = np.isfinite(values[members])
            total = np.where(known, values[members], 0.0).sum(axis=0, dtype=np.float64)
            number = known.sum(axis=0)
            values = np.divide(total, number, out=np.full(size, np.nan), where=number > 0)
        if name == "time":
            values = values.astype("datetime64[ns]").astype(np.int64) / 1e9
        columns[name] = values.astype(np.float64)
    columns["chord_speed"] = _chord_speed(columns)
    tails = np.atleast_1d(block["aircraft"].to_numpy())
    bounds = row_bounds(block["row_size"].to_numpy())
    for tail, start, stop in zip(tails, *bounds, strict=True):
        step = max(1, (stop - start) // MOST)
        yield str(tail), {name: values[start:stop:step] for name, values in columns.items()}


def _chord_speed(columns: Sample) -> Array:
    """Speed (m s-1) from each position to the next of its flight, 20 to 900 s later; else NaN."""
    gap = np.diff(columns["time"])
    same = (np.diff(columns["flight"]) == 0) & (gap >= 20.0) & (gap <= 900.0)
    phi, lam = np.radians(columns["latitude"]), np.radians(columns["longitude"])
    distance = EARTH_RADIUS * central_angle(phi[:-1], lam[:-1], phi[1:], lam[1:])
    speed = np.full(columns["time"].size, np.nan)
    speed[:-1][same] = distance[same] / gap[same]
    return speed


def findings_of(sample: Sample) -> list[Finding]:
    """Findings of one aircraft.

    Parameters
    ----------
    sample : mapping of arrays, shape (report,)
        The variables of ``headings`` that the tests use (m s-1, m, K, degrees), reference winds of
        one reference; NaN where absent.

    Returns
    -------
    list of Finding
        Without aircraft. A mistake that explains others is named alone.
    """
    levels = _level_findings(sample)
    if wrong := _ground_findings(sample):
        return levels + wrong
    motion = [*_airspeed_findings(sample), *_heading_findings(sample)]
    # Wrong levels have other reference winds, and winds are derived from headings and airspeeds.
    derived = bool(np.any(sample["wind_source"] > WIND_SOURCE["reported"]))
    if levels or (motion and derived):
        return levels + motion
    return motion + _wind_findings(sample, derived=derived)


def _air(sample: Sample) -> tuple[Array, Array]:
    """Air velocity as the reference implies it (eastward, northward)."""
    return (
        sample["ground_eastward_velocity"] - sample["reference_eastward_wind"],
        sample["ground_northward_velocity"] - sample["reference_northward_wind"],
    )


def _level_findings(sample: Sample) -> list[Finding]:
    altitude, kelvin = sample["pressure_altitude"], sample["air_temperature"]
    known = np.isfinite(altitude) & np.isfinite(kelvin)
    if np.count_nonzero(known) >= FEWEST:
        return _against_standard_atmosphere(altitude[known], kelvin[known])
    speed = np.hypot(*_air(sample))
    known = np.isfinite(altitude) & np.isfinite(speed)
    if np.count_nonzero(known) < FEWEST:
        return []

    def too_fast(factor: float) -> float:
        pressure = pressure_from_altitude(np.clip(factor * altitude[known], -700.0, 20_000.0))
        kelvin = standard_temperature(np.clip(factor * altitude[known], -700.0, 20_000.0))
        return float(
            np.mean(speed[known] > airspeed_from_calibrated(FASTEST_CALIBRATED, pressure, kelvin))
        )

    if too_fast(1.0) <= 0.3:
        return []
    likely = next(
        (name for name, f in _ALTITUDE_MISTAKES.items() if f > 1.0 and too_fast(f) < 0.05), ""
    )
    evidence = (
        f"{too_fast(1.0):.0%} of the airspeeds are beyond any aircraft's limit at these altitudes "
        f"(median {np.median(speed[known]) / KNOT:.0f} kt at "
        f"{np.median(altitude[known]) / FOOT:,.0f} ft)"
    )
    return [Finding("pressure_altitude", likely, evidence)]


def _against_standard_atmosphere(altitude: Array, kelvin: Array) -> list[Finding]:
    def compared(factor: float, temperature: Array) -> tuple[float, bool]:
        """Median distance (K), and whether temperatures change as the standard atmosphere's."""
        standard = standard_temperature(np.clip(factor * altitude, -700.0, 20_000.0))
        apart = float(np.median(np.abs(temperature - standard)))
        if (spread := float(np.var(standard))) < 64.0:
            return apart, True
        slope = float(np.cov(temperature, standard, bias=True)[0, 1]) / spread
        return apart, 0.55 <= slope <= 1.5

    apart, alike = compared(1.0, kelvin)
    if apart <= 18.0 and alike:
        return []
    trials = {
        **{
            ("pressure_altitude", name): compared(factor, kelvin)
            for name, factor in _ALTITUDE_MISTAKES.items()
        },
        **{
            ("air_temperature", name): compared(1.0, corrected(kelvin))
            for name, corrected in _TEMPERATURE_MISTAKES.items()
        },
    }
    possible = {key: distance for key, (distance, alike) in trials.items() if alike}
    possible["air_temperature", ""] = np.inf
    (quantity, likely), best = min(possible.items(), key=lambda item: item[1])
    if best > min(12.0, 0.5 * apart):
        if apart < 60.0:  # air near the ground in a polar winter is 50 K colder than the standard
            return []
        quantity, likely = "air_temperature", ""
    evidence = (
        f"temperatures are {apart:.0f} K from the standard atmosphere (median "
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
    of_what = {
        "wind_speed": "those of the reference",
        "reported_airspeed": "the airspeed of ground velocity and reference wind",
        "ground_speed": "the speed between successive positions",
    }[quantity]
    return Finding(quantity, "", f"they are {factor:.2f} times {of_what}", factor)


def _ground_findings(sample: Sample) -> list[Finding]:
    chord = sample["chord_speed"]
    speed = np.hypot(sample["ground_eastward_velocity"], sample["ground_northward_velocity"])
    known = np.isfinite(speed) & (chord > 20.0)
    if np.count_nonzero(known) < FEWEST:
        return []
    factor = float(np.median(speed[known] / chord[known]))
    return [] if 0.8 <= factor <= 1.25 else [_scaled("ground_speed", factor)]


def _airspeed_findings(sample: Sample) -> list[Finding]:
    reported = np.where(sample["reported_airspeed"] > 0.0, sample["reported_airspeed"], np.nan)
    implied = np.hypot(*_air(sample))
    known = np.isfinite(reported) & (implied > 20.0)
    if np.count_nonzero(known) < FEWEST:
        return []
    reported, implied = reported[known], implied[known]
    factor = float(np.median(reported / implied))
    altitude = np.clip(np.nan_to_num(sample["pressure_altitude"][known]), -700.0, 20_000.0)
    as_true = airspeed_from_calibrated(
        reported, pressure_from_altitude(altitude), standard_temperature(altitude)
    )
    finding = _scaled("reported_airspeed", factor)
    if abs(float(np.median(as_true / implied)) - 1.0) < 0.06 and abs(factor - 1.0) > 0.12:
        return [replace(finding, likely="indicated airspeeds", factor=0.0)]
    return [] if 0.8 <= factor <= 1.25 else [finding]


def _heading_findings(sample: Sample) -> list[Finding]:
    heading = sample["reported_heading"]
    air = np.degrees(np.arctan2(*_air(sample)))
    known = np.isfinite(heading) & np.isfinite(air)
    if np.count_nonzero(known) < FEWEST:
        return []
    heading, air = heading[known], air[known]

    def agreement(angle: Array) -> float:
        return float(np.mean(np.cos(np.radians(angle - air))))

    if agreement(heading) >= 0.7:
        return []
    trials = {
        name: agreement(corrected(heading)) for name, corrected in _DIRECTION_MISTAKES.items()
    }
    best = max(trials, key=lambda name: trials[name])
    evidence = (
        f"they lie between {np.quantile(heading, 0.01):.0f} and {np.quantile(heading, 0.99):.0f} "
        "degrees and do not agree with the headings of ground velocity and reference wind"
    )
    return [Finding("reported_heading", best if trials[best] > 0.9 else "", evidence)]


def _heading_offset(sample: Sample) -> tuple[float, float, float] | None:
    """Offset of the headings from the reference's, its standard error and the declination."""
    apart = wrap_degrees(sample["reported_heading"] - np.degrees(np.arctan2(*_air(sample))))
    known = np.isfinite(apart) & np.isfinite(sample["declination"])
    if np.count_nonzero(known) < FEWEST:
        return None
    flights, number = np.unique(sample["flight"][known], return_inverse=True)
    means = np.bincount(number, weights=apart[known]) / np.bincount(number)
    # One flight has the reference's error of one day: 2 m/s across at 100 m/s is 1 degree.
    error = float(np.std(means, ddof=1)) if flights.size > 2 else 1.0
    middle = float(np.median(apart[known]))
    angle = float(np.mean(sample["declination"][known]))
    return middle, max(error / np.sqrt(flights.size), 0.2), angle


def _kind_of_heading(
    offsets: Mapping[str, tuple[float, float, float]], fleet: int
) -> list[Finding]:
    if not offsets:
        return []
    offset, error, angle = (np.array(column) for column in zip(*offsets.values(), strict=True))
    kind = taken_for(offset, error, angle)
    if not kind:
        return []
    likely, sign = {
        "magnetic_for_true": (
            "headings taken for true are magnetic: map their column as magnetic_heading_deg",
            "minus the declination",
        ),
        "true_for_magnetic": (
            "headings taken for magnetic are true: map their column as heading_deg",
            "the declination",
        ),
    }[kind]
    evidence = (
        f"their offsets (median {np.median(offset):+.1f} degrees) are {sign} "
        f"({np.median(angle):+.1f} degrees)"
    )
    tails = tuple(offsets)
    share = len(tails) / fleet
    return [Finding("reported_heading", likely, evidence, 0.0, tails, share, refused=False)]


def _winds(sample: Sample) -> tuple[Complex, Complex]:
    """Reported and reference wind (eastward + 1j northward) where both are known."""
    reported = sample["eastward_wind"] + 1j * sample["northward_wind"]
    reference = sample["reference_eastward_wind"] + 1j * sample["reference_northward_wind"]
    known = np.isfinite(reported) & np.isfinite(reference)
    return reported[known], reference[known]


def _motion_in_winds(sample: Sample, *, derived: bool) -> list[Finding]:
    """Winds that hold a part of the ground velocity."""
    ground = sample["ground_eastward_velocity"] + 1j * sample["ground_northward_velocity"]
    apart = (sample["eastward_wind"] - sample["reference_eastward_wind"]) + 1j * (
        sample["northward_wind"] - sample["reference_northward_wind"]
    )
    known = np.isfinite(ground) & np.isfinite(apart) & (np.abs(ground) > 20.0)
    if np.count_nonzero(known) < FEWEST:
        return []
    part = float(
        np.sum((apart[known] * ground[known].conj()).real) / np.sum(np.abs(ground[known]) ** 2)
    )
    if abs(part) <= 0.2:
        return []
    evidence = f"winds contain {part:+.2f} times the ground velocity"
    return [Finding("ground_velocity" if derived else "wind_speed", "", evidence)]


def _wind_findings(sample: Sample, *, derived: bool) -> list[Finding]:
    reported, reference = _winds(sample)
    strength = float(np.sqrt(np.mean(np.abs(reference) ** 2))) if reference.size else 0.0
    if reported.size < FEWEST or strength < 5.0 or not np.any(reported):
        return []

    def correlation(wind: Complex) -> float:
        product = np.sum((wind * reference.conj()).real)
        return float(product / np.sqrt(np.sum(np.abs(wind) ** 2) * np.sum(np.abs(reference) ** 2)))

    agreement = correlation(reported)
    if agreement >= 0.6:
        ratio = float(np.sqrt(np.mean(np.abs(reported) ** 2))) / strength
        # The scale is between the two regressions, agreement * ratio and ratio / agreement.
        if agreement * ratio / 1.25 <= 1.0 <= ratio / agreement * 1.25:
            return []
        finding = _scaled("wind_speed", ratio)
        if np.count_nonzero(np.isfinite(sample["air_temperature"])) >= FEWEST:
            return [finding]
        levels = "altitudes in m read as ft" if ratio > 1.0 else "altitudes in ft read as m"
        return [replace(finding, likely=levels)]
    if motion := _motion_in_winds(sample, derived=derived):
        return motion
    direction = np.degrees(np.arctan2(-reported.real, -reported.imag)) % 360.0
    speed = np.abs(reported)
    trials = {}
    for name, corrected in _DIRECTION_MISTAKES.items():
        angle = np.radians(corrected(direction))
        trials[name] = correlation(-speed * (np.sin(angle) + 1j * np.cos(angle)))
    best = max(trials, key=lambda name: trials[name])
    low, high = (float(value) for value in np.quantile(direction, [0.01, 0.99]))
    of_reference = np.degrees(np.arctan2(-reference.real, -reference.imag)) % 360.0
    outside = float(np.mean((of_reference < low - 20.0) | (of_reference > high + 20.0)))
    evidence = (
        f"they lie between {low:.0f} and {high:.0f} degrees, and the correlation with the "
        f"reference's is {agreement:.2f}"
    )
    explained = trials[best] >= 0.75 and trials[best] - agreement >= 0.3
    if explained and (trials[best] >= 0.9 or outside < 0.15):
        return [Finding("wind_direction", best, evidence)]
    if outside >= 0.15 and high - low <= 270.0:
        return [Finding("wind_direction", "a part of the circle missing", evidence)]
    if agreement < 0.2 and reported.size >= 200 and strength >= 8.0:
        return [Finding("wind_direction", "", evidence)]
    return []


def with_implausible(fits: xr.Dataset, findings: Sequence[Finding]) -> xr.Dataset:
    """Set the status of aircraft with implausible reports, and store the findings.

    Parameters
    ----------
    fits : Dataset
        Of :func:`airswing.compass.fit.deviation.fit_deviation`.
    findings : sequence of Finding
        Of :func:`plausibility`.

    Returns
    -------
    Dataset
        Status ``implausible_reports`` where the fit would be published or does not improve the
        winds; attribute ``implausible_reports`` holds the findings as JSON.
    """
    tails = {tail for finding in findings if finding.refused for tail in finding.aircraft}
    named = xr.DataArray([str(t) in tails for t in fits["aircraft"].to_numpy()], dims="aircraft")
    # Winds that a correction does not improve are a consequence of implausible reports.
    judged = published(fits["status"]) | (fits["status"] == STATUS["no_improvement"]).to_numpy()
    # A large deviation changes the reported winds, too. Where it explains most of the variance of
    # the heading error, the compass causes the difference of the winds and not a wrong unit.
    explained = 1.0 - (fits["residual_rms_after"] / fits["residual_rms_before"]) ** 2
    by_compass = (fits["status"] == STATUS["ok"]) & (explained > 0.5)
    affected = named & xr.DataArray(judged, dims=fits["status"].dims) & ~by_compass
    status = fits["status"].where(~affected, STATUS["implausible_reports"])
    return fits.assign(status=status.astype(fits["status"].dtype)).assign_attrs(
        implausible_reports=json.dumps([asdict(finding) for finding in findings])
    )


def plausibility_warnings(fits: xr.Dataset) -> list[str]:
    """Return one sentence for each finding stored by :func:`with_implausible`."""
    stored = json.loads(str(fits.attrs.get("implausible_reports", "[]")))
    return [str(Finding(**one | {"aircraft": tuple(one["aircraft"])})) for one in stored]
