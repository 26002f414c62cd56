"""MADIS ACARS: the real file whole against an independent reading, and later versions made up."""

import gzip

import netCDF4
import numpy as np
import pytest
import xarray as xr
from tests.reports.tables import audit_of

from airswing.errors import InputError
from airswing.flags import PLATFORM
from airswing.products.ragged import aircraft_of_report
from airswing.reports import read_reports

REAL = "reports/acars_19990209_14z.nc"
CODES_OF_THE_REAL_FILE = {  # counted by another program; see the notes next to the file
    "dataDescriptor": {"T": 1773, "R": 473, "X": 58},
    "errorType": {".": 2246, "W": 32, "T": 15, "B": 11},
    "rollFlag": {"N": 1796, "G": 388, "B": 120},
    "tempError": {"p": 2283, "H": 21},
    "windDirError": {"p": 2289, "B": 15},
    "windSpeedError": {"p": 2266, "D": 23, "F": 15},
    "speedError": {"p": 1982, "-": 317, "F": 5},
    "bounceError": {"p": 1798, "-": 506},
    "correctedFlag": {"r": 2095, "t": 193, "T": 16},
    "interpolatedTime": {"r": 2099, "i": 205},
    "interpolatedLL": {"r": 2228, "i": 76},
    "waterVaporQC": {"-": 2177, "7": 93, "2": 19, "0": 15},
}


def test_the_real_file_agrees_with_an_independent_reading(real):
    ds = read_reports(real(REAL))
    audit = audit_of(ds)
    assert (audit["reports_read"], ds.sizes["aircraft"]) == (2304, 298)
    assert audit["reports_kept"] == ds.sizes["report"] == int(ds["row_size"].sum()) == 2301
    assert audit["dropped"] == {"same_tail_and_time": 1, "conflicting_position": 2}
    assert {name: audit["flags"][name] for name in CODES_OF_THE_REAL_FILE} == CODES_OF_THE_REAL_FILE
    # ``heading`` is the ground track of the last leg
    assert np.isnan(ds["reported_heading"]).all() and np.isnan(ds["reported_airspeed"]).all()
    raw = xr.open_dataset(real(REAL), engine="netcdf4", decode_times=False)
    tails = np.char.strip(np.char.decode(raw["en_tailNumber"].to_numpy().astype("S12"), "ascii"))
    speed, direction = raw["windSpeed"].to_numpy(), np.radians(raw["windDir"].to_numpy())
    level = raw["altitude"].to_numpy().astype(float)
    pressure = np.where(  # ICAO standard atmosphere, written out again
        level < 11000.0,
        101325.0 * (1.0 - 0.0065 * level / 288.15) ** 5.255880,
        22632.06 * np.exp(-(level - 11000.0) * 9.80665 / (287.05287 * 216.65)),
    )
    keys = list(zip(tails, raw["timeObs"].to_numpy(), raw["latitude"].to_numpy(), strict=True))
    position = {key: index for index, key in enumerate(keys) if keys.count(key) == 1}
    ours = ds["aircraft"].to_numpy()[aircraft_of_report(ds)]
    seconds = ds["time"].to_numpy().astype(np.int64) / 1e9
    ours_by_key = list(zip(ours, seconds, ds["latitude"].to_numpy().astype("f4"), strict=True))
    matched = [k for k, key in enumerate(ours_by_key) if key in position]
    index = [position[ours_by_key[k]] for k in matched]
    assert len(matched) > 2250
    for name, wanted in {
        "eastward_wind": -speed * np.sin(direction),
        "northward_wind": -speed * np.cos(direction),
        "air_temperature": raw["temperature"].to_numpy(),
        "longitude": raw["longitude"].to_numpy(),
        "pressure_altitude": level,
        "pressure": pressure,
    }.items():
        read, close = ds[name].to_numpy()[matched], {"rtol": 1e-5, "atol": 1e-4}
        np.testing.assert_allclose(read, wanted[index], **close, err_msg=name)


def write_madis(path, **variables):
    """A small file in the style of later versions; text is written as bytes of its codes."""
    defaults = {
        "timeObs": 1231156800.0 + 60.0 * np.arange(4),
        "latitude": np.full(4, 41.5, "f4"),
        "longitude": np.linspace(-87.0, -86.8, 4).astype("f4"),
        "altitude": np.full(4, 6096.0, "f4"),
        "windDir": np.full(4, 270.0, "f4"),
        "windSpeed": np.full(4, 20.0, "f4"),
        "temperature": np.full(4, 250.0, "f4"),
        "heading": np.full(4, 90.0, "f4"),
    }
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.createDimension("recNum", None)
        file.createDimension("enLen", 12)
        tail = file.createVariable("en_tailNumber", "S1", ("recNum", "enLen"))
        tail[:4] = np.array([list("FSL00007".ljust(12, "\x00"))] * 4, "S1")
        for name, values in {**defaults, **variables}.items():
            if isinstance(values, str):
                values = np.frombuffer(values.encode(), dtype=np.int8)
            fill = 99999.0 if values.dtype.kind == "f" and name != "timeObs" else None
            file.createVariable(name, values.dtype, ("recNum",), fill_value=fill)[:] = values
    return path


