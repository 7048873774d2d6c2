"""Experiments to identify a printer from: recordings, each with the motion that was played.

    files → experiments, each a run

The motion of strokes, or of Marlin's sweep, is in its command's file. That of a test of resonances
follows from [resonance_tester] of printer.cfg, corrected by what the recording shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.recordings.accelerometer import Recording, axes_map
from hframe_post.identification.recordings.clock import known_start
from hframe_post.identification.recordings.folder import (
    Aside,
    Measurement,
    contents,
)
from hframe_post.identification.recordings.resonance_search import find
from hframe_post.identification.recordings.resonance_test import (
    DEFAULTS,
    SECTION,
    ResonanceTest,
    probe_points,
)
from hframe_post.printer.settings import Travel

ALIKE = 0.9  # cosine between two sensors' views of one axis, from which they are mounted alike


EXCHANGED = (
    "the tests of x and y show each other's axis: either the sensor is turned against its axes_map "
    "in printer.cfg, which does no harm, or the names of the two files are exchanged"
)


@dataclass(frozen=True, slots=True)
class Experiment:
    """A motion that was played, and its recording.

    source: the recording in its file. motion: which it was, in words. notes: what was unusual.
    axis (3,): the direction of a test of resonances, as the sensor shows it.
    """

    source: Measurement
    run: Run
    motion: str
    notes: Sequence[str] = ()
    axis: Array | None = None

    @property
    def label(self) -> str:
        return self.source.label

    @property
    def kind(self) -> str:
        """Return the purpose of `measure` that wrote the motion, if its start is known."""
        return self.source.command.kind if self.source.command else ""

    def as_text(self) -> str:
        session = self.source.session
        repeated = f", session {session}" if session > 1 else ""
        return "; ".join([f"{self.label}: {self.motion}{repeated}", *self.notes])

    def as_json(self) -> dict[str, Any]:
        return {
            "file": self.label, "motion": self.motion, "session": self.source.session,
            "sha256": self.source.digest, "notes": list(self.notes),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Gathered:
    """Experiments that are used, and the files that were left aside."""

    used: list[Experiment]
    aside: list[Aside]

    @property
    def runs(self) -> list[Run]:
        return [one.run for one in self.used]

    def day(self, runs: Sequence[Run]) -> date:
        """Return the last day on which some of the runs were recorded. Raises OSError."""
        names = {run.name for run in runs}
        return max(one.source.day for one in self.used if one.label in names)

    def rows(self) -> list[tuple[str, str]]:
        """Return what was used and what was not, labelled, for a summary."""
        return [
            *(("used", one.as_text()) for one in self.used),
            *(("left aside", f"{one.label}: {one.reason}") for one in self.aside),
        ]

    def as_json(self) -> dict[str, Any]:
        return {
            "recordings": [one.as_json() for one in self.used],
            "left_aside": [{"file": one.label, "reason": one.reason} for one in self.aside],
        }


def gather(
    paths: Sequence[Path], config: KlipperConfig | None, travel: Travel,
    columns: Sequence[str] | None = None, chips: Mapping[str, str] = MappingProxyType({}),
    pairs: Sequence[tuple[Path, Path]] = (),
) -> Gathered:  # fmt: skip
    """Return the experiments in files and folders, with recordings in the sensors' axes.

    config: printer.cfg, which describes the tests of resonances; Klipper's defaults without it.
    columns: names of time, x, y, z in files that do not say it. chips: by x and y, the sensors
    where no config names them. pairs: commands and their recordings, as the owner knows them.
    Raises OSError, and IdentificationError if no recording can be used.
    """
    measurements, aside = contents(paths, columns, _chips(config) or chips, pairs)
    found = list[Experiment]()
    for one in measurements:
        try:
            found.append(_experiment(one, config, travel))
        except HframeError as error:
            strange = [] if one.recording.up.any() else one.recording.warnings()[-1:]
            aside.append(Aside(one.label, ". ".join([*strange, str(error)])))
    struck = {axis for one in found if one.run.known_start for axis in one.run.axes}
    used = []
    for each in _exchanged(found):
        if not each.run.known_start and struck.intersection(each.run.axes):
            aside.append(Aside(each.label, "strokes along the same axis are more like a print"))
        else:
            used.append(each)
    if not used:
        reasons = "; ".join(f"{one.label}: {one.reason}" for one in aside[:3])
        reasons = reasons or "The files are commands, without their recordings"
        more = f"; and {len(aside) - 3} more files" if len(aside) > 3 else ""
        raise IdentificationError(f"no recording can be used. {reasons}{more}")
    return Gathered(used, aside)


def _exchanged(found: Sequence[Experiment]) -> list[Experiment]:
    """Return the same, with a note where the tests of x and y show each other's axis."""
    shown = {one.source.direction: one.axis for one in found if one.axis is not None}
    x, y = (shown.get(direction) for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    if x is None or y is None or min(abs(x[Y]), abs(y[X])) < ALIKE:
        return list(found)
    return [
        one if one.axis is None else replace(one, notes=[*one.notes, EXCHANGED]) for one in found
    ]


# ---------------------------------------------------------------------- kinds of experiments


def _experiment(one: Measurement, config: KlipperConfig | None, travel: Travel) -> Experiment:
    """Return the experiment that a recording is of. Raises HframeError."""
    command, axis, clock = one.command, None, None
    unusual: Sequence[str] = ()
    recording = one.recording if command and command.kind else _in_sensor_axes(one, config)
    if command is None:
        found = find(one.recording, _expected(one, config, travel))
        motion, clock, axis = found.test.command(), found.clock, found.axis
        described = _described(found.test, config)
    else:
        motion, described = command.motion, f"{command.kind or 'sweep'} {command.path.name}"
        check_travel(motion, travel)
        if command.kind:
            clock, unusual = known_start(recording, len(motion), one.name.ended)
    run = Run(one.label, motion, recording, clock)
    run = replace(run, found=run.aligned())
    if run.known_start:
        run.own_axes()  # raises if it does not show them
    return Experiment(one, run, described, [*unusual, *one.recording.warnings()], axis)


def _in_sensor_axes(one: Measurement, config: KlipperConfig | None) -> Recording:
    """Return the recording without the axes_map of printer.cfg.

    Owners' maps often mirror, and then gravity does not tell on which side the other axis lies.
    """
    if config is None:
        return one.recording
    assert one.direction is not None
    given = config.text(_chip(config, "x" if one.direction[0] else "y"), "axes_map")
    if not given:
        return one.recording
    return replace(one.recording, a=one.recording.a @ axes_map(given))


def check_travel(motion: Array, travel: Travel) -> None:
    """Raise IdentificationError if a motion (m, 2) leaves the printer's travel."""
    for axis, at, (low, high) in zip("xy", motion.T, (travel.x, travel.y), strict=True):
        if at.min() < low or at.max() > high:
            raise IdentificationError(
                f"its motion goes from {at.min():.1f} to {at.max():.1f} mm in {axis}, but the "
                f"profile's travel from {low:g} to {high:g} mm. Was it played on another printer?"
            )


def _expected(one: Measurement, config: KlipperConfig | None, travel: Travel) -> ResonanceTest:
    """Return the test that printer.cfg describes."""
    assert one.direction is not None
    middle = (sum(travel.x) / 2.0, sum(travel.y) / 2.0)
    if config is None or not config.has(SECTION):
        return ResonanceTest(
            one.direction, one.name.point or middle, **DEFAULTS, around_point=False
        )
    point = one.name.point or probe_points(config)[0]
    # Shake&Tune tests in the middle where the point is -1, -1
    return ResonanceTest.from_config(config, one.direction, middle if min(point) < 0.0 else point)


def _described(test: ResonanceTest, config: KlipperConfig | None) -> str:
    """Return the test as the recording shows it, and what printer.cfg says otherwise."""
    dx, dy = test.direction[:2]
    axis = ("x" if dx else "y") if not dx or not dy else f"{dx / abs(dx):g},{dy / abs(dx):.3g}"
    keys = ["min_freq", "max_freq", "accel_per_hz"]
    keys += ["sweeping_accel", "sweeping_period"] if test.sweeping_period else []
    shown = []
    for key in keys:
        value = float(getattr(test, key))
        usual = value if config is None or test.around_point else DEFAULTS[key]
        given = usual if config is None else config.number(SECTION, key, usual)
        known = "printer.cfg" if config is not None and config.text(SECTION, key) else "default"
        differs = abs(given - value) > 0.1 * value
        shown.append(f"{key} {value:g}" + (f" ({known}: {given:g})" if differs else ""))
    old = " of Klipper before December 2024" if test.around_point else ""
    x, y = test.point
    return f"TEST_RESONANCES{old} of {axis} at {x:g},{y:g}: {', '.join(shown)}"


def _chips(config: KlipperConfig | None) -> dict[str, str]:
    """Return the names of the sensors for x and for y, as files have them."""
    if config is None:
        return {}
    return {axis: "_".join(_chip(config, axis).lower().split()) for axis in "xy"}


def _chip(config: KlipperConfig, axis: str) -> str:
    """Return the section of the sensor for an axis, x or y."""
    return config.text(SECTION, f"accel_chip_{axis}") or config.text(SECTION, "accel_chip")
