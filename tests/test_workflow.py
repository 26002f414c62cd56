"""The whole job on the shipped sample: it finds the truth, and its products keep the contract."""

import json

import netCDF4
import numpy as np
import pytest
import xarray as xr

import airswing
from airswing import workflow
from airswing.config_file import load_config
from airswing.flags import STATUS
from airswing.products.netcdf import read_product
from airswing.vocabulary import lookup
from tests.compass.flown import wrap

PRODUCTS = (
    workflow.HEADINGS,
    workflow.FITS,
    workflow.CORRECTED,
    workflow.PROFILES,
    "observation_errors.nc",
    "innovation_statistics.nc",
)
GLOBAL = (
    "Conventions title institution source history references summary creator_name license "
    "time_coverage_start geospatial_lat_max airswing_config airswing_version uuid source_uuids"
)
NAMES = {
    workflow.HEADINGS: """
        time latitude longitude pressure eastward_wind northward_wind reference_eastward_wind
        reference_northward_wind lead_time ground_speed track ground_velocity_error heading
        magnetic_heading heading_error heading_error_standard_error airspeed airspeed_error
        declination horizontal_field phase flight screening aircraft row_size""",
    workflow.FITS: """
        aircraft reference deviation deviation_covariance offset amplitude phase harmonics
        offset_standard_error amplitude_standard_error phase_standard_error airspeed_scale
        reference_bias report_count flight_count compass_points condition_number status
        residual_rms_before residual_rms_after table_heading table_correction table_residual_rms""",
    workflow.CORRECTED: """
        corrected_eastward_wind corrected_northward_wind corrected_wind_standard_error
        corrected_heading correction_applied platform eastward_wind northward_wind""",
}


@pytest.mark.parametrize("reference", ["ruc", "rtfdaa", "ruc+rtfdaa"])
def test_the_sample_recovers_its_truth_within_its_intervals(quickstart, root, reference):
    truth = json.loads((root / "data_samples/truth/truth.json").read_text())["aircraft"]
    fits = read_product(quickstart / workflow.FITS).sel(reference=reference)
    trusted = fits.isel(aircraft=np.flatnonzero(fits["status"] == STATUS["ok"]))
    assert trusted.sizes["aircraft"] >= 4
    scores = []
    for name in trusted["aircraft"].to_numpy():
        fit = trusted.sel(aircraft=name)
        true = np.array([truth[name]["deviation"][c] for c in "ABCDE"])
        error = np.sqrt(np.diag(fit["deviation_covariance"]))
        free = error > 0
        scores += list(((fit["deviation"].to_numpy() - true) / error)[free])
        if truth[name]["amplitude"] > 2:
            assert abs(float(fit["amplitude"]) - truth[name]["amplitude"]) < 0.5
            assert abs(wrap(float(fit["phase"]) - truth[name]["phase"])) < 6
    # Standard scores of a right fit: few beyond two, none beyond four.
    scores = np.abs(scores)
    assert scores.max() < 4
    assert (scores < 1.96).mean() >= 0.75


@pytest.fixture
def path(quickstart, name):
    """File of a product, its first month."""
    return next((quickstart / name).glob("*.nc"), quickstart / name)


@pytest.mark.parametrize("name", PRODUCTS)
def test_every_product_keeps_the_contract(quickstart, name, path):
    with netCDF4.Dataset(path) as file:
        assert not [key for key, variable in file.variables.items() if variable.dtype is str]
    with xr.open_dataset(path, decode_timedelta=False) as ds:
        assert all(key in ds.attrs for key in GLOBAL.split())
        assert ds.attrs["Conventions"] == "CF-1.11, ACDD-1.3"
        assert ds.attrs["airswing_config"].startswith("{")
        if name != workflow.HEADINGS:
            parents = {read_product(quickstart / parent).attrs["uuid"] for parent in PRODUCTS[:2]}
            assert set(ds.attrs["source_uuids"].split()) & parents
        for key, variable in ds.variables.items():
            entry = lookup(str(key), variable.dims)
            assert variable.dims == entry.dims, key
            assert variable.attrs.get("units", entry.units) == entry.units, key
            assert variable.attrs["long_name"] == entry.long_name
            if variable.dtype.kind == "f" and not str(key).startswith("reported_"):
                assert np.isfinite(variable.to_numpy()).any(), key


