"""Cost of collocation against plain decoding of the same messages.

    python -m benchmarks.collocation [--hours 48] [--repeats 3]

Ratios of processor time: hours of GRIB1 simple packing of a RUC-size model with 2,000 reports an
hour, without cache, over decoding every message with ecCodes (bar 0.20); one hour of each packing
decoded whole, over the same (bar 1.4 for complex packing, 1.5 for the others). Exit status 1 where
a bar is missed.
"""

import argparse
import itertools
import tempfile
import time
from pathlib import Path

import eccodes
import numpy as np
import xarray as xr
from tests.reference.builders import PARALLELS, build, grid_keys

from airswing.guarded import guarded
from airswing.reference.catalogue import build_catalogue
from airswing.reference.collocate import collocate

NI, NJ = 451, 337
LEVELS = np.arange(100, 1001, 25)
REPORTS = 2000  # an hour
START = np.datetime64("2009-08-01T00:00", "ns")
METRES = {"DxInMetres": 13545, "DyInMetres": 13545}
CORNER = (233.862, 16.281)
LAMBERT = grid_keys("lambert", (NI, NJ), CORNER, **PARALLELS, **METRES, uvRelativeToGrid=1)
PACKINGS = {
    "GRIB1 simple": "grid_simple",
    "GRIB2 complex": "grid_complex_spatial_differencing",
    "GRIB2 JPEG 2000": "grid_jpeg",
    "GRIB2 CCSDS": "grid_ccsds",
}
BARS = {"GRIB2 complex": 1.4}


def smooth_field(rng):
    """A wind component with waves of many lengths, to 0.1 m/s."""
    y, x = np.mgrid[0:NJ, 0:NI]
    field = np.full((NJ, NI), 15.0)
    for wavelength in (400.0, 200.0, 90.0, 40.0, 20.0):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        along = (x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / wavelength
        field += 0.03 * wavelength * np.sin(along + phase)
    return np.round(field + rng.normal(0, 0.3, field.shape), 1).ravel()


def write_hour(path, label, fields):
    options = {"edition": int(label[4]), "packing": PACKINGS[label], "bits": 12}
    messages = [
        build(
            LAMBERT,
            values,
            parameter="uv"[number % 2],
            level=int(LEVELS[number // 2]),
            when=(20090801, 0),
            **options,
        )
        for number, values in enumerate(fields)
    ]
    path.write_bytes(b"".join(messages))


def copy_hours(path, hours):
    """The same GRIB1 hour at later valid times: only the bytes of the date change."""
    data, starts = path.read_bytes(), [0]
    while starts[-1] < len(data):
        starts.append(starts[-1] + int.from_bytes(data[starts[-1] + 4 : starts[-1] + 7], "big"))
    paths = []
    for hour in range(hours):
        copy = bytearray(data)
        for start in starts[:-1]:
            copy[start + 22], copy[start + 23] = 1 + hour // 24, hour % 24
        paths.append(path.with_name(f"hour{hour:03d}.grb1"))
        paths[-1].write_bytes(copy)
    return [str(path) for path in paths]


def some_reports(hours):
    rng = np.random.default_rng(7)
    count = REPORTS * hours
    seconds = rng.uniform(0, (hours - 1) * 3600.0, count)
    return xr.Dataset(
        {
            "time": ("report", START + (seconds * 1e9).astype("timedelta64[ns]")),
            "latitude": ("report", rng.uniform(26.0, 48.0, count)),
            "longitude": ("report", rng.uniform(-115.0, -75.0, count)),
            "pressure": ("report", rng.uniform(15000.0, 99000.0, count)),
        }
    )


def decode(paths):
    for path in paths:
        with open(path, "rb") as file:
            while (handle := eccodes.codes_grib_new_from_file(file)) is not None:
                eccodes.codes_get_values(handle)
                eccodes.codes_release(handle)


def collocated(paths, reports, caches):
    """From files never seen before (a new cache each time) to winds at the reports."""
    catalogue = build_catalogue(paths, name="ruc", cache_dir=next(caches))
    collocate(reports, {"ruc": catalogue}).compute(scheduler="synchronous")


def ratio(work, baseline, repeats):
    """Least processor time of some runs of each, taken in turn: their ratio, and seconds."""
    times = [[], []]
    for _ in range(repeats):
        for durations, run in zip(times, (work, baseline), strict=True):
            start = time.process_time() + guarded(time.process_time)
            run()
            durations.append(time.process_time() + guarded(time.process_time) - start)
    return min(times[0]) / min(times[1]), min(times[0])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=int, default=48)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    rng, rows = np.random.default_rng(1), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        caches = (folder / f"cache{number}" for number in itertools.count())
        fields = [smooth_field(rng) for _ in range(2 * LEVELS.size)]
        files = {label: folder / f"{packing}.grb" for label, packing in PACKINGS.items()}
        for label, path in files.items():
            write_hour(path, label, fields)
        paths = copy_hours(files["GRIB1 simple"], options.hours)
        jobs = [(f"GRIB1 simple, {options.hours} hours, single points", paths, 0.20)]
        jobs += [
            (f"{label}, one hour, whole", [str(files[label])], BARS.get(label, 1.5))
            for label in PACKINGS
            if label != "GRIB1 simple"
        ]
        for label, inputs, bar in jobs:
            reports = some_reports(len(inputs)) if len(inputs) > 1 else some_reports(1)
            value, seconds = ratio(
                lambda inputs=inputs, reports=reports: collocated(inputs, reports, caches),
                lambda inputs=inputs: decode(inputs),
                options.repeats,
            )
            rows.append({"what": label, "ratio": value, "bar": bar, "seconds": seconds})
    print(f"{'over plain decoding':42} {'ratio':>7} {'bar':>5} {'seconds':>8}")
    for row in rows:
        print(f"{row['what']:42} {row['ratio']:7.3f} {row['bar']:5.2f} {row['seconds']:8.2f}")
    return int(any(row["ratio"] > row["bar"] for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
