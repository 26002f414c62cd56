"""Files of model winds: compressed, at URLs, of foreign kinds, on several grids, and of WRF."""

import bz2
import functools
import gzip
import http.server
import threading
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import airswing
from airswing.errors import InputError
from airswing.reference.catalogue import build_catalogue
from airswing.reference.files import Reader, identify
from tests.command import airswing as command
from tests.command import configured
from tests.reference.builders import GLOBE, LATLON, SIZE, build, profile, write
from tests.reference.gridded.datasets import by_hand, points, winds
from tests.reference.gridded.test_layouts import LAT, LON, P, base, check


def inside(model):
    """Reports within the grid of GRIB files."""
    return points(LAT, LON + 5.0, P, start=model.times[0])


def at_first_time(model, *, chunks=None):
    reports = inside(model) if chunks is None else inside(model).chunk(report=chunks)
    return np.array(winds(airswing.collocate(reports, {"x": model})))


@pytest.mark.parametrize("levels_far", [(300, 900), (200, 300, 500, 900)])
def test_of_two_grids_the_one_around_the_reports_is_used(levels_far, tmp_path):
    """Also if the other grid has more levels."""
    far = {**LATLON, "latitudeOfFirstGridPointInDegrees": -20.0}
    far |= {"latitudeOfLastGridPointInDegrees": -40.0}
    far = profile(levels_far, np.full(SIZE, 1.0), keys=far)
    near = profile((300, 900), np.full(SIZE, 7.0))
    for order in (far + near, near + far):
        model = build_catalogue(write(tmp_path / "x", *order), name="x", cache_dir=tmp_path / "c")
        assert any("grids" in note for note in model.notes)
        for chunks in (None, 1):
            np.testing.assert_allclose(at_first_time(model, chunks=chunks), 7.0)


@pytest.mark.parametrize(("surface", "edition"), [(150, 2), (102, 2), (103, 2), (104, 2), (109, 1)])
def test_levels_of_any_type_with_a_pressure(surface, edition, tmp_path):
    """The pressure varies along x; u is ln p in every column and so at every report."""
    messages = []
    columns = 1 + 0.01 * (np.arange(SIZE) % LATLON["Ni"])
    for number, pressure in enumerate((95000.0, 60000.0, 30000.0), 1):
        fields = {"u": np.log(pressure * columns), "v": columns, "p": pressure * columns}
        for parameter, values in fields.items():
            if edition == 2:
                category, code = {"u": (2, 2), "v": (2, 3), "p": (3, 0)}[parameter]
                extra = {"parameterCategory": category, "parameterNumber": code}
                extra |= {"typeOfFirstFixedSurface": surface, "scaleFactorOfFirstFixedSurface": 0}
                extra |= {"scaledValueOfFirstFixedSurface": number}
                messages.append(build(LATLON, values, bits=24, extra=extra))
            else:
                message = bytearray(build(LATLON, values, edition=1, bits=24))
                message[16] = {"u": 33, "v": 34, "p": 1}[parameter]
                message[17], message[18:20] = surface, number.to_bytes(2, "big")
                messages.append(bytes(message))
    model = build_catalogue(write(tmp_path / "x", *messages), name="x", cache_dir=tmp_path)
    u, v = at_first_time(model)
    np.testing.assert_allclose(u, np.log(P), atol=1e-4)
    assert np.isfinite(v).all()


