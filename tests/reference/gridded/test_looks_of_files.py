"""Look-alikes of the files people have: names, units, times, members and levels in their ways."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.errors import InputError
from tests.reference.gridded.datasets import (
    HOUR,
    LEVELS,
    START,
    by_hand,
    fields,
    latlon,
    points,
    projected,
    winds,
)

LAT, LON = np.arange(30.0, 50.1, 2.5), np.arange(-110.0, -79.9, 2.5)
WHERE = np.array([[33.3, 41.7, 48.9], [-100.1, -84.4, -107.7]])
PRESSURE = np.array([95000.0, 42000.0, 21000.0])


def base() -> xr.Dataset:
    return latlon(latitude=LAT, longitude=LON)


def expected(ds: xr.Dataset | None = None, hour: int = 0) -> tuple[np.ndarray, np.ndarray]:
    ds = base() if ds is None else ds
    fi = (WHERE[1] - LON[0]) / 2.5
    fj = (WHERE[0] - LAT[0]) / 2.5
    return by_hand(ds.u.values[hour], ds.v.values[hour], LEVELS * 100, fi, fj, PRESSURE)


def check(ds: xr.Dataset, *, hour: int = 0, atol: float = 1e-3, **options: object) -> xr.Dataset:
    """The Dataset gives the winds of the plain one."""
    model = airswing.build_catalogue(ds, name="m", **options)
    found = airswing.collocate(points(*WHERE, PRESSURE, after=float(hour)), {"m": model}).compute()
    np.testing.assert_allclose(winds(found), expected(hour=hour), atol=atol)
    return found


def cds_new(ds: xr.Dataset) -> xr.Dataset:
    """The Climate Data Store since 2024."""
    ds = ds.rename(time="valid_time", level="pressure_level")
    ds["pressure_level"] = ds.pressure_level.astype(float)
    ds = ds.isel(pressure_level=slice(None, None, -1)).isel(latitude=slice(None, None, -1))
    ds.pressure_level.attrs = {"units": "hPa", "positive": "down", "standard_name": "air_pressure"}
    ds.valid_time.attrs = {"standard_name": "time", "long_name": "time"}
    for name in "uv":
        ds[name].attrs |= {
            "GRIB_paramId": 131 + "uv".index(name),
            "GRIB_stepType": "instant",
            "GRIB_uvRelativeToGrid": 0,
            "GRIB_gridType": "regular_ll",
        }
    return ds.assign_coords(number=((), 0), expver=("valid_time", np.array(["0001", "0001"])))


def unlabelled(ds: xr.Dataset) -> xr.Dataset:
    """Names alone tell the winds and the places."""
    ds = ds.rename(u="UGRD", v="VGRD", latitude="lat", longitude="lon", level="lev")
    for name in ("UGRD", "VGRD"):
        ds[name].attrs = {"units": "m/s"}
    return ds


def ncep(ds: xr.Dataset) -> xr.Dataset:
    """NCEP reanalysis: millibars, north to south, levels from the ground up."""
    ds = ds.rename(u="uwnd", v="vwnd", latitude="lat", longitude="lon")
    ds = ds.isel(level=slice(None, None, -1), lat=slice(None, None, -1))
    ds.level.attrs = {"units": "millibar", "positive": "down", "axis": "Z", "GRIB_name": "hybl"}
    for name, long in (("uwnd", "4xDaily U-wind"), ("vwnd", "4xDaily V-wind")):
        ds[name].attrs = {"units": "m/s", "long_name": long, "statistic": "Individual Obs"}
    return ds.assign_coords(lon=np.mod(ds.lon, 360))


def merra(ds: xr.Dataset) -> xr.Dataset:
    ds = ds.rename(u="U", v="V", latitude="lat", longitude="lon", level="lev")
    ds.lev.attrs = {
        "units": "hPa",
        "long_name": "vertical level",
        "positive": "down",
        "coordinate": "PLE",
        "standard_name": "PLE_level",
    }
    for name in ("U", "V"):
        ds[name].attrs["standard_name"] = f"{'east' if name == 'U' else 'north'}ward_wind"
    return ds


def cmip(ds: xr.Dataset) -> xr.Dataset:
    ds = ds.rename(u="ua", v="va", latitude="lat", longitude="lon", level="plev")
    ds["plev"] = ("plev", LEVELS * 100.0, {"units": "Pa", "axis": "Z", "positive": "down"})
    for name in ("ua", "va"):
        ds[name].attrs["cell_methods"] = "time: point"
    return ds


def ncl(ds: xr.Dataset) -> xr.Dataset:
    """GRIB by NCL."""
    names = {"u": "UGRD_P0_L100_GLL0", "v": "VGRD_P0_L100_GLL0", "level": "lv_ISBL0"}
    ds = ds.rename(
        names | {"latitude": "lat_0", "longitude": "lon_0", "time": "initial_time0_hours"}
    )
    ds["lv_ISBL0"] = ("lv_ISBL0", LEVELS * 100.0, {"units": "Pa", "long_name": "Isobaric surface"})
    for name, words in (
        ("UGRD_P0_L100_GLL0", "U-component of wind"),
        ("VGRD_P0_L100_GLL0", "V-component of wind"),
    ):
        ds[name].attrs = {"units": "m s-1", "long_name": words}
    return ds


def knots(ds: xr.Dataset) -> xr.Dataset:
    attrs = {n: ds[n].attrs | {"units": "knots"} for n in "uv"}
    ds = ds.assign({n: ds[n] / np.float32(1852 / 3600) for n in "uv"})
    for n in "uv":
        ds[n].attrs = attrs[n]
    return ds


def grads(ds: xr.Dataset) -> xr.Dataset:
    """GrADS' server (NOMADS): units stand at the end of the long name."""
    ds = ds.rename(u="ugrdprs", v="vgrdprs", latitude="lat", longitude="lon", level="lev")
    for letter in "uv":
        words = f"** (1000 975 950 925 900..) {letter}-component of wind [m/s] "
        ds[f"{letter}grdprs"].attrs = {"long_name": words}
    ds.lev.attrs = {"units": "millibar", "grads_dim": "z", "long_name": "altitude"}
    return ds


