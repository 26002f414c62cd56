"""Datasets that cannot be used, and files that are damaged: a result, a count, or one message."""

import netCDF4
import numpy as np
import pytest
from benchmarks.fuzz.seeds import make_dataset_seeds

import airswing
from airswing.errors import LONGEST, InputError
from tests.reference.builders import LATLON, build, write
from tests.reference.gridded.datasets import latlon, points, projected, winds


def base():
    return latlon(latitude=np.arange(30.0, 50.1, 2.5), longitude=np.arange(-110.0, -79.9, 2.5))


def changed(ds, name, **attrs):
    ds[name].attrs = attrs
    return ds


def with_levels(values, **attrs):
    return base().assign_coords(level=("level", values, attrs))


HYBRID = "atmosphere_hybrid_sigma_pressure_coordinate"
SPEED = {"standard_name": "wind_speed", "units": "m s-1"}
TRUE = {"units": "m/s", "grid_mapping": "crs", "standard_name": "northward_wind"}
CASES = {
    "no winds": (base().drop_vars("v").rename(u="t").assign(t=0 * base().u), "no wind"),
    "u alone": (base().drop_vars("v"), "no wind"),
    "speed only": (
        changed(base().rename(u="ws").drop_vars("v"), "ws", **SPEED),
        "no wind.*no u or v at all",
    ),
    "no levels": (base().isel(level=0, drop=True), "no wind"),
    "no time": (base().isel(time=0, drop=True), "no time axis"),
    "no units": (changed(base(), "u", standard_name="eastward_wind"), "u: units missing"),
    "heights": (with_levels(np.arange(6.0), units="m", standard_name="height"), "no wind"),
    "hybrid without pressure": (with_levels(np.arange(1.0, 7.0), standard_name=HYBRID), "no wind"),
    "no projection": (projected("lambert").drop_vars("crs"), "projection that is not given"),
    "unknown projection": (
        changed(projected("lambert"), "crs", grid_mapping_name="my_projection"),
        "projection not known.*my_projection",
    ),
    "mixed": (changed(projected("lambert"), "va", **TRUE), "one component points along the grid"),
    "two of one kind": (base().assign(u2=base().u), "two candidates for u"),
    "two level axes": (
        base().rename(level="tier").expand_dims(layer=[1.0, 2.0]).drop_vars("tier"),
        r"several dimensions may hold the levels.*level: NAME",
    ),
}


@pytest.mark.parametrize("case", sorted(CASES))
def test_unusable_datasets_are_refused_with_one_message(case, tmp_path):
    ds, words = CASES[case]
    ds.to_netcdf(tmp_path / "bad.nc")
    for source in (str(tmp_path / "bad.nc"), ds):
        with pytest.raises(InputError, match=words) as caught:
            airswing.build_catalogue(source, name="bad")
        message = str(caught.value)
        assert len(message) < 2000 and "Traceback" not in message
        if isinstance(source, str):
            assert "bad.nc" in message or "references.bad" in message


def test_files_and_engines_that_cannot_be_used_together(tmp_path):
    base().to_netcdf(tmp_path / "a.nc")
    write(tmp_path / "b.grib", build(LATLON, parameter="u"), build(LATLON, parameter="v"))
    with pytest.raises(InputError, match=r"several kinds.*b\.grib.*a\.nc"):
        airswing.build_catalogue(str(tmp_path / "*"), name="m")
    with pytest.raises(InputError, match="no such engine"):
        airswing.build_catalogue("x", name="m", engine="magic")
    with pytest.raises(InputError, match="no file found"):
        airswing.build_catalogue("nowhere/*.nc", name="m")


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    return make_dataset_seeds(tmp_path_factory.mktemp("seeds"))


def catalogue_and_u(path, cache):
    """Catalogue of a file, and u at 40 places on two levels."""
    rng, when = np.random.default_rng(1), np.datetime64("2009-09-16T09:00")
    places = rng.uniform(40.0, 45.0, 40), rng.uniform(-90.0, -85.0, 40)
    reports = points(*places, np.repeat([60_000.0, 70_000.0], 20), start=when)
    model = airswing.build_catalogue(str(path), name="m", cache_dir=cache)
    return model, winds(airswing.collocate(reports, {"m": model}))[0]


def test_a_section_that_ends_eccodes_costs_its_message(seeds, tmp_path):
    _, sound = catalogue_and_u(seeds["GRIB2 Gaussian"], tmp_path)
    bodies = seeds["GRIB2 Gaussian"].read_bytes().split(b"GRIB")[1:]
    bodies = [b"GRIB" + body for body in bodies]
    deadly = bytearray(bodies[4])
    deadly[75] = 1  # byte 39 of section 3, the basic angle: ecCodes ends the process
    path = tmp_path / "gaussian.grib"
    path.write_bytes(b"".join([*bodies[:4], deadly, bodies[5]]))
    model, u = catalogue_and_u(path, tmp_path)
    assert np.isfinite(sound).all()
    np.testing.assert_array_equal(u, np.where(np.arange(40) < 20, sound, np.nan))
    assert [entry["count"] for entry in model.skipped if entry["what"] == "grid"] == [1]


DAMAGES = [
    ("gridded NetCDF-4", lambda file: file["latitude"].setncattr("standard_name", 7)),
    ("gridded NetCDF-4", lambda file: file["level"].setncattr("units", np.arange(3.0))),
    ("gridded NetCDF-4", lambda file: file["longitude"].setncattr("axis", 1e30)),
    ("gridded NetCDF-3", lambda file: file["time"].setncattr("units", "days since 0-0-0")),
    ("wrfout", lambda file: file.setncattr("MAP_PROJ", "round")),
    ("wrfout", lambda file: file["XLAT"].__setitem__((0, 4, 5), np.nan)),
]


@pytest.mark.parametrize(("kind", "damage"), DAMAGES)
def test_wrong_attributes_give_a_result_or_one_message(kind, damage, seeds, tmp_path):
    path = tmp_path / "damaged.nc"
    path.write_bytes(seeds[kind].read_bytes())
    with netCDF4.Dataset(path, "a") as file:
        damage(file)
    try:
        _, u = catalogue_and_u(path, tmp_path)
    except InputError as error:
        assert str(path) in str(error) and len(str(error)) < LONGEST
    else:
        assert np.isfinite(u).any() and np.nanmax(np.abs(u)) < 40.0
    if damage is DAMAGES[-1][1]:  # among several files it is named and left out
        (tmp_path / "sound.nc").write_bytes(seeds[kind].read_bytes())
        model, u = catalogue_and_u(tmp_path / "*.nc", tmp_path)
        (skipped,) = [entry for entry in model.skipped if "damaged.nc" in entry["file"]]
        assert "cannot be understood" in skipped["reason"] and np.isfinite(u).any()
