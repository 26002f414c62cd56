"""Reject list, error table and JEDI tables; errors of single reports by leg, layer and aircraft."""

import csv
import json

import numpy as np
import pytest
import xarray as xr

import airswing
from airswing.config import Handover
from airswing.errors import InputError
from airswing.evaluation.innovations import LEVEL_EDGES_HPA
from airswing.flags import PHASE
from airswing.handover.error_tables import LEVELS, changed_table
from airswing.handover.reject_list import read_reject_list
from airswing.handover.wind_errors import table_error
from airswing.products.netcdf import write_product
from tests.handover import wrfda
from tests.handover.archives import corrected
from tests.handover.test_readers import golden
from tests.ragged import ragged

LIST = "lists/rap_current_bad_aircraft.txt"
HEADER = ";criteria: bias_S > 2, std_S > 5, bias_DIR > 7,\n; std_DIR > 30, std_W > 5, rms_W > 7\n"
HEADER += ";\n" * 14


def turned(degrees, speed=20.0):
    """Wind from the west turned clockwise by an angle."""
    angle = np.radians(270.0 + degrees)
    return np.stack([-speed * np.sin(angle), -speed * np.cos(angle)])


def run(folder, fleet, *, pressure=50000.0):
    """A run of some aircraft: name to (degrees as reported, degrees as corrected)."""
    fleet = dict(sorted(fleet.items()))
    degrees = np.repeat(np.array([*fleet.values()], float), 300, axis=0).T
    names = ("eastward_wind", "northward_wind")
    names = (*names, *(f"corrected_{name}" for name in names))
    winds = dict(zip(names, np.concatenate([turned(degree) for degree in degrees]), strict=True))
    ds = corrected(dict.fromkeys(fleet, 300), pressure=pressure, **winds)
    seconds = np.tile(np.arange(300) * 288, len(fleet)) * np.timedelta64(1, "s")
    ds["time"] = ("report", np.datetime64("2008-07-15", "ns") + seconds)
    u, v = turned(np.zeros((1, seconds.size)))
    references = {"reference_eastward_wind": u, "reference_northward_wind": v}
    headings = ds.assign(ragged(references, reference=["ruc"]))
    ds.attrs["correction_reference"] = "ruc"
    output = '{"references": {"ruc": {}}, "pool": {}}'
    write_product(ds, folder / "corrected.nc", title="corrected", config_json=output)
    write_product(headings, folder / "headings.nc", title="headings")
    write_errors(folder, dict.fromkeys(fleet, (3.0, 1.3)))
    return folder / "corrected.nc"


EDGES = np.array(LEVEL_EDGES_HPA) * 100.0
LAYERS = np.linspace(1.0, 1.7, EDGES.size - 1)
PHASES = ("all", "ascent", "cruise", "descent")


def write_errors(folder, aircraft, table=None, edges=EDGES, phases=PHASES):
    """Errors in m/s by aircraft and state, and by state, phase and layer.

    The default: 1.0, 1.1, ... m/s as corrected from the ground up, twice that as reported.
    """
    if table is None:
        table = np.repeat(np.stack([2.0 * LAYERS, LAYERS])[:, None], len(phases), axis=1)
    cell, measured = ("state", "flight_phase", "layer"), np.array(table)
    measured[:, 2, 0] = np.nan
    ds = xr.Dataset(
        {
            "observation_error": (cell, measured),
            "observation_error_filled": (cell, table),
            "fleet_observation_error": ("state", [2.6, 1.3]),
            "aircraft_observation_error": (("aircraft", "state"), [*aircraft.values()]),
            "observation_count": (cell[1:], np.full(measured.shape[1:], 1000)),
            "disagreement_rms": (cell, np.full(measured.shape, 3.0)),
            "median_wind_speed": ("layer", np.full(measured.shape[2], 10.0)),
            "layer_bottom_pressure": ("layer", edges[:-1]),
            "layer_top_pressure": ("layer", edges[1:]),
        },
        coords={"flight_phase": list(phases), "aircraft": list(aircraft)},
    ).assign_coords(state=["reported", "corrected"])
    order = {"layer": slice(None, None, -1), "flight_phase": [1, 0, *range(2, len(phases))]}
    shuffled = ds.transpose("layer", ...).isel(order)
    (folder / "observation_errors.nc").unlink(missing_ok=True)
    write_product(shuffled, folder / "observation_errors.nc", title="errors")


