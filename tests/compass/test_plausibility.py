"""Each usual mistake is named, also by a run, and sound archives are not suspected."""

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing import collocate, derive_headings, fleet_wind, read_reports
from airswing.compass.plausibility import (
    heading_kind_warnings,
    plausibility,
    plausibility_warnings,
    taken_for,
    with_implausible,
)
from airswing.evaluation import Evaluation
from airswing.flags import STATUS
from airswing.physics.atmosphere import pressure_from_altitude, standard_temperature
from airswing.products.netcdf import read_product
from airswing.synthetic.mode_s import write_mode_s
from airswing.units import FOOT, KNOT, ZERO_CELSIUS
from tests.command import configured
from tests.ragged import ragged

AIRCRAFT, FLIGHTS, REPORTS = 4, 6, 40


def archive(change=dict, *, temperature=True):
    """Headings of made flights at all levels in winds of 20 m/s, with errors of 2 m/s."""
    rng = np.random.default_rng(7)
    size = AIRCRAFT * FLIGHTS * REPORTS
    flight = np.repeat(np.arange(AIRCRAFT * FLIGHTS), REPORTS)
    altitude = np.tile(np.interp(np.arange(REPORTS), [0, 12, 28, 39], [600, 9e3, 9e3, 900]), 24)
    angle = rng.normal(270.0, 40.0, AIRCRAFT * FLIGHTS)[flight]
    reference = speed_and_direction({"direction": angle, "speed": 8.0 + 2e-3 * altitude})
    wind = reference + rng.normal(0, 1.5, size) + 1j * rng.normal(0, 1.5, size)
    course = np.radians(rng.uniform(0, 360, AIRCRAFT * FLIGHTS))[flight]
    airspeed = 120.0 + 0.01 * altitude
    ground = airspeed * np.exp(1j * (np.pi / 2 - course)) + reference
    seconds = np.tile(np.arange(REPORTS) * 120.0, 24) + flight * 86400.0
    way = np.cumsum(ground * 120.0) - (np.cumsum(ground * 120.0))[flight * REPORTS]
    fields = {
        **polar(wind),
        "pressure_altitude": altitude,
        "air_temperature": standard_temperature(altitude) + rng.normal(4.0, 2.0, size),
        "reported_airspeed": airspeed * (1 + rng.normal(0, 0.01, size)),
        "reported_heading": np.degrees(course) % 360.0,
        "ground": ground,
        "reference": reference,
    }
    fields = {**fields, **change(fields)}
    if not temperature:
        fields["air_temperature"] = np.full(size, np.nan)
    columns = {
        "latitude": 40.0 + way.imag / 111_195.0,
        "longitude": -90.0 + way.real / (111_195.0 * np.cos(np.radians(40.0))),
        "flight": flight,
        "declination": np.full(size, -14.0),
        "wind_source": fields.get("wind_source", np.zeros(size)),
    }
    names = ("pressure_altitude", "air_temperature", "reported_airspeed", "reported_heading")
    columns |= {name: fields[name] for name in names}
    winds = speed_and_direction(fields), fields["reference"], fields["ground"]
    return headings(seconds, *winds, columns, "ABCD")


