"""Messages that lie: in lengths, counts, times, places, identity; and winds no atmosphere has."""

from __future__ import annotations

import os
import signal
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from tests.reference.builders import LAMBERT, LATLON, build, write

from airswing.errors import InputError
from airswing.reference.collocate import collocate
from airswing.reference.grib.catalogue import Catalogue, build_catalogue
from airswing.reference.grib.messages import scan_file
from airswing.reference.grib.values import _message_bytes, field_values
from airswing.reference.packing import decoder
from airswing.reference.packing.simple_packing import UnreadableMessageError

SIZE = LATLON["Ni"] * LATLON["Nj"]


def field(number: int = 0) -> np.ndarray:
    """Winds of an ordinary day."""
    rng = np.random.default_rng(number)
    return np.round(10.0 + 8.0 * np.sin(np.arange(SIZE) / 9.0 + number) + rng.normal(0, 1, SIZE), 2)


def pair(edition: int = 2, *, level: int = 500, **options: object) -> list[bytes]:
    return [
        build(LATLON, field(n), edition=edition, parameter=name, level=level, **options)  # type: ignore[arg-type]
        for n, name in enumerate("uv")
    ]


def section(message: bytes, number: int) -> int:
    """Start of a section of a GRIB2 message."""
    at = 16
    while message[at + 4] != number:
        at += int.from_bytes(message[at : at + 4], "big")
    return at


def bent(message: bytes, place: int, octets: bytes) -> bytes:
    return message[:place] + octets + message[place + len(octets) :]


def what_is_said(tmp_path: Path, message: bytes) -> set[str]:
    contents = scan_file(write(tmp_path / "m.grib", message))
    assert not contents.fields
    return {reason for _, reason in contents.skipped}


@pytest.mark.parametrize(
    ("number", "octet", "octets", "says"),
    [
        (1, 12, b"\x00\x00", "impossible reference time"),  # the year 0
        (1, 12, b"\x27\x0f", "base time not of the years"),  # 9999
        (1, 14, b"\x0d", "impossible reference time"),  # month 13
        (4, 18, b"\x7f\xff\xff\xff", "lead time of"),
        (4, 24, b"\x7f\xff\xff\xff", "pressure level of"),
        (3, 6, b"\x00\x00\x01\x00", "data points on a grid"),
        (3, 30, b"\x00\x00\x00\x00", "grid of 0 by 11 points"),
        (3, 55, b"\x06\x00\x00\x00", "grid off the earth"),
        (3, 63, b"\x00\x00\x00\x01", "corners and increments contradict"),
        (5, 5, b"\x00\x00\x00\x01", "1 values on a grid of 176 points"),
        (5, 11, struct.pack(">f", 1e20), "lowest value of a field"),
        (5, 11, struct.pack(">f", float("nan")), "lowest value of a field"),
        (5, 15, b"\x7f\xff", "scale factors"),
        (5, 17, b"\xff\xff", "scale factors"),
        (5, 19, b"\x07", "data section longer than its grid"),
        (5, 19, b"\x20", "data section too short"),
        (5, 19, b"\xff", "255 bits a value"),
        (7, 0, b"\x00\x00\x00\x05", "section lengths do not add up"),
        (4, 0, b"\xff\xff\xff\xff", "section lengths do not add up"),
        (4, 4, b"\x02", "section 2 after section 3"),
    ],
)
def test_headers_that_lie_are_named(
    number: int, octet: int, octets: bytes, says: str, tmp_path: Path
) -> None:
    message = pair()[0]
    reasons = what_is_said(tmp_path, bent(message, section(message, number) + octet, octets))
    assert any(says in reason for reason in reasons), reasons


