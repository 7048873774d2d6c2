"""The G-code that Klipper plays while it records its accelerometers, and what the recordings say.

Both kinds have a folder in FOLDER, with the G-code, the exact commands and the recordings. Those of
one axis stay until it is recorded again, so that the sensor may be moved in between.

The component runs this file as a process: ``python recordings.py DUTY SETTINGS WORD...``. It prints
what to show, and the job to play, as a line of JSON each.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAME = "hframe_post"
FOLDER = ".hframe_post"  # in the folder of G-code, from which Klipper prints
MEMORY_BYTES = 1_000_000_000  # of data of a process; 370 MB are the most that any has needed
WRITING = {  # the file of G-code, and the words of the command that writes it
    "calibration": ("measure.gcode", "--times", "2"),
    "check": ("check.gcode", "--for", "check"),
}
MEASURING_S = 15.0 * 60.0  # s that such a command may take on a slow host
ENDS_RECORDING = re.compile(r"^ACCELEROMETER_MEASURE CHIP=\S+ NAME=(\S+)$", re.MULTILINE)
AXES = {"Gxx": "x", "Gyy": "y"}
OTHER_PLACE = {
    "X": "Mount the sensor on the print head, then type HFRAME_CALIBRATE AXIS=X",
    "Y": "Move the sensor to the bed, then type HFRAME_CALIBRATE AXIS=Y",
}


def prepare(settings: Settings, kind: str, axis: str) -> None:
    """Write the G-code of a kind and print the job to play: its name below the folder; or why not.

    axis: X or Y where one sensor records both, in two places.
    """
    folder = settings.folder / kind
    try:
        program, profile = settings.program_and_profile()
        if kind == "calibration" and axis != "Y":
            shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        if kind == "calibration" or not _is_written(folder, profile):
            job, *words = WRITING[kind]
            target = ("-p", str(profile), "-q", "-o", str(folder / job))
            _run([*program, "measure", *words, *target], MEASURING_S)
    except (FailureError, OSError) as error:
        report(f"nothing is measured: {_cause(error)}", failed=True)
        return
    jobs = sorted(folder.glob("*.gcode"))
    if len(jobs) > 1:
        jobs = [job for job in jobs if job.stem.endswith(f"-{(axis or 'X').lower()}")]
    elif axis:
        report("this printer's sensors record x and y at once, so AXIS does nothing")
    print(json.dumps({"job": f"{FOLDER}/{kind}/{jobs[0].name}"}), flush=True)


def conclude(settings: Settings, kind: str, job: str, began: str) -> None:
    """Update the profile from what was recorded since a time, and say what came out.

    job: as ``prepare`` prints it. began: s since 1970.
    """
    try:
        folder = settings.folder / kind
        _fetch(settings, Path(settings.gcodes, job), float(began))
        program, profile = settings.program_and_profile()
        if kind == "calibration":
            for axis in _missing(folder):
                report(f"recorded. {OTHER_PLACE[axis]}")
                return
        report("recorded. The model is computed, which may take some minutes")
        known = _computed(folder, program, profile)
        lines = [*(_identified if kind == "calibration" else _checked)(known)]
    except (FailureError, OSError, ValueError) as error:
        report(f"the model was not changed: {_cause(error)}", failed=True)
        return
    plots = f", plots into {profile.stem}.html next to it" if kind == "calibration" else ""
    lines.append(f"the model is written into {profile}{plots}")
    if profile.with_suffix(".kernel").is_file():
        lines.append("with [hframe_live] in printer.cfg, restart Klipper: it takes this model")
    report("\n".join(lines))  # at once: some consoles show the newest message first


def report(text: str, failed: bool = False) -> None:
    """Let the component show a message in the console of the web interface."""
    print(json.dumps({"text": f"hframe-post: {text}", "failed": failed}), flush=True)


def _computed(folder: Path, program: list[str], profile: Path) -> Any:
    """Update the profile from the recordings in a kind's folder; return the command's summary."""
    summary, page = folder / "summary.json", str(profile.with_suffix(".html"))
    words = ["identify", "--report", page] if folder.name == "calibration" else ["check"]
    result = ("-p", str(profile), "--json", str(summary), "-o", str(profile))
    inputs = (str(path) for path in sorted(folder.glob("*.csv")) if _is_wanted(folder, path))
    _run([*program, *words, *result, *inputs], MEASURING_S)
    return json.loads(summary.read_text("utf-8"))


def _is_written(folder: Path, profile: Path) -> bool:
    """Return whether the G-code in a folder is of the present profile."""
    times = [path.stat().st_mtime for path in folder.glob("*.gcode")]
    return bool(times) and min(times) > profile.stat().st_mtime


def _recordings(folder: Path, run: str) -> list[Path]:
    """Return the recordings of a run in a folder."""
    name = re.compile(rf".+-{re.escape(run)}(-t\d+)?\.csv")
    return [path for path in folder.glob(f"*-{run}*.csv") if name.fullmatch(path.name)]


def _fetch(settings: Settings, job: Path, began: float) -> None:
    """Copy what Klipper recorded of a job, once it is complete. Raises FailureError, OSError."""
    expected = Counter(ENDS_RECORDING.findall(job.read_text("utf-8")))
    # Klipper writes its recordings in the background
    source, deadline = Path(settings.recordings), time.monotonic() + 120.0
    before: dict[Path, int] = {}
    changed = time.monotonic()
    while True:
        found = {
            run: [p for p in _recordings(source, run) if p.stat().st_mtime >= began - 1.0]
            for run in expected
        }
        sizes = {path: path.stat().st_size for paths in found.values() for path in paths}
        if sizes != before:
            before, changed = sizes, time.monotonic()
        complete = all(len(found[run]) >= count for run, count in expected.items())
        if complete and time.monotonic() - changed > 3.0:  # s without a change
            break
        if time.monotonic() > deadline:
            raise FailureError(
                f"Klipper wrote {len(sizes)} of {sum(expected.values())} recordings into {source}. "
                "If it writes elsewhere, set recordings in [hframe_post] of moonraker.conf"
            )
        time.sleep(0.5)
    for run, paths in found.items():
        for old in _recordings(job.parent, run):
            old.unlink()
        for path in paths:
            shutil.copyfile(path, job.parent / path.name)


def _missing(folder: Path) -> Iterator[str]:
    """Yield X or Y for each command of one axis that has no recording."""
    for command in sorted(folder.glob("*.*.csv")):
        if not _is_wanted(folder, command):
            yield command.stem.split("-")[1].upper()


def _is_wanted(folder: Path, path: Path) -> bool:
    """Return whether a file is a recording, or the command of a run that was recorded.

    A command has the name of its run, such as measure.measure-x-at-110.csv.
    """
    run = path.stem.partition(".")[2]
    return not run or bool(_recordings(folder, run))


def _identified(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what identify says, in four lines."""
    axes = {AXES[name]: one for name, one in found["functions"].items() if name in AXES}
    rings = [
        f"{axis} rings at {one['modes'][0]['hz']:.1f} Hz (damping {one['modes'][0]['damping']:.2f})"
        if one["modes"] else f"{axis} does not ring"
        for axis, one in axes.items()
    ]  # fmt: skip
    if "Gxtheta" in found["functions"]:
        rings.append("it racks")
    yield ", ".join(rings)
    errors, range_ = found["predicted"], found["predicted_under_model_error"]
    yield (
        f"compensation leaves {range_['median_um']:.1f} of {errors['none']['rms']:.1f} µm RMS of a "
        f"rectangle's contour error, up to {range_['worst_um']:.1f} µm as the printer changes"
    )
    unexplained = (f"{axis} {100.0 * one['residual']:.1f} %" for axis, one in axes.items())
    yield f"it does not remove what the model does not explain: {', '.join(unexplained)}"
    warnings = found["warnings"]
    yield "WARNING: " + "; ".join(warnings) if warnings else "nothing else is unusual"