def headings(seconds, wind, reference, ground, columns, aircraft):
    """Dataset of aircraft with equal numbers of reports; vectors are complex, east + i north."""
    columns = columns | {
        "time": np.datetime64("2009-01-05", "ns") + (seconds * 1e9).astype("m8[ns]"),
        "eastward_wind": wind.real,
        "northward_wind": wind.imag,
        "ground_eastward_velocity": ground.real,
        "ground_northward_velocity": ground.imag,
        "reference_eastward_wind": reference.real[None],
        "reference_northward_wind": reference.imag[None],
    }
    return ragged(columns, np.full(len(aircraft), seconds.size // len(aircraft)), aircraft, ["ruc"])


def polar(wind):
    """Speed and direction of a complex wind."""
    return {"speed": np.abs(wind), "direction": (270.0 - np.degrees(np.angle(wind))) % 360.0}


def speed_and_direction(fields):
    return fields["speed"] * np.exp(1j * np.radians(270.0 - fields["direction"]))


def triangle(heading=np.asarray, track=np.asarray, ground=1.0):
    """Winds derived from headings, airspeeds and ground vectors with a mistake in one of them."""

    def change(fields):
        reported = heading(fields["reported_heading"])
        derived_track = track(np.degrees(np.pi / 2 - np.angle(fields["ground"])) % 360.0)
        wind = ground * np.abs(fields["ground"]) * np.exp(1j * np.radians(90 - derived_track))
        wind = wind - fields["reported_airspeed"] * np.exp(1j * np.radians(90 - reported))
        wind[(np.abs(wind) > 150.0) | (derived_track > 360.0)] = np.nan  # as on reading
        return polar(wind) | {"reported_heading": reported, "wind_source": np.ones(wind.size)}

    return change


def scaled(name, factor):
    return lambda fields: {name: factor * fields[name]}


def with_direction(function):
    return lambda fields: {"direction": function(fields["direction"])}


def celsius(function):
    return lambda fields: {
        "air_temperature": ZERO_CELSIUS + function(fields["air_temperature"] - ZERO_CELSIUS)
    }


def indicated(fields):
    altitude = fields["pressure_altitude"]
    density = pressure_from_altitude(altitude) / standard_temperature(altitude) * 288.15 / 101325.0
    return {"reported_airspeed": fields["reported_airspeed"] * np.sqrt(density)}


def test_sound_reports_are_plausible():
    assert plausibility(archive()) == []
    assert plausibility(archive(temperature=False)) == []


@pytest.mark.parametrize(
    ("change", "quantity", "likely"),
    [
        (scaled("speed", KNOT), "wind_speed", "values in m/s read as kt"),
        (scaled("speed", 3.6), "wind_speed", "values in km/h read as m/s"),
        (scaled("speed", 10.0), "wind_speed", "values in tenths"),
        (triangle(heading=np.radians), "reported_heading", "radians"),
        (triangle(heading=lambda angle: angle / 0.9), "reported_heading", "grads"),
        (triangle(heading=lambda angle: angle + 180.0), "reported_heading", "opposite"),
        (triangle(track=np.radians), "track", "radians"),
        (triangle(ground=KNOT), "ground_speed", "values in m/s read as kt"),
        (with_direction(lambda angle: angle / 10.0), "wind_direction", "tens of degrees"),
        (with_direction(lambda angle: (angle + 180.0) % 360.0), "wind_direction", "opposite"),
        (with_direction(lambda angle: (90.0 - angle) % 360.0), "wind_direction", "exchanged"),
        (with_direction(lambda angle: angle % 256.0), "wind_direction", "part of the circle"),
        (scaled("pressure_altitude", FOOT), "pressure_altitude", "values in m read as ft"),
        (scaled("pressure_altitude", 0.01), "pressure_altitude", "flight levels read as ft"),
        (celsius(lambda t: 1.8 * t + 32.0), "air_temperature", "Fahrenheit"),
        (celsius(np.abs), "air_temperature", "minus signs"),
        (scaled("reported_airspeed", KNOT), "reported_airspeed", "values in m/s read as kt"),
        (indicated, "reported_airspeed", "indicated airspeeds"),
        (scaled("ground", KNOT), "ground_speed", "values in m/s read as kt"),
    ],
)
def test_each_mistake_is_named_for_the_whole_fleet(change, quantity, likely):
    (finding,) = plausibility(archive(change))
    assert (finding.quantity, finding.share) == (quantity, 1.0)
    assert likely in finding.likely
    assert "all aircraft" in str(finding)


@pytest.mark.parametrize("factor", [1.0, KNOT])
def test_metres_for_feet_are_named_before_the_winds_at_wrong_levels(factor):
    def change(fields):
        height = fields["pressure_altitude"]
        # the reference is that of the reported level
        low = (8.0 + 2e-3 * FOOT * height) / (8.0 + 2e-3 * height)
        return {
            "pressure_altitude": FOOT * height,
            "reference": low * fields["reference"],
            "reported_heading": np.full(low.size, np.nan),
            "speed": factor * fields["speed"],
        }

    (finding,) = plausibility(archive(change))
    assert (finding.quantity, finding.likely) == ("pressure_altitude", "values in m read as ft")


def test_without_temperatures_the_speed_at_the_level_shows_metres_under_feet():
    fast = archive(
        lambda fields: {
            "pressure_altitude": FOOT * fields["pressure_altitude"],
            "ground": 1.15 * fields["ground"],
            "reported_airspeed": np.full(fields["speed"].size, np.nan),
        },
        temperature=False,
    )
    (finding,) = plausibility(fast)
    assert (finding.quantity, finding.likely) == ("pressure_altitude", "values in m read as ft")


def test_single_aircraft_are_named_and_aircraft_with_few_reports_are_pooled():
    first = np.arange(AIRCRAFT * FLIGHTS * REPORTS) < FLIGHTS * REPORTS
    (finding,) = plausibility(archive(scaled("speed", np.where(first, KNOT, 1.0))))
    assert finding.aircraft == ("A",)
    short = archive(scaled("speed", KNOT)).drop_dims("aircraft")
    short = short.assign_coords(aircraft=[f"T{n}" for n in range(48)])
    (finding,) = plausibility(short.assign(row_size=("aircraft", np.full(48, 20))))
    assert len(finding.aircraft) == 48


@pytest.mark.parametrize(
    ("turn", "likely"),
    [(14.0, "headings taken for true are magnetic"), (-14.0, "taken for magnetic are true")],
)
def test_magnetic_headings_taken_for_true_are_named_and_the_reverse(turn, likely):
    values = {"offset": turn, "offset_standard_error": 0.3, "status": STATUS["ok"]}
    data = {name: (("reference", "aircraft"), np.full((1, 4), x)) for name, x in values.items()}
    data["mean_declination"] = "aircraft", np.full(4, -14.0)
    (sentence,) = heading_kind_warnings(xr.Dataset(data, {"reference": ["ruc"]}), "ruc")
    assert likely in sentence


@pytest.mark.parametrize(
    ("sign", "expected"), [(-1.0, "magnetic_for_true"), (1.0, "true_for_magnetic"), (0.0, "")]
)
def test_offsets_equal_to_the_declination_are_recognised(sign, expected):
    rng = np.random.default_rng(4)
    for _ in range(50):
        declination = rng.uniform(-14, -7) + rng.normal(0, 1, 8)
        offset = rng.normal(0, 0.7) + rng.normal(0, 0.7, 8) + sign * declination
        assert taken_for(offset, np.full(8, 0.3), declination) == expected
    assert taken_for([sign * 12.0], [0.1], [12.0]) == expected  # one aircraft
    # Netherlands 2017, 0.9 degrees east: offsets of Mode-S aircraft are as large
    assert not taken_for(rng.normal(0, 0.7, 50), np.full(50, 0.2), np.full(50, 0.9))


@pytest.mark.parametrize(("ahead", "evidence"), [(0.0, ""), (-5.0, "later"), (7.0, "earlier")])
def test_clocks_of_another_time_zone(ahead, evidence):
    """Flights on one route every three hours for 20 days, in weather that changes within a day."""
    rng = np.random.default_rng(2)
    hours = np.repeat(np.arange(160) * 3.0, 10) + np.tile(np.arange(10) / 30.0, 160)
    phase = np.cumsum(rng.normal(0.0, 0.1, 5000))

    def weather(hour):
        return 15.0 * np.exp(1j * np.interp(hour + 50.0, np.arange(5000) / 5.0, phase))

    reference = weather(hours)
    wind = weather(hours - ahead) + rng.normal(0, 1.5, 1600) + 1j * rng.normal(0, 1.5, 1600)
    ground = 200.0 * np.exp(1j * np.repeat(np.tile([0.3, 3.4], 80), 10))
    columns = {
        "latitude": 40.0 + np.tile(np.arange(10) * 0.01, 160),
        "longitude": np.full(1600, -90.0),
        "flight": np.repeat(np.arange(160), 10),
        "pressure_altitude": np.full(1600, 2000.0),
        "wind_source": np.zeros(1600),
    }
    ds = headings(3600.0 * hours, wind, reference, ground, columns, ("A",))
    clock = [finding for finding in plausibility(ds) if finding.quantity == "time"]
    assert all(evidence in finding.evidence for finding in clock)
    assert len(clock) == (evidence != "")


def test_implausible_aircraft_get_a_status_and_a_warning():
    status = (("reference", "aircraft"), np.array([[0, 1, 4, 7, 0]], dtype=np.int8))
    fits = xr.Dataset({"status": status}, coords={"reference": ["ruc"], "aircraft": list("ABCDE")})
    marked = with_implausible(fits, plausibility(archive(scaled("speed", KNOT))))
    implausible = STATUS["implausible_reports"]
    assert marked["status"].values.tolist() == [[implausible, 1, implausible, implausible, 0]]
    assert marked["status"].dtype == np.int8
    (sentence,) = plausibility_warnings(marked)
    assert "wind speeds of all aircraft" in sentence and "m/s read as kt" in sentence
    assert plausibility_warnings(with_implausible(fits, [])) == []


@pytest.mark.parametrize("amplitude", [25.0, 30.0])
@pytest.mark.parametrize("strength", [1.0, 0.3])
def test_large_deviations_and_weak_winds_are_not_taken_for_wrong_units(amplitude, strength):
    def deviated(fields):
        wind = strength * speed_and_direction(fields)
        air = fields["ground"] - wind
        heading = np.pi / 2 - np.angle(air)
        biased = fields["ground"] - air * np.exp(-1j * np.radians(amplitude) * np.sin(heading))
        unknown = np.full(wind.size, np.nan)
        reference = strength * fields["reference"]
        return polar(biased) | {"reference": reference, "reported_heading": unknown}

    assert plausibility(archive(deviated)) == []


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("modes/mpm_20170111_12z_aggregated.csv", marks=pytest.mark.slow),
        pytest.param("reports/acars_19990209_14z.nc", marks=pytest.mark.slow),
        "reports/madis_acars_20050826_00z.nc.gz",
        pytest.param("reports/amdar_20090123_europe.bufr", marks=pytest.mark.slow),
    ],
)
def test_no_false_alarm_on_real_reports(real, name):
    reports = read_reports(real(name))
    winds = collocate(reports, {"fleet": fleet_wind(reports)})
    assert plausibility(derive_headings(reports, winds)) == []