def test_the_real_list_is_understood(real):
    path = real(LIST)
    header, entries, criteria, _ = read_reject_list(path)
    lines = path.read_bytes().splitlines(keepends=True)
    assert header == b"".join(lines[:16])
    assert b"".join(entry.line for entry in entries) == b"".join(lines[16:])
    assert criteria["bias_DIR"] == 7.0 and criteria["rms_W"] == 7.0
    assert sum(bool(entry.identifier) for entry in entries) == 164
    by_name = {entry.identifier: entry for entry in entries}
    assert by_name["00000566"].reasons == ("bias_DIR",) and by_name["00000566"].flags == "W"
    assert by_name["00000506"].flags == "TWR"
    assert by_name["N174AA"].second == "YUZICORA" and by_name["N174AA"].flags == "T"
    # Of the five with a bias of direction, four are turboprops.
    assert sum("bias_DIR" in entry.reasons for entry in entries) == 5


def exported(product, to, base=None, name="out", **options):
    """Result of an export next to a product, based on a file or bytes, and the bytes written."""
    path = product.parent / name
    if isinstance(base, bytes):
        (product.parent / "base").write_bytes(base)
        base = product.parent / "base"
    options["settings"] = Handover(base=base)
    return airswing.export(product, to=to, path=path, **options), path.read_bytes()


def test_a_turboprop_comes_off_the_real_list(real, tmp_path):
    fleet = {"566": (9.0, 0.5), "00000784": (9.0, 8.0), "506": (12.0, 0.0), "N921DL": (0.0, 0.0)}
    product = run(tmp_path, {**fleet, "FINE": (0.0, 0.0)})
    done, after = exported(product, "reject_list", real(LIST))
    before, after = real(LIST).read_bytes().splitlines(), after.splitlines()
    assert after == [line for line in before if not line.startswith(b"00000566")]
    off = done["taken_off"][0]
    assert [entry["aircraft"] for entry in done["taken_off"]] == ["00000566"]
    assert off["reported"]["bias_DIR"] == pytest.approx(9.0, abs=0.01)
    assert off["reported"]["rms_W"] == pytest.approx(40.0 * np.sin(np.radians(4.5)), abs=0.01)
    assert off["reported_fails"] == ["bias_DIR"] and off["corrected_fails"] == []
    assert off["winds_a_day"] == pytest.approx(300.0, rel=0.01)
    assert done["winds_a_day_gained"] == off["winds_a_day"]
    why = {entry["aircraft"]: entry["why"] for entry in done["stay"]}
    assert "corrected winds fail too: bias_DIR 8.0" in why["00000784"]
    assert "resrch_T_W_R" in why["00000506"] and "md88_W" in why["N921DL"]
    assert why["00000808"] == "not in the archive"
    json.dumps(done)


def test_other_lines_are_unchanged_and_blank_identifiers_are_filled(tmp_path):
    rows = [
        "00000751  - W -      MDC00001  300 SAAB ( bias_DIR )\n",
        "00000752  T W - 9999          772  -0.8   0.9   1.8   3.1  13 SAAB ( std_T bias_DIR )\r\n",
        "00000753  - W -\n",
        "00000755  - W -      --------  100 SAAB ( std_T )\n",
        "00000756  - W -      --------  100 SAAB ( bias_DIR rms_W bias_X )\n",
        "; a remark\n",
        "another line\n",
        "\n",
        "N1        - X -\n",
        "00000754  - - R    1 --------  100 SAAB ( bias_RH )",
    ]
    fleet = dict.fromkeys(("00000751", "752", "753", "755", "756"), (9.0, 0.0))
    base = (HEADER + "".join(rows)).encode()
    done, after = exported(run(tmp_path, fleet), "reject_list", base)
    after = after.decode().removeprefix(HEADER).splitlines(keepends=True)
    assert after[0] == "00000752  T - - 9999 --------" + rows[1][29:]
    assert after[1] == "00000753  - W -      --------\n"
    assert after[2:] == rows[3:]
    off = {entry["aircraft"]: entry["still_rejected"] for entry in done["taken_off"]}
    assert off == {"00000751": "", "00000752": "T"}
    why = {entry["aircraft"]: entry["why"] for entry in done["stay"]}
    assert "gives no reason" in why["00000753"] and "another reason: std_T" in why["00000755"]
    assert why["00000756"] == "listed for another reason: bias_X"
    assert done["blank_identifiers_filled"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a reject list"),
        (HEADER + "nothing here\n", "not a reject list"),
        (";\n" * 16 + "00000751  - W -      MDC00001\n", "no criterion of wind"),
    ],
)
def test_other_files_are_no_reject_list(tmp_path, text, message):
    base = tmp_path / "list"
    base.write_text(text)
    with pytest.raises(InputError, match=f"{base}.*{message}"):
        read_reject_list(base)


