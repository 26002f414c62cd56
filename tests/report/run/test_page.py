"""The run's page: whole, self-contained, headline first, small enough, written atomically."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from tests.report import factories

from airswing.errors import InputError
from airswing.evaluation.results import Evaluation
from airswing.report import write_page
from airswing.report.run import overview, page
from airswing.report.run.evaluation_sections import sensitivity_section


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


def test_page_is_whole_and_asks_for_nothing_outside(tmp_path: Path) -> None:
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
    text, found = parsed(written)
    assert found.open == []
    outside = [a for a in found.addresses if not a.startswith(("data:image/", "#"))]
    assert outside == ["../tables.csv", "notes.txt"]
    assert found.images >= 6 and text.count('role="img"') == 6 + 6
    assert not re.search(r"https?://(?!www\.w3\.org)", re.sub(r'src="data:[^"]*"', "", text))
    headline = re.search(r"<h1>(.*?)</h1>", text).group(1)
    assert headline.startswith("5 of 6 aircraft fitted against ruc+rtfdaa")
    assert "falls from" in headline
    for name in factories.names(6):
        assert name in text
    assert not list(written.parent.glob(".index*"))


def test_page_names_what_did_not_come_in(tmp_path: Path) -> None:
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


def test_page_without_a_single_fit_says_so(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=2, reports=60), factories.fits(aircraft=2)
    fits["status"][:] = 1
    text, _ = parsed(write_page(tmp_path, headings=headings, fits=fits))
    assert "None of 2 aircraft could be fitted" in text


def test_names_are_escaped_and_a_dollar_sign_in_one_begins_no_formula(tmp_path: Path) -> None:
    headings, fits = factories.headings(), factories.fits()
    odd = headings["aircraft"].to_numpy().astype(object)
    odd[:4] = r"$\frac{1$", "N_1^$2$", "<script>x</script>", "N&1"
    page = write_page(
        tmp_path,
        headings=headings.assign_coords(aircraft=odd),
        fits=fits.assign_coords(aircraft=odd),
    )
    text, found = parsed(page)
    assert "N_1^$2$" in text and "<script>x" not in text
    assert found.open == []


def test_unwritable_folder_leaves_the_old_page(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=1, reports=60), factories.fits(aircraft=1)
    (tmp_path / "report").write_text("a file where the folder should be")
    with pytest.raises(InputError, match="cannot write the product; nothing was changed"):
        write_page(tmp_path / "report", headings=headings, fits=fits)
    assert (tmp_path / "report").read_text() == "a file where the folder should be"


def test_large_fleet_stays_usable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "LARGE_PANELS", 2)
    monkeypatch.setattr(page, "SMALL_PANELS", 5)
    monkeypatch.setattr(page, "SMALL_TOGETHER", 3)
    monkeypatch.setattr(overview, "PAGE_OF_AIRCRAFT", 3)
    headings, fits = factories.headings(aircraft=8, reports=60), factories.fits(aircraft=8)
    text, found = parsed(write_page(tmp_path, headings=headings, fits=fits))
    assert "The 2 aircraft with the largest amplitude; the other 6" in text
    assert "<p>The 3 aircraft with the largest amplitude.</p>" in text
    fleet, roses, places, audit = 1, 1, 3, 1
    assert found.images == fleet + roses + places + audit
    assert text.count('role="img"') == 5 + 2 and text.count("<details") >= 1 + 2
    rows = re.search(r"<tbody>(.*?)</tbody>", text, re.DOTALL).group(1).split("<tr")[1:]
    shown = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    assert [cells[0] for cells in shown] == overview.by_amplitude(fits, "ruc+rtfdaa")
    assert shown[-1][0] == "N408" and shown[-1][-1] == "poor heading coverage"
    sizes = [float(cells[11].split()[0]) for cells in shown[:-1]]
    assert sizes == sorted(sizes, reverse=True) and len(sizes) == 7


def test_page_of_a_thousand_aircraft_is_small(tmp_path: Path) -> None:
    headings = factories.headings(aircraft=1000, reports=4)
    written = write_page(tmp_path, headings=headings, fits=factories.fits(aircraft=1000))
    text, found = parsed(written)
    assert found.open == [] and "N1400" in text
    assert written.stat().st_size < 2.5e6


def test_evaluations_become_sections(tmp_path: Path) -> None:
    headings, fits = factories.headings(aircraft=2, reports=60), factories.fits(aircraft=2)
    text, found = parsed(
        write_page(
            tmp_path,
            headings=headings,
            fits=fits,
            evaluation=Evaluation(
                field_test=factories.full_field_test(),
                sensitivity=factories.sensitivity(),
                profiles=factories.profiles(),
            ),
        )
    )
    assert found.open == []
    for anchor in ("field-test", "sensitivity", "profiles"):
        assert f'<section id="{anchor}">' in text
    assert "gained 2.47 kt (2.10 to 2.80) beyond the controls by the linear difference" in text
    assert "2.24 kt (1.90 to 2.60) adding errors in quadrature" in text
    assert "Not poolable: ruc - nam (nam is in never_pool)" in text
    assert "negative variance" in text


def test_a_pool_against_its_member_is_no_test_of_its_own() -> None:
    found = factories.sensitivity()
    first = found["pairs"][0]
    second = first | {"references": ["ruc+rtfdaa", "ruc"], "own_test": False}
    section = sensitivity_section(found | {"pairs": [first, second], "by_phase": []})
    assert section.lead.startswith("No two references differ both beyond error and by a size")
    text = "".join(str(part) for part in section.parts)
    assert text.count("the pool is made of its members") == text.count("none of its own") == 1
    assert text.count(first["why"]) == 1


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
def test_the_search_finds_names_and_statuses_and_no_numbers(tmp_path: Path) -> None:
    """By the page's own script on the table's cells."""
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
    told = subprocess.run(
        ["node", "-e", DOM], input=json.dumps(given), capture_output=True, text=True, check=True
    )
    digits, begin, status, every = json.loads(told.stdout)
    assert digits == [name for name in names if "12" in name]
    assert 0 < len(digits) < sum("12" in " ".join(cells) for cells in rows)
    assert begin == [name for name in names if name.startswith("N40")]
    assert status == [cells[0] for cells in rows if "coverage" in cells[-1]] and status
    assert every == names
