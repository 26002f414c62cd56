"""Products of simulated flights, as figures and pages take them."""

import json
from datetime import date
from functools import cache

import numpy as np

from airswing.compass.correction import add_tables, correct
from airswing.compass.fit.deviation import fit_deviation
from airswing.evaluation.comparison import compare
from airswing.evaluation.field_test import field_test
from airswing.flags import SCREENING, STATUS
from airswing.products.ragged import joined, some_reports
from tests.compass.flown import Setting
from tests.evaluation.archives import fleet

POOL = "ruc+rtfdaa"
POOLS = {"ruc": ["ruc"], "rtfdaa": ["rtfdaa"], "nam": ["nam"], POOL: ["ruc", "rtfdaa"]}
TAILS = [f"N{k:03d}" for k in range(6)]
READ = {"reports_read": 2500, "files": 1, "dropped": {"duplicate": 12, "impossible_position": 3}}


@cache
def _products():
    setting = Setting(aircraft=6, days=20, references=3, flights_a_day=3, reports_a_flight=14)
    headings, _ = fleet(1, setting, amplitude=4.0)
    fits = add_tables(fit_deviation(headings, pools=POOLS), headings).compute()
    fits["status"][:, -1] = STATUS["poor_heading_coverage"]
    corrected = correct(headings, fits, reference=POOL).compute()
    number = np.arange(headings.sizes["report"])
    along = number % 14
    headings["phase"][:] = np.where(along < 4, 1, np.where(along > 9, 3, 2))
    headings["pressure"][:] = 4e4 + 1e4 * np.maximum(4 - along, along - 9).clip(0)
    headings["screening"][number % 20 == 0] |= SCREENING["turn"]
    headings["screening"][number % 60 == 0] |= SCREENING["roll"]
    headings.attrs["reading_audit"] = json.dumps(READ | {"repaired": {"longitude_wrapped": 40}})
    return headings, fits, corrected


def products():
    """Headings, fits and corrected winds of six aircraft; the fits of the last are refused."""
    headings, fits, corrected = (ds.copy(deep=True) for ds in _products())
    return headings, fits, corrected


def few(aircraft=2, reports=60):
    """Headings and fits of any number of aircraft, some of the same over and over."""
    headings, fits, _ = products()
    size = int(headings["row_size"][0])
    some = some_reports(headings, np.arange(headings.sizes["report"]) % size < reports)
    names = [f"N{400 + k}" for k in range(aircraft)]
    repeated = joined([some] * (aircraft // 6 + 1))
    repeated = repeated.isel(aircraft=slice(aircraft), report=slice(aircraft * reports))
    fits_repeated = fits.isel(aircraft=np.arange(aircraft) % 6)
    return repeated.assign_coords(aircraft=names), fits_repeated.assign_coords(aircraft=names)


@cache
def field_tested():
    """Content of field_test.json."""
    headings = _products()[0]
    flags = dict.fromkeys(("roll_flag", "temperature_qc"), headings["phase"] * 0)
    groups = {"corrected": TAILS[:3], "controls": TAILS[3:]}
    days = {"start": date(2008, 7, 11), "before_start": date(2008, 7, 1)}
    return dict(field_test(headings.assign(flags), pools=POOLS, reference=POOL, **groups, **days))


@cache
def compared():
    """Content of sensitivity.json."""
    return dict(compare(_products()[0], pools=POOLS, never_pool=["nam"]))
