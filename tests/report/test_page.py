"""The page of a run and its maps: whole, self-contained, headline first; what figures show."""

import json
import re

import matplotlib
import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import airswing.report as report
from airswing.evaluation import Evaluation
from airswing.evaluation.innovations import innovation_statistics
from airswing.flags import STATUS
from airswing.report import html
from airswing.report.html import maps
from airswing.report.run import page
from airswing.report.run.selection import Run
from tests.compass.flown import curve
from tests.report import factories
from tests.report.factories import POOL, POOLS, TAILS
from tests.report.pages import Drawn, check_page, labels

HEADINGS, FITS, CORRECTED = factories.products()
STATISTICS = innovation_statistics(HEADINGS, CORRECTED, pools=POOLS)
EVALUATION = Evaluation(
    field_test=factories.field_tested(), sensitivity=factories.compared(), innovations=STATISTICS
)
PRODUCTS = {"headings": HEADINGS, "fits": FITS, "corrected": CORRECTED, "evaluation": EVALUATION}
PRODUCTS |= {"summary": {"configuration": "a.yaml"}}
BEFORE = dict(matplotlib.rcParams)


@pytest.fixture(scope="module")
def full_page(tmp_path_factory):
    """Text, figures, addresses and file of the page with every product."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "tables.csv").write_text("aircraft\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(html, "Figures", Drawn)
        written = report.write_page(folder / "report", **PRODUCTS)
    text, summary = check_page(written)
    return text, Drawn.last.made, summary.addresses, written


def test_the_page_is_complete_and_self_contained(full_page):
    text, _, addresses, written = full_page
    assert dict(matplotlib.rcParams) == BEFORE
    assert written.name == "index.html"
    assert "../tables.csv" in addresses
    assert "5 of 6 aircraft" in text and "falls from" in text
    assert all(name in text for name in TAILS)
    assert "Deviation = A + B sin m" in text
    assert not list(written.parent.glob(".index*"))
    first = (written.parent / "figures/fleet.png").read_bytes()
    old = written.parent / "figures/old.png"
    old.write_text("of an earlier page")
    text = report.write_page(written.parent, headings=HEADINGS, fits=FITS).read_text()
    assert not old.exists()
    assert (written.parent / "figures/fleet.png").read_bytes() == first
    for anchor in ("field-test", "sensitivity", "innovations", "ranking", "stability"):
        assert f'<section id="{anchor}">' not in text


def test_all_products_become_sections(full_page):
    tested, text = factories.field_tested(), full_page[0]
    for anchor in ("field-test", "sensitivity", "innovations"):
        assert f'<section id="{anchor}">' in text
    for name, words in {"": "as a linear difference", "_quadrature": "in quadrature"}.items():
        low, high = tested[f"adjusted_reduction{name}_ci_kt"]
        amount = f"{tested[f'adjusted_reduction{name}_kt']:.2f} kt ({low:.2f} to {high:.2f})"
        assert f"{amount} {words}" in text
    assert "Not poolable: ruc - nam (" in text and "nam is in never_pool" in text
    assert text.count("a pool and one of its members") == 2


def test_innovation_figures_show_the_statistics_of_the_product(full_page):
    axes = full_page[1]["innovations"].axes[0]
    shown = dict(zip(labels(axes), axes.lines[0].get_xdata(), strict=True))
    cells = STATISTICS.sel(reference=POOL, state="reported")
    for name, selection in (("cruise", {"flight_phase": "cruise"}), ("N002", {"aircraft": "N002"})):
        selected = cells.sel(selection)
        count = selected["innovation_speed_count"]
        bias = (selected["innovation_speed_bias"] * count).sum() / count.sum()
        assert shown[name] == pytest.approx(float(bias) * 3600 / 1852)
    drawn = full_page[1]["innovation_histogram"].axes[0].images[0].get_array()
    assert np.nansum(np.ma.filled(drawn, 0)) == cells["innovation_histogram"].sum()


def test_the_page_names_rejected_reports_and_unusable_tables(full_page, tmp_path):
    cells = re.findall("<td[^>]*>(.*?)</td>", full_page[0].split('<section id="audit">')[1])
    assert cells[0] == "turn" and "</span>252 (5.0 %)" in cells[1] and cells[2] == "168"
    assert cells[6:10] == ["dropped: duplicate", "12", "dropped: impossible position", "3"]
    assert cells[10:12] == ["repaired: longitude wrapped", "40"]
    headings, fits = factories.few(2, 40)
    headings["screening"][:] = 0
    fits["status"][:] = STATUS["implausible_reports"]
    skipped = [{"file": name, "reason": f"{name}: is empty"} for name in ("a.csv", "b.csv")]
    audit = {"files": 3, "files_skipped": skipped, "similar_tails": [["N401", "n401"]]}
    broken = {"file": "x.grb", "what": "message", "reason": "truncated message", "count": 2}
    models = {"ruc": {"skipped": [broken], "notes": []}}
    headings.attrs = {"reading_audit": json.dumps(audit), "reference_audit": json.dumps(models)}
    text = report.write_page(tmp_path, headings=headings, fits=fits).read_text()
    words = ("80 of 80 reports (100.0 %) entered", "truncated message", "2 of 5 report files")
    assert all(word in text for word in (*words, "x.grb", "a.csv", "b.csv", "n401"))
    assert "No table may be loaded: implausible reports (2 aircraft)." in text
    row = text[text.index('<td class="words">N401') :].split("</tr>")[0]
    assert row.count("<td>-</td>") == 12 and "±" not in row


def test_lazy_products_give_the_same_page(full_page, tmp_path):
    for name, ds in (("headings", HEADINGS), ("corrected", CORRECTED)):
        ds.to_netcdf(tmp_path / f"{name}.nc")
    with (
        xr.open_dataset(tmp_path / "headings.nc", chunks={"report": 500}) as lazy,
        xr.open_dataset(tmp_path / "corrected.nc") as better,
    ):
        same = PRODUCTS | {"headings": lazy, "corrected": better}
        text, _, _, eager = full_page
        assert report.write_page(eager.parents[1] / "lazy", **same).read_text() == text


def test_captions_name_the_heading_of_the_fit(full_page, tmp_path):
    assert full_page[0].count("by indicated magnetic heading (") == 3
    headings, fits = factories.few(2, 40)
    fits.attrs |= {"abscissa": "true", "table_resolution": 0.05}
    text = report.write_page(tmp_path, headings=headings, fits=fits).read_text()
    assert text.count("by indicated true heading (") == 3 and "magnetic heading" not in text
    row = text[text.index('<td class="words">N40') :].split("</tr>")[0]
    assert len(re.findall(r"<td>[+-]\d+\.\d\d</td>", row)) == 8


def test_names_are_escaped_and_a_dollar_sign_begins_no_formula(tmp_path):
    odd = [r"$\frac{1$", "N_1^$2$", "<script>x</script>", "N&1"]
    headings, fits = (ds.assign_coords(aircraft=odd) for ds in factories.few(4))
    headings.attrs["reading_audit"] = "not json"
    text, _ = check_page(report.write_page(tmp_path, headings=headings, fits=fits))
    assert "N_1^$2$" in text and "<script>x" not in text
    figure = html.empty_figure("x").say("a < b & c (n = 0)")
    shown = html.Figures()("x", figure)
    assert "a &lt; b &amp; c" in shown and 'alt="a &lt; b' in shown


def test_a_large_fleet_stays_usable(tmp_path, monkeypatch):
    for name, number in {"PANELS": 5, "TOGETHER": 3, "OVERVIEW": 3}.items():
        monkeypatch.setattr(page, name, number)
    headings, fits = factories.few(8)
    text, summary = check_page(report.write_page(tmp_path, headings=headings, fits=fits))
    assert "<p>The 3 aircraft with the largest amplitude.</p>" in text
    panels, overview, places = 2, 1, 1
    assert summary.images == panels + overview + places
    rows = re.search(r"<tbody>(.*?)</tbody>", text, re.DOTALL).group(1).split("<tr")[1:]
    shown = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    assert [cells[0] for cells in shown] == Run(headings, fits, POOL).order
    assert shown[-1][0] == "N405" and shown[-1][-1] == "poor heading coverage"


@pytest.mark.slow
def test_the_page_of_a_thousand_aircraft_is_small(tmp_path):
    headings, fits = factories.few(1000, 4)
    written = report.write_page(tmp_path, headings=headings, fits=fits)
    assert "N1399" in written.read_text() and written.stat().st_size < 3.5e6


def test_heading_error_figure_draws_the_fit_and_the_table():
    axes = report.heading_error_figure(HEADINGS, FITS, "N002", "ruc").axes[0]
    low, high = axes.get_ylim()
    assert all(low <= y <= high for y in axes.lines[0].get_ydata())
    lines = {line.get_label(): line for line in axes.get_lines()}
    fit = FITS.sel(reference="ruc", aircraft="N002")
    x, y = lines["fitted curve"].get_data()
    assert np.allclose(y, curve(fit["deviation"].to_numpy(), x))
    _, nodes = lines["removed by the 8-point table"].get_data()
    assert nodes.tolist() == (-fit["table_correction"].to_numpy()).tolist()
    refused = report.heading_error_figure(HEADINGS, FITS, "N005", "ruc")
    shown = {line.get_label() for line in refused.axes[0].get_lines()}
    assert "fit, not usable" in shown and "removed by the 8-point table" not in shown
    assert "poor heading coverage" in refused.caption


@pytest.mark.parametrize(
    ("layer", "longitude", "latitude"),
    [
        ("coast", -0.1, 5.6),  # Accra, on the Gulf of Guinea
        ("coast", 18.4, -34.3),  # Cape of Good Hope
        ("state", -90.6, 41.5),  # the Mississippi between Iowa and Illinois
        ("border", -122.8, 49.0),  # the 49th parallel on the Pacific
    ],
)
def test_lines_pass_where_the_earth_has_them(layer, longitude, latitude):
    points = np.concatenate(maps.lines()[layer])
    assert np.hypot(*(points - [longitude, latitude]).T).min() < 0.4


def test_views_across_the_antimeridian_are_narrow_and_lines_continuous():
    view = maps.view_of([175.0, 179.0, -178.0, -175.0], [50.0, 52.0, 53.0, 51.0])
    assert view.east - view.west < 20
    assert np.diff(view.unwrapped([179.0, -179.0])) == pytest.approx(2.0)
    for line in maps.lines()["coast"]:
        assert np.abs(np.diff(line[:, 0])).max(initial=0) < 180
    assert maps.view_of([np.nan], [np.nan]) == (-180, 180, -90, 90)


@given(st.lists(st.floats(-180, 179.9), min_size=1), st.floats(-80, 80), st.floats(0, 8))
def test_every_point_lies_in_its_view(longitude, south, height):
    latitude = np.linspace(south, min(south + height, 90), len(longitude))
    view = maps.view_of(longitude, latitude)
    x = view.unwrapped(longitude)
    assert np.all((x >= view.west - 0.1) & (x <= view.east + 0.1))
    assert np.all((latitude >= view.south - 1e-9) & (latitude <= view.north + 1e-9))
    assert view.east - view.west <= 360.0