def test_a_list_is_needed_and_nothing_is_written_over(tmp_path):
    product = run(tmp_path, {"A": (9.0, 0.0)})
    with pytest.raises(InputError, match="current list is needed"):
        exported(product, "reject_list")
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        exported(product, "reject_list", f"{HEADER}A         - W -      MDC00001\n".encode())
    assert (tmp_path / "out").read_text() == "mine"


def read_wind_tables(text):
    """Wind tables as OBSPROC reads them: 28 values of six columns by section and type."""
    tables, section, rows = {}, "", text.splitlines()
    for place, line in enumerate(rows):
        if "SENSOR ERRORS" in line:
            section = line.split("SENSOR")[0].split()[-1]
        label = line[42:].strip()
        if section in ("UV", "SPD", "DIR") and label in ("TAMDARS", "AIREPS"):
            wide = "".join(row[:42] for row in rows[place : place + 4])
            tables[section, label] = [float(wide[k : k + 6]) for k in range(0, 168, 6)]
    return tables


def test_error_table_holds_the_measured_errors(tmp_path, root):
    done, text = exported(run(tmp_path, {"A": (9.0, 0.0)}), "obs_errors")
    text = text.decode()
    original = (root / "pipeline/airswing/handover/data/obserr.txt").read_text()
    tables, before = read_wind_tables(text), read_wind_tables(original)
    assert before["UV", "TAMDARS"][6] == 3.6 and before["UV", "TAMDARS"][23] == 2.3
    # Layers run from 1100 to 200 hPa; 850 is the middle of the second, 1000 of the first.
    values = dict(zip(LEVELS, tables["UV", "TAMDARS"], strict=False))
    assert values[1000] == values[1100] == 1.0 and values[850] == 1.1 and values[300] == 1.65
    assert values[10] == values[150] == values[250] == 1.7  # of the nearest layer
    assert tables["UV", "TAMDARS"][26:] == before["UV", "TAMDARS"][26:]
    assert tables["SPD", "TAMDARS"] == tables["UV", "TAMDARS"]
    angle = dict(zip(LEVELS, tables["DIR", "TAMDARS"], strict=False))
    assert angle[1000] == pytest.approx(np.degrees(np.arctan(0.1)), abs=0.005)
    for section in ("UV", "SPD", "DIR"):
        assert tables[section, "AIREPS"] == before[section, "AIREPS"]
    pairs = zip(text.splitlines(), original.splitlines(), strict=True)
    assert sum(line != before for line, before in pairs) == 12  # four rows in three tables
    assert done["types"] == ["TAMDARS"] and "6.5 m/s" in done["notes"][0]


def test_other_files_are_no_error_table(tmp_path):
    with pytest.raises(InputError, match="not a table of observation errors"):
        exported(run(tmp_path, {"A": (9.0, 0.0)}), "obs_errors", b"no table\n")
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="no rows of UV AIREPS"):
        changed_table("1.0 \n", {"UV": {500: 1.0}}, ["AIREPS"])


def write_fits(folder):
    axes, curve = ("reference", "aircraft", "coefficient"), [0.5, 2.0, -1.25, 0.0, 0.0]
    fits = xr.Dataset(
        {
            "deviation": (axes, [[curve, [np.nan] * 5]]),
            "airspeed_scale": (axes[:2], [[0.01, np.nan]]),
            "mean_horizontal_field": (axes[:2], [[19000.0, np.nan]]),
            "status": (axes[:2], np.array([[0, 1]], dtype=np.int8)),
        },
        coords={"reference": ["ruc"], "aircraft": ["A1", "B2"], "coefficient": list("ABCDE")},
    )
    write_product(fits, folder / "fits.nc", title="fits")


