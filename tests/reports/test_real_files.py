"""Real files of others: Mode-S against its authors' winds, TAMDAR against soundings."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from pyproj import Geod

from airswing.reports import read_reports

GEOD = Geod(ellps="WGS84")
MODES = "modes/mpm_20170111_12z_aggregated.csv"
THEIR_WINDS = "modes/mpm_20170111_12z_wind.csv"
TAMDAR = "reports/madis_acars_20050826_00z.nc.gz"
SOUNDINGS = "reports/madis_rawin_20050826_00z.nc.gz"


def test_real_mode_s_winds_are_the_authors_with_declination_zero(
    tmp_path: Path, real: Callable[[str], Path]
):
    """They took the magnetic heading for true, indicated airspeed at the standard temperature."""
    raw = pd.read_csv(real(MODES))
    theirs = pd.read_csv(real(THEIR_WINDS)).drop_duplicates(["ts", "icao"])
    columns = {
        "icao": "tail",
        "ts": "time",
        "lat": "latitude",
        "lon": "longitude",
        "alt": "pressure_altitude_ft",
        "hdg": "heading_deg",
        "ias": "indicated_airspeed_kt",
        "gs_adsb": "ground_speed_kt",
        "trk_adsb": "track_deg",
    }
    raw = raw.drop_duplicates(["ts", "icao"]).drop(columns=["mach", "tas", "gs", "trk"])
    raw = raw.rename(columns={"hdg": "told"})
    path = tmp_path / "as_true.csv"
    raw.to_csv(path, index=False)
    columns["told"] = columns.pop("hdg")
    ours = read_reports(path, columns=columns)
    frame = pd.DataFrame(
        {
            "icao": np.repeat(ours["aircraft"].values, ours["row_size"].values),
            "ts": ours["time"].values.astype("datetime64[ns]").astype(float) / 1e9,
            "u": ours["eastward_wind"].values,
            "v": ours["northward_wind"].values,
        }
    )
    both = theirs.assign(ts=theirs["ts"].round(1)).merge(
        frame.assign(ts=frame["ts"].round(1)), on=["ts", "icao"]
    )
    apart = np.hypot(both["u"] - both["vwx"], both["v"] - both["vwy"]).dropna()
    assert apart.size > 39_000
    assert np.median(apart) < 0.015  # they round to 0.01 m/s
    assert np.quantile(apart, 0.9) < 0.04


def test_real_mode_s_is_understood_as_it_stands(real: Callable[[str], Path]):
    reports = read_reports(real(MODES))
    assert reports.sizes["aircraft"] == 296
    derived = reports["wind_source"].values > 0
    assert derived.sum() > 40_000
    heading = reports["reported_heading"].values
    assert np.isfinite(heading[derived]).all()


def test_real_tamdar_winds_are_those_of_the_soundings_of_the_same_hour(
    tmp_path: Path, real: Callable[[str], Path]
):
    """878 reports of summer's weak winds, 473 of them within 150 km of a sounding."""
    reports = read_reports(real(TAMDAR), columns={"source": {"only": "TAMDAR"}})
    theirs, ours = [], []
    for _, one in sounding_winds(real(SOUNDINGS), tmp_path):
        place = (one["latitude"], one["longitude"])
        _, _, away = GEOD.inv(
            reports.longitude.values.astype(float),
            reports.latitude.values.astype(float),
            np.full(reports.sizes["report"], place[1]),
            np.full(reports.sizes["report"], place[0]),
        )
        height = np.log(reports.pressure.values.astype(float))
        near = (away < 150e3) & (height >= one["ln_p"][0]) & (height <= one["ln_p"][-1])
        for wind in ("eastward_wind", "northward_wind"):
            theirs.append(np.interp(height[near], one["ln_p"], one[wind]))
            ours.append(reports[wind].values[near])
    truth, found = np.concatenate(theirs), np.concatenate(ours)
    known = np.isfinite(found)
    truth, found = truth[known], found[known]
    assert found.size > 2 * 400
    assert abs((found - truth).mean()) < 0.3
    # over 100 km apart on the whole: winds from the opposite direction would differ by 6.9 m/s
    assert np.sqrt(((found - truth) ** 2).mean()) < 4.0
    assert np.sqrt(((found + truth) ** 2).mean()) > 6.0
    assert np.corrcoef(found, truth)[0, 1] > 0.6


def sounding_winds(path: Path, folder: Path):
    """Winds on the mandatory levels of every sounding, from the lowest pressure up."""
    plain = folder / "soundings.nc"
    plain.write_bytes(gzip.decompress(path.read_bytes()))
    with xr.open_dataset(plain, decode_times=False) as ds:
        table = {name: ds[name].values for name in ("staLat", "staLon", "prMan", "wsMan", "wdMan")}
    for number in range(table["staLat"].size):
        p, speed, angle = (table[name][number] for name in ("prMan", "wsMan", "wdMan"))
        good = (p > 1) & (p < 1200) & (speed < 150) & (angle <= 360)
        if good.sum() < 2:
            continue
        order = np.flatnonzero(good)[np.argsort(p[good])]
        turn = np.radians(angle[order])
        yield (
            number,
            {
                "latitude": float(table["staLat"][number]),
                "longitude": float(table["staLon"][number]),
                "ln_p": np.log(p[order] * 100.0),
                "eastward_wind": -speed[order] * np.sin(turn),
                "northward_wind": -speed[order] * np.cos(turn),
            },
        )
