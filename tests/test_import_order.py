"""pyproj and eccodes in one interpreter, in both orders, with work done by both.

Some builds of eccodes bundle a libproj that clashes with pyproj's; where the
pins let one in, these end with a signal instead of status 0.
"""

import subprocess
import sys

import pytest

WORK = """
import pyproj.crs
assert pyproj.CRS("EPSG:4326").to_authority() == ("EPSG", "4326")
a = pyproj.Geod(ellps="WGS84").inv(0.0, 50.0, 1.0, 50.0)[2]
assert 71000 < a < 72000
h = eccodes.codes_grib_new_from_samples("GRIB2")
assert eccodes.codes_get_values(h).size
eccodes.codes_release(h)
"""
ORDERS = {
    "pyproj, eccodes": "import pyproj\nimport eccodes\n",
    "eccodes, pyproj": "import eccodes\nimport pyproj\n",
    "airswing, eccodes": "import airswing\nimport eccodes\nimport pyproj\n",
    "airswing's writer": "import airswing.products.netcdf\nimport eccodes\n",
    "cfgrib, airswing": "import cfgrib\nimport eccodes\nimport airswing\nimport pyproj\n",
}


@pytest.mark.parametrize("order", ORDERS)
def test_both_orders_work_and_end_well(order):
    done = subprocess.run(
        [sys.executable, "-c", ORDERS[order] + WORK], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])


def test_airswing_brings_pyproj_before_eccodes():
    code = "import sys, airswing; print('pyproj' in sys.modules, 'eccodes' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["True", "False"]