@pytest.mark.parametrize("surface", ["lnsp", "sp"])
def test_ecmwf_model_levels(surface, tmp_path):
    """Pressure by the pv section, winds by hand."""
    rng = np.random.default_rng(21)
    count = 8
    half = np.linspace(0.0, 1.0, count + 1)
    a, b = 15000.0 * half * (1 - half), half**1.3
    pv = np.concatenate([a, b])
    u, v = rng.normal(10, 15, (2, count, 19, 36))
    ps = rng.uniform(85000.0, 102000.0, (19, 36))

    def message(values, pv=None, **keys):
        return build(GLOBE, values.ravel(), when=(20221111, 0), bits=24, extra=keys, pv=pv)

    messages = [
        message(field[k], pv, parameterNumber=number, typeOfFirstFixedSurface=105, level=k + 1)
        for k in range(count)
        for number, field in ((2, u), (3, v))
    ]
    keys = {"parameterCategory": 3, "parameterNumber": 0, "typeOfFirstFixedSurface": 1}
    if surface == "lnsp":
        keys |= {"parameterNumber": 25, "typeOfFirstFixedSurface": 105, "level": 1}
        messages.append(message(np.log(ps), pv, **keys))
    else:
        messages.append(message(ps, **keys))
    model = build_catalogue(write(tmp_path / "ml.grib2", *messages), name="ifs", cache_dir=tmp_path)
    assert "cfgrib" in model.notes[0] and "slower" in model.notes[0]
    lat, lon = rng.uniform(-85, 85, 120), rng.uniform(-180, 180, 120)
    p = rng.uniform(20000.0, 75000.0, 120)
    pressure = (a[1:] + a[:-1])[:, None, None] / 2 + (b[1:] + b[:-1])[:, None, None] / 2 * ps
    expected = by_hand(u, v, pressure, np.mod(lon, 360) / 10, (90 - lat) / 10, p)
    collocated = winds(airswing.collocate(points(lat, lon, p), {"ifs": model}))
    assert np.isfinite(expected[0]).all()
    np.testing.assert_allclose(collocated, expected, atol=1e-3)
    assert not list(tmp_path.glob("*.idx"))


def test_keys_for_grib_are_honoured_or_refused_by_name(tmp_path):
    path = write(tmp_path / "x", *profile([500]))
    for naming in ({"u": "U"}, {"units": {"u": "kt"}}, {"level": "lev"}, {"projection": "+proj=x"}):
        (key,) = naming
        with pytest.raises(InputError, match=rf"references\.x\.{key}: this key does not apply"):
            build_catalogue(path, name="x", naming=naming, cache_dir=tmp_path)
    with pytest.raises(InputError, match=r"references\.x\.winds: must be grid or earth"):
        build_catalogue(path, name="x", naming={"winds": "north"}, cache_dir=tmp_path)


@pytest.mark.parametrize("opener", [gzip.open, bz2.open])
@pytest.mark.parametrize("kind", ["grib", "netcdf"])
def test_compressed_files_are_read(opener, kind, tmp_path):
    source = tmp_path / "plain"
    if kind == "netcdf":
        base().to_netcdf(source)
    else:
        write(source, *profile((300, 900), np.arange(SIZE) / 10.0))
    packed = tmp_path / "packed.gz"
    with opener(packed, "wb") as file:
        file.write(source.read_bytes())
    expected, decompressed = (
        at_first_time(build_catalogue(str(path), name="x", cache_dir=tmp_path / "c"))
        for path in (source, packed)
    )
    assert np.isfinite(expected).all()
    np.testing.assert_array_equal(decompressed, expected)
    packed.write_bytes(packed.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"cannot be decompressed|cannot be read|cannot be opened"):
        build_catalogue(str(packed), name="x", cache_dir=tmp_path / "c", on_bad_file="fail")


def test_more_compressed_files_than_are_kept_are_read_by_threads(tmp_path):
    """One field a file, as weather services give them; copies are removed when others come."""
    for level in (200, 300, 500, 700, 850, 900):
        for parameter in "uv":
            message = build(LATLON, np.arange(SIZE) / 10.0, parameter=parameter, level=level)
            (tmp_path / f"{parameter}_{level}.grib2.bz2").write_bytes(bz2.compress(message))
    model = build_catalogue(str(tmp_path / "*.bz2"), name="x", cache_dir=tmp_path / "c")
    lazy = airswing.collocate(inside(model), {f"x{number}": model for number in range(6)})
    u = lazy.compute(scheduler="threads", num_workers=6)["reference_eastward_wind"]
    assert np.isfinite(u).all()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\n<html>not found</html>", "is a page of HTML"),
        (b'{"error": 404}', "is JSON"),
        (b"\x28\xb5\x2f\xfd0000", "compressed with zstandard"),
        (b"BUFR00000", "is BUFR"),
        (b"", "is empty"),
        (b"time,lat\n", "is text"),
        (b"\x80\x04\x95\x00", "no wind .*no whole GRIB message"),
    ],
)
def test_foreign_files_are_named(content, expected, tmp_path):
    path = tmp_path / "x.nc"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"{path}.*{expected}|{expected}.*{path}"):
        build_catalogue(str(path), name="x")
    base().to_netcdf(tmp_path / "good.nc")
    model = build_catalogue(str(tmp_path / "*.nc"), name="x")
    assert len(model) == 2 and [Path(entry["file"]).name for entry in model.skipped] == ["x.nc"]


