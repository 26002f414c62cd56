"""Layouts of Datasets in use: each gives the winds of the same Dataset in its plain form."""

from functools import partial

import cftime
import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.errors import InputError
from tests.reference.gridded.datasets import HOUR, START, latlon, points, projected, winds

LAT, LON = np.array([45.3, 50.1, 55.7]), np.array([3.3, 8.8, 12.1])
P = np.array([33000.0, 52000.0, 81000.0])
LNP = np.log(P / 100)
EXPECTED = np.array([LON - 0.5 * LAT + 3 * LNP, -LON + 0.25 * LAT - 2 * LNP])
PER_HOUR = 7.0  # m/s, change of u and v
NORTH = {"units": "degrees_north"}


def base():
    """Winds that are linear in place and time, so that points and order do not matter."""
    ds = latlon(latitude=np.arange(40.0, 61.0), longitude=np.arange(0.0, 21.0))
    x, y, z = ds.longitude, ds.latitude, np.log(ds.level)
    hour = PER_HOUR * xr.DataArray([0.0, 1.0], dims="time")
    u, v = x - 0.5 * y + 3 * z + hour, -x + 0.25 * y - 2 * z + hour
    for name, values in (("u", u), ("v", v)):
        ds[name] = values.transpose(*ds[name].dims).astype("f4").assign_attrs(ds[name].attrs)
    return ds


def collocated(ds, after=0.0, **options):
    model = airswing.build_catalogue(ds, name="m", **options)
    return airswing.collocate(points(LAT, LON, P, after=after), {"m": model}).compute()


def check(ds, after=0.0, **options):
    """The Dataset gives the winds of the plain one."""
    collocated_winds = collocated(ds, after, **options)
    np.testing.assert_allclose(winds(collocated_winds), EXPECTED + PER_HOUR * after, atol=2e-3)
    return collocated_winds


def shifted(x=0.0, y=0.0, *, flip=False):
    """v on points shifted by part of a grid length, under coordinates of other names."""
    ds = base()
    at = {"longitude": ds.longitude.values + x, "latitude": ds.latitude.values + y}
    v = ds.v.interp(at, kwargs={"fill_value": "extrapolate"})
    v = v.isel(latitude=slice(None, None, -1)) if flip else v
    v = v.rename(longitude="longitude_v", latitude="latitude_v")
    v["longitude_v"].attrs, v["latitude_v"].attrs = {"units": "degrees_east"}, NORTH
    return ds.drop_vars("v").assign(v=v.assign_attrs(ds.v.attrs))


def levels(scale=1.0, **attrs):
    ds = base()
    return ds.assign_coords(level=("level", ds.level.values * scale, attrs))


def times(values, **attrs):
    return base().isel(time=[0]).assign_coords(time=("time", np.array(values), attrs))


def radians():
    ds = base()
    for name in ("latitude", "longitude"):
        attrs = {"units": "radian", "standard_name": name}
        ds = ds.assign_coords({name: (name, np.radians(ds[name].values), attrs)})
    return ds


def filled():
    """-999 in the rows to the south of all reports; between them and the fill there is no wind."""
    ds = base()
    ds["u"][:, :, :5, :] = -999.0
    return ds


def two_experiments():
    """ERA5 and ERA5T of the former store: each time is in one of them, NaN in the other."""
    ds = base()
    parts = [ds.where(ds.time == ds.time[n]) for n in range(2)]
    joined = xr.concat(parts, dim=xr.Variable("expver", [1, 5])).transpose("time", "expver", ...)
    for name in "uv":
        joined[name].attrs = ds[name].attrs
    return joined


