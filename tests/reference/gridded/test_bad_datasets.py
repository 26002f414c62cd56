"""Datasets that cannot be used: one message that names the file, the field and what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.errors import InputError
from tests.reference.gridded.datasets import latlon, projected

LAT, LON = np.arange(30.0, 50.1, 2.5), np.arange(-110.0, -79.9, 2.5)


def base() -> xr.Dataset:
    return latlon(latitude=LAT, longitude=LON)


def without_units(ds: xr.Dataset, name: str) -> xr.Dataset:
    ds[name].attrs.pop("units")
    return ds


def speed_only(ds: xr.Dataset) -> xr.Dataset:
    ds = ds.rename(u="ws").drop_vars("v")
    ds.ws.attrs = {"standard_name": "wind_speed", "units": "m s-1"}
    return ds


def heights(ds: xr.Dataset) -> xr.Dataset:
    ds["level"] = ("level", np.arange(6.0) * 100, {"units": "m", "standard_name": "height"})
    return ds


def no_mapping() -> xr.Dataset:
    ds = projected("lambert").drop_vars("crs")
    return ds


def odd_mapping() -> xr.Dataset:
    ds = projected("lambert")
    ds["crs"].attrs = {"grid_mapping_name": "my_own_projection"}
    return ds


def mixed() -> xr.Dataset:
    ds = projected("lambert")
    ds.va.attrs["standard_name"] = "northward_wind"
    return ds


def two_winds(ds: xr.Dataset) -> xr.Dataset:
    return ds.assign(u2=ds.u.copy())


def hybrid_without_pressure(ds: xr.Dataset) -> xr.Dataset:
    ds["level"] = (
        "level",
        np.arange(1.0, 7.0),
        {"standard_name": "atmosphere_hybrid_sigma_pressure_coordinate"},
    )
    return ds


CASES: dict[str, tuple[Callable[[], xr.Dataset], str]] = {
    "no winds": (
        lambda: base().drop_vars(["u", "v"]).assign(t=base().u.rename("t") * 0),
        "no wind",
    ),
    "u alone": (lambda: base().drop_vars("v"), "no wind"),
    "speed only": (lambda: speed_only(base()), "wind speed without components"),
    "no levels": (lambda: base().isel(level=0, drop=True), "no wind"),
    "no time": (lambda: base().isel(time=0, drop=True), "no time axis"),
    "units of u missing": (lambda: without_units(base(), "u"), "u: units missing"),
    "heights": (lambda: heights(base()), "no wind"),
    "no projection": (no_mapping, "projection that is not given"),
    "unknown projection": (odd_mapping, "projection not known.*my_own_projection"),
    "one along, one true": (mixed, "one component points along the grid"),
    "two of one kind": (lambda: two_winds(base()), "two candidates for u"),
    "two level axes": (
        lambda: base().rename(level="tier").expand_dims(layer=[1.0, 2.0]).drop_vars("tier"),
        r"several dimensions may hold the levels.*level: NAME",
    ),
    "hybrid without pressure": (lambda: hybrid_without_pressure(base()), "no wind"),
}


@pytest.mark.parametrize("case", sorted(CASES))
def test_one_clear_message(case: str, tmp_path: Path) -> None:
    make, words = CASES[case]
    path = tmp_path / "bad.nc"
    make().to_netcdf(path)
    for given in (str(path), make()):
        with pytest.raises(InputError, match=words) as caught:
            airswing.build_catalogue(given, name="bad")
        message = str(caught.value)
        assert len(message) < 2000 and "Traceback" not in message
        if isinstance(given, str):
            assert "bad.nc" in message or "references.bad" in message


def test_damaged_files_are_named_and_skipped(tmp_path: Path) -> None:
    base().to_netcdf(tmp_path / "good.nc")
    whole = (tmp_path / "good.nc").read_bytes()
    (tmp_path / "short.nc").write_bytes(whole[: len(whole) // 3])
    (tmp_path / "empty.nc").write_bytes(b"")
    found = airswing.build_catalogue(str(tmp_path / "*.nc"), name="m")
    assert sorted(Path(one["file"]).name for one in found.skipped) == ["empty.nc", "short.nc"]
    with pytest.raises(InputError, match="is empty"):
        airswing.build_catalogue(str(tmp_path / "*.nc"), name="m", on_bad_file="fail")
    with pytest.raises(InputError, match=r"short\.nc"):
        airswing.build_catalogue(str(tmp_path / "short.nc"), name="m")


def test_files_of_several_kinds(tmp_path: Path) -> None:
    from tests.reference.builders import LATLON, build, write

    base().to_netcdf(tmp_path / "a.nc")
    write(tmp_path / "b.grib", build(LATLON, parameter="u"), build(LATLON, parameter="v"))
    with pytest.raises(InputError, match=r"several kinds.*b\.grib.*a\.nc"):
        airswing.build_catalogue(str(tmp_path / "*"), name="m")


def test_names_that_are_not_there() -> None:
    for key in ("level", "latitude", "time"):
        with pytest.raises(InputError, match=f"{key}|y"):
            airswing.build_catalogue(base(), name="m", naming={key: "nothing"})
    with pytest.raises(InputError, match="no such engine"):
        airswing.build_catalogue("x", name="m", engine="magic")
    with pytest.raises(InputError, match="no file found"):
        airswing.build_catalogue("nowhere/*.nc", name="m")
