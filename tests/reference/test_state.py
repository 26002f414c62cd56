"""Fields that look like winds and are not an atmospheric state are refused by every reader."""

from pathlib import Path

import numpy as np
import pytest

from airswing.errors import InputError
from airswing.reference.catalogue import build_catalogue
from tests.reference.builders import SIZE, profile, write
from tests.reference.gridded.datasets import latlon


def messages(change=bytes, *, edition=2, **extra):
    """Winds on two levels with other keys, each message changed by a function."""
    winds = profile((300, 700), np.full(SIZE, 10.0), edition=edition, extra=extra)
    return b"".join(map(change, winds))


def section_1(entries, length=52):
    """Change of a GRIB1 message: a longer section 1 with some bytes changed, counted from 1."""

    def change(message):
        product = bytearray(message[8:36]) + bytes(length - 28)
        product[:3] = length.to_bytes(3, "big")
        for place, value in entries.items():
            product[place - 1] = value
        body = bytes(product) + message[36:]
        return b"GRIB" + (8 + len(body)).to_bytes(3, "big") + b"\x01" + body

    return change


def local(kind):
    """Change of a GRIB2 message: ECMWF's local section with a MARS type."""

    def change(message):
        section = b"\0\0\0\x11\x02\0\x01\0\x01" + kind.to_bytes(2, "big") + b"\x04\x060001"
        body = message[16:21] + b"\0\x62" + message[23:37] + section + message[37:]
        return message[:8] + (16 + len(body)).to_bytes(8, "big") + body

    return change


GRIB = {
    "spread": messages(productDefinitionTemplateNumber=2, derivedForecast=4),
    "standard deviation": messages(productDefinitionTemplateNumber=2, derivedForecast=2),
    "probability": messages(productDefinitionTemplateNumber=5),
    "percentile": messages(productDefinitionTemplateNumber=6),
    "analysis error": messages(typeOfGeneratingProcess=7),
    "climatology": messages(typeOfGeneratingProcess=9),
    "increment": messages(typeOfGeneratingProcess=20),
    "average": messages(productDefinitionTemplateNumber=8),
    "event probability": messages(typeOfProcessedData=8),
    "percentile of NCEP": messages(productDefinitionTemplateNumber=2, derivedForecast=193),
    "spread of ECMWF": messages(local(18)),
    "standard deviation, edition 1": messages(section_1({21: 119}), edition=1),
    "average of edition 1": messages(section_1({21: 3}), edition=1),
    "spread of ECMWF, edition 1": messages(section_1({5: 98, 41: 1, 43: 18}), edition=1),
    "analysis error of ECMWF": messages(section_1({5: 98, 41: 1, 43: 13}), edition=1),
    "monthly mean of ECMWF": messages(section_1({5: 98, 41: 1, 43: 2, 44: 4, 45: 47}), edition=1),
    "spread of NCEP, edition 1": messages(section_1({5: 7, 41: 1, 44: 11}), edition=1),
}
STATES = {
    "mean": messages(productDefinitionTemplateNumber=2, derivedForecast=0),
    "member": messages(productDefinitionTemplateNumber=1, perturbationNumber=3),
    "analysis": messages(typeOfGeneratingProcess=0),
    "mean of ECMWF": messages(local(17)),
    "member of ECMWF, edition 1": messages(section_1({5: 98, 41: 1, 43: 11, 50: 4}), edition=1),
    "mean of NCEP, edition 1": messages(section_1({5: 7, 41: 1, 44: 2}), edition=1),
}


@pytest.mark.parametrize("engine", ["auto", "grib"])
@pytest.mark.parametrize("name", GRIB)
def test_grib_fields_that_are_no_state_are_refused(name, engine, tmp_path):
    path = write(tmp_path / "x.grib", GRIB[name])
    with pytest.raises(InputError, match="no wind") as caught:
        build_catalogue(path, name="x", engine=engine, cache_dir=tmp_path)
    reasons = "not an atmospheric state", "not instantaneous", "ensemble statistic"
    assert any(reason in str(caught.value) for reason in reasons)


