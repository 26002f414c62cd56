"""pyproj and eccodes in one interpreter, in both orders, with work done by both.

Some builds of eccodes bundle a libproj that clashes with pyproj's; where the
pins let one in, these end with a signal instead of status 0.
"""

import subprocess
import sys

import pytest

WORK = """
import sys, eccodes, pyproj
assert pyproj.CRS("EPSG:4326").to_authority() == ("EPSG", "4326")
assert 71000 < pyproj.Geod(ellps="WGS84").inv(0.0, 50.0, 1.0, 50.0)[2] < 72000
h = eccodes.codes_grib_new_from_samples("GRIB2")
assert eccodes.codes_get_values(h).size
eccodes.codes_release(h)
"""


@pytest.mark.parametrize(
    "first",
    [
        "import pyproj",
        "import eccodes",
        "import sys, airswing; assert 'pyproj' in sys.modules and 'eccodes' not in sys.modules",
    ],
)
def test_both_libraries_work_in_any_import_order(first):
    command = [sys.executable, "-c", first + WORK]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