def test_platform_by_data_source(tmp_path, real):
    path = real("reports/madis_acars_20050826_00z.nc.gz")
    ds = read_reports(path)
    with netCDF4.Dataset("memory", memory=gzip.open(path).read()) as file:
        tails = netCDF4.chartostring(file["en_tailNumber"][:], encoding="latin-1")
        stream = np.asarray(file["dataSource"][:])
    tamdar = {str(name).rstrip("\x00 ") for name in tails[stream == 4]}
    tails_read = ds["aircraft"].to_numpy()[ds["platform"].to_numpy() == PLATFORM["TAMDAR"]]
    assert len(tamdar) == 43
    assert set(tails_read.tolist()) == tamdar
    # Most reports count; a code nobody knows is ACARS, as the files are.
    reports = read_reports(write_madis(tmp_path / "a.nc", dataSource=np.array([1, 4, 4, -9], "i2")))
    assert reports["platform"].to_numpy().tolist() == [PLATFORM["TAMDAR"]]


DESCRIPTORS = {"temperatureDD": "VXQZ", "windDirDD": "CSBZ", "windSpeedDD": "CXGZ"}
ERRORS = {"tempError": "p-Cp", "windDirError": "pp-p", "windSpeedError": "pS-p"}
ERRORS |= {"dataDescriptor": "RRRX", "errorType": "....", "correctedFlag": "rflr"}


@pytest.mark.parametrize(
    ("letters", "temperature", "wind", "codes"),
    [
        (DESCRIPTORS, [1, 2, 2, 0], [1, 2, 2, 0], {"windDirDD": {"C": 1, "S": 1, "B": 1, "Z": 1}}),
        (ERRORS, [1, 0, 2, 2], [1, 2, 0, 2], {"correctedFlag": {"r": 2, "f": 1, "l": 1}}),
    ],
)
def test_letters_of_descriptors_and_errors(tmp_path, letters, temperature, wind, codes):
    ds = read_reports(write_madis(tmp_path / "a.nc", rollFlag="GBN-", **letters))
    assert ds["temperature_qc"].to_numpy().tolist() == temperature
    assert ds["wind_qc"].to_numpy().tolist() == wind
    assert ds["roll_flag"].to_numpy().tolist() == [1, 2, 3, 0]
    assert codes.items() <= audit_of(ds)["flags"].items()


def test_true_airspeed_where_present_and_fill_values(tmp_path):
    path = write_madis(
        tmp_path / "a.nc",
        trueAirSpeed=np.array([120, 121, 99999, 123], "f4"),
        windSpeed=np.array([20, 99999, 20, 20], "f4"),
        timeObs=np.array([1231156800.0, 1231156860.0, 1231156920.0, 0.0]),
    )
    ds = read_reports(path)
    np.testing.assert_array_equal(ds["reported_airspeed"], np.array([120, 121, np.nan]))
    assert np.isnan(ds["eastward_wind"][1])
    assert audit_of(ds)["dropped"] == {"missing_time": 1}


def test_a_count_of_records_that_the_file_cannot_hold_is_refused(tmp_path):
    data = write_madis(tmp_path / "a.nc").read_bytes()
    (tmp_path / "a.nc").write_bytes(data[:4] + b"\x7f\xff\xff\xf0" + data[8:])
    with pytest.raises(InputError, match=f"bytes by its header, of which {len(data):,} are there"):
        read_reports(tmp_path / "a.nc")


def test_another_netcdf_is_refused_with_what_it_lacks(tmp_path):
    xr.Dataset({"u": ("x", [1.0])}).to_netcdf(tmp_path / "a.nc")
    with pytest.raises(InputError, match=r"windSpeed.*is not a MADIS .*variables u\).*or of IODA"):
        read_reports(tmp_path / "a.nc")


@pytest.mark.parametrize("format", ["NETCDF3_CLASSIC", "NETCDF4"])
def test_a_file_that_xarray_wrote_again_reads_the_same(tmp_path, real, format):
    with xr.open_dataset(real(REAL), decode_cf=False) as raw:
        raw["windSpeed"] = raw["windSpeed"].astype("f8")
        raw["rollFlag"] = raw["rollFlag"].astype("i4")
        raw.to_netcdf(tmp_path / "again.nc", format=format)
    with netCDF4.Dataset(tmp_path / "again.nc") as file:
        assert file["en_tailNumber"].ndim == 3  # xarray adds a dimension of one
    xr.testing.assert_equal(read_reports(tmp_path / "again.nc"), read_reports(real(REAL)))
