"""A real file of decoded Mode-S messages against the winds of its authors."""

import numpy as np
import pandas as pd

from airswing.reports import read_file
from tests.reports.tables import write


def test_real_mode_s_winds_are_the_authors_with_declination_zero(tmp_path, real):
    """They took the magnetic heading for true, indicated airspeed at the standard temperature."""
    raw = pd.read_csv(real("modes/mpm_20170111_12z_aggregated.csv"))
    theirs = pd.read_csv(real("modes/mpm_20170111_12z_wind.csv")).drop_duplicates(["ts", "icao"])
    names = {
        **{"icao": "tail", "ts": "time", "lat": "latitude", "lon": "longitude"},
        **{"alt": "pressure_altitude_ft", "hdg": "heading_deg", "ias": "indicated_airspeed_kt"},
        **{"gs_adsb": "ground_speed_kt", "trk_adsb": "track_deg"},
    }
    table = raw.drop_duplicates(["ts", "icao"])[list(names)].rename(columns=names)
    ours, _ = read_file(write(tmp_path / "as_true.csv", table))
    seconds = ours["time"].to_numpy().astype("datetime64[ns]").astype(float) / 1e9
    frame = ours.assign(ts=seconds.round(1), icao=ours["tail"].astype(str))
    both = theirs.assign(ts=theirs["ts"].round(1)).merge(frame, on=["ts", "icao"])
    apart = np.hypot(both["eastward_wind"] - both["vwx"], both["northward_wind"] - both["vwy"])
    apart = apart.dropna()
    assert apart.size > 39_000
    assert np.median(apart) < 0.015  # they round to 0.01 m/s
    assert np.quantile(apart, 0.9) < 0.04
