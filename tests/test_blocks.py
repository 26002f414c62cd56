"""However an archive is divided: the same products, and no stage reads more than a block."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from benchmarks import fault_drill
from xarray.backends.netCDF4_ import NetCDF4ArrayWrapper

from airswing import workflow
from airswing.config_file import load_config
from airswing.products import ragged
from airswing.reference import places
from airswing.reports import report_blocks as archive
from airswing.reports import staging_store as spool
from airswing.workflow.closing_summary import summarise
from airswing.workflow.progress import Progress

LARGEST = 6600
"""Reports of the sample's largest aircraft, and a few."""


def run(root: Path, output: Path) -> dict:
    """Every stage but the page on the shipped sample, with its field test."""
    content = yaml.safe_load((root / "configs/quickstart.yaml").read_text())
    content["reports"]["files"] = str(root / "data_samples/reports/N40[1235].csv")
    for reference in content["references"].values():
        reference["files"] = str(root / reference["files"])
    content["field_test"] = {
        "start": "2009-10-08",
        "before_start": "2009-09-16",
        "corrected": ["N401", "N403"],
        "controls": ["N402", "N405"],
        "roll": "ignore",
        "temperature_qc": "ignore",
    }
    path = output.parent / "config.yaml"
    path.write_text(yaml.safe_dump(content))
    job = workflow.Job(load_config(path, output=output), Progress(quiet=True))
    headings = workflow.make_headings(job)
    fits = workflow.make_fits(job, headings)
    corrected = workflow.make_corrected(job, headings, fits)
    workflow.make_evaluation(job, headings, fits, corrected)
    return summarise(job.config, headings, fits, corrected)


@pytest.fixture(scope="module")
def at_once(blank_cards, tmp_path_factory):
    root = Path(__file__).resolve().parents[1]
    output = tmp_path_factory.mktemp("whole") / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ragged, "BLOCK_REPORTS", 10**9)
        return output, run(root, output)


def test_any_division_gives_the_same_products_and_reads_no_more(at_once, tmp_path, root):
    read: list[int] = []
    getitem = NetCDF4ArrayWrapper._getitem

    def noted(self, key):
        found = getitem(self, key)
        if len(self.shape) and self.shape[-1] > LARGEST:
            read.append(found.shape[-1] if found.ndim else 1)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NetCDF4ArrayWrapper, "_getitem", noted)
        patch.setattr(ragged, "BLOCK_REPORTS", 1)
        patch.setattr(archive, "BLOCK_REPORTS", 7000)
        patch.setattr(spool, "SEGMENT_REPORTS", 2500)
        patch.setattr(places, "STRETCH_REPORTS", 900)
        summary = run(root, tmp_path / "results")
    assert len(read) > 100 and max(read) <= LARGEST
    output, whole = at_once
    differences = fault_drill.differences(output, tmp_path / "results")
    # finished work that is kept for a later run lies in pieces of its own, one for each division
    kept = ("airswing_config", ".collocated/")
    assert [words for words in differences if not any(k in words for k in kept)] == []
    assert str(summary) == str(whole)
