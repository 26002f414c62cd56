"""What is written is read back: by eccodes, by cfgrib, value by value and key by key."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import eccodes
import numpy as np
import pytest

from airswing.synthetic.fields import (
    GRIB1_RADIUS,
    GRIB2_RADIUS,
    GriddedReference,
    centred_grid,
    write_reference,
)

START = datetime(2009, 10, 19)
LEVELS = np.array([850.0, 500.0])
HOURS = np.array([22.0, 23.0, 24.0, 25.0])
CASES = [
    (1, "grid_simple", 1e-4),
    (2, "grid_simple", 1e-5),
    (2, "grid_complex_spatial_differencing", 0.1),
    (2, "grid_ccsds", 0.1),
    (2, "grid_jpeg", 1e-5),
]


def fields(edition: int, *, flag: bool) -> GriddedReference:
    grid = centred_grid(
        43.0,
        -86.0,
        columns=14,
        rows=11,
        spacing=40635.0,
        radius=GRIB1_RADIUS if edition == 1 else GRIB2_RADIUS,
    )
    wind = np.random.default_rng(2).normal(5, 20, (4, 2, 2, 11, 14)).round(1).astype(np.float32)
    return GriddedReference("ruc", grid, LEVELS, HOURS, wind, flag)


def messages(path: Path) -> list[dict[str, object]]:
    keys = (
        *("shortName", "level", "typeOfLevel", "validityDate", "validityTime", "endStep"),
        *("uvRelativeToGrid", "gridType", "radius", "editionNumber"),
    )
    found = []
    with path.open("rb") as source:
        while (handle := eccodes.codes_grib_new_from_file(source)) is not None:
            message = {key: eccodes.codes_get(handle, key) for key in keys}
            for key in ("values", "latitudes", "longitudes"):
                message[key] = eccodes.codes_get_array(handle, key)
            found.append(message)
            eccodes.codes_release(handle)
    return found


@pytest.mark.parametrize(("edition", "packing", "tolerance"), CASES)
@pytest.mark.parametrize("flag", [True, False])
def test_eccodes_reads_what_was_written(
    tmp_path: Path, edition: int, packing: str, tolerance: float, flag: bool
) -> None:
    made = fields(edition, flag=flag)
    paths = write_reference(
        tmp_path, made, start=START, edition=edition, lead_hours=2, packing=packing
    )
    assert len(paths) == 4
    for step, path in enumerate(paths):
        found = messages(path)
        assert [(item["shortName"], item["level"]) for item in found] == [
            ("u", 850),
            ("v", 850),
            ("u", 500),
            ("v", 500),
        ]
        for number, item in enumerate(found):
            expected = made.wind[step, number % 2, number // 2].ravel()
            np.testing.assert_allclose(item["values"], expected, atol=tolerance)
            assert item["uvRelativeToGrid"] == int(flag)
            assert (item["gridType"], item["typeOfLevel"]) == ("lambert", "isobaricInhPa")
            assert (item["radius"], item["endStep"]) == (made.grid.radius, 2)
            assert item["editionNumber"] == edition
    late = messages(paths[2])[0]
    assert (late["validityDate"], late["validityTime"]) == (20091020, 0)


@pytest.mark.parametrize("edition", [1, 2])
def test_eccodes_places_the_grid_where_we_do(tmp_path: Path, edition: int) -> None:
    made = fields(edition, flag=True)
    path = write_reference(tmp_path, made, start=START, edition=edition, lead_hours=1)[0]
    first = messages(path)[0]
    lat, lon = made.grid.coordinates
    np.testing.assert_allclose(first["latitudes"], lat.ravel(), atol=1e-6)
    east = np.asarray(first["longitudes"])
    np.testing.assert_allclose((east + 180) % 360 - 180, lon.ravel(), atol=1e-6)


@pytest.mark.parametrize("edition", [1, 2])
def test_cfgrib_reads_several_times_in_one_file(tmp_path: Path, edition: int) -> None:
    import xarray as xr

    made = fields(edition, flag=True)
    paths = write_reference(
        tmp_path, made, start=START, edition=edition, lead_hours=3, times_per_file=4
    )
    assert len(paths) == 1
    data = xr.open_dataset(paths[0], engine="cfgrib", backend_kwargs={"indexpath": ""})
    np.testing.assert_allclose(data["u"].values, made.wind[:, 0], atol=1e-4)
    np.testing.assert_allclose(data["v"].values, made.wind[:, 1], atol=1e-4)
    assert str(data["valid_time"].values[3])[:16] == "2009-10-20T01:00"
