"""Use of a damaged file as the commands use it: the outcome is a result or one clear message."""

import contextlib
import functools
import io
import os
import random
import shutil
import subprocess
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
import yaml
from benchmarks.fuzz.mutations import CELLS, damage_dataset, damage_store, mutated, sections
from benchmarks.fuzz.seeds import (
    DATASETS,
    GRIBS,
    KEPT,
    LEVELS,
    PRODUCTS,
    STATIONS,
    STORES,
    TABLES,
    TEXTS,
    WHEN,
    reports,
)

from airswing.errors import LONGEST, AirswingError

MAX_WIND = 150.0
COMMAND_SECONDS = 50  # a worker ends after a minute
COMPARED = 0.2
"""Share of cases whose damage is one byte of data or one cell: all else is compared."""
EXPORTS = ("obs_domain", "little_r", "ob_ascii", "jedi", "reject_list")
EXPORTED = ("corrected.nc", "reject list")
OTHERS = (*DATASETS, *STATIONS, *EXPORTED, "error table")


class FoundError(Exception):
    """A forbidden outcome: the campaign's column, and a description."""

    def __init__(self, column, description):
        super().__init__(column, description)
        self.column, self.what = column, description


def case(kind, seed, seeds, folder):
    """Make one case in an empty folder and run it; ``result`` or ``refused``, else FoundError."""
    pick = random.Random(f"{kind} {seed}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        end = _work(kind, pick, seeds, folder)
    if partial := [path.name for path in folder.rglob("*.part")]:
        raise FoundError("half-written", ", ".join(partial))
    return end


def _work(kind, pick, seeds, folder):
    if kind in KEPT:
        return _run_state(kind, pick, seeds, folder)
    if kind == "whole command":
        return _command(pick, seeds, folder)
    if kind in OTHERS:
        return _external_input(kind, pick, seeds, folder)
    if kind in (*GRIBS, "csv", "csv.gz") and pick.random() < COMPARED:
        return _refusable(lambda: _compared(kind, pick, seeds, folder))
    path = damaged(kind, pick, seeds, folder)
    if kind in GRIBS:
        return _refusable(lambda: _grib(path, folder, pick))
    if kind in PRODUCTS:
        return _product(kind, path, seeds, folder, pick)
    if kind == "yaml":
        return _refusable(lambda: _config(path))
    if kind == "effects":
        return _refusable(lambda: _effects(path))
    return _refusable(lambda: _reports(path))


def damaged(kind, pick, seeds, folder):
    source, donor = seeds[kind], seeds[pick.choice([*GRIBS, *TEXTS, *TABLES])]
    path = folder / f"damaged.{kind.replace(' ', '_').replace(',', '')}"
    if kind in STORES:
        shutil.copytree(source, path)
        damage_store(path, pick)
        return path
    shutil.copy(source, path)
    netcdf = "NetCDF" in kind or kind in ("wrfout", "corrected.nc")
    if netcdf and pick.random() < 0.6:
        damage_dataset(path, pick)
        return path
    family = "csv" if kind in STATIONS else kind
    family = "grib" if "GRIB" in kind else family
    path.write_bytes(mutated(family, source.read_bytes(), donor.read_bytes(), pick))
    return path


def _refusable(work):
    try:
        work()
    except AirswingError as error:
        text = str(error)
        if len(text) > LONGEST or "\n" in text:
            raise FoundError("long message", f"{len(text)} characters") from None
        return "refused"
    return "result"


def _require_possible(east, north):
    speed = np.hypot(np.asarray(east, np.float64), np.asarray(north, np.float64))
    absurd = ~(speed <= MAX_WIND) & ~np.isnan(speed)
    if absurd.any():
        raise FoundError("absurd winds", f"{int(absurd.sum())}, up to {np.nanmax(speed):.4g} m/s")


def _external_input(kind, pick, seeds, folder):
    """Datasets, stations, and inputs of exports."""
    path = damaged(kind, pick, seeds, folder)
    if kind in DATASETS:
        return _refusable(lambda: _gridded(path, folder, pick))
    if kind == "error table":
        return _refusable(lambda: _error_table(path))
    if kind in EXPORTED:
        return command(*_export(kind, path, seeds, folder, pick))
    if kind == "station pairs":
        section = {"pairs": {"files": str(path)}}
    else:
        paths = {name: seeds[name] for name in STATIONS} | {kind: path}
        section = {
            "forecasts": {"files": str(paths["station GRIB"])},
            "stations": {"files": str(paths["station observations"])},
        }
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump({"postprocess": section, "output": str(folder / "out")}))
    end = command("postprocess", str(config), "--quiet")
    if end == "result" and kind != "station pairs":
        with xr.open_dataset(folder / "out" / "postprocessed.nc", engine="netcdf4") as ds:
            winds = ds["forecast"][[str(n) != "air_temperature" for n in ds["variable"].values]]
            _require_possible(winds, 0.0)
    return end


