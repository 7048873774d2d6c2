"""The motion of Klipper's TEST_RESONANCES, rebuilt from the parameters of [resonance_tester].

Pulses: the acceleration is ±accel_per_hz·f for a quarter of 1/f each, and f grows by hz_per_sec
times the time that has passed. Since December 2024 a slow square wave of acceleration is added,
the sweeping, so that the printer never stops for long.

    pulses, today      + − | − + | + − | …   f grows at each |, where the printer is at rest
    pulses, formerly   + + | − − | + + | …   f grows at each |, where it is fastest

Today's motion swings to one side of the point, the former one around it. Acceleration and speed
are as large as the test needs: Klipper lifts its limits, [printer] max_accel included. Only the
last braking, after sweeping, obeys max_accel. Klipper before July 2026 and Kalico compute that
braking from the wrong speed; their last 0.1 s differs from the motion here.

Shake&Tune plays the same motion in its tests of shapers and belts. Its axes map test is one plain
move along each axis, its vibrations test many: neither excites a band of frequencies. Nor does its
test at a constant frequency.

https://www.klipper3d.org/Config_Reference.html#resonance_tester
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig

SECTION = "resonance_tester"
SLACK = 1e-6  # Hz by which the last frequency may exceed max_freq, as in the firmware
STOP_ACCEL = 3000.0  # mm/s², where printer.cfg has no max_accel
OPTIONS = {  # as Klipper has it where printer.cfg leaves it out, and bounds
    "min_freq": (5.0, 1.0, 300.0), "max_freq": (135.0, 1.0, 300.0),
    "hz_per_sec": (1.0, 0.05, 20.0), "accel_per_hz": (60.0, 0.1, 10000.0),
    "sweeping_accel": (400.0, 0.1, 100000.0), "sweeping_period": (1.2, 0.05, 60.0),
}  # fmt: skip
DEFAULTS = {key: usual for key, (usual, _, _) in OPTIONS.items()}
FORMER_MAX_FREQ = 10000.0 / 75.0  # Hz, the default before December 2024


@dataclass(frozen=True, slots=True)
class ResonanceTest:
    """A test along a direction (a unit vector x, y or x, y, z) from a point (x, y, mm).

    Frequencies are in Hz, accelerations in mm/s², periods in s, as in [resonance_tester].
    sweeping_period: 0 without sweeping. stop_accel: mm/s² with which the motion ends after
    sweeping. around_point: whether the motion swings around the point, as before December 2024.
    """

    direction: tuple[float, ...]
    point: tuple[float, float]
    min_freq: float
    max_freq: float
    hz_per_sec: float
    accel_per_hz: float
    sweeping_accel: float
    sweeping_period: float
    stop_accel: float = STOP_ACCEL
    around_point: bool = False

    @classmethod
    def from_config(
        cls,
        config: KlipperConfig,
        direction: Sequence[float],
        point: tuple[float, float] | None = None,
    ) -> ResonanceTest:
        """Return the test that a printer.cfg describes.

        direction: x, y[, z] as TEST_RESONANCES AXIS=dx,dy takes it, of any length. point: x and y
        in mm, by default the first of probe_points. Raises HframeError.
        """
        length = float(np.linalg.norm(direction))
        if not (np.isfinite(length) and length > 0.0):
            raise IdentificationError(f"{tuple(direction)} is not a direction: try (1, 0)")
        values = {key: config.number(SECTION, key, usual) for key, usual in DEFAULTS.items()}
        for key, (_, low, high) in OPTIONS.items():
            value = values[key]
            if not (low <= value <= high or (value == 0.0 and key == "sweeping_period")):
                raise IdentificationError(
                    f"[{SECTION}] {key} is {value:g}; it must be {low:g} to {high:g}"
                )
        if values["max_freq"] < values["min_freq"]:
            raise IdentificationError(
                f"[{SECTION}] max_freq {values['max_freq']:g} is below min_freq "
                f"{values['min_freq']:g}"
            )
        stop_accel = config.number("printer", "max_accel", STOP_ACCEL)
        return cls(
            tuple(float(d) / length for d in direction),
            probe_points(config)[0] if point is None else point,
            **values,
            stop_accel=stop_accel if stop_accel > 0.0 else STOP_ACCEL,
            around_point=False,
        )

    @property
    def seconds(self) -> float:
        """Return the duration of the pulses in s; braking after sweeping comes on top."""
        return float(self._pulses()[0].sum())

    def half_cycles(self) -> Array:
        """Return the frequency of each half-cycle, (n,) Hz."""
        f, hz = self.min_freq, []
        while f <= self.max_freq + SLACK:
            hz.append(f)
            f += 0.5 / f * self.hz_per_sec
        return np.array(hz)

    def pulses(self) -> Array:
        """Return the displacement (m,) in mm by pulses alone, every 1 ms from the first moment."""
        return _sampled(*self._pulses(), self._samples())

    def sweeping(self) -> Array:
        """Return the displacement (m,) in mm by the slow sweeping alone, as long as ``pulses``."""
        return _sampled(*self._sweeping(), self._samples())

    def command(self) -> Array:
        """Return x and y (m, 2) in mm every 1 ms, from rest at the point to rest."""
        along = self.pulses() + self.sweeping()
        return np.asarray(self.point + along[:, None] * np.array(self.direction[:2]))

    def _samples(self) -> int:
        return int(np.ceil(float(self._sweeping()[0].sum()) / TS)) + 1

    def _pulses(self) -> tuple[Array, Array]:
        """Return durations (k,) in s and accelerations (k,) in mm/s² of the pulses."""
        hz = self.half_cycles()
        quarter = 0.25 / hz
        size = self.accel_per_hz * hz * np.where(np.arange(len(hz)) % 2, -1.0, 1.0)
        if not self.around_point:
            return np.repeat(quarter, 2), np.column_stack([size, -size]).ravel()
        # from rest and to rest a quarter takes two ramps, so that it needs √2 times as long
        ramp = np.sqrt(0.5)
        time = np.concatenate([[ramp * quarter[0]], np.repeat(quarter, 2), [ramp * quarter[-1]]])
        accel = np.concatenate([[size[0]], np.repeat(-size, 2), [size[-1]]])
        time[1] *= ramp
        time[-2] *= ramp
        return time, accel

    def _sweeping(self) -> tuple[Array, Array]:
        """Return durations and accelerations, (k,) each, of the sweeping and the last braking."""
        seconds = self.seconds
        if not self.sweeping_period:
            return np.array([seconds]), np.zeros(1)
        first = self.sweeping_period * np.sqrt(2.0) / 8.0
        ends = np.arange(int(seconds / self.sweeping_period * 2.0) + 2) * self.sweeping_period / 2.0
        ends = np.concatenate([[first], 2.0 * first + self.sweeping_period / 4.0 + ends])
        ends = np.append(ends[ends < seconds], seconds)
        time = np.diff(ends, prepend=0.0)
        accel = np.where(np.arange(len(time)) % 2, -self.sweeping_accel, self.sweeping_accel)
        speed = float((time * accel).sum())
        brake = -np.copysign(self.stop_accel, speed)
        return np.append(time, abs(speed) / self.stop_accel), np.append(accel, brake)


def probe_points(config: KlipperConfig) -> list[tuple[float, float]]:
    """Return the places (x, y) in mm at which a printer.cfg has resonances tested.

    Raises IdentificationError if there are none.
    """
    text = config.text(SECTION, "probe_points")
    try:
        rows = [[float(v) for v in row.split(",")] for row in text.splitlines() if row.strip()]
    except ValueError:
        rows = []
    if not rows or any(len(row) != 3 for row in rows):
        raise IdentificationError(
            f"[{SECTION}] probe_points: {text!r} is not a list of points: write 100, 100, 20"
        )
    return [(row[0], row[1]) for row in rows]


def _sampled(time: Array, accel: Array, samples: int) -> Array:
    """Return the double integral (samples,) of constant accelerations (k,) that last (k,) s."""
    begin = np.concatenate([[0.0], np.cumsum(time)])
    speed = np.concatenate([[0.0], np.cumsum(accel * time)])
    way = np.concatenate([[0.0], np.cumsum((speed[:-1] + 0.5 * accel * time) * time)])
    t = np.minimum(np.arange(samples) * TS, begin[-1])
    k = np.clip(np.searchsorted(begin, t, side="right") - 1, 0, len(time) - 1)
    since = t - begin[k]
    return np.asarray(way[k] + (speed[k] + 0.5 * accel[k] * since) * since)
