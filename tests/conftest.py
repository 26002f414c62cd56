"""Shared fixtures: real data next to the repository, a small archive, hypothesis profiles."""

import fcntl
import gc
import os
import shutil
from pathlib import Path

import pytest
from hypothesis import settings

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy: threads of two workers slow each other down

import airswing  # imports pyproj before anything imports eccodes

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "real"

settings.register_profile("default", max_examples=30, deadline=None)
settings.register_profile("ci", max_examples=60, deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


def pytest_collection_modifyitems(items):
    """From the last file to the first: those that take longest begin early."""
    items.sort(key=lambda item: item.path, reverse=True)


@pytest.fixture(autouse=True, scope="module")
def _frozen():
    """Exempt what earlier files made and imported from the collections after every stage."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def real():
    """Path of a real file by its name below ``../shared/real``; skips by name where absent."""

    def find(name):
        path = REAL / name
        if not path.exists():
            pytest.skip(f"real data absent: ../shared/real/{name}")
        return path

    return find


def _once(factory, name, make):
    """Folder for all tests of the run, made by the first worker that needs it."""
    shared = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # of the run
    folder = shared / name
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").is_file():
            shutil.rmtree(folder, ignore_errors=True)  # a worker may have failed half way
            folder.mkdir()
            make(folder)
            (folder / "made").touch()
    return folder


EFFECTS = [
    {"name": name, "tails": [tail], "parameters": parameters, "period": None}
    for name, tail, parameters in (
        ("hard_iron", "N401", {"amplitude_deg": 6.0, "phase_deg": 40.0}),
        ("tas_scale", "N403", {"scale_percent": 3.0}),
    )
]
"""Effects in the reports of `gap_archive`."""


@pytest.fixture(scope="session")
def gap_archive(tmp_path_factory):
    """Configuration of a small archive with `EFFECTS`, whose headings are made."""

    def make(folder):
        from airswing.workflow import Job, make_headings

        coarse = {"columns": 32, "rows": 25, "spacing_km": 57.0, "interval_hours": 2}
        options = {"days": 14, "aircraft": 6, "seed": 11} | coarse
        config = airswing.write_archive(folder, effects=EFFECTS, times_per_file=6, **options)
        with config.open("a") as file:
            file.write("fit: {shared_error: false}\n")  # a tenth of the time
        make_headings(Job.of(config, quiet=True))

    return _once(tmp_path_factory, "gap_archive", make) / "config.yaml"


@pytest.fixture(scope="session")
def quickstart_config():
    """Writes the quickstart's configuration with absolute paths and changed sections."""
    import yaml

    def write(folder, **changes):
        content = yaml.safe_load((ROOT / "configs/quickstart.yaml").read_text())
        for section in (content["reports"], *content["references"].values()):
            section["files"] = str(ROOT / section["files"])
        content |= {"output": str(folder / "results")} | changes
        path = folder / "config.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return path

    return write


@pytest.fixture(scope="session")
def quickstart(quickstart_config, tmp_path_factory):
    """Output folder of ``airswing run`` on the quickstart."""

    def make(folder):
        airswing.run(quickstart_config(folder))

    return _once(tmp_path_factory, "quickstart", make) / "results"


@pytest.fixture(scope="session")
def collocated(gap_archive):
    """Copies the headings of `gap_archive` into a folder."""

    results = gap_archive.parent / "results"
    return lambda folder: shutil.copytree(results, folder, dirs_exist_ok=True)


@pytest.fixture
def names_only(monkeypatch):
    """Diagnoses without unknown effects, which take most of their time."""
    from airswing.gap import diagnose as stages

    fit_model = stages.fit_model

    def without_tables(*args, **options):
        return fit_model(*args, **{**options, "tables": False})

    monkeypatch.setattr(stages, "fit_model", without_tables)
    monkeypatch.setattr(stages, "slices", lambda *_: [])


@pytest.fixture
def no_gap_page(monkeypatch):
    """``airswing gap`` without its page, which takes a fifth of its time."""
    page = "airswing.workflow.gap_stage.write_gap_page"
    monkeypatch.setattr(page, lambda folder, **_: folder / "index.html")


@pytest.fixture(scope="module")
def blank_cards():
    """Swing cards are an empty file; to draw them takes longer than the rest of a small run."""

    def blank(fits, headings, path, **_):
        Path(path).touch()
        return 0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("airswing.report.run.heading_error.write_swing_cards", blank)
        yield


@pytest.fixture(scope="session")
def root():
    """Top of the repository."""
    return ROOT