def _places():
    table = reports()
    return xr.Dataset(
        {
            "time": ("report", np.full(len(table), WHEN)),
            "latitude": ("report", table["latitude"]),
            "longitude": ("report", table["longitude"]),
            "pressure": ("report", table["pressure_hPa"] * 100.0),
        }
    )


def _winds(path, cache, **options):
    from airswing.reference.catalogue import build_catalogue
    from airswing.reference.collocate import collocate

    catalogue = build_catalogue(str(path), name="ref", cache_dir=cache)
    lazy = collocate(_places(), {"ref": catalogue}, **options)
    collocated = lazy.compute(scheduler="synchronous")
    return collocated["reference_eastward_wind"], collocated["reference_northward_wind"]


def _drawn(pick):
    return {"sparse": pick.random() < 0.5, "derivatives": pick.random() < 0.3}


def _gridded(path, folder, pick):
    from airswing.workflow.inspection import inspect_file

    with contextlib.suppress(AirswingError):
        inspect_file(path)
    _require_possible(*_winds(path, folder / "cache", derivatives=pick.random() < 0.3))


def _grib(path, folder, pick):
    from airswing.reference.inspection import inspect_winds

    with contextlib.suppress(AirswingError):
        inspect_winds(str(path))
    _require_possible(*_winds(path, folder / "cache", **_drawn(pick)))


def _reports(path):
    from airswing.reports import read_reports
    from airswing.workflow.inspection import inspect_file

    with contextlib.suppress(AirswingError):
        inspect_file(path)
    ds = read_reports(path)
    _require_possible(ds["eastward_wind"], ds["northward_wind"])
    if ds.sizes["report"] != int(ds["row_size"].sum()):
        raise FoundError("silent", "row sizes do not add up")


def _config(path):
    from airswing.config_file import load_config

    load_config(path)


def _effects(path):
    from airswing.gap.simulation.effects_file import plain_effects, read_effects

    plain_effects(read_effects(path))


def _error_table(path):
    from airswing.handover.error_tables import changed_table

    errors = {"UV": dict.fromkeys((1000, 700, 500, 300, 200, 100), 1.7)}
    changed_table(path.read_bytes().decode("latin-1"), errors, ["AIREPS"])


# ---------------------------------------------------------------------------------- comparisons
def _compared(kind, pick, seeds, folder):
    """One changed byte of data, byte of a gzip stream, or cell: all else is unchanged.

    Under PNG and gzip, which have checksums, no value may differ at all.
    """
    from airswing.reports import read_reports

    data, path = seeds[kind].read_bytes(), folder / f"damaged.{kind.replace(' ', '_')}"
    if kind in GRIBS:
        changed, number = _payload_changed(data, pick)
        path.write_bytes(changed)
        winds = _winds(path, folder / "cache", **_drawn(pick))
        _require_possible(*winds)
        wrong = _others_differ(winds, _sound_winds(seeds[kind]), number, kind == "grib2 PNG")
    else:
        number, sound = -1, _sound_reports(seeds["csv"])
        if kind == "csv":
            changed, number = _cell_changed(data, pick)
        else:
            changed = mutated("gzip", data, b"", pick)
        path.write_bytes(changed)
        tail = None if number < 0 else str(sound.index[number])
        wrong = _rows_differ(_by_tail(read_reports(path)), sound, tail)
    if wrong:
        raise FoundError("silent", wrong)


@functools.cache
def _sound_winds(path):
    with tempfile.TemporaryDirectory() as cache:
        return _winds(path, Path(cache))


@functools.cache
def _sound_reports(path):
    from airswing.reports import read_reports

    return _by_tail(read_reports(path))


def _payload_changed(data, pick):
    """Change one bit of one message's data; the message's number."""
    messages = sections(data)
    number = pick.randrange(len(messages))
    start, length = messages[number][-1]
    header = 11 if data[messages[number][0][0] + 7] == 1 else 5
    at = start + header + pick.randrange(length - header)
    return data[:at] + bytes([data[at] ^ (1 << pick.randrange(8))]) + data[at + 1 :], number