def other_order(ds: xr.Dataset) -> xr.Dataset:
    return ds.transpose("longitude", "latitude", "level", "time")


def other_levels_too(ds: xr.Dataset) -> xr.Dataset:
    """Winds at 10 m, above the ground by pressure, and on potential vorticity."""
    wind = {"units": "m/s", "long_name": "u-component of wind @ other"}
    layer = {"units": "Pa", "long_name": "Level at specified pressure difference from ground"}
    dims = ("time", "latitude", "longitude")
    shape = tuple(ds.sizes[d] for d in dims)
    return ds.assign(
        u10=(dims, np.zeros(shape), {"units": "m/s", "long_name": "10 metre U wind component"}),
        v10=(dims, np.zeros(shape), {"units": "m/s", "long_name": "10 metre V wind component"}),
        u_layer=(("time", "layer", *dims[1:]), np.zeros((2, 2, *shape[1:])), wind),
    ).assign_coords(layer=("layer", [3000.0, 6000.0], layer))


@pytest.mark.parametrize(
    "look",
    [cds_new, unlabelled, ncep, merra, cmip, ncl, grads, knots, other_order, other_levels_too],
)
def test_files_as_they_come(look: Callable[[xr.Dataset], xr.Dataset]) -> None:
    found = check(look(base()))
    assert found["lead_time"].values[0] == pytest.approx(0.0)


def test_preliminary_and_final_data_beside_each_other() -> None:
    """ERA5 and ERA5T of the former store: each time is in one of them, NaN in the other."""
    ds = base()
    parts = [ds.where(ds.time == ds.time[n]) for n in range(2)]
    both = xr.concat(parts, dim=xr.Variable("expver", [1, 5])).transpose("time", "expver", ...)
    for name in "uv":
        both[name].attrs = ds[name].attrs
    check(both, hour=0)
    check(both, hour=1)


FORECASTS = {
    "cfgrib": lambda ds: ds.rename(time="step").assign_coords(
        step=("step", [0.0, 1.0], {"units": "hours", "standard_name": "forecast_period"}),
        time=((), START, {"standard_name": "forecast_reference_time"}),
        valid_time=("step", START + HOUR * np.arange(2), {"standard_name": "time"}),
    ),
    "weatherbench": lambda ds: (
        ds.rename(time="prediction_timedelta")
        .assign_coords(prediction_timedelta=HOUR * np.arange(2))
        .expand_dims(time=[START])
    ),
    "init and lead": lambda ds: (
        ds.rename(time="lead_time")
        .assign_coords(lead_time=("lead_time", HOUR * np.arange(2)))
        .expand_dims(init_time=[START])
    ),
    "CF": lambda ds: ds.assign_coords(
        forecast_reference_time=((), START, {"standard_name": "forecast_reference_time"})
    ),
}


