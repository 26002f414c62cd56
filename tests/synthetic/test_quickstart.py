"""The committed sample archive: small, complete, and what its command writes."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from airswing.config_file import load_config
from airswing.synthetic.quickstart import write_quickstart


@pytest.fixture
def sample(root: Path) -> Path:
    return root / "data_samples"


def test_the_command_writes_the_committed_files(sample: Path, tmp_path: Path) -> None:
    """The same files; a value in a thousand may round the other way on another machine."""
    assert sum(path.stat().st_size for path in sample.rglob("*") if path.is_file()) < 8_000_000
    made = write_quickstart(tmp_path)
    names = {path.relative_to(sample) for path in sample.rglob("*") if path.is_file()}
    assert names - {Path("README.md")} == {
        path.relative_to(made) for path in made.rglob("*") if path.is_file()
    }
    for part in ("reports", "field_test"):
        for path in sorted((sample / part).glob("*.csv")):
            kept, again = pd.read_csv(path), pd.read_csv(made / part / path.name)
            assert len(kept) == len(again)
            for column in ("time", "flight", "wind_speed_kt", "wind_direction_deg"):
                assert (kept[column] == again[column]).mean() > 0.999
    kept, again = (
        json.loads((folder / "truth" / "truth.json").read_text()) for folder in (sample, made)
    )
    assert kept["effects"] == again["effects"]
    for tail, values in kept["aircraft"].items():
        for name, value in values["deviation"].items():
            assert again["aircraft"][tail]["deviation"][name] == pytest.approx(value, abs=1e-3)


@pytest.mark.parametrize("name", ["quickstart", "field_test", "real_winds"])
def test_configurations_load_and_point_at_the_sample(
    root: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root)
    config = load_config(root / "configs" / f"{name}.yaml")
    assert len(config.references) == 2
    if name != "real_winds":
        for reference in config.references.values():
            assert any(list(root.glob(pattern)) for pattern in reference.files)