def _others_differ(winds, sound, number, checksum):
    """Describe winds that differ though their message (u and v by turns) was not changed."""
    level = LEVELS[number // 2] * 100.0
    nearest = np.sort(np.abs(LEVELS * 100.0 - level))[1]
    unaffected = np.abs(_places()["pressure"].to_numpy() - level) > nearest
    for ours, theirs in zip(map(np.asarray, winds), map(np.asarray, sound), strict=True):
        same = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
        if not same[..., unaffected].all():
            return f"{int((~same[..., unaffected]).sum())} winds of sound messages"
        if checksum and not (same | np.isnan(ours)).all():
            return f"{int((~same).sum())} winds of a stream with a checksum"
    return ""


def _cell_changed(data, pick):
    """Change one cell of one row of a table; the row's number, from 0."""
    rows = data.split(b"\n")
    number = pick.randrange(1, len(rows) - 1)
    cells = rows[number].split(b",")
    quiet = [cell for cell in CELLS if '"' not in cell and "," not in cell]
    cells[pick.randrange(1, len(cells))] = pick.choice(quiet).encode("utf-8", "replace")
    rows[number] = b",".join(cells)
    return b"\n".join(rows), number - 1


def _by_tail(ds):
    """Winds, places and times of reports by tail: every report is another aircraft's."""
    names = ("time", "latitude", "longitude", "pressure", "eastward_wind", "northward_wind")
    tails = np.repeat(ds["aircraft"].values.astype(str), ds["row_size"].values)
    return pd.DataFrame({name: ds[name].values for name in names}, index=tails)


def _rows_differ(table, sound, changed):
    """Describe values that differ in rows that were not changed; absent rows are allowed."""
    for name in table.columns:
        ours = table[name]
        theirs = sound[name].reindex(ours.index)
        wrong = ~((ours == theirs) | (ours.isna() & theirs.isna())) & (ours.index != changed)
        if wrong.any():
            return f"{name} of {int(wrong.sum())} sound rows"
    return ""


# ------------------------------------------------------------------------------------- commands
def command(*words):
    from airswing import cli

    before, sys.argv = sys.argv, ["airswing", *words]
    messages = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(messages):
            cli.main()
    except SystemExit as ended:
        if ended.code not in (0, None, 2):
            raise FoundError("traceback", f"exit status {ended.code}") from None
        _require_short(messages.getvalue())
        return "refused" if ended.code else "result"
    finally:
        sys.argv = before
    return "result"


def _require_short(messages):
    longest = max(map(len, messages.splitlines()), default=0)
    if longest > LONGEST + 20:
        raise FoundError("long message", f"{longest} characters")


def _export(kind, path, seeds, folder, pick):
    run, output = seeds["kept notes"], folder / "results"
    output.mkdir()
    for product in (run / "results").glob("*.nc"):
        shutil.copy(path if product.name == kind else product, output / product.name)
    content = yaml.safe_load((run / "config.yaml").read_text()) | {"output": str(output)}
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(content))
    to = "reject_list" if kind == "reject list" else pick.choice(EXPORTS)
    base = path if kind == "reject list" else seeds["reject list"]
    base_option = ("--base", str(base)) if to == "reject_list" else ()
    winds = ("--winds", pick.choice(("corrected", "reported", "reported")))
    target = ("-o", str(folder / "exported"))
    return ("export", str(config), "--to", to, *target, *winds, *base_option, "--quiet")


def _product(kind, path, seeds, folder, pick):
    from airswing.gap.simulation.effects_file import read_known

    output = folder / "out"
    (output / "headings").mkdir(parents=True)
    targets = {"headings.nc": output / "headings/2009-01.nc", "fits.nc": output / "fits.nc"}
    for name, target in targets.items():
        shutil.copy(path if name == kind else seeds[name], target)
    config = str(seeds["kept notes"] / "config.yaml")
    ends = [command("inspect", str(targets[kind]))]
    stage = "fit" if kind == "headings.nc" and pick.random() < 0.3 else "correct"
    ends.append(command(stage, config, "--output", str(output), "--quiet"))
    _refusable(lambda: read_known(output / "fits.nc", reference="ruc"))
    return "refused" if "refused" in ends else "result"


@functools.cache
def _truth(folder):
    from airswing.products.netcdf import open_product

    with open_product(folder / "results" / "headings") as ds:
        return {str(name): ds[name].to_numpy() for name in ds.variables if name != "screening"}


