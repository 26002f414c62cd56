"""Damaged NetCDF files are refused before their library reads them."""

import struct

import netCDF4
import numpy as np
import pytest

from airswing.errors import InputError
from airswing.products.damaged_netcdf import require_sound, written_here


def written(path, kind, records=7):
    with netCDF4.Dataset(path, "w", format=kind) as file:
        file.createDimension("time", None)
        file.createDimension("x", 5)
        file.title = "three words"
        file.createVariable("x", "f8", ("x",))[:] = np.arange(5.0)
        for name, numbers in (("a", "i2"), ("b", "f4")):
            file.createVariable(name, numbers, ("time", "x"))[:] = np.ones((records, 5))
    return path


@pytest.mark.parametrize("kind", ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"])
def test_a_count_of_records_that_is_not_there_is_refused(kind, tmp_path):
    require_sound(written(tmp_path / "b.nc", kind, records=0))
    path = written(tmp_path / "a.nc", kind)
    require_sound(path)
    data = bytearray(path.read_bytes())
    wide = kind == "NETCDF3_64BIT_DATA"
    data[4 : 12 if wide else 8] = struct.pack(">Q" if wide else ">I", 9)
    path.write_bytes(data)
    with pytest.raises(InputError, match="9 records"):
        require_sound(path)


def test_every_cut_of_a_header_is_refused(tmp_path):
    path = written(tmp_path / "a.nc", "NETCDF3_CLASSIC")
    data = path.read_bytes()
    for length in range(4, 200, 7):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="damaged"):
            require_sound(path)


def test_a_cut_hdf5_file_is_refused_and_one_this_process_wrote_is_not_opened(tmp_path):
    path = written(tmp_path / "a.nc", "NETCDF4")
    require_sound(path)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="a damaged NetCDF file"):
        require_sound(path)
    written_here(path)
    require_sound(path)