@pytest.mark.parametrize("style", sorted(FORECASTS))
def test_runs_and_leads(style: str) -> None:
    ds = FORECASTS[style](base())
    found = check(ds, hour=1)
    np.testing.assert_allclose(found["lead_time"].values[0], 1.0)
    with pytest.raises(InputError, match="lead condition"):
        airswing.build_catalogue(ds, name="m", lead=">= 3 h")


def test_the_shortest_of_several_leads() -> None:
    early = base().assign(u=base().u + 50).expand_dims(reftime=[START - 6 * HOUR])
    late = base().expand_dims(reftime=[START])
    ds = xr.concat([early, late], "reftime")
    ds.time.attrs["standard_name"] = "time"
    ds.reftime.attrs["standard_name"] = "forecast_reference_time"
    check(ds)
    assert check(ds, hour=1)["lead_time"].values[0, 0] == 1.0


@pytest.mark.parametrize("name", ["number", "realization", "ensemble_member"])
def test_the_member_asked_for(name: str) -> None:
    ds = xr.concat([base().assign(u=base().u + 30 * n) for n in (1, 0, 2)], name)
    ds = ds.assign_coords({name: [4, 7, 9]}).transpose("time", name, ...)
    check(ds, member=7)
    model = airswing.build_catalogue(ds, name="m")
    assert set(model.members) == {4} and "several ensemble members" in " ".join(model.notes)
    with pytest.raises(InputError, match="no wind of ensemble member 5"):
        airswing.build_catalogue(ds, name="m", member=5)


def test_packed_integers_and_fill_values(tmp_path: Path) -> None:
    ds = base()
    ds["u"][0, :, 4, 5] = np.nan
    packing = {"dtype": "i2", "scale_factor": 0.004, "add_offset": 3.0, "_FillValue": -32767}
    ds.to_netcdf(tmp_path / "p.nc", encoding={n: packing for n in "uv"})
    path = str(tmp_path / "p.nc")
    model = airswing.build_catalogue(path, name="m")
    found = airswing.collocate(points(*WHERE, PRESSURE), {"m": model})
    np.testing.assert_allclose(winds(found), expected(), atol=2.1e-3)
    # Beside the missing point there is no wind; on a grid point next to it there is.
    at = points([LAT[4], LAT[4], LAT[4] + 1], [LON[5] + 1, LON[6], LON[5]], 50000.0)
    u, _ = winds(airswing.collocate(at, {"m": model}))
    np.testing.assert_array_equal(np.isfinite(u), [False, True, False])


def test_calendars_without_leap_years() -> None:
    import cftime

    ds = base()
    dates = [cftime.DatetimeNoLeap(2022, 11, 11, hour) for hour in (0, 1)]
    check(ds.assign_coords(time=("time", np.array(dates, dtype=object))))
    odd = [cftime.Datetime360Day(2022, 2, 30, hour) for hour in (0, 1)]
    with pytest.raises(InputError, match="360 days"):
        check(ds.assign_coords(time=("time", np.array(odd, dtype=object))))


HYBRID = np.linspace(0.02, 1.0, 9)