def _run_state(kind, pick, seeds, folder):
    run = seeds[kind]
    if kind == "header cache":
        return _header_cache(run, pick, folder)
    output = folder / "results"
    shutil.copytree(run / "results", output)
    victim = pick.choice(sorted((output / ".airswing").glob("*.json")))
    status = victim.stat()
    victim.write_bytes(mutated("kept", victim.read_bytes(), b"0123456789" * 9, pick))
    os.utime(victim, ns=(status.st_atime_ns, status.st_mtime_ns))
    content = yaml.safe_load((run / "config.yaml").read_text()) | {"output": str(output)}
    (folder / "config.yaml").write_text(yaml.safe_dump(content))
    return _refusable(lambda: _resumed(folder / "config.yaml", _truth(run)))


def _resumed(config, truth):
    from airswing.config_file import load_config
    from airswing.workflow import make_headings
    from airswing.workflow.job import Job
    from airswing.workflow.progress import Progress

    with make_headings(Job(load_config(config), Progress(quiet=True))) as headings:
        for name, values in truth.items():
            stored = headings[name].to_numpy()
            same = stored.shape == values.shape and (
                np.array_equal(stored, values, equal_nan=values.dtype.kind == "f")
            )
            if not same:
                raise FoundError("silent", f"{name} differs")


def _header_cache(run, pick, folder):
    cache = folder / "cache"
    shutil.copytree(run / "cache", cache)
    victim = pick.choice(sorted((cache / "grib-headers").iterdir()))
    victim.write_bytes(mutated("cache", victim.read_bytes(), b"rubbish" * 9, pick))
    files = str(run / "ruc" / "*")

    def work():
        if _catalogue(files, cache) != _sound_catalogue(files, run / "cache"):
            raise FoundError("silent", "another catalogue from a damaged cache")

    return _refusable(work)


def _catalogue(files, cache):
    from airswing.reference.catalogue import build_catalogue

    catalogue = build_catalogue(files, name="ruc", cache_dir=cache)
    rows = catalogue.valid, catalogue.leads, catalogue.bounds, catalogue.rows
    return b"".join(array.tobytes() for array in rows)


_sound_catalogue = functools.cache(_catalogue)


def _command(pick, seeds, folder):
    kind = pick.choice([*GRIBS, "csv", "netcdf3", "netcdf4", "parquet", "bufr", "yaml"])
    path = damaged(kind, pick, seeds, folder)
    config = folder / "config.yaml"
    of_reports = kind in (*TEXTS, *TABLES)
    content = {
        "reports": {"files": str(path if of_reports else seeds["csv"])},
        "references": {"ref": {"files": str(path if kind in GRIBS else seeds["grib1 simple"])}},
        "collocation": {"sparse": pick.random() < 0.5},
        "screening": {"phases": ["ascent", "cruise", "descent", "unknown"]},
        "output": str(folder / "out"),
    }
    config.write_text(yaml.safe_dump(content))
    words = ["inspect", str(path)] if pick.random() < 0.3 else ["collocate", str(config)]
    words = ["evaluate", str(path), "--quiet"] if kind == "yaml" else words
    done = subprocess.run(
        [sys.executable, "-m", "airswing", *words],
        capture_output=True,
        text=True,
        check=False,
        errors="replace",
        timeout=COMMAND_SECONDS,
        cwd=folder,
    )
    if done.returncode < 0:
        raise FoundError("ended", f"signal {-done.returncode}")
    if done.returncode not in (0, 2) or "Traceback" in done.stderr:
        raise FoundError("traceback", done.stderr[-300:])
    _require_short(done.stderr)
    for product in (folder / "out" / "headings").glob("*.nc"):
        with xr.open_dataset(product, engine="netcdf4") as ds:
            _require_possible(ds["reference_eastward_wind"], ds["reference_northward_wind"])
    return "refused" if done.returncode else "result"


def answer(kind, seed, seeds, folder):
    """Run one case in a worker process: how it ended, and what was found."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there
    try:
        return {"end": case(kind, seed, seeds, folder)}
    except FoundError as found:
        return {"end": found.column, "what": found.what}
    except subprocess.TimeoutExpired:
        return {"end": "ended", "what": "the command did not end"}
    except Exception as error:
        steps = traceback.extract_tb(error.__traceback__)
        ours = [step for step in steps if "/airswing/" in step.filename] or steps
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return {"end": "traceback", "what": f"{type(error).__name__} at {where}: {error}"[:300]}