def test_cfgrib_fields_that_are_no_state_are_refused(tmp_path):
    for name in ("spread", "analysis error of ECMWF"):
        path = write(tmp_path / "x.grib", GRIB[name])
        with pytest.raises(InputError, match=r"other than a mean|analysis error"):
            build_catalogue(path, name="x", engine="cfgrib", cache_dir=tmp_path)


@pytest.mark.parametrize("name", STATES)
def test_states_are_used(name, tmp_path):
    path = write(tmp_path / "x.grib", STATES[name])
    assert build_catalogue(path, name="x", cache_dir=tmp_path).levels(0).size == 2


@pytest.mark.parametrize("ending", ["", " of NCEP, edition 1"])
def test_of_a_mean_and_a_spread_the_mean_is_used(ending, tmp_path):
    write(tmp_path / "mean.grib", STATES["mean" + ending])
    write(tmp_path / "spread.grib", GRIB["spread" + ending])
    model = build_catalogue(str(tmp_path / "*.grib"), name="x", cache_dir=tmp_path / "c")
    assert [Path(file.path).name for file in model.model_time(0).files] == ["mean.grib"]
    assert model.levels(0).size == 2


def changed(**attrs):
    ds = latlon(latitude=np.arange(40.0, 61.0), longitude=np.arange(0.0, 21.0))
    for name in "uv":
        ds[name].attrs |= attrs
    return ds


def named(ending):
    ds = changed().rename(u=f"u_{ending}", v=f"v_{ending}")
    for name in ds.data_vars:
        ds[name].attrs = {"units": "m/s"}
    return ds


DATASETS = {
    "standard deviation over members": changed(cell_methods="realization: standard_deviation"),
    "time mean": changed(cell_methods="time: mean"),
    "maximum": changed(cell_methods="time: maximum (interval: 1 hour)"),
    "standard error": changed(standard_name="eastward_wind standard_error"),
    "long name": changed(long_name="ensemble spread of the wind"),
    "data type": changed(GRIB_dataType="es"),
    "step type": changed(GRIB_stepType="avg"),
    "climatology": changed(long_name="u wind climatology"),
    "daily mean of PSL": changed(long_name="mean Daily U wind", statistic="Mean"),
    "mean over two dimensions": changed(cell_methods="area: time: mean"),
    "statistic of another name": changed(ensemble_statistic="spread"),
    "derived type of THREDDS": changed(Grib_Ensemble_Derived_Type="SpreadOfAllMembers"),
    "interval of THREDDS": changed(Grib_Statistical_Interval_Type="Average"),
    "title": changed().assign_attrs(title="GEFS ensemble spread"),
    "averages of MERRA-2": changed().assign_attrs(Title="MERRA2 tavg3: 3-Hourly,Time-Averaged"),
    **{f"name u_{ending}": named(ending) for ending in ("spread", "std", "sd")},
    **{f"other name {n}": named(n) for n in ("p90", "sprd", "err", "clim", "anom", "prob")},
    "history of CDO": changed().assign_attrs(history="Mon 1 Jan: cdo -ensstd a.nc b.nc out.nc"),
    "time mean of NCO": changed().assign_attrs(history="ncra in.nc out.nc"),
    "scalar coordinate": changed().assign_coords(percentile=90.0),
    "percentile": changed().expand_dims(percentile=[90.0]),
    "product type": changed().assign_attrs(product_type="ensemble_spread"),
}


@pytest.mark.parametrize("name", DATASETS)
def test_variables_that_are_no_state_are_refused(name):
    state = "no wind" if name.startswith("other") else "not an atmospheric state"
    with pytest.raises(InputError, match=state):
        build_catalogue(DATASETS[name], name="x")


@pytest.mark.parametrize(
    "attrs",
    [
        {"cell_methods": "time: point"},
        {"cell_methods": "area: mean time: point"},
        {"cell_methods": "realization: mean"},
        {"cell_methods": "lat: lon: mean time: point"},
        {"statistic": "Ensemble Mean"},
        {"long_name": "bias-corrected u wind"},
        {"GRIB_dataType": "an", "GRIB_stepType": "instant"},
    ],
)
def test_variables_that_are_states_are_used(attrs):
    assert len(build_catalogue(changed(**attrs), name="x")) > 0