def test_observations_are_no_model_winds(tmp_path):
    track = xr.Dataset({"u": ("obs", [1.0])}, attrs={"featureType": "trajectory"})
    track.to_netcdf(tmp_path / "track.nc")
    track.to_netcdf(tmp_path / "ioda.nc", group="ObsValue")
    for name, kind in (("track", "featureType trajectory"), ("ioda", "IODA")):
        with pytest.raises(InputError, match=rf"holds observations .{kind}.*under reports"):
            build_catalogue(str(tmp_path / f"{name}.nc"), name="x")


@pytest.mark.parametrize("order", ["ab", "ba"])
def test_of_two_files_with_other_values_neither_is_used(order, tmp_path):
    for name, change in zip(order, (0.0, 5.0), strict=True):
        ds = base()
        ds["u"] += change
        ds.to_netcdf(tmp_path / f"{name}.nc")
    with pytest.raises(InputError, match="given again with other values"):
        build_catalogue(str(tmp_path / "*.nc"), name="x")


def test_winds_in_a_group(tmp_path):
    ds = base()
    ds.to_netcdf(tmp_path / "x.nc", group="model/levels")
    with pytest.raises(InputError, match=r"in groups.*/model/levels.*group="):
        build_catalogue(str(tmp_path / "x.nc"), name="x")
    check(xr.open_dataset(tmp_path / "x.nc", group="model/levels"))


@pytest.mark.parametrize("dimension", ["ncells", "nCells", "cell", "ncol", "values"])
def test_unstructured_grids_are_named(dimension):
    ds = base().stack({dimension: ("latitude", "longitude")}).reset_index(dimension)
    with pytest.raises(InputError, match=r"unstructured grid.*cdo remapbil"):
        build_catalogue(ds, name="x")


def test_urls_are_read_through_fsspec(tmp_path):
    import fsspec

    base().to_netcdf(tmp_path / "x.nc")
    netcdf = (tmp_path / "x.nc").read_bytes()
    contents = {"x.nc": netcdf, "x.nc.gz": gzip.compress(netcdf), "page.nc": b"<html>log in</html>"}
    for name, content in contents.items():
        with fsspec.open(f"memory://models/{name}", "wb") as file:
            file.write(content)
    for name in ("x.nc", "x.nc.gz", "x.n*c"):
        check(f"memory://models/{name}")
    with pytest.raises(InputError, match=r"page\.nc: is a page of HTML"):
        build_catalogue("memory://models/page.nc", name="x")
    with pytest.raises(InputError, match=r"memory://models/absent\.nc: cannot be"):
        build_catalogue("memory://models/absent.nc", name="x", on_bad_file="fail")


def test_a_new_chunk_changes_the_identity_of_a_zarr_store(tmp_path):
    base().to_zarr(tmp_path / "store")
    before = identify(str(tmp_path / "store"))
    assert identify(str(tmp_path / "store")) == before
    (tmp_path / "store/u/extra").touch()
    assert identify(str(tmp_path / "store")) != before


def test_the_reason_why_a_file_does_not_open_is_kept(tmp_path):
    (tmp_path / "a").touch()
    reader, error = Reader(), InputError("no address", found="404")
    assert reader.open(identify(str(tmp_path / "a")), Mock(side_effect=error)) is None
    ((_, reason),) = reader.problems
    assert reason == "cannot be opened: no address (found: 404)"


@pytest.mark.parametrize("name", ["store.zarr", "store.zarr-v3", "store"])
def test_zarr_at_a_url(name):
    base().to_zarr(f"memory://{name}", mode="w")
    check(f"memory://{name}")


def test_files_of_a_web_server_need_no_optional_package(tmp_path):
    base().to_netcdf(tmp_path / "x.nc")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        check(f"{address}/x.nc")
        with pytest.raises(InputError, match=r"absent\.nc: cannot be opened.*404"):
            build_catalogue(f"{address}/absent.nc", name="x")
        server.shutdown()


