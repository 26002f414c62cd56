"""Reports of one day flown through a real model run with its real forecast error.

The folder holds one run (a 00Z cycle, valid times of one day) and an analysis of a later cycle,
GRIB1 on a Lambert grid. True wind = run + (later analysis - run at the same time), shifted by some
rows and columns: every flight has another shift, and thus an independent error with the true
structure in space and height. Run as ``python -m airswing.synthetic.real_winds FOLDER
GRIB_FOLDER``. Units: hours from the run's start, hPa, m/s.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from airswing.errors import InputError
from airswing.physics.atmosphere import pressure_from_altitude
from airswing.synthetic.archive import Scenario, finished, write_reports
from airswing.synthetic.atmosphere import Array, stream
from airswing.synthetic.fields import GriddedReference, LambertGrid, sample_reference
from airswing.synthetic.flights import report_steps, tour
from airswing.synthetic.instrument import EarthField, parse_faults
from airswing.synthetic.observe import Coding, Units, observe
from airswing.synthetic.truth import fleet_deviations, save_truth, truth_record

# Levels of lower pressure (hPa) are omitted: tours fly below them.
_LOWEST = 350
_TRIES = 60
# Latitude and longitude (degrees), pressure (Pa) and hours of points (n,).
_Places = tuple[Array, Array, Array, Array]


def read_run(folder: Path) -> tuple[GriddedReference, GriddedReference, datetime]:
    """Run, its error at one time (analysis of the next cycle minus run), and its start.

    Components along the grid, NaN where missing.
    """
    import eccodes

    # by base time, lead (h), level (hPa) and component
    fields: dict[tuple[datetime, int, int, int], NDArray[np.float32]] = {}
    grid = None
    for path in sorted(item for item in folder.iterdir() if item.is_file()):
        with path.open("rb") as source:
            while (handle := eccodes.codes_grib_new_from_file(source)) is not None:

                def key(name: str, handle: int = handle) -> Any:
                    return eccodes.codes_get(handle, name)

                name, level = key("shortName"), int(key("level"))
                if (
                    name in ("u", "v")
                    and key("typeOfLevel") == "isobaricInhPa"
                    and level >= _LOWEST
                ):
                    grid = grid or LambertGrid(
                        key("latitudeOfFirstGridPointInDegrees"),
                        (key("longitudeOfFirstGridPointInDegrees") + 180.0) % 360.0 - 180.0,
                        int(key("Nx")),
                        int(key("Ny")),
                        float(key("DxInMetres")),
                        (key("LoVInDegrees") + 180.0) % 360.0 - 180.0,
                        key("Latin1InDegrees"),
                        float(key("radius")),
                    )
                    values = eccodes.codes_get_values(handle).astype(np.float32)
                    if key("bitmapPresent"):
                        values[values == np.float32(key("missingValue"))] = np.nan
                    stamp = f"{key('dataDate'):08d}{key('dataTime'):04d}"
                    place = datetime.strptime(stamp, "%Y%m%d%H%M"), int(key("endStep")), level
                    fields[*place, "uv".index(name)] = values.reshape(grid.rows, grid.columns)
                eccodes.codes_release(handle)
    bases = sorted({base for base, *_ in fields})
    if grid is None or len(bases) < 2:
        raise InputError("needs the winds of two cycles", file=str(folder))
    start, later = bases[:2]
    levels = sorted({level for *_, level, _ in fields}, reverse=True)
    hours = sorted({lead for base, lead, *_ in fields if base == start})
    missing = np.full((grid.rows, grid.columns), np.nan, np.float32)

    def wind(base: datetime, lead: int) -> NDArray[np.float32]:
        rows = [[fields.get((base, lead, p, c), missing) for p in levels] for c in (0, 1)]
        return np.array(rows)

    run = np.stack([wind(start, lead) for lead in hours])
    error = wind(later, 0) - run[hours.index(round((later - start).total_seconds() / 3600.0))]
    axes = grid, np.array(levels, float)
    return (
        GriddedReference("run", *axes, np.array(hours, float), run),
        GriddedReference("error", *axes, np.array([-1e4, 1e4]), np.stack([error] * 2)),
        start,
    )


def _filled(stored: GriddedReference) -> GriddedReference:
    """Fields with gaps filled by the nearest value of the same level."""
    wind = stored.wind.copy()
    for index in np.ndindex(*wind.shape[:3]):
        gap = np.isnan(wind[index])
        if gap.any() and not gap.all():
            nearest = distance_transform_edt(gap, return_distances=False, return_indices=True)
            wind[index] = wind[index][tuple(nearest)]
    return replace(stored, wind=np.nan_to_num(wind))


class RealAir:
    """The true wind of every flight: the run and its shifted error."""

    def __init__(self, run: GriddedReference, error: GriddedReference, *, seed: int) -> None:
        self._run, self._error = _filled(run), error
        self._filled_error = _filled(error)
        self._seed = seed
        self._shift = np.zeros((2, 0))

    def _sampled(
        self, stored: GriddedReference, places: _Places, shift: tuple[Array, Array] | None = None
    ) -> Array:
        """Wind (2, n) with times and levels limited to those of the fields."""
        latitude, longitude, pressure, hours = places
        level = np.clip(pressure / 100.0, stored.levels.min(), stored.levels.max())
        when = np.clip(hours, stored.hours[0], stored.hours[-1])
        return sample_reference(stored, latitude, longitude, level, when, shift=shift)

    def run_wind(self, latitude: Array, longitude: Array, altitude: Array, hours: Array) -> Array:
        """Wind (2, n) of the run at pressure altitudes in m; calm off the grid."""
        places = latitude, longitude, pressure_from_altitude(altitude), hours
        return np.nan_to_num(self._sampled(self._run, places))

    def draw(
        self, flight: NDArray[np.int64], latitude: Array, longitude: Array, pressure: Array
    ) -> None:
        """Draw for every flight a shift that keeps all its reports (n,) on the error field."""
        rng = stream(self._seed, "shifts")
        flights = int(flight.max()) + 1
        self._shift = np.zeros((2, flights))
        open_ = np.isin(np.arange(flights), flight)
        for _ in range(_TRIES):
            rows = np.nonzero(open_[flight])[0]
            if rows.size == 0:
                break
            size = np.array([[self._run.grid.rows], [self._run.grid.columns]])
            trial = rng.uniform(-0.6, 0.6, (2, flights)) * size
            where = flight[rows]
            shift = trial[0, where], trial[1, where]
            places = latitude[rows], longitude[rows], pressure[rows], np.zeros(rows.size)
            wind = self._sampled(self._error, places, shift)
            lost = np.bincount(where, np.isnan(wind[0]), flights)
            good = open_ & (lost == 0)
            self._shift[:, good] = trial[:, good]
            open_ &= ~good

    def wind(self, flight: NDArray[np.int64], *places: *_Places) -> Array:
        """True wind (2, n), m/s; see `airswing.synthetic.observe.Wind`."""
        shift = self._shift[0, flight], self._shift[1, flight]
        error = self._sampled(self._filled_error, places, shift)
        return np.nan_to_num(self._sampled(self._run, places)) + np.nan_to_num(error)


def write_archive(
    directory: str | Path,
    grib: str | Path,
    *,
    aircraft: int = 12,
    seed: int = 1,
    effects: Sequence[Mapping[str, object]] | None = None,
    output: str | None = None,
) -> Path:
    """Write the reports of one day flown through a real run, and a configuration for them.

    The configuration names two references: ``cycle_00``, every file of the first cycle in the
    folder ``grib``, and ``cycle_12``, the later analysis with the last four files of the first.
    """
    root, source = Path(directory), Path(grib)
    run, error, start = read_run(source)
    tails = Scenario(aircraft=aircraft).tails
    effects = fleet_deviations(tails, seed) if effects is None else effects
    faults = parse_faults(effects, start=start, tails=tails)
    air = RealAir(run, error, seed=seed)
    flown = tour(air.run_wind, aircraft=aircraft, seed=seed)
    flight, step = report_steps(flown, climb_seconds=60.0, cruise_seconds=60.0)
    latitude, longitude = flown.latitude[step, flight], flown.longitude[step, flight]
    air.draw(flight, latitude, longitude, pressure_from_altitude(flown.altitude[step, flight]))
    box = (latitude.min(), latitude.max(), longitude.min(), longitude.max())
    earth = EarthField(start, 1.0, box)
    units = Units(tails, faults, Coding(position_arcmin=0.01))  # reports a minute apart
    reports = observe(flown, flight, step, wind=air.wind, seed=seed, field=earth, units=units)
    frame = finished(reports, start)
    write_reports(root / "reports", frame)
    files = sorted(str(path.resolve()) for path in source.iterdir() if path.is_file())
    target = root / "config.yaml"
    first = [name for name in files if f"{start:%Y%m%d%H}" in Path(name).name]
    later = [name for name in files if name not in first]
    config = {
        "reports": {"files": f"{root.resolve()}/reports/*.csv"},
        "references": {
            "cycle_00": {"files": first},
            "cycle_12": {"files": later + first[-4:]},
        },
        "output": output or f"{root.resolve()}/results",
    }
    target.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    record = truth_record(frame, faults, tails, effects)
    save_truth(root / "truth", record, seed=seed, start=start)
    return target


if __name__ == "__main__":
    print(write_archive(sys.argv[1], sys.argv[2]))
