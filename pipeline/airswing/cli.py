"""The ``airswing`` command: parse, call, print.

Assumes nothing about the data; heavy imports are inside the command that needs them, so
that ``--help`` is quick. Results go to standard output, progress and messages to standard error.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from airswing.version import __version__

if TYPE_CHECKING:
    from airswing.workflow import Job

T = TypeVar("T")


def _text(text: str) -> str:
    # An empty path, as from an unset variable of a script, would be the current directory.
    if not text.strip():
        raise typer.BadParameter("the path is empty")
    return text


def _path(text: str) -> Path:
    return Path(_text(text))


ConfigPath = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Configuration (YAML).", parser=_path)
]
Output = Annotated[
    Path | None, typer.Option(help="Folder for the products.", metavar="DIR", parser=_path)
]
Written = Annotated[
    Path, typer.Option("-o", "--output", help="File to write.", metavar="FILE", parser=_path)
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Remake every month.")]
# Without effect; accepted because scripts of earlier versions give it.
Resume = Annotated[bool, typer.Option("--resume", hidden=True)]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a dask scheduler.", metavar="ADDRESS")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Results and errors only, no progress.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[int, typer.Option(help="Seed of all random numbers.", min=0)]

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

_INTERRUPTED = 130  # exit status of a command that SIGINT ended: 128 + 2
# Base class of errors in the command line, which typer does not export.
_USAGE_ERROR: Any = typer.BadParameter.__base__


def _version(asked: bool) -> None:
    if asked:
        print(f"airswing {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    """Swing the compass of an aircraft from its archive of wind reports and model winds."""


def _run_stage(stage: Callable[[Job], T], config: Path, **options: Any) -> tuple[Job, T]:
    from airswing.products.whole_files import workspace
    from airswing.workflow import Job

    job = Job.of(config, **options)
    with job.running(), workspace(job.output):
        return job, stage(job)


def _print(content: object, *, as_json: bool, text: str) -> None:
    import json

    from airswing.products.whole_files import json_types

    print(json.dumps(json_types(content), indent=2) if as_json else text, flush=True)


@app.command()
def run(
    config: ConfigPath,
    output: Output = None,
    fresh: Fresh = False,
    resume: Resume = True,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run every stage and write every product and the page.

    Months whose reports, model files and settings are unchanged are kept: the same command resumes
    an interrupted run and includes new files.
    """
    from airswing import workflow
    from airswing.workflow.main import summary_text

    options: Any = {"output": output, "fresh": fresh, "quiet": quiet, "scheduler": scheduler}
    job = workflow.Job.of(config, **options)
    with job.running():
        summary = workflow.run_job(job).summary
    _print(summary, as_json=json, text=summary_text(summary, job.output))
    workflow.record_printed(job, summary.get("events", 0))