def test_winds_alone_at_places_without_reported_winds(tmp_path):
    base().to_netcdf(tmp_path / "era5.nc")
    shown = command("inspect", tmp_path / "era5.nc")
    assert shown.returncode == 0 and "6 pressure levels, 200 to 1000 hPa" in shown.stdout
    columns = {"tail": list("ABC"), "time": "2022-11-11T00:20Z", "pressure_hPa": 400.0}
    table = pd.DataFrame(columns | {"latitude": LAT, "longitude": LON})
    table.to_csv(tmp_path / "reports.csv", index=False)
    reports, era5 = tmp_path / "reports.csv", {"era5": tmp_path / "era5.nc"}
    path = configured(tmp_path, reports, era5)
    assert "for model winds alone" in command("collocate", path).stderr
    unknown = {name: {"value": np.nan} for name in ("wind_direction_deg", "wind_speed_kt")}
    configured(tmp_path, {"files": str(reports), "columns": unknown}, era5)
    shown = command("collocate", path)
    assert shown.returncode == 0 and "only model winds at the reports" in shown.stderr
    ds = airswing.open_product(tmp_path / "out/headings")
    assert np.isfinite(ds["reference_eastward_wind"]).all() and np.isnan(ds["heading"]).all()


LOW = np.array([60000.0, 52000.0, 81000.0])


def wrf_winds(ds, folder):
    path = folder / f"{len(list(folder.iterdir()))}.nc"  # the one before is still open
    ds.to_netcdf(path)
    model = build_catalogue(str(path), name="wrf")
    names = ("XLAT", "XLONG") if "XLAT" in ds else ("XLAT_M", "XLONG_M")
    lat, lon = (ds[n].values[0, [20, 25, 28], [18, 24, 30]] + 0.02 for n in names)
    reports = points(lat, lon, LOW, start=model.times[0])
    return np.array(winds(airswing.collocate(reports, {"wrf": model})))


def test_files_of_wrf_in_several_layouts(real, tmp_path):
    native = xr.open_dataset(
        real("models/wrfpython_ci_test_file.nc"), decode_times=False, engine="netcdf4"
    ).isel(Time=[0])
    native = native[["Times", "XTIME", "U", "V", "P", "PB", "XLAT", "XLONG"]].load()
    for name in native.variables:
        native[name].encoding = {}
    expected = wrf_winds(native, tmp_path)
    assert np.isfinite(expected).all()
    start = str(native.attrs["START_DATE"]).replace("_", " ")
    minutes = native.drop_vars("Times")
    minutes["XTIME"].attrs["units"] = f"minutes since {start}"
    np.testing.assert_array_equal(wrf_winds(minutes, tmp_path), expected)
    np.testing.assert_array_equal(wrf_winds(minutes.rename(XTIME="time"), tmp_path), expected)
    for naming in ({"units": {"U": "kt"}}, {"level": "bottom_top"}):
        with pytest.raises(InputError, match="does not apply to files of WRF"):
            build_catalogue(native, name="wrf", naming=naming)
    # met_em: unequal names, a full pressure, the ground as the first level
    pressure = (native.P + native.PB).rename("PRES")
    met = native.rename(U="UU", V="VV", XLAT="XLAT_M", XLONG="XLONG_M").drop_vars(["P", "PB"])
    met = xr.concat(
        [met.assign(PRES=pressure).isel(bottom_top=[k]) for k in [5, *range(14)]],
        "bottom_top",
        data_vars="minimal",
    ).rename(bottom_top="num_metgrid_levels")
    np.testing.assert_allclose(wrf_winds(met, tmp_path), expected, atol=1e-5)
    # winds on pressure levels at mass points, linear in ln p
    levels = np.array([20000.0, 50000.0, 90000.0], dtype="f4")
    shape = (1, 3, native.sizes["south_north"], native.sizes["west_east"])
    dims = ("Time", "num_press_levels_stag", "south_north", "west_east")
    field = np.broadcast_to(np.log(levels)[None, :, None, None], shape)
    pld = native.drop_vars(["U", "V", "P", "PB"])
    pld["U_PL"], pld["V_PL"] = (dims, field.copy()), (dims, -field)
    pld["P_PL"] = (dims[:2], levels[None])
    np.testing.assert_allclose(wrf_winds(pld, tmp_path), [np.log(LOW), -np.log(LOW)], atol=1e-4)