@pytest.mark.parametrize("name", PRODUCTS)
def test_the_compliance_checker_finds_nothing(path, tmp_path):
    runner = pytest.importorskip("compliance_checker.runner")
    runner.CheckSuite.load_all_available_checkers()
    report = tmp_path / "report.json"
    passed, _ = runner.ComplianceChecker.run_checker(
        str(path), ["cf:1.11"], 1, "strict", output_filename=str(report), output_format="json"
    )
    results = json.loads(report.read_text())["cf:1.11"]
    failed = [entry for entry in results["all_priorities"] if entry["value"][0] < entry["value"][1]]
    assert [entry["msgs"] for entry in failed] == []
    assert passed


@pytest.mark.parametrize("name", [workflow.HEADINGS, workflow.CORRECTED])
def test_cf_xarray_and_trajan_open_the_trajectories(path):
    pytest.importorskip("cf_xarray")
    pytest.importorskip("trajan")
    from trajan.traj.ragged import Ragged

    with xr.open_dataset(path) as ds:
        assert ds.cf.cf_roles == {"trajectory_id": ["aircraft"]}
        assert ds.cf.coordinates["time"] == ["time"]
        assert ds["eastward_wind"].cf["longitude"].name == "longitude"
        assert ds.traj is not None
        # TrajAn looks for ragged arrays by these names of their dimensions
        ragged = ds[["row_size", "eastward_wind"]].rename(aircraft="trajectory", report="index")
        opened = ragged.drop_vars("pressure_altitude").traj
        assert isinstance(opened, Ragged)
        sizes = {"trajectory": ds.sizes["aircraft"], "index": int(ds["row_size"].max())}
        assert opened.ds.sizes == sizes


@pytest.mark.parametrize("product", NAMES)
def test_the_documented_names_are_there(quickstart, product):
    assert not set(NAMES[product].split()) - set(read_product(quickstart / product).variables)


def test_the_page_and_the_tables_are_there(quickstart):
    assert "<html" in (quickstart / "report/index.html").read_text()
    assert (quickstart / "tables.csv").read_text().count("N401") >= 1
    assert (quickstart / "swing_cards.pdf").read_bytes().startswith(b"%PDF")


def test_a_corrected_archive_has_nothing_left_to_correct(quickstart):
    """Round trip: the corrected winds, fitted again, show hardly any deviation."""
    config = load_config("configs/quickstart.yaml")
    headings = read_product(quickstart / workflow.HEADINGS)
    corrected = read_product(quickstart / workflow.CORRECTED)
    winds = headings[["reference_eastward_wind", "reference_northward_wind", "lead_time"]]
    names = ("eastward_wind", "northward_wind")
    reports = headings.drop_dims("reference")
    reports = reports.assign({name: corrected[f"corrected_{name}"] for name in names})
    again = airswing.derive_headings(reports, winds)
    again = airswing.screen(again, **config.screening.model_dump())
    refit = airswing.fit_deviation(again, pools=config.pools(), harmonics=1)
    refit = refit.sel(reference="ruc+rtfdaa")
    first = read_product(quickstart / workflow.FITS).sel(reference="ruc+rtfdaa")
    ok = (first["status"] == 0).to_numpy()
    assert ok.sum() >= 4
    assert set(refit["status"].to_numpy()[ok]) <= {STATUS["ok"], STATUS["no_correction_needed"]}
    assert np.nanmax(refit["amplitude"].to_numpy()[ok]) < 0.3
