"""Files whose header lies, or that their library does not survive; notes with a checksum."""

from __future__ import annotations

import os
import signal
import struct
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from airswing.errors import InputError
from airswing.products import openable
from airswing.products.checked import note, noted
from airswing.products.classic_netcdf import require_whole
from airswing.products.openable import require_openable, written_here


def classic(path: Path, kind: str, records: int = 7) -> Path:
    with netCDF4.Dataset(path, "w", format=kind) as file:  # type: ignore[arg-type]
        file.createDimension("time", None)
        file.createDimension("x", 5)
        file.title = "three octets"
        file.createVariable("x", "f8", ("x",))[:] = np.arange(5.0)
        for name, numbers in (("a", "i2"), ("b", "f4")):
            file.createVariable(name, numbers, ("time", "x"))[:] = np.ones((records, 5))
    return path


KINDS = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_classic_file_passes(kind: str, tmp_path: Path):
    require_whole(classic(tmp_path / "a.nc", kind))
    require_whole(classic(tmp_path / "b.nc", kind, records=0))


@pytest.mark.parametrize("kind", KINDS)
def test_a_count_of_records_that_is_not_there_is_refused(kind: str, tmp_path: Path):
    path = classic(tmp_path / "a.nc", kind)
    data = bytearray(path.read_bytes())
    wide = kind == "NETCDF3_64BIT_DATA"
    data[4 : 12 if wide else 8] = struct.pack(">Q" if wide else ">I", 9)
    path.write_bytes(data)
    with pytest.raises(InputError, match="9 records"):
        require_whole(path)


def test_one_variable_of_records_stands_without_padding(tmp_path: Path):
    path = tmp_path / "a.nc"
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.createDimension("time", None)
        file.createVariable("flag", "i1", ("time",))[:] = np.ones(101, dtype="i1")
    require_whole(path)


def test_every_cut_of_a_header_is_refused(tmp_path: Path):
    path = classic(tmp_path / "a.nc", "NETCDF3_CLASSIC")
    data = path.read_bytes()
    for length in range(4, 200, 7):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="damaged"):
            require_whole(path)


def netcdf4(path: Path) -> Path:
    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("x", 50)
        file.createVariable("a", "f8", ("x",), zlib=True)[:] = np.arange(50.0)
    return path


def test_a_sound_file_is_opened_once_beside(tmp_path: Path):
    path = netcdf4(tmp_path / "a.nc")
    require_openable(path)
    (helper,) = openable._HELPER
    require_openable(path)  # known
    require_openable(netcdf4(tmp_path / "b.nc"))
    assert [helper] == openable._HELPER


def test_a_helper_that_was_ended_is_started_anew(tmp_path: Path):
    require_openable(netcdf4(tmp_path / "a.nc"))
    os.kill(openable._HELPER[0].pid, signal.SIGKILL)
    openable._HELPER[0].wait()
    require_openable(netcdf4(tmp_path / "b.nc"))


def test_octets_that_are_no_file_are_refused(tmp_path: Path):
    path = netcdf4(tmp_path / "a.nc")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(InputError, match="a damaged NetCDF file"):
        require_openable(path)


def test_what_this_process_wrote_is_not_asked_about(tmp_path: Path):
    path = tmp_path / "a.nc"
    path.write_bytes(b"\x89HDF\r\n\x1a\n not in truth")
    written_here(path)
    require_openable(path)


def test_notes_come_back_as_they_were_or_not_at_all():
    content = {"key": "x", "files": [["a", 1, 2.5]], "none": None}
    text = note(content)
    assert noted(text) == content
    for place in range(0, len(text), 5):
        changed = text[:place] + chr(ord(text[place]) ^ 1) + text[place + 1 :]
        try:
            assert noted(changed) == content
        except ValueError:
            continue
