"""Damaged NetCDF files are refused before their library reads them."""

from __future__ import annotations

import struct
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from airswing.errors import InputError
from airswing.products.damaged_netcdf import require_sound, written_here


def classic(path: Path, kind: str, records: int = 7) -> Path:
    with netCDF4.Dataset(path, "w", format=kind) as file:  # type: ignore[arg-type]
        file.createDimension("time", None)
        file.createDimension("x", 5)
        file.title = "three words"
        file.createVariable("x", "f8", ("x",))[:] = np.arange(5.0)
        for name, numbers in (("a", "i2"), ("b", "f4")):
            file.createVariable(name, numbers, ("time", "x"))[:] = np.ones((records, 5))
    return path


KINDS = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_classic_file_passes(kind: str, tmp_path: Path):
    require_sound(classic(tmp_path / "a.nc", kind))
    require_sound(classic(tmp_path / "b.nc", kind, records=0))


@pytest.mark.parametrize("kind", KINDS)
def test_a_count_of_records_that_is_not_there_is_refused(kind: str, tmp_path: Path):
    path = classic(tmp_path / "a.nc", kind)
    data = bytearray(path.read_bytes())
    wide = kind == "NETCDF3_64BIT_DATA"
    data[4 : 12 if wide else 8] = struct.pack(">Q" if wide else ">I", 9)
    path.write_bytes(data)
    with pytest.raises(InputError, match="9 records"):
        require_sound(path)


def test_every_cut_of_a_header_is_refused(tmp_path: Path):
    path = classic(tmp_path / "a.nc", "NETCDF3_CLASSIC")
    data = path.read_bytes()
    for length in range(4, 200, 7):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="damaged"):
            require_sound(path)


def netcdf4(path: Path) -> Path:
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("x", 50)
        file.createVariable("a", "f8", ("x",), zlib=True)[:] = np.arange(50.0)
    return path


def test_bytes_that_are_no_file_are_refused(tmp_path: Path):
    path = netcdf4(tmp_path / "a.nc")
    require_sound(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match="a damaged NetCDF file"):
        require_sound(path)


def test_a_file_this_process_wrote_is_not_opened_elsewhere(tmp_path: Path):
    path = tmp_path / "a.nc"
    path.write_bytes(b"\x89HDF\r\n\x1a\n not a file")
    written_here(path)
    require_sound(path)
