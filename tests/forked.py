"""Separate processes, forked from one that has the package imported: quick to start and to end."""

import multiprocessing
import os
import sys
import traceback

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["airswing.workflow", "matplotlib.figure"])


def forked(function, *arguments, **options):
    """Start a function of a test module in a separate process."""
    everything = os.environ.copy(), function, arguments, options
    process = _SERVER.Process(target=_within, args=everything)
    process.start()
    return process


def _within(environment, function, arguments, options):
    os.environ.update(environment)  # that of the server is from its start
    code = 0
    try:
        function(*arguments, **options)
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 0
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    # A process of multiprocessing would wait at its end for the workers of the decoding pool.
    os._exit(code)
