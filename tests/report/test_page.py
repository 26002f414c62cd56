"""The page of a run: whole, self-contained, headline first, small enough, written atomically."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
import xarray as xr

from airswing.errors import InputError
from airswing.evaluation.innovations import innovation_statistics
from airswing.evaluation.results import Evaluation
from airswing.flags import STATUS
from airswing.report import write_page
from airswing.report.run import page
from airswing.report.run.selection import by_amplitude
from tests.report import factories

POOLS = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"], "ruc+rtfdaa": ["ruc", "rtfdaa"]}


class Balance(HTMLParser):
    """Collect tags left open, and every address the page asks for."""

    void = frozenset({"meta", "img", "br", "link", "input", "hr"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.images = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.void:
            self.open.append(tag)
        self.images += tag == "img"
        self.addresses += [str(v) for k, v in attrs if k in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def parsed(page: Path) -> tuple[str, Balance]:
    text = page.read_text("utf-8")
    found = Balance()
    found.feed(text)
    return text, found


def check_self_contained(page: Path) -> tuple[str, Balance]:
    """No tag stays open, nothing is fetched, and every figure is a file as well."""
    text, found = parsed(page)
    assert found.open == []
    outside = [a for a in found.addresses if not a.startswith(("data:image/", "#"))]
    files = sorted(a for a in outside if a.startswith("figures/"))
    assert files == sorted(f"figures/{one.name}" for one in (page.parent / "figures").glob("*.png"))
    assert len(files) == found.images
    assert not re.search(r"https?://", re.sub(r'src="data:[^"]*"', "", text))
    headline = re.search(r"<h1>(.*?)</h1>", text)
    assert headline and len(headline.group(1).split()) <= 25
    return text, found


def test_the_page_is_whole_and_asks_for_nothing_outside(tmp_path: Path) -> None:
    headings, fits = factories.headings(), factories.fits()
    (tmp_path / "tables.csv").write_text("aircraft\n")
    written = write_page(
        tmp_path / "report",
        headings=headings,
        fits=fits,
        corrected=factories.corrected(headings),
        summary={"links": [("notes", "notes.txt")], "configuration": "a.yaml"},
    )
    assert written == tmp_path / "report" / "index.html"
    text, found = check_self_contained(written)
    assert {"../tables.csv", "notes.txt"} <= set(found.addresses)
    assert "5 of 6 aircraft" in text and "falls from" in text
    assert all(name in text for name in factories.names(6))
    assert "deviation = A + B sin m" in text.replace("Deviation", "deviation")
    assert re.search(r"B = [+-]\d\.\d\d ± 0\.12°", text)
    assert not list(written.parent.glob(".index*"))
    (tmp_path / "report/figures/old.png").write_text("of an earlier page")
    write_page(tmp_path / "report", headings=headings, fits=fits)
    assert not (tmp_path / "report/figures/old.png").exists()


def test_a_fleet_with_refused_fits_alone_has_no_table_to_load(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=2, reports=200), factories.fits(aircraft=2)
    fits["status"][:] = STATUS["implausible_reports"]
    text, _ = parsed(write_page(tmp_path / "report", headings=headings, fits=fits))
    assert "No table may be loaded: implausible reports (2 aircraft)." in text
    assert "Coefficients with" not in text
    row = text[text.index('<td class="words">N402') :].split("</tr>")[0]
    assert row.count("<td>-</td>") == 12 and "±" not in row


def test_all_products_become_sections_in_the_unit_that_is_asked_for(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=2, reports=200), factories.fits(aircraft=2)
    fits["status"][:] = 0
    corrected = factories.corrected(headings)
    evaluation = Evaluation(
        field_test=factories.full_field_test(),
        sensitivity=factories.sensitivity(),
        innovations=innovation_statistics(headings, corrected, pools=POOLS),
    )

    def made(units: str) -> str:
        written = write_page(
            tmp_path / units[0],
            headings=headings,
            fits=fits,
            corrected=corrected,
            evaluation=evaluation,
            units=units,  # type: ignore[arg-type]
        )
        return check_self_contained(written)[0]

    text = made("kt")
    for anchor in ("field-test", "sensitivity", "innovations"):
        assert f'<section id="{anchor}">' in text
    assert "2.47 kt (2.10 to 2.80) as a linear difference" in text
    assert "2.24 kt (1.90 to 2.60) in quadrature" in text
    assert "Not poolable: ruc - nam (nam is in never_pool)" in text
    assert "negative variance" in text
    metric = made("m/s")
    assert "1.27 m/s (1.08 to 1.44) as a linear difference" in metric
    words = re.sub(r"<[^>]*>", " ", metric.split("<main>")[1].split("<script>")[0])
    assert not re.search(r"\d kt\b|\(kt\)", words)


def test_lazy_products_are_read_aircraft_by_aircraft(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=2, reports=200), factories.fits(aircraft=2)
    corrected = factories.corrected(headings)
    headings.attrs, corrected.attrs = {}, {}
    headings.to_netcdf(tmp_path / "headings.nc")
    corrected.to_netcdf(tmp_path / "corrected.nc")
    eager = write_page(tmp_path / "a", headings=headings, fits=fits, corrected=corrected)
    with (
        xr.open_dataset(tmp_path / "headings.nc", chunks={"report": 500}) as lazy,
        xr.open_dataset(tmp_path / "corrected.nc") as better,
    ):
        written = write_page(tmp_path / "b", headings=lazy, fits=fits, corrected=better)
    assert written.read_text() == eager.read_text()


def test_the_page_names_what_was_left_out(tmp_path: Path) -> None:
    headings = factories.headings(aircraft=2, reports=60)
    skipped = [{"file": name, "reason": f"{name}: is empty"} for name in ("a.csv", "b.csv")]
    headings.attrs["reading_audit"] = json.dumps(
        {"files": 3, "files_skipped": skipped, "similar_tails": [["N401", "n401"]]}
    )
    broken = {"file": "x.grb", "what": "message", "reason": "truncated message", "count": 2}
    headings.attrs["reference_audit"] = json.dumps({"ruc": {"skipped": [broken], "notes": []}})
    text, _ = parsed(write_page(tmp_path, headings=headings, fits=factories.fits(aircraft=2)))
    for words in ("2 of 5 report files", "a.csv", "b.csv", "truncated message", "x.grb", "n401"):
        assert words in text


def test_names_are_escaped_and_a_dollar_sign_begins_no_formula(tmp_path: Path) -> None:
    headings = factories.headings(aircraft=5, reports=100)
    fits = factories.fits(aircraft=5)
    odd = headings["aircraft"].to_numpy().astype(object)
    odd[:4] = r"$\frac{1$", "N_1^$2$", "<script>x</script>", "N&1"
    written = write_page(
        tmp_path,
        headings=headings.assign_coords(aircraft=odd),
        fits=fits.assign_coords(aircraft=odd),
    )
    text, _ = check_self_contained(written)
    assert "N_1^$2$" in text and "<script>x" not in text


def test_an_unwritable_folder_is_refused(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=1, reports=60), factories.fits(aircraft=1)
    (tmp_path / "report").write_text("a file where the folder should be")
    with pytest.raises(InputError, match="cannot write"):
        write_page(tmp_path / "report", headings=headings, fits=fits)
    assert (tmp_path / "report").read_text() == "a file where the folder should be"


def test_a_large_fleet_stays_usable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, number in {"LARGE_PANELS": 2, "SMALL_PANELS": 5, "SMALL_TOGETHER": 3}.items():
        monkeypatch.setattr(page, name, number)
    monkeypatch.setattr(page, "OVERVIEW", 3)
    headings, fits = factories.headings(aircraft=8, reports=60), factories.fits(aircraft=8)
    text, found = check_self_contained(write_page(tmp_path, headings=headings, fits=fits))
    assert "The 2 aircraft with the largest amplitude; the swing cards" in text
    assert "<p>The 3 aircraft with the largest amplitude.</p>" in text
    small, large, fleet, roses, places, audit = 2, 2, 1, 1, 3, 1
    assert found.images == small + large + fleet + roses + places + audit
    rows = re.search(r"<tbody>(.*?)</tbody>", text, re.DOTALL).group(1).split("<tr")[1:]
    shown = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    assert [cells[0] for cells in shown] == by_amplitude(fits, "ruc+rtfdaa")
    assert shown[-1][0] == "N408" and shown[-1][-1] == "poor heading coverage"


@pytest.mark.slow
def test_the_page_of_a_thousand_aircraft_is_small(tmp_path: Path) -> None:
    headings = factories.headings(aircraft=1000, reports=4)
    written = write_page(tmp_path, headings=headings, fits=factories.fits(aircraft=1000))
    assert "N1400" in written.read_text() and written.stat().st_size < 3.5e6


def test_importing_the_package_does_not_import_matplotlib() -> None:
    code = "import airswing.report, sys; print('matplotlib' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


DOM = """
const given = JSON.parse(require("fs").readFileSync(0, "utf8")), heads = given.heads.map(words => ({
  classList: {contains: name => name === "words" && words}, style: {}, addEventListener() {}}));
