"""Names that hold markup are escaped; nothing is written outside the output and the cache."""

import os
import subprocess
import sys

import matplotlib
import pandas as pd
import pytest
import yaml

from airswing.synthetic.archive import write_archive

TAILS = {"N401": "<script>alert('tail')</script>", "N402": 'N402"><img src=x onerror=alert(2)>'}
REFERENCE = "<b onclick=alert(3)>ruc</b>"
FILE = "a<i>b & c.csv"


def files_below(folder):
    """Every file with its size and time."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run over names of markup, with all files next to its output noted."""
    top = tmp_path_factory.mktemp("markup")
    data, here, home = top / "data", top / "here", top / "home"
    write_archive(data, days=1, aircraft=2, seed=1)
    for folder in (here, home):
        folder.mkdir()
    parts = [pd.read_csv(path) for path in sorted((data / "reports").glob("*.csv"))]
    table = pd.concat(parts).replace({"tail": TAILS})
    for path in (data / "reports").glob("*.csv"):
        path.unlink()
    table.to_csv(data / "reports" / FILE, index=False)
    (data / "reports" / f"broken {FILE}").write_text("no table\n")
    sound = sorted((data / "ruc").iterdir())[0]
    sound.rename(sound.with_name("<u>model</u>.grb".replace("/", "")))
    (data / "ruc" / "broken<u>.grb").write_bytes(b"GRIB" + bytes(40))
    config = data / "config.yaml"
    config.write_text(
        yaml.safe_dump(
            {
                "reports": {"files": str(data / "reports" / "*.csv")},
                "references": {REFERENCE: {"files": str(data / "ruc" / "*")}},
                "screening": {"phases": ["ascent", "cruise", "descent"]},
                "fit": {"min_reports": 20},
                "output": str(top / "out"),
            }
        )
    )
    before = files_below(top)
    done = subprocess.run(
        [sys.executable, "-m", "airswing", "run", str(config), "--quiet"],
        check=False,
        capture_output=True,
        text=True,
        cwd=here,
        timeout=600,
        env=os.environ
        | {"HOME": str(home), "AIRSWING_CACHE": str(top / "cache"), "TMPDIR": str(home)}
        | {"MPLCONFIGDIR": matplotlib.get_cachedir()},  # or its list of fonts is made anew
    )
    assert done.returncode == 0, done.stderr
    return top, before


def test_the_page_escapes_what_names_hold(run):
    top, _ = run
    pages = sorted((top / "out").rglob("*.html"))
    assert pages
    said = ""
    for page in pages:
        text = page.read_text(encoding="utf-8")
        said += text
        for markup in ("<script>alert", "<img src=x", "<b onclick", "<i>b &", "<u>"):
            assert markup not in text, f"{page.name}: {markup}"
    assert "&lt;script&gt;alert" in said


def test_nothing_is_written_outside_the_output_and_the_cache(run):
    top, before = run
    after = files_below(top)
    outside = {
        name: entry
        for name, entry in after.items()
        if not name.startswith(("out/", "cache/", "home/"))
    }
    assert outside == before
    left = [name for name in after if name.startswith("home/")]
    assert [name for name in left if "matplotlib" not in name and "fontlist" not in name] == []
