"""The option --json: a summary of what a command did, or of why it failed (docs/interfaces.md)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from hframe_post.cli.parameters import dashed
from hframe_post.errors import HframeError
from hframe_post.version import __version__
from hframe_post.writers.outputs import Outputs

SCHEMA = 2  # raised when a key goes or changes its meaning
_SUMMARY = "hframe_post.json"  # in a context's meta


@dataclass(slots=True)
class _Summary:
    """The summary that a command was asked for.

    outputs: those that it appears with, once it is opened. final: whether it holds the failure.
    """

    context: click.Context
    path: Path
    outputs: Outputs | None = None
    final: bool = False


def _remember(context: click.Context, _: click.Parameter, path: Path | None) -> Path | None:
    if path is not None:
        context.meta[_SUMMARY] = _Summary(context, path)
    return path


json_option = click.option(
    "--json", "json_file", type=click.Path(path_type=Path, allow_dash=True, dir_okay=False),
    metavar="FILE", callback=_remember, is_eager=True,
    help="Summary as JSON; '-' is standard output.",
)  # fmt: skip


def open_json(outputs: Outputs, path: Path | None) -> Callable[..., None]:
    """Return the function that writes a summary to a file or standard output; None: nowhere.

    It takes the summary's own keys, the exit status (0, or 1 with an error) and, if the command is
    going to fail, its error. The file is opened at once, so that a file that cannot be written is
    reported before any work.
    """
    context = click.get_current_context()
    asked: _Summary | None = context.meta.get(_SUMMARY)
    if path is None or asked is None:
        return lambda *_, **__: None
    file = outputs.open(dashed(path))
    asked.outputs = outputs

    def write(
        own: dict[str, Any], status: int | None = None, error: HframeError | None = None
    ) -> None:
        asked.final = error is not None
        failure = {} if error is None else _failure(str(error), error)
        known = (0 if error is None else 1) if status is None else status
        file.write(_document(asked.context, known, {**failure, **own}))

    return write


def write_failure(context: click.Context, status: int, text: str, error: Exception) -> None:
    """Write the summary of a command that failed, if it was asked for one.

    It replaces an earlier summary, but no other file: neither one that the command reads or
    writes, nor one that is not JSON.
    """
    asked: _Summary | None = context.meta.get(_SUMMARY)
    if asked is None or asked.final:
        return
    to_stdout = str(asked.path) == "-"
    if to_stdout and asked.outputs is not None and asked.outputs.appeared:
        return  # printed already; the failure came after it
    with suppress(HframeError, OSError):
        if asked.path.is_file():
            with asked.path.open("rb") as file:
                if file.read(1) not in (b"", b"{"):
                    return
        with Outputs(_files_of(asked.context)) as outputs:
            document = _document(asked.context, status, _failure(text, error))
            outputs.open(dashed(asked.path)).write(document)


def _failure(text: str, error: Exception) -> dict[str, Any]:
    line = getattr(error, "line", None)
    return {"error": text, **({"line": line} if line is not None else {})}


def _document(context: click.Context, status: int, own: dict[str, Any]) -> bytes:
    head = {
        "schema": SCHEMA, "version": __version__, "command": context.info_name, "status": status,
    }  # fmt: skip
    return (json.dumps({**head, **own}, indent=2) + "\n").encode()


def _files_of(context: click.Context) -> Iterator[Path]:
    """Yield what the command's other parameters name, which may be files."""
    for name, value in context.params.items():
        for one in value if isinstance(value, tuple) else (value,):
            if name != "json_file" and isinstance(one, str | Path):
                yield Path(one)