def _checked(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what check says, a line for each axis."""
    for name, one in found["functions"].items():
        before, now = one["resonance"]["hz"]
        moved = f"moved from {before:.1f} to {now:.1f} Hz" if one["drifted"] else "has not drifted"
        old, new = (f"{100.0 * share:.0f} %" for share in one["unexplained"])
        yield f"{AXES[name]}: the main resonance {moved}, unexplained {old} → {new}"


# ----------------------------------------------------------------------
# The section of moonraker.conf, the program that it names, and the console.


class FailureError(Exception):
    """The reason why nothing is measured."""


@dataclass(frozen=True)
class Settings:
    """What the component passes to its processes.

    gcodes: the folder of G-code. command: that runs hframe-post with the profile. recordings: the
    folder into which Klipper writes those of accelerometers.
    """

    gcodes: str
    command: list[str]
    recordings: str

    @property
    def folder(self) -> Path:
        return Path(self.gcodes) / FOLDER

    def program_and_profile(self) -> tuple[list[str], Path]:
        """Return the command's words before -p, and the profile after it. Raises FailureError."""
        for option in ("-p", "--printer"):
            if option in self.command[1:-1]:
                place = self.command.index(option)
                return self.command[:place], Path(self.command[place + 1])
        raise FailureError(
            f"command in [{NAME}] of moonraker.conf names no profile. Add -p and the profile's path"
        )


def _run(command: Sequence[str], seconds: float) -> None:
    """Run a command of hframe-post. Raises FailureError."""
    reading_end, writing_end = os.pipe()  # which closes with this process, and ends the command
    try:
        done = subprocess.run(
            command, stdin=reading_end, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", check=False, timeout=seconds,
            env={**os.environ, "HFRAME_POST_CHILD": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise FailureError(f"{' '.join(command[:2])} took more than {seconds:.0f} s") from None
    except OSError as error:
        raise FailureError(
            f"{command[0]} cannot be run: {error.strerror}. Correct command in [{NAME}] of "
            "moonraker.conf"
        ) from None
    finally:
        os.close(reading_end)
        os.close(writing_end)
    if done.returncode:
        last = done.stdout.rstrip().rpartition("\n")[2].removeprefix("Error: ")
        raise FailureError(last or f"hframe-post ended with {done.returncode}")


def _cause(error: Exception) -> str:
    """Return what is wrong, and where."""
    if isinstance(error, OSError) and error.strerror:
        return ": ".join(str(part) for part in (error.filename, error.strerror) if part)
    return str(error)


def _stand_back() -> None:
    """Give precedence to Klipper, which may be printing. Holds for all that is started, too."""
    import resource  # which Windows has not, where setup reads this file

    os.nice(10)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    memory = MEMORY_BYTES if most == resource.RLIM_INFINITY else min(MEMORY_BYTES, most)
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    with contextlib.suppress(OSError):  # the first that Linux ends if memory runs out
        Path("/proc/self/oom_score_adj").write_text("1000")


if __name__ == "__main__":
    _stand_back()
    duty, own, *words = sys.argv[1:]
    run = prepare if duty == "prepare" else conclude
    run(Settings(**json.loads(own)), *words)
