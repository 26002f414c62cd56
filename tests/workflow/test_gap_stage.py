"""The gap works on the headings of the main job: the same ones, and nothing is decoded again."""

from __future__ import annotations

import json

import numpy as np
import pytest

from airswing.config_file import load_config
from airswing.gap.archive.frame import Frame
from airswing.products.netcdf import read_product
from airswing.reference.collocate import DERIVATIVES
from airswing.synthetic.archive import write_archive
from airswing.workflow import HEADINGS, Job, make_headings
from airswing.workflow.gap_stage import GAP_JSON, diagnosis
from airswing.workflow.progress import Progress


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A job whose headings are made, and its configuration."""
    folder = tmp_path_factory.mktemp("gap")
    path = write_archive(folder, days=3, aircraft=2, seed=3, references=("ruc",))
    job = Job(load_config(path), Progress(quiet=True))
    make_headings(job)
    return path, job


def decoded(job):
    return sum(record.messages for record in job.progress.records)


def again(path, **changes):
    return Job(load_config(path).model_copy(update=changes), Progress(quiet=True))


def test_gap_json_is_of_the_same_headings(run, names_only, no_gap_page):
    path, first = run
    job = again(path)
    content = diagnosis(job)
    assert decoded(first) > 0
    assert decoded(job) == 0  # nothing is decoded, or collocated, again
    headings = read_product(job.output / HEADINGS)
    assert content.headings_uuid == headings.attrs["uuid"]
    written = json.loads((job.output / GAP_JSON).read_text())
    assert written["headings_uuid"] == headings.attrs["uuid"]
    frame = Frame.from_headings(make_headings(job), reference="ruc")
    for field, name in (
        ("heading", "heading"),
        ("magnetic_heading", "magnetic_heading"),
        ("heading_error", "heading_standard_error"),
    ):
        expected = np.radians(headings[name].to_numpy().astype(float))[frame.report]
        np.testing.assert_array_equal(getattr(frame, field), expected)
    for field, name in (
        ("airspeed", "airspeed"),
        ("ground_u", "ground_eastward_velocity"),
        ("ground_v", "ground_northward_velocity"),
    ):
        np.testing.assert_array_equal(
            getattr(frame, field), headings[name].to_numpy()[frame.report]
        )


def test_the_headings_hold_the_derivatives_the_gap_needs(run):
    _, job = run
    headings = read_product(job.output / HEADINGS)
    known = np.isfinite(headings["reference_eastward_wind"].to_numpy())
    for name in DERIVATIVES:
        assert np.isfinite(headings[name].to_numpy()[known]).mean() > 0.9, name
