"""What a command that reads measurements writes: findings, and the profile with its model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import click

from hframe_post.cli.parameters import WRITTEN, Summary, quoted, say, write_kernel
from hframe_post.errors import HframeError
from hframe_post.printer.choice import PROFILE
from hframe_post.printer.model_file import model_path, texts
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer

recordings_argument = click.argument(
    "recordings", nargs=-1, metavar="[FOLDER|FILES]...",
    type=click.Path(path_type=Path, exists=True),
)  # fmt: skip
profile_option = click.option(
    "-o", "--output", type=WRITTEN, metavar="PROFILE.TOML",
    help="Write the profile with what was found; may be that of -p.",
)  # fmt: skip


class Shown(Protocol):
    """Findings as text and as the keys of a JSON summary."""

    def as_text(self) -> str: ...
    def as_json(self) -> dict[str, Any]: ...


@dataclass(frozen=True, slots=True)
class Rows:
    """Findings as labelled rows; values: the same for a JSON summary."""

    rows: list[tuple[str, str]]
    values: dict[str, Any]

    def as_text(self) -> str:
        return "\n".join(f"{label:13s}{text}" for label, text in self.rows)

    def as_json(self) -> dict[str, Any]:
        return self.values


@dataclass(slots=True)
class Findings:
    """What recordings or a print show.

    printer: the profile to write; None if there is a fault, which the command ends with. aside:
    what was not used, and why. page: the report for a browser. notes: for the model's file, None to
    keep its present ones. advice: what to do next with the profile.
    """

    report: Shown
    printer: Printer | None = None
    fault: HframeError | None = None
    aside: Sequence[str] = ()
    page: Callable[[], bytes] = bytes
    notes: Sequence[str] | None = None
    advice: str = ""


def publish(
    find: Callable[[], Findings], reads: Sequence[Path], source: str, output: Path | None,
    summary: Summary | None = None, report_file: Path | None = None, text: str | None = None,
) -> None:  # fmt: skip
    """Write what ``find`` returns: reports first, the profile last and only without a fault.

    All files are opened before the work, so that none of it is in vain. source: name or file of the
    profile that is completed. text: of that, if it is in no file.
    """
    summary = summary or Summary()
    if output is not None and output.suffix != ".toml":
        raise HframeError(
            f"{output}: the model is written next to the profile, whose name must end in .toml"
        )
    with Outputs(reads) as profiles:
        files = list[IO[bytes]]()
        if output is not None:
            own = Path(source) if text is None else None
            files += [
                profiles.open(output, own),
                profiles.open(model_path(output), model_path(output)),
            ]
        with Outputs([*reads, *([output] if output else [])]) as reports:
            summary.open(reports)
            html = reports.open(report_file) if report_file is not None else None
            found = find()
            summary.write(found.report.as_json(), error=found.fault)
            if html is not None:
                html.write(found.page())
        for one in found.aside:
            say(f"left aside   {one}")
        click.echo(found.report.as_text(), err=summary.to_stdout)
        if found.fault is not None:
            raise found.fault
        if found.printer is None:
            return
        if output is None:  # it is kept in the profile that was read, if that is a file
            kept = source if Path(source).suffix == ".toml" else PROFILE
            say(f"Nothing is written. To keep it, add -o {quoted(kept)}")
            return
        written = texts(found.printer, source, output, found.notes, text)
        for file, content in zip(files, (written.profile, written.model), strict=True):
            file.write(content.encode())
        write_kernel(profiles, output, written.printer)
    say(f"Next: {found.advice or f'hframe-post PART.GCODE -o OUT.GCODE -p {quoted(output)}'}")
