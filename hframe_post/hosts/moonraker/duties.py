"""What the component's processes do. Each returns an exit status, as a program does."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
from pathlib import Path

from .conversion import PAGE_SHOWS, Interface, Settings, converted, page_of
from .disk import (
    BeyondError,
    FailureError,
    GoneError,
    alone,
    cause,
    settle,
    stamp,
)
from .originals import PAGE_SUFFIX, Upload, refuse, settings_of
from .recordings import conclude, prepare

__all__ = ["Settings", "again", "conclude", "prepare", "stale", "tidy", "upload"]

OF_THE_FILE = re.compile(r"line \d+: ")  # how the reasons begin that a line of the file gives
NOT_MEASURED = "this printer is not measured yet"  # of a profile, says the command line


def upload(settings: Settings, path: str) -> int:
    """Convert a new file. If its own lines are the cause of a failure, it cannot be printed."""
    with alone(settings.folder):
        settings.originals.make_room()
        while stamp(Path(path)):  # otherwise it was deleted while it waited
            status = _uploaded(settings, Path(path))
            if status is not None:
                return status
            settle(Path(path))  # it was replaced, and Moonraker does not read it meanwhile
    return 1


def _uploaded(settings: Settings, path: Path) -> int | None:
    """Convert a new file; return None if it was replaced meanwhile."""
    interface, one = _interface(settings, path), Upload(path, Path(settings.gcodes))
    made = one.work.with_suffix(".converted")
    try:
        one.take()
        text, is_new = converted(
            one.work, made, path.name, settings.command, interface, one.is_gone,
            settings.originals.has_room() and not settings_of(one.work),
        )  # fmt: skip
        one.give_back(made if is_new else None, settings.originals)
    except (FailureError, GoneError, OSError) as error:
        fate = one.let_go() if one.is_gone() else "failed"
        if fate == "replaced":
            return None
        if fate != "failed":
            interface.report(f"its conversion was stopped, because it was {fate}")
        elif one.work.exists() and (harmless := _harmless(settings, error)):
            one.give_back(None, settings.originals)
            interface.report(f"left as sliced: {harmless}", failed=True)
        else:
            reason = f"not converted: {cause(error)}"
            interface.report(reason, failed=True)
            refuse(one, reason)
        return 1
    finally:
        _remove(made)
    _conclude(settings, path, interface, text)
    return 0


def _harmless(settings: Settings, error: Exception) -> str:
    """Return why a file was not converted that may print as sliced; empty: it must not print.

    It may if no file at all can be converted with the profile, or if it takes too much here.
    """
    if isinstance(error, BeyondError):
        return cause(error)
    if not isinstance(error, FailureError) or OF_THE_FILE.match(cause(error)):
        return ""
    try:
        settings.present()
    except FailureError as of_profile:
        if NOT_MEASURED in cause(of_profile):
            return f"{NOT_MEASURED}. To measure it, type HFRAME_CALIBRATE"
        return cause(of_profile) if shutil.which(settings.command[0]) else ""
    return ""


def again(settings: Settings, *names: str) -> int:
    """Convert files again from what was sliced; without names all that are stale."""
    gcodes, failed = Path(settings.gcodes), 0
    with alone(settings.folder):
        try:
            present = "" if names else settings.present()
            paths = [gcodes / name for name in names] or [*settings.originals.stale(present)]
        except FailureError as error:
            Interface(settings.socket).report(f"nothing is converted: {cause(error)}", failed=True)
            return 1
        for path in paths:
            known = settings_of(path)
            failed |= _again(settings, path) if known else _uploaded(settings, path) or 0
    return failed


def _again(settings: Settings, path: Path) -> int:
    """Convert a file again. It stays as it is until the new one is complete, and if that fails."""
    interface, before = _interface(settings, path), stamp(path)
    new = settings.folder / f"{os.getpid()}.converted"
    try:
        original = settings.originals.of(path)
        if not original.exists():
            raise FailureError("its sliced file is not kept: upload it again")
        text, _ = converted(
            original, new, path.name, settings.command, interface,
            lambda: stamp(path) != before, settings.originals.has_room(),
        )  # fmt: skip
        settings.originals.replace(path, new, original)
    except GoneError:
        interface.report("its conversion was stopped, because it was deleted or replaced")
        return 1
    except (FailureError, OSError) as error:
        interface.report(f"left as it was converted before: {cause(error)}", failed=True)
        return 1
    finally:
        _remove(new)
    _conclude(settings, path, interface, text.replace("converted", "converted again", 1))
    return 0


def _remove(made: Path) -> None:
    """Remove a converted file and its page, unless they are in their places."""
    made.unlink(missing_ok=True)
    made.with_suffix(PAGE_SUFFIX).unlink(missing_ok=True)


def _conclude(settings: Settings, path: Path, interface: Interface, text: str) -> None:
    """Report a conversion and link its page."""
    interface.report(text)
    with contextlib.suppress(OSError):  # it was deleted meanwhile
        if settings.originals.page_of(path).exists():
            interface.report(f"{PAGE_SHOWS}: {page_of(_name(Path(settings.gcodes), path))}")


def stale(settings: Settings, *names: str) -> int:
    """Print which files, or which of these, were converted with other settings, as JSON.

    kept: those that can be converted again.
    """
    gcodes = Path(settings.gcodes)
    try:
        present = settings.present()
    except FailureError:  # which an upload reports
        return 1
    if names:
        old = [gcodes / name for name in names if settings_of(gcodes / name) not in ("", present)]
        kept = [path for path in old if settings.originals.of(path).exists()]
    else:
        old = kept = [*settings.originals.stale(present)]
    shown = {"old": old, "kept": kept}
    print(json.dumps({key: [_name(gcodes, path) for path in each] for key, each in shown.items()}))
    return 0


def tidy(settings: Settings) -> int:
    """Remove what is kept for files that are gone."""
    with alone(settings.folder), contextlib.suppress(OSError):  # a file is deleted meanwhile
        settings.originals.tidy()
    return 0


def _interface(settings: Settings, path: Path) -> Interface:
    return Interface(settings.socket, _shown(path))


def _shown(path: Path) -> str:
    return os.fsencode(path.name).decode(errors="replace")


def _name(gcodes: Path, path: Path) -> str:
    return os.fsencode(os.path.relpath(path, gcodes)).decode(errors="surrogateescape")