def native(style):
    """Native levels in several ways; winds are linear in ln p in every column."""
    eta = np.linspace(0.02, 1.0, 9)
    a, b = 20000.0 * (1 - eta) * eta, eta**1.5
    isobaric = base()
    ps = 1e5 - 500.0 * (isobaric.latitude - 40.0) - 300.0 * isobaric.longitude
    standard = {"standard_name": "atmosphere_hybrid_sigma_pressure_coordinate", "positive": "down"}
    lev = xr.DataArray(eta, dims="lev")
    pressure = a.reshape(-1, 1, 1) + b.reshape(-1, 1, 1) * ps.expand_dims(lev=9)
    if style == "sigma":
        pressure = 5000.0 + lev * (ps - 5000.0)
    z = np.log(pressure / 100.0)
    u = isobaric.longitude - 0.5 * isobaric.latitude + 3 * z
    v = -isobaric.longitude + 0.25 * isobaric.latitude - 2 * z
    dims = ("time", "lev", "latitude", "longitude")
    two = xr.DataArray([1.0, 1.0], dims="time")
    ds = xr.Dataset(
        {
            "ua": (two * u).transpose(*dims).assign_attrs(isobaric.u.attrs),
            "va": (two * v).transpose(*dims).assign_attrs(isobaric.v.attrs),
            "ps": (two * ps).transpose(*dims[:1], *dims[2:]).assign_attrs(units="Pa"),
        },
        coords={**isobaric.drop_vars("level").coords, "lev": ("lev", eta * 1000.0, standard)},
    )
    if style == "ap":
        ds["ap"], ds["b"] = ("lev", a / 100.0, {"units": "hPa"}), ("lev", b)
        ds.lev.attrs["formula_terms"] = "ap: ap b: b ps: ps"
    elif style == "p0":  # CESM writes hPa on numbers that are no pressures
        ds["hyam"], ds["hybm"] = ("lev", a / 1e5), ("lev", b)
        ds["P0"] = ((), 1e5, {"units": "Pa"})
        ds.lev.attrs |= {"formula_terms": "a: hyam b: hybm p0: P0 ps: ps", "units": "hPa"}
    elif style == "sigma":
        ds["ptop"] = ((), 50.0, {"units": "hPa"})
        formula = "sigma: lev ps: ps ptop: ptop"
        attrs = {"standard_name": "atmosphere_sigma_coordinate", "formula_terms": formula}
        ds = ds.assign_coords(lev=("lev", eta, attrs))
    else:  # a pressure on the same levels, numbered from the ground up
        ds["p"] = (two * pressure).transpose(*dims)
        ds["p"].attrs = {"units": "Pa", "standard_name": "air_pressure"}
        ds = ds.drop_vars("ps").isel(lev=slice(None, None, -1))
    return ds


def cds_new():
    """The Climate Data Store since 2024."""
    ds = base().rename(time="valid_time", level="pressure_level")
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


def renamed(attrs, level="lev", *, north_up=True, pascals=False, **names):
    """The Dataset under other names, with attributes replaced by new name."""
    ds = base().rename({"latitude": "lat", "longitude": "lon", "level": level} | names)
    ds = ds if north_up else ds.isel({level: slice(None, None, -1), "lat": slice(None, None, -1)})
    ds = ds.assign_coords({level: 100.0 * ds[level]}) if pascals else ds
    for name, new in attrs.items():
        ds[name].attrs = dict(new)
    return ds


def attrs_of(u, v, attrs, *words):
    """Attributes of u and v; the words of each are its long or standard name."""
    key = "standard_name" if words and words[0].endswith("ward_wind") else "long_name"
    named = [{key: text} for text in words] or [{}, {}]
    return {name: attrs | text for name, text in zip((u, v), named, strict=True)}


def ncep():
    """NCEP reanalysis: millibars, north to south, levels from the ground up."""
    wind = {"units": "m/s", "statistic": "Individual Obs"}
    attrs = attrs_of("uwnd", "vwnd", wind, "4xDaily U-wind", "4xDaily V-wind")
    attrs["lev"] = {"units": "millibar", "positive": "down", "axis": "Z", "GRIB_name": "hybl"}
    ds = renamed(attrs, north_up=False, u="uwnd", v="vwnd")
    return ds.assign_coords(lon=np.mod(ds.lon, 360))


