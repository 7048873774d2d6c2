"""``hframe-post batch``: its options, and where the files are converted."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import click

from hframe_post.cli.batch.job import Job, first_line, jobs_of
from hframe_post.cli.batch.local import LocalProcesses
from hframe_post.cli.batch.running import Place, run
from hframe_post.cli.batch.watching import watch_folder
from hframe_post.cli.options import (
    LazyChoice,
    files_read,
    force_option,
    json_option,
    limits_option,
    on_limit_option,
    open_json,
    printer_option,
    say,
    strategies,
)

ADDRESS = re.compile(r"[a-z+]+://\S+:\d+")


def address(text: str) -> str:
    """Of a scheduler: protocol, host and port."""
    if not ADDRESS.fullmatch(text):
        raise click.BadParameter(f"{text!r} is not such as tcp://farm:8786")
    return text


@click.command()
@click.argument("sources", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False),
                metavar="[FILE]...")  # fmt: skip
@click.option(
    "-d", "--directory", "folder", required=True, type=click.Path(path_type=Path, file_okay=False),
    help="Where the converted files go, under their names.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 256),
    help="Files at a time. Default: one a processor; of a cluster, one a thread of its workers.",
)  # fmt: skip
@printer_option
@click.option("-c", "--compensation", type=LazyChoice(strategies), help="Default: the profile's.")
@limits_option
@on_limit_option
@force_option
@click.option(
    "--resume", is_flag=True,
    help="Skip what is there already, converted with the same settings from a file not newer.",
)  # fmt: skip
@click.option(
    "--watch", "watched", type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER", help="Convert what lands in a folder, until stopped with Ctrl-C.",
)  # fmt: skip
@click.option(
    "--scheduler", type=address, metavar="tcp://HOST:PORT",
    help="Convert on the workers of a Dask cluster, which find files and profile under the same "
    "paths as here. Needs dask.distributed: pip install 'hframe-post[cluster]'.",
)  # fmt: skip
@click.option(
    "--send", is_flag=True,
    help="With --scheduler: send the files and fetch the results, where storage is not shared.",
)  # fmt: skip
@json_option
@click.option("-q", "--quiet", is_flag=True, help="No table, no summary.")
@click.pass_context
def batch(
    context: click.Context, sources: tuple[Path, ...], folder: Path, jobs: int | None,
    printer: str, compensation: str | None, limits: str, on_limit: str, force: bool, resume: bool,
    watched: Path | None, scheduler: str | None, send: bool, json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Convert many files at a time; one that fails does not stop the others.

    Exit status 0: all are converted; 1: some failed; 2: wrong usage.

    \b
    Examples:
      hframe-post batch jobs/*.gcode -d out/ -p my.toml --resume
      hframe-post batch --watch uploads/ -d printable/
      hframe-post batch jobs/*.gcode -d out/ --scheduler tcp://farm:8786
    """
    from hframe_post.printer.profile import check_identified, load
    from hframe_post.writers.files.atomic_file import Outputs

    _check_usage(sources, watched, folder, json_file, scheduler, send)
    stamped = first_line(printer, compensation, limits, on_limit)  # so it is a sound profile
    if compensation != "none" and not force:
        check_identified(load(printer))
    folder.mkdir(parents=True, exist_ok=True)
    options = ["--limits", limits, "--on-limit", on_limit, *(["--force"] if force else [])]
    options += ["-c", compensation] if compensation else []
    place = _place(scheduler, send, jobs, printer, options, stamped)
    if watched is not None:
        watch_folder(watched, folder, place, stamped, quiet)
        return
    pending = jobs_of(sources, folder, stamped if resume else b"")
    with Outputs(files_read(*sources, printer)) as outputs:
        write_json = open_json(outputs, json_file)
        done = run(pending, place(), quiet)
        failed = sum(job.state == "failed" for job in done)
        write_json({"files": [job.as_json() for job in done], "failed": failed})
    if not quiet:
        say(_summary(done))
    context.exit(1 if failed else 0)


def _check_usage(
    sources: tuple[Path, ...], watched: Path | None, folder: Path, json_file: Path | None,
    scheduler: str | None, send: bool,
) -> None:  # fmt: skip
    if bool(sources) == (watched is not None):
        raise click.UsageError("give either files or --watch FOLDER")
    if watched is not None and json_file is not None:
        raise click.UsageError("--watch never ends, so there is no summary for --json")
    if watched is not None and watched.resolve() == folder.resolve():
        raise click.UsageError("the folder that is watched cannot take the converted files")
    if send and scheduler is None:
        raise click.UsageError("--send needs --scheduler")


def _place(
    scheduler: str | None, send: bool, jobs: int | None, printer: str, options: list[str],
    stamped: bytes,
) -> Callable[[], Place]:  # fmt: skip
    """Where a set of files is converted, anew for each set."""
    if scheduler is None:
        return lambda: LocalProcesses(jobs, ["-p", printer, *options])
    from hframe_post.cli.batch.cluster import Cluster

    cluster = Cluster(scheduler, jobs, printer, options, stamped, send)
    return lambda: cluster


def _summary(done: list[Job]) -> str:
    """How many, and what to do about those that failed."""
    counts = [sum(job.state == state for job in done) for state in ("done", "skipped", "failed")]
    told = "{} converted, {} skipped, {} failed".format(*counts)
    return f"{told}; --resume tries only those again" if counts[2] else told
