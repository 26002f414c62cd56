"""Processes of their own, forked from one that has the package imported: quick to begin and end."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.process import BaseProcess

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["airswing.workflow", "matplotlib.figure"])


def forked(function: Callable[..., object], *given: object, **options: object) -> BaseProcess:
    """Begin a function of a module of tests in a process of its own."""
    process = _SERVER.Process(target=_within, args=(os.environ.copy(), function, given, options))
    process.start()
    return process


def _within(
    environment: dict[str, str], function: Callable[..., object], given: tuple, options: dict
) -> None:
    os.environ.update(environment)  # the server's is that of when it began
    function(*given, **options)