def merra():
    attrs = attrs_of("U", "V", {"units": "m s-1"}, "eastward_wind", "northward_wind")
    attrs["lev"] = {"units": "hPa", "long_name": "vertical level", "standard_name": "PLE_level"}
    return renamed(attrs, u="U", v="V")


def cmip():
    attrs = {name: base()[name[0]].attrs | {"cell_methods": "time: point"} for name in ("ua", "va")}
    attrs["plev"] = {"units": "Pa", "axis": "Z", "positive": "down"}
    return renamed(attrs, "plev", pascals=True, u="ua", v="va")


def ncl():
    """GRIB by NCL."""
    u, v = "UGRD_P0_L100_GLL0", "VGRD_P0_L100_GLL0"
    attrs = attrs_of(u, v, {"units": "m s-1"}, "U-component of wind", "V-component of wind")
    attrs["lv_ISBL0"] = {"units": "Pa", "long_name": "Isobaric surface"}
    return renamed(attrs, "lv_ISBL0", pascals=True, u=u, v=v, time="initial_time0_hours")


def grads():
    """GrADS' server (NOMADS): units are at the end of the long name."""
    words = (f"** (1000 975 950 925 900..) {c}-component of wind [m/s] " for c in "uv")
    attrs = attrs_of("ugrdprs", "vgrdprs", {}, *words)
    attrs["lev"] = {"units": "millibar", "grads_dim": "z", "long_name": "altitude"}
    return renamed(attrs, u="ugrdprs", v="vgrdprs")


def knots():
    ds = base()
    for name in "uv":
        ds[name] = (ds[name] / (1852 / 3600)).assign_attrs(ds[name].attrs | {"units": "knots"})
    return ds


def other_levels_too():
    """Winds at 10 m, above the ground by pressure, and on potential vorticity."""
    ds = base()
    calm = 0.0 * ds.u.isel(level=0, drop=True)
    layer = {"units": "Pa", "long_name": "Level at specified pressure difference from ground"}
    ds["layer"] = ("layer", [3000.0, 6000.0], layer)
    for name, values, words in (
        ("u10", calm, "10 metre U wind component"),
        ("v10", calm, "10 metre V wind component"),
        ("u_layer", calm.expand_dims(layer=ds.layer, axis=1), "u-component of wind @ other"),
    ):
        ds[name] = values.assign_attrs(units="m/s", long_name=words)
    return ds


def cdo_time():
    ds = base().assign_coords(time=[20221111.0, 20221111 + 1 / 24])
    ds["time"].attrs = {"units": "day as %Y%m%d.%f", "standard_name": "time"}
    return ds


def no_leap(calendar=cftime.DatetimeNoLeap, month=11, day=11):
    dates = np.array([calendar(2022, month, day, hour) for hour in (0, 1)], dtype=object)
    return base().assign_coords(time=("time", dates))