@app.command()
def collocate(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|TRACK", help="Configuration; or CSV or Parquet file.", parser=_path
        ),
    ],
    reference: Annotated[
        list[str] | None,
        typer.Option(help="Model winds for a TRACK, such as 'ruc=ruc/*.grb'.", metavar="NAME=GLOB"),
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            help="Column of a TRACK and its meaning, such as 'fl=pressure_altitude_ft'.",
            metavar="COLUMN=NAME",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Folder for the products of CONFIG; table to write for TRACK.",
            metavar="PATH",
            parser=_path,
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Add model winds to reports (CONFIG) or to a table (TRACK).

    CONFIG: writes headings/YYYY-MM.nc, also where nothing can be screened or fitted.

    TRACK: a table of time, place and level; appends the earth-relative winds of each --reference
    and writes the table to -o.
    """
    from airswing import workflow
    from airswing.errors import InputError
    from airswing.workflow.job import require_kept
    from airswing.workflow.progress import Progress
    from airswing.workflow.track import TABLES, collocate_track

    if reference or source.suffix.lower() in TABLES:
        if output is None:
            raise typer.BadParameter("give the file to write", param_hint="-o")
        say = Progress(quiet=quiet).say
        print(collocate_track(source, reference or (), output, columns=columns or (), say=say))
        return
    if columns:
        raise typer.BadParameter("only for a TRACK, not for a CONFIG", param_hint="--columns")
    job, headings = _run_stage(workflow.make_headings, source, output=output, quiet=quiet)
    try:
        require_kept(headings)
    except InputError as nothing:
        job.progress.say(f"  only model winds at the reports: {nothing}")
    print(job.output / workflow.HEADINGS)


@app.command()
def fit(config: ConfigPath, output: Output = None, quiet: Quiet = False) -> None:
    """Fit the deviation of every aircraft: fits.nc, tables.csv.

    Needs the headings.
    """
    from airswing import workflow

    job, _ = _run_stage(workflow.make_fits, config, output=output, quiet=quiet)
    print(job.output / workflow.FITS)


@app.command()
def correct(config: ConfigPath, output: Output = None, quiet: Quiet = False) -> None:
    """Correct the archive: corrected/YYYY-MM.nc.

    Needs the headings and fits.nc.
    """
    from airswing import workflow

    job, _ = _run_stage(workflow.make_corrected, config, output=output, quiet=quiet)
    print(job.output / workflow.CORRECTED)


@app.command()
def evaluate(config: ConfigPath, output: Output = None, quiet: Quiet = False) -> None:
    """Compute the field test: field_test.json on standard output.

    Needs the headings.
    """
    from airswing import workflow

    _, result = _run_stage(workflow.make_field_test, config, output=output, quiet=quiet)
    _print(result, as_json=True, text="")


@app.command()
def compare(config: ConfigPath, output: Output = None, quiet: Quiet = False) -> None:
    """Show how the fits depend on the reference: sensitivity.json.

    Needs the headings.
    """
    from airswing import workflow

    _, result = _run_stage(workflow.make_sensitivity, config, output=output, quiet=quiet)
    _print(result, as_json=True, text="")


@app.command()
def monitor(
    config: ConfigPath, output: Output = None, quiet: Quiet = False, json: Json = False
) -> None:
    """List changes that no earlier run reported: events.json.

    Needs the headings and fits.nc. Each event is printed once; `airswing run` does the same.
    """
    from dataclasses import asdict

    from airswing import workflow

    job, monitoring = _run_stage(workflow.make_monitoring, config, output=output, quiet=quiet)
    _print(asdict(monitoring), as_json=json, text=monitoring.text)
    workflow.record_printed(job, len(monitoring.events))


@app.command()
def export(
    config: ConfigPath,
    to: Annotated[str, typer.Option(help="Format to write; see above.", metavar="FORMAT")],
    output: Annotated[  # text, since a slash at its end asks for a folder
        str,
        typer.Option(
            "-o",
            "--output",
            help="File to write; a folder of files for windows, or where it ends with '/'.",
            metavar="PATH",
            parser=_text,
        ),
    ],
    winds: Annotated[str, typer.Option(help="corrected or reported.")] = "corrected",
    window: Annotated[
        str | None, typer.Option(help="Write a folder for each window, such as '1 h'.")
    ] = None,
    soundings: Annotated[
        bool, typer.Option("--soundings", help="Join ascents and descents into one report each.")
    ] = False,
    domain: Annotated[int | None, typer.Option(help="Nest of WRF, for OBS_DOMAIN.")] = None,
    platform: Annotated[
        str | None, typer.Option(help="TAMDAR, AMDAR, ACARS or AIREP; by default by source.")
    ] = None,
    identifiers: Annotated[
        str | None, typer.Option(help="tail, or number: five digits an aircraft.")
    ] = None,
    base: Annotated[
        Path | None,
        typer.Option(
            help="Reject list or error table to change; reject_list needs it.", metavar="FILE"
        ),
    ] = None,
    start: Annotated[str | None, typer.Option(help="First time (ISO 8601, UTC).")] = None,
    end: Annotated[str | None, typer.Option(help="End of the period, excluded.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Export the corrected winds for WRF, WRFDA, GSI or JEDI.

    \b
    FORMAT is one of
      obs_domain: reports for WRF's observation nudging.
      little_r: reports for OBSPROC, to WRFDA.
      ob_ascii: reports for WRFDA, each with its error.
      obs_errors: wind errors for OBSPROC and WRFDA (obserr.txt).
      jedi: errors by aircraft and pressure for JEDI (CSV).
      reject_list: a GSI reject list without the aircraft whose corrected winds pass.
    """  # noqa: D301
    from airswing import workflow
    from airswing.config_file import with_handover
    from airswing.handover.export import as_text
    from airswing.handover.export import export as write_export
    from airswing.products.netcdf import product_path

    job = workflow.Job.of(config, quiet=quiet)
    flags: dict[str, object] = {"domain": domain, "platform": platform, "identifiers": identifiers}
    flags |= {"base": base, "start": start, "end": end}
    with job.progress.stage("export") as stage:
        result = write_export(
            product_path(job.output, workflow.CORRECTED),
            to=to,
            path=output,
            winds=winds,  # type: ignore[arg-type]
            window=window,
            soundings=soundings,
            overwrite=overwrite,
            settings=with_handover(job.config, flags),
        )
        number = len(result["files"])
        stage.note = f"{number:,} file{'s' * (number != 1)}"
    _print(result, as_json=json, text=as_text(result))


@app.command()
def simulate(
    config: ConfigPath,
    output: Written,
    effects: Annotated[
        Path | None, typer.Option(help="Effects file (YAML).", metavar="FILE")
    ] = None,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Simulate the reports that the units should have sent."""
    from airswing.workflow.gap_stage import simulation

    stage = partial(simulation, effects=effects, output=output, seed=seed)
    print(_run_stage(stage, config, quiet=quiet)[1])


@app.command()
def gap(
    config: ConfigPath,
    output: Output = None,
    resume: Resume = True,
    scheduler: Scheduler = None,
    without: Annotated[
        list[str] | None,
        typer.Option(help="Effect to leave out of the catalogue.", metavar="EFFECT"),
    ] = None,
    known: Annotated[
        Path | None,
        typer.Option(
            help="Effects that the simulation contains: effects.yaml, or a run's fits.nc.",
            metavar="FILE",
        ),
    ] = None,
    simulated: Annotated[
        str | None,
        typer.Option(
            help="Reports of another simulation (file, glob, or its configuration).",
            metavar="REPORTS",
        ),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Diagnose the gap to the simulation: where, and which effect."""
    from airswing.report.gap.words import verdict
    from airswing.workflow.gap_stage import diagnosis

    stage = partial(diagnosis, without=without or (), known=known, simulated=simulated)
    job, result = _run_stage(stage, config, output=output, quiet=quiet, scheduler=scheduler)
    text = f"{verdict(result)}\npage: {job.output / 'gap' / 'index.html'}"
    _print(result.content(), as_json=json, text=text)


@app.command(name="gap-check")
def gap_check(
    cases: Annotated[int, typer.Option(help="Number of cases.", min=1)] = 60,
    seed: Seed = 1,
    output: Annotated[
        Path,
        typer.Option(
            help="Folder of archives, labels, diagnoses and scores.", metavar="DIR", parser=_path
        ),
    ] = Path("results/gap_check"),
    workers: Annotated[
        int, typer.Option(help="Archives written and diagnosed at a time.", min=1)
    ] = 1,
    nulls: Annotated[
        int | None, typer.Option(help="Cases without an effect; a quarter by default.", min=0)
    ] = None,
    so_far: Annotated[
        bool, typer.Option("--so-far", help="Score the diagnosed cases without diagnosing more.")
    ] = False,
    fast: Annotated[bool, typer.Option("--fast", help="Small archives, clear effects.")] = False,
    real: Annotated[
        Path | None, typer.Option(help="Folder with real data; rung 5 needs it.", metavar="DIR")
    ] = None,
    rung: Annotated[
        list[int] | None, typer.Option(help="Rung to run; all by default.", min=1, max=5)
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Test the gap diagnosis on sealed archives with known effects."""
    from airswing.blind_check import Plan, targets, write_report
    from airswing.blind_check import gap_check as check_diagnosis
    from airswing.workflow.progress import Progress

    plan = Plan(cases, seed, fast, nulls, tuple(rung) if rung else None, real=real)
    check = check_diagnosis(
        output, plan, workers=workers, so_far=so_far, say=Progress(quiet=quiet).say
    )
    report = write_report(output, check, command=plan.command)
    reached = targets(check.scores)
    summary = {"digest": check.digest, "targets": reached.to_dict("records")}
    text = f"{reached.to_string(index=False, float_format='%.3g')}\nreport: {report}"
    _print(summary | {"settings": check.settings}, as_json=json, text=text)


@app.command()
def postprocess(
    config: ConfigPath, output: Output = None, quiet: Quiet = False, json: Json = False
) -> None:
    """Correct forecasts at stations: postprocessed.nc and its page."""
    from airswing.workflow.postprocessing import postprocess as correct_after

    result = correct_after(config, output=output, quiet=quiet)
    lines = [result["headline"], *result["summary"]]
    lines += [f"product: {result['product']}", f"page: {result['page']}"]
    _print(result, as_json=json, text="\n".join(lines))


@app.command()
def sample(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to write to.", parser=_path)
    ],
    days: Annotated[int, typer.Option(help="Length of the archive.", min=1)] = 30,
    aircraft: Annotated[int, typer.Option(help="Number of aircraft.", min=1)] = 10,
    seed: Seed = 1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace reports, models and truth in DIR.")
    ] = False,
) -> None:
    """Write a sample archive and the file of its known truth.

    With five aircraft or more the last flies a single route: too few headings for a fit.
    """
    import shutil

    from airswing.errors import InputError
    from airswing.synthetic.archive import EDITIONS, write_archive

    if directory.is_dir() and any(directory.iterdir()):
        if not overwrite:
            raise InputError(
                "the folder is not empty",
                file=directory,
                remedy="Choose another folder, or give --overwrite to replace its archive",
            )
        for name in ("reports", "truth", *EDITIONS):
            if (directory / name).exists():
                shutil.rmtree(directory / name)
    shuttles = int(aircraft >= 5)
    print(write_archive(directory, days=days, aircraft=aircraft, seed=seed, shuttles=shuttles))


@app.command()
def inspect(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Files to inspect.", parser=_path)
    ],
    json: Json = False,
) -> None:
    """Print the content of GRIB files, report files or products."""
    from airswing.workflow.inspection import as_text, inspect_file

    summaries = [inspect_file(file) for file in files]
    _print(summaries, as_json=json, text="\n\n".join(as_text(entry) for entry in summaries))


def main() -> None:
    """Entry point: turn errors into one message and an exit status."""
    from airswing.errors import AirswingError

    try:
        # Depending on its version typer returns 130 after an interrupt, or raises Abort.
        if app(standalone_mode=False) == _INTERRUPTED:
            raise KeyboardInterrupt
    except _USAGE_ERROR as err:
        err.show()
        raise SystemExit(2) from None
    except (KeyboardInterrupt, typer.Abort):
        print("airswing: interrupted; finished products are intact", file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None
    except BrokenPipeError:  # the reader of standard output has ended, as in `... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except (AirswingError, MemoryError, OSError, RuntimeError) as err:
        message = _input_fault(err)
        if message is None:
            raise
        print(f"airswing: {message}", file=sys.stderr)
        raise SystemExit(2) from None


def _input_fault(err: Exception) -> str | None:
    """Message for bad input, or a fault of the disk, a folder or a file; None for a defect."""
    from airswing.errors import AirswingError, shortened

    if isinstance(err, AirswingError):
        return str(err)
    if isinstance(err, MemoryError):
        limits = "compute.workers and compute.threads limit the work done at a time"
        return f"not enough memory; {limits}"
    # numbers of the operating system; those of the NetCDF library are negative
    if isinstance(err, OSError) and (err.errno or 0) > 0:
        return f"{shortened(err.filename or 'a file')}: {err.strerror}"
    # The NetCDF and HDF5 libraries report damaged data only by these words.
    words = ("NetCDF:", "HDF error", "inflate() failed", "filter returned failure", "read data")
    if any(word in str(err) for word in words):
        return f"a NetCDF file is damaged ({shortened(err)}); make it again, or remove it"
    return None
