"""Which files a batch converts: those that are named, and those in folders."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from hframe_post.batch.jobs import Job
from hframe_post.errors import HframeError
from hframe_post.gcode.lines import NAMES, is_gcode_name

MOST_COMMENTS = 1 << 20  # bytes; previews may precede the first line of ours


def with_targets(
    sources: Iterable[Path], folder: Path
) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Return the files to convert, each with its target in ``folder``, and packed ones left out.

    Of a folder these are the files of G-code in it and its subfolders, whose structure is kept.
    Raises HframeError for a folder without G-code, and OSError for one that cannot be read.
    """
    found: list[tuple[Path, Path]] = []
    packed = list[Path]()
    for source in sources:
        if not source.is_dir():
            if _is_packed(source.name):
                raise HframeError(f"{source} is packed: unpack it first, with gunzip")
            found.append((source, folder / source.name))
            continue
        files = _gcode_in(source, folder, packed, _raise)
        if not files:
            raise HframeError(f"{source} holds no G-code ({', '.join(NAMES)})")
        found += [(path, folder / path.relative_to(source)) for path in files]
    return list(dict.fromkeys(found)), packed


def _is_packed(name: str) -> bool:
    return name.lower().endswith(".gz") and is_gcode_name(name[: -len(".gz")])


def _gcode_in(
    folder: Path, without: Path, packed: list[Path], on_error: Callable[[OSError], object]
) -> list[Path]:
    """Return the files of G-code in a folder and its subfolders, without hidden ones.

    without: a subfolder that is left out, too: the one of the output. packed: gets those that are
    compressed.
    """
    found, left_out = [], without.resolve()
    for place, folders, names in os.walk(folder, onerror=on_error):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and Path(place, name).resolve() != left_out
        )
        shown = [name for name in sorted(names) if name[0] != "."]
        found += [Path(place, name) for name in shown if is_gcode_name(name)]
        packed += [Path(place, name) for name in shown if _is_packed(name)]
    return found


def _raise(error: OSError) -> None:
    raise error


def jobs_for(files: Sequence[tuple[Path, Path]], first_line: bytes) -> list[Job]:
    """Return one job per file and target; those converted already are marked as skipped.

    first_line: that of a file converted with the same settings; empty: skip none.
    Raises HframeError where a target would be written twice or replace a source.
    """
    jobs, taken = [], dict[Path, Path]()
    inputs = {source.resolve(): source for source, _ in files}
    for source, target in files:
        place = target.resolve()
        if place in inputs:
            raise HframeError(
                f"{target} would replace the input {inputs[place]}: choose another --output"
            )
        if place in taken:
            raise HframeError(
                f"{taken[place]} and {source} would both be written to {target}: rename one, or "
                "name a folder that holds both, whose subfolders are kept"
            )
        taken[place] = source
        done = (
            first_line
            and target.is_file()
            and target.stat().st_mtime >= source.stat().st_mtime
            and _has(target, first_line)
        )
        jobs.append(Job(source, target, "skipped" if done else "waiting"))
    return jobs


def _has(path: Path, first_line: bytes) -> bool:
    """Return whether a file has the line, maybe behind previews that come first."""
    with path.open("rb") as file:
        return (b"\n" + first_line) in b"\n" + file.read(MOST_COMMENTS)
