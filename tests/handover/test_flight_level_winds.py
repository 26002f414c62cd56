"""Model winds at flight levels paired with corrected ones: boxes by hand, a bias followed."""

import numpy as np
import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.handover.forecasts.correcting import TIME
from airswing.handover.forecasts.forecast_pairs import flight_level_pairs
from tests.handover.archives import corrected


def archive(days, bias, *, count=12):
    """One aircraft in two boxes; the model's eastward wind too strong by a bias in the western."""
    size = days * count
    ds = corrected({"A": size})
    west = np.arange(size) % 2 == 0
    ds["longitude"] = ("report", np.where(west, -93.0, 179.0))
    ds["latitude"] = ("report", np.where(west, 42.0, -3.0))
    day = np.repeat(np.arange(days), count)
    start = np.datetime64("2008-07-01T03:00", "ns")
    hours = np.tile(np.arange(count), days)
    ds["time"] = ("report", start + day * np.timedelta64(1, "D") + hours * np.timedelta64(1, "h"))
    u = ds["corrected_eastward_wind"].to_numpy() + np.where(west, bias, 0.0)
    v = ds["corrected_northward_wind"].to_numpy()
    headings = ds.assign(
        reference_eastward_wind=(("reference", "report"), u[None]),
        reference_northward_wind=(("reference", "report"), v[None]),
    ).assign_coords(reference=["ruc"])
    return headings, ds


def test_boxes_by_hand():
    headings, ds = archive(3, 2.0)
    found = flight_level_pairs(headings, ds, ["ruc"], region=5.0, fewest=6)
    assert found.sizes == {"variable": 2, "station": 2, TIME: 3, "lead": 1}
    chosen = found.sel(station="0450_hPa_42.5N_92.5W", variable="eastward_wind")
    np.testing.assert_allclose(chosen["forecast"] - chosen["observation"], 2.0)
    assert chosen["pressure"].item() == 45_000.0
    assert (chosen["latitude"].item(), chosen["longitude"].item()) == (42.5, -92.5)
    other = found.sel(station="0450_hPa_2.5S_177.5E", variable="eastward_wind")
    np.testing.assert_allclose(other["forecast"], other["observation"])


def test_uncorrected_winds_and_thin_boxes_do_not_count():
    headings, ds = archive(3, 2.0)
    ds["correction_applied"] = xr.where(ds["longitude"] > 0, 1, 0).astype(np.int8)
    found = flight_level_pairs(headings, ds, ["ruc"], region=5.0, fewest=6)
    assert found["station"].to_numpy().tolist() == ["0450_hPa_42.5N_92.5W"]
    with pytest.raises(InputError, match="no box of 5 degrees has 7"):
        flight_level_pairs(headings, ds, ["ruc"], region=5.0, fewest=7)
