"""Which recording is of which motion, and which motion is the plain one.

The compensated motion is the one that the model turns into the other. A recording belongs to the
motion from which the model predicts it better.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording, oriented
from hframe_post.identification.recordings.folder import Aside, Measurement, read_files
from hframe_post.identification.recordings.names import stem
from hframe_post.identification.recordings.orientation import (
    QUIET,
    has_marks,
    nearest_map,
    sensor_axes,
)
from hframe_post.identification.verification.verdict import GAIN_HZ, HIGH_HZ, band_rms, measured_run
from hframe_post.model.nozzle import nozzle
from hframe_post.printer.settings import Printer

CLEARLY = 0.5  # of the model's misses: a better pairing than the one that was given
Run = tuple[Array, Recording]


def from_files(paths: Sequence[Path]) -> tuple[list[Run], list[Path]]:
    """Return the two runs of a verification in files and folders, and their recordings' files.

    Raises OSError, and IdentificationError unless there are two commands and two recordings.
    """
    commands, read = read_files(paths)
    motions = [c for c in commands if c.direction is None and has_marks(c.motion)]
    motions.sort(key=lambda command: command.run, reverse=True)  # plain, compensated
    found = [one for one in read if isinstance(one, Measurement)
             and any(c.lasts_as_long_as(one.recording) for c in motions)]  # fmt: skip
    named = [one for one in found if stem(one.path.name).endswith(tuple(c.run for c in motions))]
    found = named if len(named) == 2 else found
    if len(motions) != 2 or len(found) != 2:
        aside = "".join(f"; {one.label}: {one.reason}" for one in read if isinstance(one, Aside))
        raise IdentificationError(
            f"{len(motions)} commands of 'verify --gcode' and {len(found)} recordings of them, not "
            f"two of each. Give the folder or the four files{aside}"
        )
    found.sort(key=lambda one: stem(one.path.name).endswith(motions[0].run), reverse=True)
    runs = [(c.motion, one.recording) for c, one in zip(motions, found, strict=True)]
    return runs, [one.path for one in found]


def along_printer(run: Run, axes: str | None) -> Run:
    """Return a run with its recording along the printer's axes, by default as it shows them.

    Raises IdentificationError.
    """
    command, recording = run
    if axes is None and has_marks(command):
        axes = nearest_map(sensor_axes(command, recording))
    return command, oriented(recording, axes or "x=x,y=y,z=z", QUIET)


def sorted_out(printer: Printer, first: Run, second: Run) -> tuple[Run, Run, list[str]]:
    """Return the plain and the compensated run, and what was exchanged.

    Raises IdentificationError.
    """
    if len(first[0]) != len(second[0]):
        raise IdentificationError(
            "the commands of the two motions differ in length: they were not written by the same "
            "'hframe-post verify --gcode'"
        )
    notes = []
    if _off(printer, first[0], second[0]) < _off(printer, second[0], first[0]):
        first, second = second, first
        notes.append("the plain and the compensated motion were exchanged, and are judged as such")
    (plain, a), (compensated, b) = first, second
    given = _missed(printer, plain, a) + _missed(printer, compensated, b)
    if _missed(printer, plain, b) + _missed(printer, compensated, a) < CLEARLY * given:
        a, b = b, a
        notes.append("the two recordings were exchanged, and are judged with the other command")
    return (plain, a), (compensated, b), notes


def _off(printer: Printer, command: Array, wanted: Array) -> float:
    """Return how far the nozzle would be from a path (m, 2) with this command, mm RMS."""
    off = nozzle(printer.plant, command[0], command) - wanted
    return float(np.sqrt((off**2).mean()))


def _missed(printer: Printer, command: Array, recording: Recording) -> float:
    """Return what the model does not predict of a recording, mm/s² RMS."""
    run = measured_run(printer, command, recording)
    return band_rms(run.a - run.a_predicted, GAIN_HZ[1], HIGH_HZ)
