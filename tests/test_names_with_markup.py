"""Names that hold markup are escaped; nothing is written outside the output and the cache."""

import os
import subprocess
import sys

import matplotlib
import pandas as pd

from airswing.synthetic.archive import write_archive
from tests.command import configured

TAILS = {"N401": "<script>alert('tail')</script>", "N402": 'N402"><img src=x onerror=alert(2)>'}
REFERENCE = "<b onclick=alert(3)>ruc</b>"
FILE = "a<i>b & c.csv"


def files_below(folder):
    """Time of modification of every file."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in files}


def test_pages_escape_names_and_nothing_is_written_outside_the_output_and_the_cache(tmp_path):
    top = tmp_path
    data, work, home = top / "data", top / "here", top / "home"
    coarse = {"columns": 24, "rows": 20, "spacing_km": 75.0, "references": ("ruc",)}
    write_archive(data, days=1, aircraft=2, seed=1, **coarse)
    for folder in (work, home):
        folder.mkdir()
    for path in (data / "reports").glob("*.csv"):
        table = pd.read_csv(path).replace({"tail": TAILS})
        table.to_csv(path.with_name(f"{path.stem} {FILE}"), index=False)
        path.unlink()
    (data / "reports" / f"broken {FILE}").write_text("no table\n")
    sound = sorted((data / "ruc").iterdir())[0]
    sound.rename(sound.with_name("<u>model<u>.grb"))
    (data / "ruc" / "broken<u>.grb").write_bytes(b"GRIB" + bytes(40))
    sections = {"screening": {"phases": ["ascent", "cruise", "descent"]}}
    sections |= {"fit": {"min_reports": 20}}
    names = data / "reports/*.csv", {REFERENCE: data / "ruc/*"}
    config = configured(top, *names, **sections)
    before = files_below(top)
    places = {"HOME": str(home), "AIRSWING_CACHE": str(top / "cache"), "TMPDIR": str(home)}
    places |= {"MPLCONFIGDIR": matplotlib.get_cachedir()}  # or its list of fonts is made anew
    command = [sys.executable, "-m", "airswing", "run", str(config), "--quiet"]
    options = {"env": os.environ | places, "cwd": work, "timeout": 600}
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr
    pages = [path.read_text(encoding="utf-8") for path in (top / "out").rglob("*.html")]
    assert any("&lt;script&gt;alert" in page for page in pages)
    for markup in ("<script>alert", "<img src=x", "<b onclick", "<i>b &", "<u>"):
        assert not any(markup in page for page in pages), markup
    after = files_below(top)
    assert not [name for name in after if name.startswith("home/") and "fontlist" not in name]
    places = ("out/", "cache/", "home/")
    assert {k: v for k, v in after.items() if not k.startswith(places)} == before