@pytest.mark.parametrize(
    ("place", "octets", "says"),
    [
        (8 + 24, b"\x00", "impossible reference time"),  # the century 0
        (8 + 24, b"\x64", "base time not of the years"),
        (8 + 10, b"\xff\xff", "pressure level of"),
        (36 + 6, b"\x00\x01", "contradict"),  # Ni 1 beside its increments
        (36 + 17, b"\x7f\xff\xff", "off the earth"),
        (36, b"\x00\x00\x1f", "grid section too short"),
    ],
)
def test_grib1_headers_that_lie_are_named(
    place: int, octets: bytes, says: str, tmp_path: Path
) -> None:
    reasons = what_is_said(tmp_path, bent(pair(1)[0], place, octets))
    assert any(says in reason or "data section" in reason for reason in reasons), reasons


def test_grid_lengths_of_nothing_are_refused(tmp_path: Path) -> None:
    message = build(LAMBERT, np.zeros(LAMBERT["Nx"] * LAMBERT["Ny"]))
    place = section(message, 3) + 55
    (reason,) = what_is_said(tmp_path, bent(message, place, bytes(4)))
    assert "grid lengths" in reason


def catalogue_of(path: str, folder: Path) -> Catalogue:
    return build_catalogue(path, name="ref", cache_dir=folder)


def test_a_level_given_again_with_other_values_is_used_not_at_all(tmp_path: Path) -> None:
    u, v = pair()
    other = build(LATLON, field(7), parameter="u", level=500)
    lower = pair(level=700)
    path = write(tmp_path / "m.grib", u, v, other, *lower, lower[0])
    catalogue = catalogue_of(path, tmp_path)
    assert catalogue.levels(0).tolist() == [70000.0]
    said = {entry["reason"]: entry["count"] for entry in catalogue.skipped}
    assert said["a field of one level and time given again with other values"] == 2
    assert said["v without u"] == 1
    assert any("twice" in note for note in catalogue.notes)


def test_mixed_editions_in_one_file_are_read(tmp_path: Path) -> None:
    path = write(tmp_path / "m.grib", *pair(1, level=300), *pair(2, level=500))
    assert catalogue_of(path, tmp_path).levels(0).tolist() == [30000.0, 50000.0]


def test_wind_speed_alone_is_said(tmp_path: Path) -> None:
    message = build(LATLON, field(), extra={"parameterNumber": 1})
    with pytest.raises(InputError, match="wind speed or direction, not u and v"):
        catalogue_of(write(tmp_path / "m.grib", message), tmp_path)


def test_a_grid_that_cannot_be_placed_is_named_as_people_do(tmp_path: Path) -> None:
    message = pair()[0]
    place = section(message, 3) + 12
    path = write(tmp_path / "m.grib", bent(message, place, (140).to_bytes(2, "big")))
    with pytest.raises(InputError, match="Lambert azimuthal equal area grid") as caught:
        catalogue_of(path, tmp_path)
    assert "grid grid" not in str(caught.value)
    assert "take the same model's files on one of them" in str(caught.value)


def reports(count: int = 50) -> xr.Dataset:
    rng = np.random.default_rng(2)
    return xr.Dataset(
        {
            "time": ("report", np.full(count, np.datetime64("2009-08-01T12:00", "ns"))),
            "latitude": ("report", rng.uniform(41.0, 59.0, count)),
            "longitude": ("report", rng.uniform(6.0, 34.0, count)),
            "pressure": ("report", np.full(count, 50000.0)),
        }
    )


def sampled(path: str, folder: Path, *, sparse: bool = True) -> tuple[np.ndarray, list[str]]:
    found = collocate(
        reports(), {"ref": catalogue_of(path, folder)}, sparse=sparse, account=True
    ).compute(scheduler="synchronous")
    speed = np.hypot(found["reference_eastward_wind"], found["reference_northward_wind"])
    return speed.to_numpy()[0], [reason for _, _, reason in found["problems"].item()]


@pytest.mark.parametrize("sparse", [True, False])
@pytest.mark.parametrize("shift", [4, 8, 64])
def test_a_scale_exponent_flipped_condemns_its_message(
    shift: int, sparse: bool, tmp_path: Path
) -> None:
    u, v = pair()
    place = section(u, 5) + 15
    exponent = int.from_bytes(u[place : place + 2], "big")
    sign = -1 if exponent >> 15 else 1
    new = sign * (exponent & 0x7FFF) + shift
    octets = (abs(new) | (0x8000 if new < 0 else 0)).to_bytes(2, "big")
    path = write(tmp_path / "m.grib", bent(u, place, octets), v)
    speed, problems = sampled(path, tmp_path, sparse=sparse)
    assert np.isnan(speed).all()
    assert any("which no atmosphere has" in reason for reason in problems)