def hybrid(style: str) -> tuple[xr.Dataset, np.ndarray]:
    """Hybrid levels in several ways, and their pressures (level, y, x)."""
    rng = np.random.default_rng(8)
    u, v = fields((2, 9, LAT.size, LON.size))
    ps = rng.uniform(80000.0, 102000.0, (2, LAT.size, LON.size))
    a, b = 20000.0 * (1 - HYBRID) * HYBRID, HYBRID**1.5
    level = {"standard_name": "atmosphere_hybrid_sigma_pressure_coordinate", "positive": "down"}
    wind = {"units": "m s-1"}
    dims = ("time", "lev", "lat", "lon")
    ds = xr.Dataset(
        {
            "ua": (dims, u, wind | {"standard_name": "eastward_wind"}),
            "va": (dims, v, wind | {"standard_name": "northward_wind"}),
            "ps": (("time", "lat", "lon"), ps, {"units": "Pa"}),
        },
        coords={
            "time": START + HOUR * np.arange(2),
            "lev": ("lev", HYBRID * 1000.0, level),
            "lat": ("lat", LAT, {"units": "degrees_north"}),
            "lon": ("lon", LON, {"units": "degrees_east"}),
        },
    )
    pressure = a[:, None, None] + b[:, None, None] * ps[0]
    if style == "ap":
        ds["ap"] = ("lev", a / 100.0, {"units": "hPa"})
        ds["b"] = ("lev", b)
        ds.lev.attrs["formula_terms"] = "ap: ap b: b ps: ps"
    elif style == "p0":  # CESM writes hPa on numbers that are no pressures
        ds["hyam"], ds["hybm"] = ("lev", a / 1e5), ("lev", b)
        ds["P0"] = ((), 1e5, {"units": "Pa"})
        ds.lev.attrs |= {"formula_terms": "a: hyam b: hybm p0: P0 ps: ps", "units": "hPa"}
    elif style == "sigma":
        ds["ptop"] = ((), 50.0, {"units": "hPa"})
        formula = "sigma: lev ps: ps ptop: ptop"
        attrs = {"standard_name": "atmosphere_sigma_coordinate", "formula_terms": formula}
        ds = ds.assign_coords(lev=("lev", HYBRID, attrs))
        pressure = 5000.0 + HYBRID[:, None, None] * (ps[0] - 5000.0)
    else:  # a pressure on the same levels, numbered from the ground up
        ds["p"] = (dims, np.stack([pressure] * 2), {"units": "Pa", "standard_name": "air_pressure"})
        ds = ds.drop_vars("ps").isel(lev=slice(None, None, -1))
    return ds, pressure


@pytest.mark.parametrize("style", ["ap", "p0", "sigma", "field"])
def test_native_levels(style: str) -> None:
    ds, pressure = hybrid(style)
    found = winds(airswing.collocate(points(*WHERE, PRESSURE * 0.9), {"m": ds}))
    fi, fj = (WHERE[1] - LON[0]) / 2.5, (WHERE[0] - LAT[0]) / 2.5
    plain = hybrid("ap")[0]
    want = by_hand(plain.ua.values[0], plain.va.values[0], pressure, fi, fj, PRESSURE * 0.9)
    assert np.isfinite(want).all()
    np.testing.assert_allclose(found, want, atol=1e-3)


def test_names_in_the_configuration() -> None:
    ds = base().rename(u="speed_1", v="speed_2", level="l", latitude="a", longitude="o", time="t")
    for name in ("speed_1", "speed_2", "l", "a", "o"):
        ds[name].attrs = {}
    said = {
        "u": "speed_1",
        "v": "speed_2",
        "level": "l",
        "latitude": "a",
        "longitude": "o",
        "time": "t",
        "units": {"speed_1": "m/s", "speed_2": "m/s", "l": "hPa"},
    }
    check(ds, naming=said)


@pytest.mark.parametrize(
    ("standard", "flag", "said", "along"),
    [
        (("x_wind", "y_wind"), None, None, True),
        (("grid_eastward_wind", "grid_northward_wind"), None, None, True),
        (("eastward_wind", "northward_wind"), None, None, False),
        (("eastward_wind", "northward_wind"), 1, None, True),
        (("eastward_wind", "northward_wind"), 0, None, False),
        (("x_wind", "y_wind"), None, "earth", False),
        (("", ""), None, None, True),
        (("", ""), None, "earth", False),
    ],
)
def test_whether_winds_point_along_the_grid(
    standard: tuple[str, str], flag: int | None, said: str | None, along: bool
) -> None:
    ds = projected("lambert")
    for name, one in zip(("ua", "va"), standard, strict=True):
        ds[name].attrs["standard_name"] = one
        ds[name].attrs["long_name"] = "eastward wind" if name == "ua" else "northward wind"
        if flag is not None:
            ds[name].attrs["GRIB_uvRelativeToGrid"] = flag
    model = airswing.build_catalogue(ds, name="m", naming={"winds": said} if said else None)
    assert model.grids[0].wind_along_grid is along
    notes = " ".join(model.notes)
    assert ("along the grid" if along else "to true east") in notes
    assert ("not given" in notes) is (standard[0] == "" and said is None)
    found = airswing.collocate(points([40.0], [-97.0], 50000.0), {"m": model})
    assert notes in found.attrs["reference_notes"]
