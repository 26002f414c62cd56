"""Lies that no octet tells: attributes and coordinates of Datasets, files of Zarr stores, lists."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.fuzz.mutations import mutated

NAMED = ("units", "standard_name", "_FillValue", "scale_factor", "add_offset", "calendar", "axis")
GIVEN: tuple[Any, ...] = (
    "",
    "hPa",
    "days since 0000-00-00",
    "hours since 9999-12-31",
    "furlongs per fortnight",
    "eastward_wind",
    "latitude",
    0,
    -1,
    1e30,
    -1e-30,
    float("nan"),
    float("inf"),
    np.zeros(3),
    "x" * 5000,
    "\u202e<script>alert(1)</script>",
)

_REFUSED = (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError)
_REFUSED += (TypeError, ValueError)


def lie_in_dataset(path: Path, pick: random.Random) -> None:
    """Change an attribute, a coordinate or values of a NetCDF file through the library.

    Parameters
    ----------
    path : Path
        Changed in place.
    pick : random.Random
    """
    import netCDF4

    with netCDF4.Dataset(path, "a") as file:
        file.set_auto_maskandscale(False)
        for _ in range(pick.choice((1, 1, 2, 3))):
            name = pick.choice(sorted(file.variables))
            _lie(file, file.variables[name], pick)


def _lie(file: Any, variable: Any, pick: random.Random) -> None:
    """One lie; what the library refuses to write is left."""
    ways: list[Callable[[], object]] = [
        lambda: variable.setncattr(pick.choice(NAMED[:2] + NAMED[3:]), pick.choice(GIVEN)),
        lambda: variable.setncattr(pick.choice(NAMED[:2] + NAMED[3:]), pick.choice(GIVEN)),
        lambda: variable.delncattr(pick.choice(variable.ncattrs())),
        lambda: file.setncattr(pick.choice(file.ncattrs()), pick.choice(GIVEN)),
        lambda: file.renameVariable(variable.name, pick.choice(("u", "v", "time", "q", "XLAT"))),
        lambda: _values(variable, pick),
        lambda: _values(variable, pick),
        lambda: _values(variable, pick),
    ]
    try:
        pick.choice(ways)()
    except _REFUSED:
        return


def _values(variable: Any, pick: random.Random) -> None:
    """Values that are not finite, huge, all the same, backwards, or one of them wrong."""
    values = np.array(variable[...])
    if not values.size:
        return
    flat = values.reshape(-1)
    odd = pick.choice((float("nan"), float("inf"), 1e30, -9999.0, 0.0, -1.0, 1e9))
    with np.errstate(all="ignore"):
        text = flat.dtype.kind == "S"
        wrong = b"?" if text else np.asarray(odd).astype(flat.dtype, casting="unsafe")
        match pick.randrange(4):
            case 0:
                flat[:] = wrong
            case 1:
                flat[pick.randrange(flat.size)] = wrong
            case 2:
                flat[:] = flat[::-1].copy()
            case _:
                flat[pick.randrange(flat.size)] = flat[0]
    variable[...] = flat.reshape(values.shape)


def damage_store(store: Path, pick: random.Random) -> None:
    """Damage a Zarr store: a file of it gone, changed, in another's place, or its metadata lying.

    Parameters
    ----------
    store : Path
        Changed in place.
    pick : random.Random
    """
    for _ in range(pick.choice((1, 1, 2, 3))):
        files = sorted(path for path in store.rglob("*") if path.is_file())
        if not files:
            return
        marks = [path for path in files if path.name.startswith((".z", "zarr.json"))]
        victim = pick.choice(marks if marks and pick.random() < 0.6 else files)
        match pick.randrange(6):
            case 0:
                victim.unlink()
            case 1:
                victim.write_bytes(pick.choice(files).read_bytes())
            case 2:
                victim.unlink()
                victim.mkdir()
            case _ if victim in marks:
                victim.write_bytes(mutated("json", victim.read_bytes(), b"{}", pick))
            case _:
                victim.write_bytes(mutated("chunk", victim.read_bytes(), b"\0" * 99, pick))