LAYOUTS = {
    "plain": base,
    "u and v half a cell apart in x": lambda: shifted(x=0.5),
    "u and v half a cell apart in y": lambda: shifted(y=0.5),
    "u and v half a cell apart in both": lambda: shifted(x=-0.5, y=0.5),
    "v from north to south": lambda: shifted(flip=True),
    "levels without units in hPa": levels,
    "levels without units in Pa": lambda: levels(100.0),
    "levels in units of levels": lambda: levels(units="level"),
    "dimensions in another order": lambda: base().transpose("level", "longitude", ...),
    "absolute time of CDO": cdo_time,
    "times as yyyymmddHH": lambda: times([2022111100], units="yyyymmddhh"),
    "times as yyyymmddHHMM": lambda: times([202211110000]),
    "times as text": lambda: times(["2022-11-11_00:00:00"]),
    "Julian dates": lambda: times([2459894.5], units="julian day"),
    "calendar without leap years": no_leap,
    "places in radians": radians,
    "fill values that no attribute names": filled,
    "preliminary and final data": two_experiments,
    "Climate Data Store": cds_new,
    "names alone": lambda: renamed(attrs_of("UGRD", "VGRD", {"units": "m/s"}), u="UGRD", v="VGRD"),
    "NCEP": ncep,
    "MERRA-2": merra,
    "CMIP": cmip,
    "NCL": ncl,
    "GrADS": grads,
    "knots": knots,
    "winds on other levels too": other_levels_too,
    **{f"native levels: {style}": partial(native, style) for style in ("ap", "p0", "sigma", "p")},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_winds(layout):
    result = check(LAYOUTS[layout]())
    assert result["lead_time"].values[0] == pytest.approx(0.0)


def test_the_second_of_preliminary_and_final_data():
    check(two_experiments(), after=1.0)


def test_a_year_of_360_days_is_refused():
    with pytest.raises(InputError, match="360 days"):
        collocated(no_leap(cftime.Datetime360Day, 2, 30))


def test_assumptions_about_levels_are_in_the_notes():
    notes = airswing.build_catalogue(levels(), name="x").notes
    assert notes == ["level has no units: taken as hPa from its values"]
    with pytest.raises(InputError, match=r"end at 10 hPa.*units: \{level: hPa\}"):
        airswing.build_catalogue(levels(), name="x", naming={"units": {"level": "Pa"}})


def prediction(steps, **attrs):
    """WeatherBench2: time is the run; naming it does not drop the leads."""
    ds = base().rename(time="prediction_timedelta").assign_coords(prediction_timedelta=steps)
    ds["prediction_timedelta"].attrs = attrs
    for name in "uv":
        ds[name].attrs = {"units": "m/s"}
    return ds.expand_dims(time=[START])


RUN = {"standard_name": "forecast_reference_time"}
FORECASTS = {
    "cfgrib": lambda: (
        base()
        .rename(time="step")
        .assign_coords(
            step=("step", [0.0, 1.0], {"units": "hours", "standard_name": "forecast_period"}),
            time=((), START, RUN),
            valid_time=("step", START + HOUR * np.arange(2), {"standard_name": "time"}),
        )
    ),
    "WeatherBench": lambda: prediction(HOUR * np.arange(2)),
    "WeatherBench in hours": lambda: prediction(np.arange(2), units="hours"),
    "WeatherBench without units": lambda: prediction(np.arange(2)),
    "init and lead": lambda: (
        base()
        .rename(time="lead_time")
        .assign_coords(lead_time=("lead_time", HOUR * np.arange(2)))
        .expand_dims(init_time=[START])
    ),
    "CF": lambda: base().assign_coords(forecast_reference_time=((), START, RUN)),
}


@pytest.mark.parametrize("style", sorted(FORECASTS))
def test_runs_and_leads(style):
    ds = FORECASTS[style]()
    for naming in ({}, {"time": "time"}) if style.startswith("Weather") else ({},):
        result = check(ds, after=1.0, naming=naming)
        np.testing.assert_allclose(result["lead_time"].values[0], 1.0)
    with pytest.raises(InputError, match="lead condition"):
        airswing.build_catalogue(ds, name="m", lead=">= 3 h")


def test_the_shortest_of_several_leads():
    early = base().assign(u=base().u + 50).expand_dims(reftime=[START - 6 * HOUR])
    ds = xr.concat([early, base().expand_dims(reftime=[START])], "reftime")
    ds.time.attrs["standard_name"] = "time"
    ds.reftime.attrs["standard_name"] = "forecast_reference_time"
    check(ds)
    assert check(ds, after=1.0)["lead_time"].values[0, 0] == 1.0


@pytest.mark.parametrize("name", ["number", "realization", "ensemble_member"])
def test_the_member_asked_for(name):
    ds = xr.concat([base().assign(u=base().u + 30 * n) for n in (1, 0, 2)], name)
    ds = ds.assign_coords({name: [4, 7, 9]}).transpose("time", name, ...)
    check(ds, member=7)
    model = airswing.build_catalogue(ds, name="m")
    assert set(model.profiles["member"]) == {4}
    assert "several ensemble members" in " ".join(model.notes)
    with pytest.raises(InputError, match="no wind of ensemble member 5"):
        airswing.build_catalogue(ds, name="m", member=5)


def test_packed_integers_and_fill_values(tmp_path):
    ds = base()
    ds["u"][0, :, 4, 5] = np.nan
    packing = {"dtype": "i2", "scale_factor": 0.002, "add_offset": 3.0, "_FillValue": -32767}
    path = str(tmp_path / "p.nc")
    ds.to_netcdf(path, encoding={name: packing for name in "uv"})
    check(path)
    # near the missing point there is no wind; on a grid point next to it there is
    at = points([44.0, 44.0, 45.0], [6.0 - 0.5, 6.0, 5.0], 50000.0)
    u, _ = winds(airswing.collocate(at, {"m": airswing.build_catalogue(path, name="m")}))
    np.testing.assert_array_equal(np.isfinite(u), [False, True, True])


def test_names_in_the_configuration():
    names = {"u": "speed_1", "v": "speed_2", "level": "l", "latitude": "a", "longitude": "o"}
    ds = base().rename(names | {"time": "t"})
    for name in names.values():
        ds[name].attrs = {}
    units = {"speed_1": "m/s", "speed_2": "m/s", "l": "hPa"}
    check(ds, naming=names | {"time": "t", "units": units})


@pytest.mark.parametrize(
    ("naming", "expected"),
    [
        ({"u": "nonsense"}, "u: nonsense: no such variable"),
        ({"level": "nothing"}, "level: nothing: no such variable"),
        ({"latitude": "nothing"}, "y: nothing: no such variable"),
        ({"time": "nothing"}, "time: nothing: no such time"),
        ({"units": {"nonsense": "hPa"}}, "units: nonsense: no such variable"),
        ({"pressure": "level"}, "pressure: level: this key applies to native levels"),
        ({"surface_pressure": "u"}, "surface_pressure: u: this key applies to native levels"),
        ({"projection": "+proj=lcc +lat_1=30 +lat_2=60"}, "units of another quantity than length"),
    ],
)
def test_keys_are_honoured_or_refused_by_name(naming, expected):
    with pytest.raises(InputError, match=expected):
        airswing.build_catalogue(base(), name="x", naming=naming)


def test_a_projection_that_the_points_do_not_have():
    ds = base()
    lat, lon = xr.broadcast(ds.latitude, ds.longitude)
    ds = ds.rename(latitude="y", longitude="x").drop_vars(["y", "x"])
    lon = (("y", "x"), lon.values, {"units": "degrees_east"})
    ds = ds.assign_coords(lat=(("y", "x"), lat.values, NORTH), lon=lon)
    check(ds)
    naming = {"projection": "+proj=stere +lat_0=90 +lat_ts=60 +lon_0=0 +R=6371229"}
    with pytest.raises(InputError, match="points that are not rows and columns"):
        airswing.build_catalogue(ds, name="x", naming=naming)


@pytest.mark.parametrize(
    ("standard", "flag", "configured", "along"),
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
def test_whether_winds_point_along_the_grid(standard, flag, configured, along):
    ds = projected("lambert")
    for name, standard_name, way in zip(("ua", "va"), standard, ("east", "north"), strict=True):
        ds[name].attrs |= {"standard_name": standard_name, "long_name": f"{way}ward wind"}
        ds[name].attrs |= {} if flag is None else {"GRIB_uvRelativeToGrid": flag}
    naming = {"winds": configured} if configured else None
    model = airswing.build_catalogue(ds, name="m", naming=naming)
    assert model.grids[0].wind_along_grid is along
    notes = " ".join(model.notes)
    assert ("along the grid" if along else "to true east") in notes
    assert ("not given" in notes) is (standard[0] == "" and configured is None)
    result = airswing.collocate(points([40.0], [-97.0], 50000.0), {"m": model})
    assert notes in result.attrs["reference_notes"]
