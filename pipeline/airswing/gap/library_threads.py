"""Threads of the libraries beneath held to one: aircraft and archives are what runs side by side.

Assumptions: matrices are small and trees short, so that threads of the linear algebra, or of the
trees, of their own spend more time waiting for each other than they save: sums of an archive on two
workers cost twice the processor time with them and take half as long again.

Validity: of what is loaded when it begins; the trees are loaded for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

from threadpoolctl import threadpool_limits


@contextmanager
def one_library_thread() -> Iterator[None]:
    """Hold linear algebra and trees to one thread each while it lasts."""
    import_module("sklearn.ensemble")  # brings threads of its own, which a limit before would miss
    with threadpool_limits(limits=1):
        yield
