"""Swing an aircraft's compass from its archive of wind reports and model winds.

Assumes reports of wind, position and time from aircraft that compute wind as ground velocity
minus air velocity along a magnetic heading, and model winds in GRIB. The stages, in order, are
functions from Datasets to a Dataset: :func:`read_reports`, :func:`build_catalogue`,
:func:`collocate`, :func:`derive_headings`, :func:`screen`, :func:`fit_deviation`,
:func:`add_tables`, :func:`correct`; then :func:`field_test`, :func:`compare` and
:func:`diagnose`. See the README for the two-command start and ``airswing --help`` for the
commands.
"""

import ast
from importlib import import_module
from pathlib import Path

# pyproj must come first: some eccodes builds bundle a libproj that crashes the interpreter
# when it is loaded before pyproj's. tests/test_import_order.py holds both orders.
import pyproj  # noqa: F401

from airswing.version import __version__ as __version__

# The stub file lists the public names for editors and type checkers; at run time each is imported
# on first use (Scientific Python SPEC 1).
_MODULES = {
    alias.name: str(statement.module)
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text()).body
    if isinstance(statement, ast.ImportFrom) and statement.module != "airswing.version"
    for alias in statement.names
}

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module 'airswing' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *_MODULES]
