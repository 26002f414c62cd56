"""Real files of others: Mode-S against its authors' winds, TAMDAR against soundings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from airswing.reports import read_reports

MODES = "modes/mpm_20170111_12z_aggregated.csv"
THEIR_WINDS = "modes/mpm_20170111_12z_wind.csv"


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