def test_a_jet_stream_is_none_of_that(tmp_path: Path) -> None:
    jet = 115.0 * np.exp(-(((np.arange(SIZE) // LATLON["Ni"]) - 5.0) ** 2) / 4.0) - 20.0
    u = build(LATLON, jet, parameter="u", level=500)
    v = build(LATLON, -30.0 * np.ones(SIZE) + field(3), parameter="v", level=500)
    speed, problems = sampled(write(tmp_path / "m.grib", u, v), tmp_path)
    assert not problems
    assert np.isfinite(speed).all()


PACKINGS = [
    (2, "grid_complex"),
    (2, "grid_complex_spatial_differencing"),
    (2, "grid_png"),
    (2, "grid_jpeg"),
    (2, "grid_ccsds"),
    (2, "grid_ieee"),
    (1, "grid_second_order"),
]
PLANE = 10.0 + 8.0 * np.sin(np.arange(LAMBERT["Nx"] * LAMBERT["Ny"]) / 9.0)


@pytest.mark.parametrize(("edition", "packing"), PACKINGS)
def test_every_packing_is_decoded_wherever_it_is(
    edition: int, packing: str, tmp_path: Path
) -> None:
    message = build(LAMBERT, PLANE, edition=edition, packing=packing)
    path = write(tmp_path / "m.grib", message)
    (row,) = scan_file(path).table()
    every = np.arange(PLANE.size)
    descriptor = os.open(path, os.O_RDONLY)
    try:
        here = field_values(descriptor, row, PLANE.size, every, sparse=False)
        single = _message_bytes(descriptor, row)
    finally:
        os.close(descriptor)
    beside = decoder.decode_beside(single, PLANE.size, every)
    np.testing.assert_array_equal(here, beside)
    np.testing.assert_allclose(here, PLANE, atol=0.01)


def test_a_decoder_that_dies_is_started_anew(tmp_path: Path) -> None:
    """An abort costs one message; so does nothing where the system ended the decoder."""
    message = build(LATLON, field(), packing="grid_ccsds")
    path = write(tmp_path / "m.grib", message)
    (row,) = scan_file(path).table()
    descriptor = os.open(path, os.O_RDONLY)
    sound = _message_bytes(descriptor, row)
    os.close(descriptor)
    points = np.arange(5)
    first = decoder.decode_beside(sound, SIZE, points)
    (waiting,) = decoder._POOL._idle[-1:]
    os.kill(waiting._process.pid, signal.SIGKILL)
    np.testing.assert_array_equal(decoder.decode_beside(sound, SIZE, points), first)
    png = build(LAMBERT, PLANE, packing="grid_png")
    deadly = bent(png, section(png, 5) + 19, b"\x08")  # another depth than the stream's
    with pytest.raises(UnreadableMessageError, match="ends the decoder"):
        decoder.decode_beside(deadly, PLANE.size, points)
    np.testing.assert_array_equal(decoder.decode_beside(sound, SIZE, points), first)


def test_a_decoder_ends_with_its_process(tmp_path: Path) -> None:
    made = decoder._Decoder()
    made.close()
    deadline = time.monotonic() + 5.0
    while made._process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert made._process.returncode == 0


def test_a_file_replaced_under_the_same_time_gives_no_wind(tmp_path: Path) -> None:
    path = Path(write(tmp_path / "m.grib", *pair()))
    catalogue = catalogue_of(str(path), tmp_path)
    status = path.stat()
    path.write_bytes(bytes(status.st_size))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    found = collocate(reports(), {"ref": catalogue}).compute(scheduler="synchronous")
    assert found["reference_eastward_wind"].isnull().all()
    assert found["unread_messages"].item() == 2
