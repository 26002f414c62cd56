"""What is done with a damaged file, and what may come of it: a result, or one clear message."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import random
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr
import yaml
from benchmarks.fuzz.comparisons import (
    by_tail,
    cell_changed,
    others_differ,
    payload_changed,
    rows_differ,
    sound_reports,
)
from benchmarks.fuzz.dataset_seeds import DATASETS
from benchmarks.fuzz.dataset_targets import (
    EXPORTED,
    OTHERS,
    collocated,
    damaged_dataset,
    error_table,
    exported,
    possible,
    postprocessed,
)
from benchmarks.fuzz.mutations import mutated
from benchmarks.fuzz.seeds import GRIBS, KEPT, PRODUCTS, TABLES, TEXTS, WHEN, reports

from airswing.errors import LONGEST, AirswingError

if TYPE_CHECKING:
    from airswing.reference.catalogue import Catalogue

MAX_WIND = 150.0
COMMAND_SECONDS = 120
COMPARED = 0.2
"""Share of cases whose damage is one octet of data or one cell: all else can be compared."""


class FoundError(Exception):
    """Something that must not be: which of the campaign's columns, and what."""

    def __init__(self, column: str, what: str) -> None:
        super().__init__(column, what)
        self.column, self.what = column, what


def case(kind: str, seed: int, seeds: dict[str, Path], folder: Path) -> str:
    """Make one case in an empty folder and run it.

    Parameters
    ----------
    kind : str
        As the campaign names it.
    seed : int
        Of the case.
    seeds : dict of str to Path
        Sound files.
    folder : Path

    Returns
    -------
    str
        How it ended: ``result`` or ``refused``.

    Raises
    ------
    FoundError
        What must not be.
    """
    pick = random.Random(f"{kind} {seed}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        end = _work(kind, pick, seeds, folder)
    left = [path.name for path in folder.rglob("*.part")]
    if left:
        raise FoundError("half-written", ", ".join(left))
    return end


def _work(kind: str, pick: random.Random, seeds: dict[str, Path], folder: Path) -> str:
    if kind in KEPT:
        return _kept(kind, pick, seeds, folder)
    if kind == "whole command":
        return _command(pick, seeds, folder)
    if kind in OTHERS:
        return _other(kind, pick, seeds, folder)
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


def _other(kind: str, pick: random.Random, seeds: dict[str, Path], folder: Path) -> str:
    """Datasets, stations and what is handed over."""
    path = folder / f"damaged.{kind.replace(' ', '_')}"
    other = seeds[pick.choice([*GRIBS, *TEXTS, *TABLES])].read_bytes()
    damaged_dataset(kind, seeds[kind], other, pick, path)
    if kind in DATASETS:
        return _refusable(lambda: _gridded(path, folder, pick))
    if kind == "error table":
        return _refusable(lambda: error_table(path))
    if kind in EXPORTED:
        return command(*exported(kind, path, seeds, folder, pick))
    end = command("postprocess", str(postprocessed(kind, path, seeds, folder)), "--quiet")
    product = folder / "out" / "postprocessed.nc"
    if end == "result":
        with xr.open_dataset(product, engine="netcdf4") as ds:
            winds = ds["forecast"][[str(n) != "air_temperature" for n in ds["variable"].values]]
            if kind != "station pairs" and not possible(winds, MAX_WIND):
                raise FoundError("absurd winds", f"{float(abs(winds).max())}")
    return end


def _gridded(path: Path, folder: Path, pick: random.Random) -> None:
    winds = collocated(path, _places(), folder, pick)
    _require_possible(winds["reference_eastward_wind"], winds["reference_northward_wind"])


def damaged(kind: str, pick: random.Random, seeds: dict[str, Path], folder: Path) -> Path:
    """A damaged copy of a sound file."""
    source, other = seeds[kind], seeds[pick.choice([*GRIBS, *TEXTS, *TABLES])]
    path = folder / f"damaged.{kind.replace(' ', '_').replace(',', '')}"
    path.write_bytes(mutated(kind, source.read_bytes(), other.read_bytes(), pick))
    return path


def _refusable(work: Callable[[], None]) -> str:
    """Run something that may refuse its input, in one message of one line."""
    try:
        work()
    except AirswingError as error:
        text = str(error)
        if len(text) > LONGEST or "\n" in text:
            raise FoundError("long message", f"{len(text)} characters") from None
        return "refused"
    return "result"


def _places() -> xr.Dataset:
    table = reports()
    return xr.Dataset(
        {
            "time": ("report", np.full(len(table), WHEN)),
            "latitude": ("report", table["latitude"]),
            "longitude": ("report", table["longitude"]),
            "pressure": ("report", table["pressure_hPa"] * 100.0),
        }
    )


def _grib(path: Path, folder: Path, pick: random.Random) -> None:
    from airswing.reference.inspection import inspect_grib

    with contextlib.suppress(AirswingError):
        inspect_grib(path)
    winds = _winds(path, folder / "cache", pick)
    _require_possible(*winds)


def _winds(path: Path, cache: Path, pick: random.Random | None = None) -> tuple[Any, Any]:
    """u and v at the reports, one way or another."""
    from airswing.reference.catalogue import build_catalogue
    from airswing.reference.collocate import collocate

    catalogue = build_catalogue(str(path), name="ref", cache_dir=cache)
    found = collocate(
        _places(),
        {"ref": catalogue},
        sparse=pick is None or pick.random() < 0.5,
        derivatives=pick is not None and pick.random() < 0.3,
    ).compute(scheduler="synchronous")
    return found["reference_eastward_wind"], found["reference_northward_wind"]


@functools.cache
def _sound_winds(path: Path) -> tuple[Any, Any]:
    with tempfile.TemporaryDirectory() as cache:
        return _winds(path, Path(cache))


def _compared(kind: str, pick: random.Random, seeds: dict[str, Path], folder: Path) -> None:
    """Damage of one octet or cell: all else has to be as it was."""
    from airswing.reports import read_reports

    data, path = seeds[kind].read_bytes(), folder / f"damaged.{kind.replace(' ', '_')}"
    if kind in GRIBS:
        changed, number = payload_changed(data, pick)
        path.write_bytes(changed)
        found, pressure = _winds(path, folder / "cache", pick), _places()["pressure"]
        _require_possible(*found)
        png = kind == "grib2 PNG"
        wrong = others_differ(found, _sound_winds(seeds[kind]), pressure, number, all_told=png)
    else:
        number, sound = -1, sound_reports(seeds["csv"])
        if kind == "csv":
            changed, number = cell_changed(data, pick)
        else:
            changed = mutated("gzip", data, b"", pick)
        path.write_bytes(changed)
        tail = None if number < 0 else str(sound.index[number])
        wrong = rows_differ(by_tail(read_reports(path)), sound, tail)
    if wrong:
        raise FoundError("silent", wrong)


def _require_possible(east: Any, north: Any) -> None:
    """Winds are missing, or ones an atmosphere has."""
    speed = np.hypot(np.asarray(east, np.float64), np.asarray(north, np.float64))
    absurd = ~(speed <= MAX_WIND) & ~np.isnan(speed)
    if absurd.any():
        raise FoundError("absurd winds", f"{int(absurd.sum())}, up to {np.nanmax(speed):.4g} m/s")


def _reports(path: Path) -> None:
    from airswing.reports import read_reports
    from airswing.workflow.inspection import inspect_file

    with contextlib.suppress(AirswingError):
        inspect_file(path)
    ds = read_reports(path)
    _require_possible(ds["eastward_wind"], ds["northward_wind"])
    if ds.sizes["report"] != int(ds["row_size"].sum()):
        raise FoundError("silent", "row sizes do not add up")


def _config(path: Path) -> None:
    from airswing.config_file import load_config

    load_config(path)


def _effects(path: Path) -> None:
    from airswing.gap.simulation.effects_file import plain_effects, read_effects

    plain_effects(read_effects(path))


def command(*words: str) -> str:
    """Run a command of the package in this process."""
    from airswing import cli

    before, sys.argv = sys.argv, ["airswing", *words]
    told = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(told):
            cli.main()
    except SystemExit as ended:
        if ended.code not in (0, None, 2):
            raise FoundError("traceback", f"exit status {ended.code}") from None
        _require_short(told.getvalue())
        return "refused" if ended.code else "result"
    finally:
        sys.argv = before
    return "result"


def _require_short(told: str) -> None:
    longest = max(map(len, told.splitlines()), default=0)
    if longest > LONGEST + 20:
        raise FoundError("long message", f"{longest} characters")


def _product(
    kind: str, path: Path, seeds: dict[str, Path], folder: Path, pick: random.Random
) -> str:
    output = folder / "out"
    output.mkdir()
    (output / "headings").mkdir()
    for name in PRODUCTS:
        target = "headings/2009-01.nc" if name == "headings.nc" else name
        shutil.copy(path if name == kind else seeds[name], output / target)
        if name == kind:
            damaged_file = output / target
    config = str(seeds["kept notes"] / "config.yaml")
    ends = [command("inspect", str(damaged_file))]
    stage = "fit" if kind == "headings.nc" and pick.random() < 0.3 else "correct"
    ends.append(command(stage, config, "--output", str(output), "--quiet"))
    _refusable(lambda: _known(output / "fits.nc"))
    return "refused" if "refused" in ends else "result"


def _known(path: Path) -> None:
    from airswing.gap.simulation.effects_file import read_known

    read_known(path, reference="ruc")


@functools.cache
def _truth(folder: Path) -> dict[str, Any]:
    """What undamaged kept work gives."""
    from airswing.products.netcdf import open_product

    with open_product(folder / "results" / "headings") as ds:
        return {str(name): ds[name].to_numpy() for name in ds.variables if name != "screening"}


def _kept(kind: str, pick: random.Random, seeds: dict[str, Path], folder: Path) -> str:
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


def _resumed(config: Path, truth: dict[str, Any]) -> None:
    from airswing.config_file import load_config
    from airswing.workflow import make_headings
    from airswing.workflow.job import Job
    from airswing.workflow.progress import Progress

    headings = make_headings(Job(load_config(config), Progress(quiet=True)))
    with headings:
        for name, values in truth.items():
            found = headings[name].to_numpy()
            same = found.shape == values.shape and (
                np.array_equal(found, values, equal_nan=values.dtype.kind == "f")
            )
            if not same:
                raise FoundError("silent", f"{name} differs")


def _header_cache(run: Path, pick: random.Random, folder: Path) -> str:
    from airswing.reference.catalogue import build_catalogue

    cache = folder / "cache"
    shutil.copytree(run / "cache", cache)
    victim = next(cache.glob("grib-headers*.sqlite"))
    victim.write_bytes(mutated("cache", victim.read_bytes(), b"SQLite format 3\0" * 9, pick))
    files = str(run / "ruc" / "*")

    def work() -> None:
        found = build_catalogue(files, name="ruc", cache_dir=cache)
        if _content(found) != _content_of(files, run / "cache"):
            raise FoundError("silent", "another catalogue from a damaged cache")

    return _refusable(work)


@functools.cache
def _content_of(files: str, cache: Path) -> bytes:
    from airswing.reference.catalogue import build_catalogue

    return _content(build_catalogue(files, name="ruc", cache_dir=cache))


def _content(catalogue: Catalogue) -> bytes:
    rows = catalogue.valid, catalogue.leads, catalogue.bounds, catalogue.u, catalogue.v
    return b"".join(one.tobytes() for one in rows)


def _command(pick: random.Random, seeds: dict[str, Path], folder: Path) -> str:
    """A whole command in a process of its own, on reports or model files that are damaged."""
    kind = pick.choice([*GRIBS, "csv", "netcdf3", "netcdf4", "parquet", "bufr", "yaml"])
    path = damaged(kind, pick, seeds, folder)
    sound = folder / "sound.csv"
    table = pd.read_csv(seeds["csv"])
    table.to_csv(sound, index=False)
    config = folder / "config.yaml"
    content: dict[str, Any] = {
        "reports": {"files": str(path if kind in (*TEXTS, *TABLES) else sound)},
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
        raise FoundError("signal", f"signal {-done.returncode}")
    if done.returncode not in (0, 2) or "Traceback" in done.stderr:
        raise FoundError("traceback", done.stderr[-300:])
    _require_short(done.stderr)
    for product in (folder / "out" / "headings").glob("*.nc"):
        with xr.open_dataset(product, engine="netcdf4") as ds:
            _require_possible(ds["reference_eastward_wind"], ds["reference_northward_wind"])
    return "refused" if done.returncode else "result"
