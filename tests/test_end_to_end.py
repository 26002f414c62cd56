"""The whole chain recovers known deviations when the model wind is the true wind.

Every grid, hemisphere and layout of files through the public stages, against the independent writer
of ``tests/perfect.py``. The fixes' resolution is the only source of error, so the tolerances are
hundredths of a degree; a wrong sign, rotation or date costs tenths.
"""

import numpy as np
import pandas as pd
import pytest

from airswing import workflow
from tests import perfect
from tests.command import configured

pytestmark = pytest.mark.usefixtures("blank_cards")


def fitted(folder, table, **reports):
    """Fits of the archive in a folder that has its model files."""
    perfect.write_reports(table, folder / "reports" / "r.csv")
    reports |= {"files": str(folder / "reports/*.csv")}
    job = workflow.Job.of(configured(folder, reports, {"model": folder / "model/*"}), quiet=True)
    headings = workflow.make_headings(job)
    assert int((headings["screening"] == 0).sum()) > 0.9 * len(table.drop_duplicates())
    return workflow.make_fits(job, headings)


def assert_found(fits, tolerance):
    for tail in fits["aircraft"].to_numpy():
        deviation = fits["deviation"].sel(reference="model", aircraft=tail).to_numpy()
        wanted = [*perfect.DEVIATIONS[str(tail)], 0.0, 0.0]
        np.testing.assert_allclose(deviation, wanted, atol=tolerance, err_msg=str(tail))
    assert (fits["status"] == 0).all()
    assert np.abs(fits["reference_bias"]).max() < 0.2 * tolerance + 0.005
    assert np.abs(fits["airspeed_scale"]).max() < 1e-3


GRIDS = {
    "ruc_grib1": {"layout": "blocks", "levels": (400, 600, 300, 500), "lead": 6},
    "greenwich_global": {},
    "europe_rotated": {"layout": "multi", "levels": perfect.LEVELS[::-1], "pascals": True},
    "fiji_mercator_across_180": {"layout": "apart"},
}


@pytest.mark.parametrize("name", GRIDS)
def test_deviations_are_recovered_on_every_grid_and_layout(tmp_path, name):
    place = perfect.PLACES[name]
    perfect.write_model(place, tmp_path / "model", **GRIDS[name])
    assert_found(fitted(tmp_path, perfect.fly(place, flights=18)), 0.01)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A model across the antimeridian, and reports of flights through it."""
    folder = tmp_path_factory.mktemp("alaska")
    place = perfect.PLACES["alaska_minus180"]
    perfect.write_model(place, folder / "model")
    return folder, perfect.fly(place)


def tenth_of_a_minute(table):
    rounded = {name: (table[name] * 600).round() / 600 for name in ("latitude", "longitude")}
    return table.assign(**rounded)


def whole_units(table):
    names = ("wind_direction_deg", "wind_speed_kt")
    return table.assign(**{name: table[name].round() for name in names})


def otherwise(table):
    """Pressures, m/s, longitudes from 0 to 360, rows in any order and twice, without phases."""
    values = {"p": perfect.pressure_of(table["pressure_altitude_ft"].to_numpy())}
    values |= {"ff": table["wind_speed_kt"] * perfect.KNOT, "longitude": table["longitude"] % 360}
    bare = table.drop(columns=["pressure_altitude_ft", "wind_speed_kt", "phase", "flight"])
    bare = bare.assign(**values)
    return pd.concat([bare, bare.iloc[::3]]).sample(frac=1, random_state=1)


OTHER_UNITS = {
    "p": {"name": "pressure_hPa", "unit": "Pa"},
    "ff": {"name": "wind_speed_kt", "unit": "m/s"},
}


@pytest.mark.parametrize(
    ("change", "tolerance"), [(tenth_of_a_minute, 0.02), (whole_units, 0.06), (otherwise, 0.01)]
)
def test_deviations_are_recovered_from_reports_in_other_units(flown, tmp_path, change, tolerance):
    folder, table = flown
    (tmp_path / "model").symlink_to(folder / "model")
    columns = OTHER_UNITS if change is otherwise else {}
    assert_found(fitted(tmp_path, change(table), columns=columns), tolerance)


def test_times_cut_to_the_minute_change_coefficients_by_less_than_a_twentieth(tmp_path):
    place = perfect.PLACES["ruc_grib1"]
    perfect.write_model(place, tmp_path / "model")
    table = perfect.fly(place, flights=50, reports=10, seconds=200)
    cut = tenth_of_a_minute(table.assign(time=table["time"].dt.floor("min")))
    assert_found(fitted(tmp_path, cut), 0.2)
