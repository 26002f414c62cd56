"""Options of the commands that have many, as one dataclass each.

Assumes the fields carry typer's annotations; :func:`takes` shows them to typer as parameters.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, TypeVar, get_type_hints

import typer


def _text(given: str) -> str:
    # An empty path is the current directory, which a variable left unset in a script would fill.
    if not given.strip():
        raise typer.BadParameter("an empty path names nothing")
    return given


def _path(given: str) -> Path:
    return Path(_text(given))


ConfigPath = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Configuration (YAML).", parser=_path)
]
Output = Annotated[
    Path | None, typer.Option(help="Folder for the products.", metavar="DIR", parser=_path)
]
OutputPath = Annotated[
    Path | None,
    typer.Option("-o", "--output", help="Folder or file to write.", metavar="PATH", parser=_path),
]
Written = Annotated[
    Path,
    typer.Option("-o", "--output", help="File to write.", metavar="FILE", parser=_path),
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Make every month anew.")]
# What a run does anyway; accepted since scripts of earlier versions give it.
Resume = Annotated[bool, typer.Option("--resume", hidden=True)]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a dask scheduler.", metavar="ADDRESS")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Results and errors alone, no progress.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]

T = TypeVar("T")


@dataclass(frozen=True)
class ExportOptions:
    """Of ``airswing export``."""

    config: ConfigPath
    to: Annotated[str, typer.Option(help="What to write; see below.", metavar="FORMAT")]
    output: Annotated[  # text: a slash at its end asks for a folder
        str,
        typer.Option(
            "-o", "--output", help="File or folder to write.", metavar="PATH", parser=_text
        ),
    ]
    winds: Annotated[str, typer.Option(help="corrected or reported.")] = "corrected"
    window: Annotated[
        str | None, typer.Option(help="A folder for every so long, such as '1 h'.")
    ] = None
    soundings: Annotated[
        bool, typer.Option("--soundings", help="Join ascents and descents into one report each.")
    ] = False
    domain: Annotated[int | None, typer.Option(help="Nest of WRF, for OBS_DOMAIN.")] = None
    platform: Annotated[
        str | None, typer.Option(help="TAMDAR, AMDAR, ACARS or AIREP; else by source.")
    ] = None
    identifiers: Annotated[
        str | None, typer.Option(help="tail, or number: five digits an aircraft.")
    ] = None
    base: Annotated[
        Path | None,
        typer.Option(help="Reject list or error table to begin from.", metavar="FILE"),
    ] = None
    start: Annotated[str | None, typer.Option(help="First time (ISO 8601, UTC).")] = None
    end: Annotated[str | None, typer.Option(help="First time no longer taken.")] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")] = False
    quiet: Quiet = False
    json: Json = False


@dataclass(frozen=True)
class GapOptions:
    """Of ``airswing gap``."""

    config: ConfigPath
    output: Output = None
    resume: Resume = True
    scheduler: Scheduler = None
    without: Annotated[
        list[str] | None,
        typer.Option(help="Effect to do without, as if unknown.", metavar="EFFECT"),
    ] = None
    known: Annotated[
        Path | None,
        typer.Option(
            help="What the simulation has already: effects.yaml, or a run's fits.nc.",
            metavar="FILE",
        ),
    ] = None
    simulated: Annotated[
        str | None,
        typer.Option(
            help="Reports a simulation made elsewhere (file, glob, or its configuration).",
            metavar="REPORTS",
        ),
    ] = None
    quiet: Quiet = False
    json: Json = False


@dataclass(frozen=True)
class CheckOptions:
    """Options of ``airswing gap-check``."""

    cases: Annotated[int, typer.Option(help="Number of cases.", min=1)] = 60
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 1
    output: Annotated[
        Path,
        typer.Option(
            help="Folder of archives, labels, diagnoses and scores.", metavar="DIR", parser=_path
        ),
    ] = Path("results/gap_check")
    workers: Annotated[
        int, typer.Option(help="Archives written and diagnosed at a time.", min=1)
    ] = 1
    nulls: Annotated[
        int | None, typer.Option(help="Cases without an effect; a quarter by default.", min=0)
    ] = None
    so_far: Annotated[
        bool, typer.Option("--so-far", help="Score the diagnosed cases without diagnosing more.")
    ] = False
    fast: Annotated[bool, typer.Option("--fast", help="Small archives, clear effects.")] = False
    real: Annotated[
        Path | None,
        typer.Option(help="Folder with real data; rung 5 needs it.", metavar="DIR"),
    ] = None
    rung: Annotated[
        list[int] | None, typer.Option(help="Rung to play; all by default.", min=1, max=5)
    ] = None
    quiet: Quiet = False
    json: Json = False


def takes(options: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Make a command of a function that takes its options as one dataclass.

    Parameters
    ----------
    options : type
        A dataclass whose fields are annotated as typer's parameters are.

    Returns
    -------
    callable
        Decorator.
    """
    hints = get_type_hints(options, include_extras=True)
    parameters = [
        inspect.Parameter(
            one.name,
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
            default=inspect.Parameter.empty if one.default is MISSING else one.default,
            annotation=hints[one.name],
        )
        for one in fields(options)  # type: ignore[arg-type]
    ]

    def decorated(function: Callable[[T], None]) -> Callable[..., None]:
        def command(**given: object) -> None:
            function(options(**given))

        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__annotations__ = {**hints, "return": None}
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return command

    return decorated
