from dataclasses import replace

import dask
import numpy as np
import pytest
from tests.gap.frames import TAILS, headings_dataset

from airswing.errors import InputError
from airswing.gap.archive.frame import REPORT_FIELDS, Frame


@pytest.fixture(scope="module")
def archive():
    return headings_dataset(flights=4)


def test_values_are_si_and_radians(archive):
    frame = Frame.from_headings(archive, reference="ruc")
    assert frame.size == archive.sizes["report"]
    np.testing.assert_allclose(np.degrees(frame.heading), archive.heading)
    np.testing.assert_allclose(np.degrees(frame.dip), archive.dip)
    np.testing.assert_allclose(np.degrees(frame.bank), archive.bank)
    np.testing.assert_allclose(frame.horizontal_field, archive.horizontal_field)
    assert frame.time[0] == archive.time.values[0].astype(np.int64) / 1e9
    assert frame.epoch == frame.time.min()
    assert frame.reference_field == np.median(archive.horizontal_field)
    np.testing.assert_array_equal(
        np.array(frame.tails)[frame.aircraft], np.repeat(TAILS, archive.row_size.values)
    )


def test_longitudes_are_continuous_across_the_antimeridian(archive):
    """Shifted to the antimeridian, an archive has the same differences of longitude."""
    moved = archive.copy(deep=True)
    turn = 180.0 - float(archive.longitude.mean())
    moved["longitude"].values[:] = np.mod(archive.longitude + turn + 180.0, 360.0) - 180.0
    assert moved.longitude.min() < -90 < 90 < moved.longitude.max()
    here, there = (Frame.from_headings(ds, reference="ruc") for ds in (archive, moved))
    np.testing.assert_allclose(
        there.longitude - there.longitude.mean(), here.longitude - here.longitude.mean(), atol=1e-9
    )
    west = moved.assign(longitude=-abs(moved.longitude))
    assert Frame.from_headings(west, reference="ruc", meridian=179.0).longitude.min() > 180.0


def test_pool_is_the_mean_of_the_members_that_exist(archive):
    holed = archive.copy(deep=True)
    holed["reference_eastward_wind"][1, :3] = np.nan
    pool = Frame.from_headings(holed, reference=["ruc", "rtfdaa"])
    by_name = Frame.from_headings(holed, reference="ruc+rtfdaa")
    expected = archive.reference_eastward_wind.values[0] + 0.5
    expected[:3] -= 0.5
    np.testing.assert_allclose(pool.u_ref, expected)
    np.testing.assert_array_equal(by_name.u_ref, pool.u_ref)


def test_reports_without_a_wind_or_with_bad_flags_are_left_out(archive):
    bad = archive.copy(deep=True)
    bad["eastward_wind"][0] = np.nan
    bad["reference_northward_wind"][0, 1] = np.nan
    bad["ground_eastward_velocity"][2] = np.nan
    bad["screening"][3] = 256  # wind_qc
    bad["screening"][4] = 512  # gross error: kept, or every effect would be attenuated
    frame = Frame.from_headings(bad, reference="ruc")
    np.testing.assert_array_equal(frame.report[:2], [4, 5])
    assert Frame.from_headings(bad, reference="ruc", excluded=()).report[0] == 3


def test_requested_phases_are_kept(archive):
    frame = Frame.from_headings(archive, reference="ruc", phases=["ascent"])
    assert set(frame.phase) == {1}
    unknown = archive.assign(phase=archive.phase * 0)
    assert Frame.from_headings(unknown, reference="ruc", phases=["cruise"]).size > 0
    with pytest.raises(InputError, match="unknown phase"):
        Frame.from_headings(archive, reference="ruc", phases=["taxi"])


def test_errors_for_no_report_and_unknown_reference(archive):
    with pytest.raises(InputError, match="overlap"):
        Frame.from_headings(archive.assign(eastward_wind=archive.heading * np.nan), reference="ruc")
    with pytest.raises(InputError, match="one of ruc, rtfdaa"):
        Frame.from_headings(archive, reference="nam")


def test_absent_variables_are_unknown_not_zero(archive):
    frame = Frame.from_headings(
        archive.drop_vars(["icing", "bank", "air_temperature", "wind_speed_resolution"]),
        reference="ruc",
    )
    assert set(frame.icing) == {-1}
    assert np.isnan(frame.bank).all()
    assert np.isnan(frame.temperature).all()
    assert np.isnan(frame.wind_speed_resolution).all()


def test_take_keeps_the_constants_of_the_archive(archive):
    frame = Frame.from_headings(archive, reference="ruc")
    later = frame.take(frame.time > np.median(frame.time))
    assert later.epoch == frame.epoch
    assert later.reference_field == frame.reference_field
    assert {getattr(later, name).shape for name in REPORT_FIELDS} == {(later.size,)}
    np.testing.assert_array_equal(frame.take([5, 2]).time, frame.time[[5, 2]])
    assert set(frame.take(frame.aircraft_mask("N402")).aircraft) == {1}
    with pytest.raises(InputError, match="N999"):
        frame.take(frame.aircraft_mask(["N401", "N999"]))


def test_step_distance_by_hand(archive):
    frame = Frame.from_headings(archive, reference="ruc").take(slice(0, 4))
    path = replace(
        frame,
        latitude=np.array([40.0, 41.0, 41.0, 60.0]),
        longitude=np.array([179.5, 179.5, -179.5, 10.0]),
        flight=np.array([1, 1, 1, 2]),
    )
    degree = 6371.0088 * np.pi / 180.0
    expected = [np.nan, degree, degree * np.cos(np.radians(41.0)), np.nan]
    np.testing.assert_allclose(path.step_distance() / 1e3, expected, rtol=1e-5)
    np.testing.assert_allclose(path.residual, 0.0)
    assert path.day[0] == 14426  # 2009-07-01


def test_lazy_headings_are_computed_once(archive):
    computed = []

    def scheduler(graph, keys, **options):
        computed.append(len(keys))
        return dask.threaded.get(graph, keys, **options)

    with dask.config.set(scheduler=scheduler):
        lazy = Frame.from_headings(archive.chunk(report=50), reference="ruc")
    assert len(computed) == 1
    np.testing.assert_array_equal(lazy.dudy, Frame.from_headings(archive, reference="ruc").dudy)
