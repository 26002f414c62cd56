"""A diagnosis works on the headings of the main job, from known effects or other simulations."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from pydantic import TypeAdapter
from tests.command import airswing
from tests.conftest import EFFECTS

from airswing.errors import InputError
from airswing.gap.archive.frame import Frame
from airswing.gap.effects import CATALOGUE
from airswing.gap.result.schema import GapReport
from airswing.gap.simulation.effects_file import active_effects, read_effects
from airswing.products.netcdf import read_product
from airswing.products.whole_files import json_types
from airswing.reference.collocate import DERIVATIVES
from airswing.report.gap.words import start_words, verdict
from airswing.workflow import Job, gap_stage

IRON, SCALE = EFFECTS


@pytest.fixture
def archive(gap_archive, names_only, monkeypatch):
    """Two effects at the strength they are drawn with, and the names that compete with theirs."""
    rivals = {"compass_offset", "compass_step", "hard_iron", "soft_iron", "tas_offset", "tas_scale"}
    for name in CATALOGUE.keys() - rivals:
        monkeypatch.delitem(CATALOGUE, name)
    return gap_archive


def effects_file(path, *effects):
    path.write_text(yaml.safe_dump(list(effects)))
    return path


@pytest.fixture(scope="module")
def frame(gap_archive, collocated, tmp_path_factory):
    job = Job.of(gap_archive, output=collocated(tmp_path_factory.mktemp("frame")), quiet=True)
    members = job.config.pools()[job.config.gap_reference()]
    return job, Frame.from_headings(gap_stage.make_headings(job), reference=members)


def begin(job, frame, **options):
    return gap_stage.starting_point(job, **options)(frame)


def test_known_effects_are_not_reported_again_and_headings_reused(archive, collocated, tmp_path):
    months = sorted((collocated(tmp_path / "out") / "headings").glob("*.nc"))
    times = [path.stat().st_mtime_ns for path in months]
    file = effects_file(tmp_path / "known.yaml", IRON)
    done = airswing("gap", archive, "--output", tmp_path / "out", "--known", file, "--quiet")
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "out" / "gap.json").read_text())
    report = GapReport.read(tmp_path / "out" / "gap.json")
    assert json_types(report.content()) == content
    assert [(effect.name, effect.tails) for effect in report.effects] == [("tas_scale", ["N403"])]
    assert [path.stat().st_mtime_ns for path in months] == times
    headings = read_product(tmp_path / "out" / "headings")
    assert content["headings_uuid"] == headings.attrs["uuid"]
    reached = np.isfinite(headings["reference_eastward_wind"].to_numpy())
    for name in DERIVATIVES:
        assert np.isfinite(headings[name].to_numpy()[reached]).mean() > 0.9, name
    (known_entry,) = content["known"]
    assert known_entry["disagreement_without_kt"] > known_entry["disagreement_with_kt"] + 0.2
    expected = pytest.approx(known_entry["disagreement_with_kt"], abs=0.05)
    assert content["gap"]["mean_vector_disagreement_kt"] == expected
    assert "1 known effect of" in done.stdout
    assert "1 known effect of" in (tmp_path / "out" / "gap" / "index.html").read_text()
    all_effects = read_effects(tmp_path / "out" / "effects.yaml")
    assert [effect.name for effect in all_effects] == ["hard_iron", "tas_scale"]
    assert all_effects[1:] == active_effects(report)


def test_effects_that_a_simulation_lacks_are_named(archive, collocated, tmp_path, no_gap_page):
    collocated(tmp_path / "out")
    effects = effects_file(tmp_path / "effects.yaml", SCALE)
    sent = tmp_path / "sent.csv"
    done = airswing("simulate", archive, "--effects", effects, "-o", sent, "--quiet")
    assert done.returncode == 0, done.stderr
    words = ("--output", tmp_path / "out", "--simulated", sent, "--quiet", "--json")
    content = json.loads(airswing("gap", archive, *words).stdout)
    assert content == json.loads((tmp_path / "out" / "gap.json").read_text())
    report = TypeAdapter(GapReport).validate_python(content)
    assert [(e.name, e.tails) for e in report.effects] == [("hard_iron", ["N401"])]
    assert report.simulation.matched == report.simulation.of
    assert "reports matched)" in verdict(report)


def test_a_simulation_on_other_paths_counts_by_its_effects(archive, frame, tmp_path, monkeypatch):
    job, archive_frame = frame
    folder = tmp_path / "other"
    folder.mkdir()
    for path in archive.parent.glob("reports/*.csv"):
        table = path.read_text().replace("2009-03-", "2009-04-").splitlines(keepends=True)
        (folder / path.name).write_text("".join(table).replace("N406", "N906"))
    asked = []

    def effects_of(simulation):
        asked.append(simulation)
        entries = [
            IRON,
            {**SCALE, "tails": ["N906"]},
            {**SCALE, "name": "tas_offset", "tails": "all", "parameters": {"offset_m_s": 1.0}},
        ]
        return read_effects(effects_file(tmp_path / "its.yaml", *entries))

    monkeypatch.setattr(gap_stage, "effects_of_archive", effects_of)
    start = begin(job, archive_frame, simulated=f"{folder}/*.csv")
    assert asked[0].config.reports.files == [f"{folder}/*.csv"]
    assert asked[0].output.parent == job.output
    removed = [(effect.name, effect.tails) for effect in start.removed]
    assert removed == [("hard_iron", ("N401",)), ("tas_offset", None)]
    entry = start.simulation
    assert entry.matched == 0 and entry.matched_by == "distribution"
    assert entry.aircraft_in_both == [f"N{k}" for k in range(401, 406)]
    assert start.known_entries[0].left_out == 1
    assert start.frame.airspeed == pytest.approx(archive_frame.airspeed - 1.0, abs=1e-9)
    assert "flew other paths" in start_words(None, start.simulation)
    monkeypatch.setattr(gap_stage, "effects_of_archive", lambda its: its.output.mkdir() or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        begin(job, archive_frame, simulated=f"{folder}/*.csv")
    assert not asked[0].output.exists()


@pytest.mark.parametrize(
    ("option", "content", "message"),
    [
        ("known", None, "no file of known effects"),
        ("known", "- {name: hard_irn}", "unknown effect"),
        ("simulated", None, "--simulated: no file found"),
        ("simulated", "a,b\n1,2\n", "a required column is missing"),
    ],
)
def test_bad_input_is_named(frame, tmp_path, option, content, message):
    file = tmp_path / ("bad.yaml" if option == "known" else "bad.csv")
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        begin(*frame, **{option: str(file)})
    assert str(file) in str(error.value)


def test_reports_against_themselves_in_other_columns_have_no_gap(archive, frame, tmp_path):
    job, archive_frame = frame
    source = next(archive.parent.glob("reports/N401.csv"))
    renamed = source.read_text().replace("wind_speed_kt", "spd", 1)
    (tmp_path / "renamed.csv").write_text(renamed)
    reports = job.config.reports.model_copy(update={"columns": {"spd": "wind_speed_kt"}})
    config = job.config.model_copy(update={"reports": reports})
    of_aircraft = archive_frame.take(archive_frame.aircraft_mask("N401"))
    simulated = str(tmp_path / "renamed.csv")
    start = begin(replace(job, config=config), of_aircraft, simulated=simulated)
    assert np.abs(start.frame.residual).max() < 1e-6
    assert start.simulation.matched_by == "aircraft and time"
