"""What is done with damaged Datasets, lists, tables of stations, effects that are known."""

from __future__ import annotations

import contextlib
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from benchmarks.fuzz.dataset_seeds import DATASETS, STATIONS, STORES
from benchmarks.fuzz.lies import damage_store, lie_in_dataset
from benchmarks.fuzz.mutations import mutated
from benchmarks.fuzz.seeds import HANDED_OVER

from airswing.errors import AirswingError

EXPORTS = ("obs_domain", "little_r", "ob_ascii", "jedi", "reject_list")
EXPORTED = (*HANDED_OVER, "reject list")
OTHERS = (*DATASETS, *STATIONS, *EXPORTED, "error table")


def damaged_dataset(kind: str, source: Path, other: bytes, pick: random.Random, path: Path) -> None:
    """Make a damaged copy.

    Parameters
    ----------
    kind : str
        Of `OTHERS`.
    source : Path
    other : bytes
        Of another file, to splice with.
    pick : random.Random
    path : Path
        Of the copy.
    """
    if kind in STORES:
        shutil.copytree(source, path)
        damage_store(path, pick)
        return
    shutil.copy(source, path)
    netcdf = "NetCDF" in kind or kind in ("wrfout", "corrected.nc")
    if netcdf and pick.random() < 0.6:
        lie_in_dataset(path, pick)
        return
    family = "csv" if kind.startswith("station") else kind
    family = "grib" if "GRIB" in kind else family
    path.write_bytes(mutated(family, path.read_bytes(), other, pick))


def collocated(path: Path, places: xr.Dataset, folder: Path, pick: random.Random) -> xr.Dataset:
    """Winds of a damaged file or store at reports, as the command gets them."""
    from airswing.reference.catalogue import build_catalogue
    from airswing.reference.collocate import collocate
    from airswing.workflow.inspection import inspect_file

    with contextlib.suppress(AirswingError):
        inspect_file(path)
    catalogue = build_catalogue(str(path), name="ref", cache_dir=folder / "cache")
    return collocate(places, {"ref": catalogue}, derivatives=pick.random() < 0.3).compute(
        scheduler="synchronous"
    )


def postprocessed(kind: str, path: Path, seeds: dict[str, Path], folder: Path) -> Path:
    """Configuration of a correction of forecasts of which one input is damaged."""
    if kind == "station pairs":
        section: dict[str, Any] = {"pairs": {"files": str(path)}}
    else:
        given = {name: seeds[name] for name in STATIONS} | {kind: path}
        section = {
            "forecasts": {"files": str(given["station GRIB"])},
            "stations": {"files": str(given["station observations"])},
        }
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump({"postprocess": section, "output": str(folder / "out")}))
    return config


def exported(
    kind: str, path: Path, seeds: dict[str, Path], folder: Path, pick: random.Random
) -> tuple[str, ...]:
    """Words of a command that hands over winds of a run, of which one input is damaged."""
    run = seeds["kept notes"]
    output = folder / "results"
    output.mkdir()
    for product in (run / "results").glob("*.nc"):
        shutil.copy(path if product.name == kind else product, output / product.name)
    content = yaml.safe_load((run / "config.yaml").read_text()) | {"output": str(output)}
    config = folder / "config.yaml"
    config.write_text(yaml.safe_dump(content))
    to = "reject_list" if kind == "reject list" else pick.choice(EXPORTS)
    base = path if kind == "reject list" else seeds["reject list"]
    given = ("--base", str(base)) if to == "reject_list" else ()
    winds = ("--winds", pick.choice(("corrected", "reported", "reported")))
    target = ("-o", str(folder / "handed_over"))
    return ("export", str(config), "--to", to, *target, *winds, *given, "--quiet")


def error_table(path: Path) -> None:
    """Put measured errors into a damaged table of errors."""
    from airswing.handover.obs_errors import changed_table

    errors = {"UV": dict.fromkeys((1000, 700, 500, 300, 200, 100), 1.7)}
    changed_table(path.read_bytes().decode("latin-1"), errors, ["AIREPS"])


def possible(values: Any, most: float) -> bool:
    """Whether all values are missing or within a limit."""
    found = np.asarray(values, dtype=np.float64)
    return not (~(np.abs(found) <= most) & ~np.isnan(found)).any()