const rows = given.rows.map(cells => ({cells: cells.map(textContent => ({textContent}))}));
const field = {addEventListener(kind, act) { this.act = act; }};
const table = {tBodies: [{rows}], tHead: {rows: [{cells: heads}]},
  parentNode: {parentNode: {insertBefore() {}}}};
globalThis.addEventListener = () => {};
globalThis.document = {createElement: () => field,
  querySelectorAll: what => what === "table.sortable" ? [table] : []};
eval(given.script);
console.log(JSON.stringify(given.wanted.map(text => { field.value = text; field.act();
  return rows.filter(row => !row.hidden).map(row => row.cells[0].textContent); })));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_search_finds_names_and_statuses_and_no_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the page's own script on the table's cells."""
    monkeypatch.setattr(page, "LARGE_PANELS", 1)
    monkeypatch.setattr(page, "SMALL_PANELS", 1)
    headings, fits = factories.headings(aircraft=30, reports=40), factories.fits(aircraft=30)
    text = write_page(tmp_path, headings=headings, fits=fits).read_text("utf-8")
    script = re.search(r"<script>(.*?)</script>", text, re.DOTALL)
    head, body = (
        re.search(rf"<{one}>(.*?)</{one}>", text, re.DOTALL) for one in ("thead", "tbody")
    )
    assert script and head and body
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in body.group(1).split("<tr")[1:]]
    names = [cells[0] for cells in rows]
    given = {
        "heads": ['class="words"' in one for one in head.group(1).split("<th ")[1:]],
        "rows": rows,
        "script": script.group(1),
        "wanted": ["12", "n40", "coverage", ""],
    }
    ran = subprocess.run(
        ["node", "-e", DOM], input=json.dumps(given), capture_output=True, text=True, check=True
    )
    digits, begin, status, every = json.loads(ran.stdout)
    assert digits == [name for name in names if "12" in name]
    assert begin == [name for name in names if name.startswith("N40")]
    assert status == [cells[0] for cells in rows if "coverage" in cells[-1]] and status
    assert every == names