def jedi_table(path):
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    return rows[:2], {(row[0], float(row[1])): float(row[2]) for row in rows[2:]}


def test_jedi_tables_have_the_layout_of_real_ones(tmp_path, real):
    product = run(tmp_path, {"A1": (9.0, 0.0), "B2": (1.0, 0.0)})
    write_fits(tmp_path)
    done = airswing.export(product, to="jedi", path=tmp_path / "jedi")
    with open(real("lists/aircraft_abias_air_constant.2021121115.csv"), newline="") as file:
        theirs = [next(csv.reader(file)) for _ in range(4)]
    (names, types), table = jedi_table(tmp_path / "jedi" / "wind_error_windEastward.csv")
    assert names[0] == theirs[0][0] and types[0] == theirs[1][0] == "string"
    assert names[1:] == ["MetaData/pressure", "ErrorVariance/windEastward"]
    assert types[1:] == ["float", "float"]
    # The identifiers of ioda-converters have eight characters.
    assert {len(row) for row, _ in table if row.strip() != row} == {8} == {len("A1      ")}
    assert {row for row, _ in table} == {"_", "A1", "A1      ", "B2", "B2      "}
    assert table["_", 100_000.0] == pytest.approx(1.0)
    assert table["A1", 85_000.0] == table["A1      ", 85_000.0]
    coefficients = (tmp_path / "jedi" / "deviation_coefficients.csv").read_text().splitlines()
    assert coefficients[2:] == ["A1,0.5,2,-1.25,0,0,0.01,19000"]
    assert [file["rows"] for file in done["files"]] == [40, 40, 1]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="there are several tables"):
        airswing.export(product, to="jedi", path=tmp_path / "file")


@pytest.mark.parametrize("winds", ["corrected", "reported"])
@pytest.mark.parametrize("aircraft_error", [0.0, 1.3, 2.0, np.nan])
def test_every_export_gives_an_aircraft_the_same_error(tmp_path, aircraft_error, winds):
    """In the middle of a layer (550 hPa), where corrections are as uncertain as each other."""
    product = run(tmp_path, {"A1": (9.0, 0.0), "B2": (1.0, 0.0)}, pressure=55000.0)
    write_fits(tmp_path)
    write_errors(tmp_path, {"A1": [aircraft_error] * 2, "B2": [np.nan] * 2})
    for to, name in (("ob_ascii", "ob"), ("jedi", "jedi/"), ("obs_errors", "obserr.txt")):
        airswing.export(product, to=to, path=f"{tmp_path}/{name}", winds=winds)
    layer = LAYERS[4] * (2.0 if winds == "reported" else 1.0)
    expected = layer if np.isnan(aircraft_error) else max(aircraft_error, layer / 2.0)
    reports, _ = wrfda.read((tmp_path / "ob").read_text())
    single = {report["id"].strip(): report["levels"][0]["error"] for report in reports}
    assert single == pytest.approx({"A1": expected, "B2": layer}, abs=0.006)
    _, table = jedi_table(tmp_path / "jedi" / "wind_error_windEastward.csv")
    assert np.sqrt(table["_", 55000.0]) == pytest.approx(layer, abs=1e-4)
    assert ("B2", 55000.0) not in table
    drawn = table.get(("A1", 55000.0), table["_", 55000.0])
    assert np.sqrt(drawn) == pytest.approx(expected, abs=1e-4)
    by_type = read_wind_tables((tmp_path / "obserr.txt").read_text())["UV", "TAMDARS"]
    assert dict(zip(LEVELS, by_type, strict=False))[550] == pytest.approx(layer, abs=0.006)


REPORTED = [[2.5, 2.0, 1.8], [2.0, 1.6, 1.9], [3.0, 2.4, 2.2]]
CORRECTED = [[1.4, 1.1, 0.9], [1.5, 1.2, 0.95], [1.0, 0.8, 0.7]]
KNOWN = np.array([REPORTED, CORRECTED])
"""m/s by state (reported, corrected), phase (all, cruise, descent) and three layers."""
BY_AIRCRAFT = {"N1": (np.nan, np.nan), "N2": (6.0, 1.3), "N3": (1.0, 0.0), "N9": (9.0, 9.0)}