def test_a_run_warns_of_magnetic_headings_taken_for_true(tmp_path, blank_cards, monkeypatch):
    # no cards, no evaluation and no page: what a run says comes before them
    monkeypatch.setattr("airswing.workflow.main.make_evaluation", lambda *_: Evaluation())
    monkeypatch.setattr("airswing.report.run.page.write_page", lambda *_, **__: None)
    write_mode_s(tmp_path, flights=10)
    warnings = []
    for output, columns in (("right", {}), ("wrong", {"heading": "heading_deg"})):
        reports = {"files": str(tmp_path / "mode_s.csv"), "interval": "60 s", "columns": columns}
        phases = {"phases": ["ascent", "cruise", "descent", "unknown"]}
        sections = {"screening": phases, "fit": {"min_reports": 100}, "output": output}
        path = configured(tmp_path, reports, {"era5": tmp_path / "era5.nc"}, **sections)
        run_warnings = airswing.run(path).summary["warnings"]
        warnings.append([line for line in run_warnings if "declination" in line])
    assert warnings[0] == []
    assert "headings taken for true are magnetic" in warnings[1][0] and len(warnings[1]) == 1
    fits = read_product(tmp_path / "right/fits.nc").isel(reference=0)
    fits = fits.sel(aircraft=["a00004", "a00005", "a00006"])
    assert (abs(fits["offset"] - [2.1, -1.4, 0.9]) < 3 * fits["offset_standard_error"]).all()
