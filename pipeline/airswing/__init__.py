"""Swing an aircraft's compass from its archive of wind reports and model winds.

Assumes reports of wind, position and time from aircraft that compute wind as ground velocity
minus air velocity along a magnetic heading, and model winds in GRIB. See the README for the
two-command start and ``airswing --help`` for the commands.
"""

# pyproj must come first: some eccodes builds bundle a libproj that crashes the interpreter
# when it is loaded before pyproj's. tests/test_import_order.py holds both orders.
import pyproj  # noqa: F401

__version__ = "0.1.0"
