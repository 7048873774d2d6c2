"""Klipper's version, as its log shows it, and what is wrong with some versions.

Klipper asks git for its version, such as "v0.13.0-635-g460ee7834": the last release, the commits
since, and the last of these; only that one if the copy of its history has no releases. "-dirty"
follows if files were changed. No G-code and no macro can read it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hframe_post.errors import one_line
from hframe_post.firmware.base import Finding
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig

LOG = "klippy.log"
VERSION = re.compile(rb"Git version: '([^']+)'")  # at each start, and where a new log begins
NAMED = re.compile(r"v([\d.]+)-(\d+)-g[0-9a-f]+")
COMMIT = re.compile(r"(?:^|-g)([0-9a-f]{7,40})(?:-dirty)?$")
# Of Klipper's main branch, db10e92e9 to 2239041df: a frequency in SET_INPUT_SHAPER changes nothing
RELEASE, SINCE = "0.13.0", range(631, 642)
AFFECTED = (
    "db10e92e9b3a", "7c0ee842c48c", "19da13507a12", "530cd0512210", "ef8edf3aef7f", "293e1e9d5882",
    "352bc8b2e384", "460ee78340a5", "ef7b13b1f2d4", "d2aa4bd7e371", "2239041df6a2",
)  # fmt: skip
HARM = (
    "ignores SET_INPUT_SHAPER SHAPER_FREQ_X=0, so input shaping stays on in converted files and "
    "moves the motors by up to 0.4 mm"
)
WHICH = f"Klipper of 27 April to 4 May 2026 (v{RELEASE}-{SINCE[0]} to -{SINCE[-1]})"


def _log_of(config: Path) -> Path | None:
    """Return the log of the Klipper that reads a printer.cfg, if it is at a usual place."""
    folder = config.absolute().parent
    places = (folder / LOG, folder.parent / "logs" / LOG)
    return next((path for path in places if path.is_file()), None)


def check_version(config: KlipperConfig, log: Path | None) -> Iterator[Finding]:
    """Yield what Klipper's version means for converted files on a printer that shapes its input.

    log: None: at a usual place. Raises OSError if it cannot be read.
    """
    axes = [f"shaper_freq_{axis}" for axis in "xyz"]
    if not config.missing and not any(config.number("input_shaper", a, 0.0) for a in axes):
        return  # nothing needs to be turned off
    log = log or _log_of(config.path)
    version = _last_version(log) if log is not None else ""
    if not version:
        where = (
            f"{log} does not show Klipper's version" if log else "Klipper's version is not known"
        )
        yield Finding(False, f"{where}: show its log with --klippy-log, since {WHICH} {HARM}")
    elif is_affected(version):
        yield Finding(True, f"{log}: Klipper {one_line(version)} {HARM}: update Klipper")


def is_affected(version: str) -> bool:
    """Return whether this version of Klipper cannot turn input shaping off."""
    commit, named = COMMIT.search(version), NAMED.match(version)
    if commit and any(each.startswith(commit[1][:12]) for each in AFFECTED):
        return True
    return bool(named and named[1] == RELEASE and int(named[2]) in SINCE)


def _last_version(log: Path) -> str:
    found = ""
    with log.open("rb") as lines:
        for line in lines:
            if match := VERSION.search(line):
                found = match[1].decode("utf-8", "replace")
    return found