def errors_of(folder, ds, winds, table=KNOWN):
    """Result of an export with known errors of the reports, and the error of every level."""
    phases = ("all", "cruise", "descent")
    write_errors(folder, BY_AIRCRAFT, table, np.array([1100e2, 700e2, 400e2, 200e2]), phases)
    write_product(ds, folder / "corrected.nc", title="test")
    result, text = exported(folder / "corrected.nc", "ob_ascii", winds=winds)
    assert result["notes"][0].startswith(f"errors of the winds from {result['errors_from']}")
    reports, _ = wrfda.read(text.decode())
    return result, [level["error"] for report in reports for level in report["levels"]]


def test_the_table_is_the_one_obsproc_gave_its_reports():
    result = [
        (level["p"][0], report["type"] == "airep", level["speed"][2])
        for report in wrfda.read(golden("obsproc_ob.ascii").read_text())[0]
        for level in report["levels"]
        if level["p"][0] > 0
    ]
    pressure, airep, error = (np.array(column) for column in zip(*result, strict=True))
    value = table_error(pressure, np.where(airep, 3, 0).astype(np.int8))
    np.testing.assert_allclose(value, error, atol=0.006)
    assert len(set(error)) >= 5


LEGS = {
    "pressure": [109000.0, 70000.0, 39999.0, 19000.0, 90000.0, 39999.0],
    "phase": [PHASE[name] for name in ("cruise",) * 4 + ("descent", "ascent")],
}
N2, LOW = {"pressure": [50000.0, 90000.0]}, {"pressure": 30000.0, "phase": PHASE["descent"]}


@pytest.mark.parametrize(
    ("sizes", "columns", "uncertain", "winds", "by_hand"),
    [
        # Corrections of equal uncertainty change nothing; an ascent has no row.
        ({"N1": 6}, LEGS, 0.4, "corrected", [1.5, 1.2, 0.95, 0.95, 1.0, 0.9]),
        ({"N1": 6}, LEGS, 0.4, "reported", [2.0, 1.6, 1.9, 1.9, 3.0, 1.8]),
        # 1.2 m/s of the cell holds (0.2^2 + 1.0^2) / 4 = 0.26 of uncertain corrections.
        ({"N1": 1, "X": 1}, {}, [0.2, 1.0], "corrected", np.sqrt([1.18 + 0.02, 1.18 + 0.5])),
        # N2 flew cells of 1.44 and 2.25 and has 1.69 itself, 0.155 less than these. Of its
        # corrections, half the squares are 0.08 and 0.02, on the mean 0.05.
        ({"N2": 2}, N2, [0.4, 0.2], "corrected", np.sqrt([1.285 + 0.03, 2.095 - 0.03])),
        ({"N2": 2}, N2, [0.4, 0.2], "reported", np.sqrt([2.56 + 36.0 - 3.28, 4.0 + 36.0 - 3.28])),
        # A variance clipped at zero counts; half of the base of 1.2 m/s is the least.
        ({"N3": 2}, {}, 0.4, "corrected", [0.6, 0.6]),
        ({"N1": 3}, {}, [0, 0, 6], "corrected", [0.6, 0.6]),
        # No error is below 0.5 m/s.
        ({"N1": 3}, LOW, [0, 0, 6], "corrected", [0.5, 0.5]),
        # A unit that corrects itself has the error of its cell.
        ({"N1": 2}, {}, [0.5, np.nan], "corrected", [1.2, 1.2]),
    ],
)
def test_errors_by_hand(tmp_path, sizes, columns, uncertain, winds, by_hand):
    ds = corrected(sizes, corrected_wind_standard_error=uncertain, **columns)
    _, errors = errors_of(tmp_path, ds, winds)
    assert errors[: len(by_hand)] == pytest.approx(by_hand, abs=0.006)


@pytest.mark.parametrize("winds", ["corrected", "reported"])
def test_a_product_without_finite_errors_is_not_named_as_source(tmp_path, winds):
    ds = corrected({"N1": 2}, pressure=50000.0, corrected_wind_standard_error=0.0)
    result, errors = errors_of(tmp_path, ds, winds, np.full_like(KNOWN, np.nan))
    assert result["errors_from"] == "WRFDA's table"
    assert "observation_errors.nc holds none for these" in result["notes"][0]
    assert ("uncertainty of each correction" in result["notes"][0]) == (winds == "corrected")
    assert errors[0] == pytest.approx(2.9)
