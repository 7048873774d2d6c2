"""Recordings that the owner has made with Klipper or Shake&Tune, where these leave them."""

from __future__ import annotations

import contextlib
from datetime import datetime, timezone
from pathlib import Path

from .history import events
from .settings import Settings

RESULTS = ("ShakeTune_results", "K-ShakeTune_results")  # next to printer.cfg; the second until 2024
SESSION = 24 * 3600.0  # s before the last recording, in which the printer has not changed


def found(settings: Settings, profile: Path) -> dict[Path, float]:
    """Return the recordings of the last session, with their times in s since 1970.

    What Klipper writes with OUTPUT=resonances is a spectrum, which tells no model.
    """
    files = [*Path(settings.recordings).glob("raw_data_*.csv")]
    for name in RESULTS:
        for ending in ("*.stdata", "*.csv"):
            files += profile.with_name(name).rglob(ending)
    times = dict[Path, float]()
    for path in sorted(files):
        with contextlib.suppress(OSError):  # it was deleted meanwhile
            times[path] = path.stat().st_mtime
    last = max(times.values(), default=0.0)
    return {path: at for path, at in times.items() if at > last - SESSION}


def offer(settings: Settings, profile: Path) -> str:
    """Return the line that offers recordings; empty: there are none since the last calibration."""
    times = found(settings, profile)
    last = max(times.values(), default=0.0)
    done = (one.at for one in events(settings.history) if one.kind == "calibration" and one.hz)
    if last <= max(done, default=0.0):
        return ""
    day = datetime.fromtimestamp(last, timezone.utc).date()  # noqa: UP017  Python 3.9
    return (
        f"recordings by Klipper or Shake&Tune found: {len(times)}, the last of {day}. To use them "
        "instead of measuring, cancel, then type HFRAME_CALIBRATE RECORDINGS=found"
    )
