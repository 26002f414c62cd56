"""Known effects are removed exactly; reports of another simulation are matched."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from tests.gap import frames

from airswing.errors import InputError
from airswing.flags import STATUS
from airswing.gap.effects import ActiveEffect
from airswing.gap.simulation.effects_file import effects_of_fits, read_known, write_effects
from airswing.gap.simulation.forward import remove_effects, simulate
from airswing.gap.simulation.report_table import match_reports, with_simulated_wind
from airswing.products.netcdf import write_product

START = frames.START.astype("datetime64[s]").astype(float)


def table(component, variable, edges, values, tails=None):
    """Return a table over one variable as an effect."""
    parameters = {"component": component, "variables": [variable], "edges": [edges]}
    return ActiveEffect("empirical", parameters | {"values": values}, tails)


ONE = {
    "sensors": [
        ActiveEffect("hard_iron", {"amplitude_deg": 6.0, "phase_deg": 50.0}, ("N401",)),
        ActiveEffect("soft_iron", {"amplitude_deg": 2.0, "phase_deg": -20.0}),
        ActiveEffect("tas_scale", {"scale_percent": 4.0}, ("N401", "N402")),
        ActiveEffect("compass_step", {"offset_deg": 3.0}, ("N403",), (START + 9 * 86400.0, None)),
    ],
    "reference": [ActiveEffect("reference_speed_bias", {"bias_percent": 8.0, "above_hPa": 600.0})],
    "tables": [
        table("across_heading", "latitude", [30.0, 41.0, 60.0], [0.0, 2.5], ("N401", "N402")),
        table("wind_factor", "hour", [0.0, 6.0, 12.0, 24.0], [8.0, 0.0, -5.0]),
        table("along_heading", "airspeed", [40.0, 120.0, 300.0], [-1.0, 1.5], ("N403",)),
        ActiveEffect("hard_iron", {"amplitude_deg": 6.0, "phase_deg": 50.0}, ("N401",)),
    ],
    "height": [ActiveEffect("altitude_offset", {"offset_ft": 400.0}, ("N402",))],
}


@pytest.mark.parametrize("name", ONE)
def test_simulated_effects_are_removed_to_rounding(name):
    perfect = frames.frame()
    sent = simulate(perfect, effects=ONE[name])
    assert np.hypot(*sent.residual.T).max() > 0.2
    removed = remove_effects(sent, ONE[name])
    residual = np.hypot(*removed.residual.T)
    assert residual.max() < 2e-6
    turned = np.angle(np.exp(1j * (removed.heading - perfect.heading)))
    if name in ("sensors", "tables"):
        assert np.abs(turned).max() < 1e-7
        assert removed.airspeed == pytest.approx(perfect.airspeed, abs=1e-5)


def test_a_table_over_the_reported_wind_is_removed():
    """Not for winds just below the upper edge, which are rotated beyond it."""
    perfect = frames.frame()
    edges = [0.0, 250.0, 270.0, 360.0]
    turned = [table("wind_angle", "wind_direction", edges, [0.0, 9.0, 0.0])]
    removed = remove_effects(simulate(perfect, effects=turned), turned)
    direction = np.degrees(np.arctan2(-perfect.u_rep, -perfect.v_rep)) % 360.0
    valid = (direction < 260.9) | (direction > 270.1)
    assert ((direction > 242.0) & valid).sum() > 100
    assert np.hypot(*removed.residual[valid].T).max() < 2e-6


def test_exchanged_identifiers_are_exchanged_back():
    perfect = frames.frame()
    swap = ActiveEffect(
        "tail_swap", {"pair": ["N401", "N402"]}, ("N401", "N402"), (START + 9 * 86400.0, None)
    )
    removed = remove_effects(perfect, [swap])
    late = perfect.time >= START + 9 * 86400.0
    exchanged = np.array([1, 0, 2])[perfect.aircraft]
    assert (removed.aircraft == np.where(late, exchanged, perfect.aircraft)).all()
    assert removed.u_rep == pytest.approx(perfect.u_rep, abs=1e-12)


def fits(status=STATUS["ok"]):
    values = np.array([[[1.5, 3.0, 4.0, 0.5, 0.0], [0.7, 1.0, 0.0, 0.0, 0.0]]])
    two = np.array([[0, status]], np.int8)
    return xr.Dataset(
        {
            "deviation": (("reference", "aircraft", "coefficient"), values),
            "airspeed_scale": (("reference", "aircraft"), np.array([[0.01, np.nan]])),
            "mean_horizontal_field": (("reference", "aircraft"), np.array([[18000.0, 19000.0]])),
            "status": (("reference", "aircraft"), two),
        },
        coords={"reference": ["ruc"], "aircraft": ["N401", "N402"], "coefficient": list("ABCDE")},
    )


def test_effects_of_a_fitted_curve_by_hand():
    found = effects_of_fits(fits(), reference="ruc")
    names = [(one.name, one.tails) for one in found]
    assert names == [
        ("compass_offset", ("N401",)),
        ("hard_iron", ("N401",)),
        ("soft_iron", ("N401",)),
        ("tas_scale", ("N401",)),
        ("compass_offset", ("N402",)),
        ("hard_iron", ("N402",)),
    ]
    iron = found[1].parameters
    # 3 sin m + 4 cos m = 5 sin(m + atan2(4, 3))
    assert iron["amplitude_deg"] == pytest.approx(5.0)
    assert iron["phase_deg"] == pytest.approx(np.degrees(np.arctan2(4, 3)))
    assert iron["at_horizontal_field_nT"] == 18000.0
    assert found[3].parameters["scale_percent"] == pytest.approx(1.0)


def test_the_removed_curve_is_the_fitted_curve():
    frame = frames.frame()
    removed = remove_effects(frame, effects_of_fits(fits(), reference="ruc")[:3])
    rows = frame.aircraft == 0
    m, field = frame.magnetic_heading[rows], frame.horizontal_field[rows]
    curve = 1.5 + 18000.0 / field * (3.0 * np.sin(m) + 4.0 * np.cos(m)) + 0.5 * np.sin(2 * m)
    turned = np.degrees(np.angle(np.exp(1j * (frame.heading - removed.heading))))[rows]
    assert turned == pytest.approx(curve, abs=1e-9)


def test_errors_for_files_without_known_effects(tmp_path):
    with pytest.raises(InputError, match="no file of known effects"):
        read_known(tmp_path / "nothing.yaml", reference="ruc")
    with pytest.raises(InputError, match="no fit against the gap's reference") as caught:
        effects_of_fits(fits(), reference="rtfdaa", file=tmp_path / "fits.nc")
    assert "fitted were ruc" in str(caught.value)
    write_product(
        xr.Dataset({"latitude": ("report", [1.0])}),
        tmp_path / "other.nc",
        title="x",
        config_json="{}",
        sources=[],
    )
    with pytest.raises(InputError, match="holds no fitted deviations"):
        read_known(tmp_path / "other.nc", reference="ruc")
    unknown = [ActiveEffect("hard_iron", {"amplitude_deg": 1.0}, ("N999",))]
    write_effects(unknown, tmp_path / "effects.yaml")
    with pytest.raises(InputError, match="unknown aircraft"):
        remove_effects(frames.frame(), read_known(tmp_path / "effects.yaml", reference="ruc"))


def simulation(**changes):
    """Reports on the paths of the archive, with eastward winds 1 m/s stronger."""
    ds = frames.headings_dataset()
    return ds.assign(eastward_wind=ds.eastward_wind + 1.0, **changes)


def test_the_same_paths_match_report_by_report():
    frame = frames.frame()
    ds = simulation()
    minutes = ds.time.values.astype("datetime64[m]").astype("datetime64[ns]")
    for each in (ds.assign(time=("report", minutes)), ds):
        matched = match_reports(frame, each)
        assert matched.found.all() and matched.same_paths
        assert matched.u == pytest.approx(frame.u_rep + 1.0)
    against = with_simulated_wind(frame, matched)
    assert against.residual[:, 0] == pytest.approx(np.full(frame.size, -1.0))


def test_other_places_times_and_aircraft_do_not_match_and_are_left_out():
    frame = frames.frame()
    ds = simulation()
    displaced = match_reports(frame, ds.assign(latitude=ds.latitude + 0.1))
    later = match_reports(frame, ds.assign(time=ds.time + np.timedelta64(61, "s")))
    renamed = match_reports(frame, ds.assign_coords(aircraft=["N901", "N402", "N403"]))
    assert not displaced.found.any() and not later.found.any()
    assert (renamed.found == (frame.aircraft != 0)).all()
    with pytest.raises(InputError, match="no simulated report is of an aircraft and time"):
        with_simulated_wind(frame, displaced)
    late = ds.time > ds.time.quantile(0.6)
    matched = match_reports(frame, ds.assign(eastward_wind=ds.eastward_wind.where(late)))
    assert not matched.same_paths  # half of them have no wind
    assert with_simulated_wind(frame, matched).size == matched.found.sum()
    few = frame.take(np.arange(150))
    assert not match_reports(few, ds).same_paths  # all match, but 150 are too few
