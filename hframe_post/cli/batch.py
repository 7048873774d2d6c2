"""``hframe-post batch``: convert many files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import click

from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.parameters import (
    chosen_printer,
    conversion_options,
    files_read,
    help_all_option,
    printer_option,
    say,
)
from hframe_post.conversion.options import Options, first_line
from hframe_post.errors import HframeError
from hframe_post.jobs import Converter, Job, State, jobs_for
from hframe_post.printer.profile import check_identified, load
from hframe_post.process import Interruption
from hframe_post.writers.outputs import Outputs

CLEAR_LINE = "\r\x1b[K"


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True),
                metavar="[FILE|FOLDER]...")  # fmt: skip
@click.option(
    "-o", "--output", "folder", required=True, type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER", help="Folder for the converted files.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", type=click.IntRange(1, 256), metavar="N",
    help="Files at a time. Default: one per processor.",
)  # fmt: skip
@printer_option
@conversion_options("strategy", "limits", "clamp", "force")
@click.option(
    "--resume", is_flag=True,
    help="Skip files that are converted already.",
)  # fmt: skip
@json_option
@help_all_option
@click.option("-q", "--quiet", is_flag=True, help="Print no progress and no summary.")
@click.pass_context
def batch(
    context: click.Context, sources: tuple[Path, ...], folder: Path, jobs: int | None,
    printer: str, options: Options, resume: bool,
    json_file: Path | None, quiet: bool,
) -> None:  # fmt: skip
    """Convert files, and all G-code in folders. A file that fails does not stop the others.

    --resume skips files that were converted with the same settings and have not changed since.
    Exit status: 0 if every file is converted, 1 if some failed, 2 for wrong usage.

    \b
    Examples:
      hframe-post batch jobs/ -o out/
      hframe-post batch jobs/*.gcode -o out/ -p my.toml --resume
    """
    profile = load(printer)
    stamped = first_line(profile, options.resolved(profile))
    if options.strategy != "none" and not options.force:
        check_identified(profile)
    try:
        todo = jobs_for(sources, folder, stamped if resume else b"")
    except HframeError as error:
        raise click.UsageError(str(error)) from None
    folder.mkdir(parents=True, exist_ok=True)
    converter = Converter(jobs, printer, options)
    compensates = (options.strategy or profile.compensation.strategy) != "none"
    results = Results(todo, quiet, chosen_printer().why, profile.warnings() if compensates else [])
    interruption = Interruption()
    with Outputs(files_read(*(job.source for job in todo), printer)) as outputs:
        write_json = open_json(outputs, json_file)
        with interruption.put_off(converter.stop):
            _convert(todo, converter, results)
        status = results.status
        if interruption.number:
            status = 128 + interruption.number
        write_json({**results.as_json(), "interrupted": bool(interruption.number)}, status)
    results.say(results.as_text())
    interruption.end()
    context.exit(status)


class Results:
    """Results of the jobs so far.

    why: what chose the profile. notices: warnings of the profile, which every file has.
    """

    def __init__(self, jobs: Sequence[Job], quiet: bool, why: str, notices: Sequence[str]) -> None:
        self.quiet, self._why, self._jobs, self._notices = quiet, why, jobs, notices
        for text in notices:
            self.say(f"WARNING {text}")

    def say(self, text: str) -> None:
        if not self.quiet:
            say(text)

    @property
    def status(self) -> int:
        return 0 if all(job.state in ("done", "skipped") for job in self._jobs) else 1

    def as_json(self) -> dict[str, Any]:
        files = [job.as_json() for job in self._jobs]
        for summary in (file["summary"] for file in files if "summary" in file):
            summary["profile_chosen_by"] = self._why  # each was converted with -p
        return {"files": files, "failed": self._count("failed")}

    def as_text(self) -> str:
        """Return what needs attention, each with its files, and the counts in the last line."""
        warned: dict[str, list[Path]] = {}
        for job in self._jobs:
            for text in job.summary.get("warnings", []):
                if text not in self._notices:
                    warned.setdefault(text, []).append(job.source)
        lines = [job.as_text() for job in self._jobs if job.state == "failed"]
        lines += [f"WARNING {_some(files)}: {text}" for text, files in warned.items()]
        counts = f"{self._count('done')} converted, {self._count('skipped')} skipped, "
        counts += f"{self._count('failed')} failed"
        if warned:
            counts += f", {len(set(chain(*warned.values())))} with warnings"
        if stopped := self._count("stopped"):
            counts += f", {stopped} not converted"
        advice = "; --resume tries only those again" if self.status else ""
        return "\n".join([*(lines if len(self._jobs) > 1 else []), counts + advice])

    def _count(self, state: State) -> int:
        return sum(job.state == state for job in self._jobs)


def _some(files: list[Path]) -> str:
    more = f" and {len(files) - 3} more" if len(files) > 3 else ""
    return ", ".join(map(str, files[:3])) + more


def _convert(jobs: list[Job], converter: Converter, results: Results) -> None:
    """Convert the jobs in place; print each result, below them a progress bar on a terminal."""
    sizes = {job.source: 0 if job.finished else job.source.stat().st_size for job in jobs}
    terminal = sys.stderr.isatty()

    def count(_: Job | None) -> str:
        return f"{sum(job.finished for job in jobs)} of {len(jobs)}"

    with click.progressbar(
        length=sum(sizes.values()), file=sys.stderr, hidden=results.quiet or not terminal,
        item_show_func=count,
    ) as bar:  # fmt: skip
        for job in converter.run(jobs):
            results.say(CLEAR_LINE * terminal + job.as_text())
            bar.update(sizes[job.source], job)
