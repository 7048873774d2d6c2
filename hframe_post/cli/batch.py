"""``hframe-post batch``: convert many files, here or on a cluster."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

from hframe_post import library
from hframe_post.batch.cluster import Cluster
from hframe_post.batch.jobs import Converter, Job, LocalProcesses, jobs_for, run, watch_folder
from hframe_post.cli.options import (
    compensation_option,
    files_read,
    force_option,
    json_option,
    limits_option,
    old_option,
    on_limit_option,
    open_json,
    printer_option,
    say,
)
from hframe_post.errors import HframeError
from hframe_post.gcode.state import LimitSource
from hframe_post.printer.profile import check_identified
from hframe_post.writers.files import Outputs

CLEAR_LINE = "\r\x1b[K"


def address(text: str) -> str:
    if not re.fullmatch(r"[a-z+]+://\S+:\d+", text):
        raise click.BadParameter(f"{text!r} is not an address such as tcp://farm:8786")
    return text


@click.command()
@click.argument("sources", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False),
                metavar="[FILE]...")  # fmt: skip
@click.option(
    "-d", "--directory", "folder", required=True, type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the converted files, which keep their names.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 256),
    help="Files to convert at a time. Default: one per processor, or per thread of the cluster.",
)  # fmt: skip
@printer_option
@compensation_option
@limits_option
@on_limit_option
@force_option
@click.option(
    "--resume", is_flag=True,
    help="Skip files that have been converted with the same settings and have not changed since.",
)  # fmt: skip
@click.option(
    "--watch", "watched", type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER", help="Convert files as they arrive in a folder, until stopped with Ctrl-C.",
)  # fmt: skip
@click.option(
    "--scheduler", type=address, metavar="tcp://HOST:PORT",
    help="Convert on the workers of a Dask cluster; files are sent to them and fetched back. Needs "
    "dask.distributed.",
)  # fmt: skip
@old_option("--send", "files are always sent to a cluster", is_flag=True, expose_value=False)
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Print no progress and no summary.")
@click.pass_context
def batch(
    context: click.Context, sources: tuple[Path, ...], folder: Path, jobs: int | None,
    printer: str, compensation: str | None, limits: LimitSource, on_limit: str, force: bool,
    resume: bool, watched: Path | None, scheduler: str | None, json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Convert many files. A file that fails does not stop the others.

    Exit status: 0 if every file is converted, 1 if some failed, 2 for wrong usage.

    \b
    Examples:
      hframe-post batch jobs/*.gcode -d out/ -p my.toml --resume
      hframe-post batch --watch uploads/ -d printable/
      hframe-post batch jobs/*.gcode -d out/ --scheduler tcp://farm:8786
    """
    _check_usage(sources, watched, folder, json_file)
    profile = library.load_printer(printer)
    first_line = library.first_line(
        profile, strategy=compensation, limits=limits, clamp=on_limit == "clamp"
    )
    if compensation != "none" and not force:
        check_identified(profile)
    folder.mkdir(parents=True, exist_ok=True)
    options = ["--limits", limits, "--on-limit", on_limit, *(["--force"] if force else [])]
    options += ["-c", compensation] if compensation else []
    converter: Converter = LocalProcesses(jobs, ["-p", printer, *options])
    if scheduler is not None:
        converter = Cluster(scheduler, jobs, printer, options, first_line)
    if watched is not None:
        if not quiet:
            say(f"watching {watched}; stop with Ctrl-C")
        for arrived in watch_folder(watched, folder, first_line):
            _convert(arrived, converter, quiet)
        return
    try:
        todo = jobs_for(sources, folder, first_line if resume else b"")
    except HframeError as error:
        raise click.UsageError(str(error)) from None
    with Outputs(files_read(*sources, printer)) as outputs:
        write_json = open_json(outputs, json_file)
        _convert(todo, converter, quiet)
        failed = sum(job.state == "failed" for job in todo)
        write_json({"files": [job.as_json() for job in todo], "failed": failed})
    if not quiet:
        skipped = sum(job.state == "skipped" for job in todo)
        summary = f"{len(todo) - skipped - failed} converted, {skipped} skipped, {failed} failed"
        say(f"{summary}; --resume tries only those again" if failed else summary)
    context.exit(1 if failed else 0)


def _check_usage(
    sources: tuple[Path, ...], watched: Path | None, folder: Path, json_file: Path | None
) -> None:
    if bool(sources) == (watched is not None):
        raise click.UsageError("name either files or --watch FOLDER")
    if watched is not None and json_file is not None:
        raise click.UsageError("--watch runs until it is stopped and writes no --json summary")
    if watched is not None and watched.resolve() == folder.resolve():
        raise click.UsageError("--watch and --directory must be different folders")


def _convert(jobs: list[Job], converter: Converter, quiet: bool) -> None:
    """Convert the jobs in place; print each result, below them a progress bar on a terminal."""
    sizes = {job.source: 0 if job.finished else job.source.stat().st_size for job in jobs}
    terminal = sys.stderr.isatty()

    def count(_: Job | None) -> str:
        return f"{sum(job.finished for job in jobs)} of {len(jobs)}"

    with click.progressbar(
        length=sum(sizes.values()), file=sys.stderr, hidden=quiet or not terminal,
        item_show_func=count,
    ) as bar:  # fmt: skip
        for job in run(jobs, converter):
            if not quiet:
                say(CLEAR_LINE * terminal + job.as_text())
            bar.update(sizes[job.source], job)
