"""What Klipper does with a stream: its ramps inside segments, its limits, its commands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Flags
from hframe_post.kinematics import Kinematics
from hframe_post.printer import Firmware, Limits, Motors, Restore
from hframe_post.stream import E, ModalState, Z

ACCEL_HEADROOM = 5.0  # times the motors' acceleration: the ramps must be short in a segment
VELOCITY_HEADROOM = 1.1
SQUARE_CORNER_VELOCITY = 100.0  # mm/s; corners are the stream's business
ROUNDS = 3  # of the speeds' dependence on their neighbours'


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """Klipper's limits while the stream runs; mm, s."""

    velocity: float
    acceleration: float
    z_velocity: float
    z_acceleration: float
    extruder_velocity: float
    extruder_acceleration: float
    extruder_corner_velocity: float

    @classmethod
    def of(cls, limits: Limits, motors: Motors, kinematics: Kinematics) -> StreamLimits:
        """High enough never to shape the stream, and no higher: they may be left behind."""
        return cls(
            VELOCITY_HEADROOM * kinematics.reach * motors.belt_velocity,
            ACCEL_HEADROOM * kinematics.reach * motors.belt_acceleration,
            limits.z_velocity,
            limits.z_acceleration,
            limits.extruder_velocity,
            limits.extruder_acceleration,
            limits.extruder_corner_velocity,
        )


def speeds(delta: Array, T: Array, rest: Flags, before: float, limits: StreamLimits) -> Array:
    """Cruise speeds (k,) at which Klipper takes the time T (k,) for each segment.

    delta (k, 4): x, y, z, e of each segment; rest (k + 1,): whether Klipper stands at each
    end; before: speed of the segment that precedes. Klipper ramps at acceleration a from
    v_s, the lower of two neighbouring cruise speeds and of what their junction allows, so a
    segment of length d takes T where d = v·T − [(v − v_s)² + (v − v_e)²]/2a.
    """
    d = np.sqrt(np.square(delta[:, :E]).sum(axis=1))
    a, _ = _segment_limits(delta, d, limits)
    caps = np.where(rest, 0.0, junctions(delta, d, a, limits))
    v = d / T
    for _ in range(ROUNDS):
        v_s, v_e = _ends(v, caps, before)
        S = a * T + v_s + v_e
        c = 4.0 * ((v_s * v_s + v_e * v_e) / 2.0 + a * d)
        v = (S - np.sqrt(np.maximum(S * S - c, 0.0))) / 2.0
    return np.asarray(v)


def durations(delta: Array, v: Array, rest: Flags, before: float, limits: StreamLimits) -> Array:
    """Time (k,) that Klipper takes for segments at cruise speeds v (k,); see ``speeds``."""
    d = np.sqrt(np.square(delta[:, :E]).sum(axis=1))
    a, top = _segment_limits(delta, d, limits)
    v = np.minimum(v, top)
    v_s, v_e = _ends(v, np.where(rest, 0.0, junctions(delta, d, a, limits)), before)
    ramps = (np.square(v - v_s) + np.square(v - v_e)) / (2.0 * a)
    return np.asarray((d + ramps) / v)


def _ends(v: Array, caps: Array, before: float) -> tuple[Array, Array]:
    """Speeds at the start and the end of each segment."""
    neighbours = np.concatenate([[before], v, v[-1:]])
    joint = np.minimum(np.minimum(neighbours[:-1], neighbours[1:]), caps)
    return np.minimum(joint[:-1], v), np.minimum(joint[1:], v)


def _segment_limits(delta: Array, d: Array, limits: StreamLimits) -> tuple[Array, Array]:
    """Acceleration and greatest speed of each segment: z and retraction lower them."""
    with np.errstate(divide="ignore"):
        per_z = d / np.abs(delta[:, Z])
        per_e = np.where(delta[:, E] < 0.0, d / np.abs(delta[:, E]), math.inf)
    a = np.minimum(per_z * limits.z_acceleration, per_e * limits.extruder_acceleration)
    top = np.minimum(per_z * limits.z_velocity, per_e * limits.extruder_velocity)
    return np.minimum(a, limits.acceleration), np.minimum(top, limits.velocity)


def junctions(delta: Array, d: Array, a: Array, limits: StreamLimits) -> Array:
    """Greatest speed at the ends of the segments, (k + 1,); the outer two are free.

    Klipper's square-corner formula, as in ``lookahead``, and its bound on the sudden change
    of extrusion speed.
    """
    unit, extrusion = delta[:, :E] / d[:, None], delta[:, E] / d
    cosine = np.clip(-(unit[:-1] * unit[1:]).sum(axis=1), -1.0, 1.0)
    sin_half, cos_half = np.sqrt(0.5 * (1.0 - cosine)), np.sqrt(0.5 * (1.0 + cosine))
    deviation = (math.sqrt(2.0) - 1.0) * SQUARE_CORNER_VELOCITY**2 / limits.acceleration
    with np.errstate(divide="ignore", invalid="ignore"):
        v2 = deviation * np.minimum(a[:-1], a[1:]) * sin_half / (1.0 - sin_half)
        fit = 0.5 * np.minimum(d[:-1] * a[:-1], d[1:] * a[1:]) * sin_half / cos_half
        corner = limits.extruder_corner_velocity / np.abs(np.diff(extrusion))
    inner = np.fmin(np.sqrt(np.fmin(v2, fit)), corner)
    return np.concatenate([[math.inf], inner, [math.inf]])


@dataclass(frozen=True, slots=True)
class Dialect:
    """Commands around the stream."""

    firmware: Firmware
    limits: StreamLimits

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """From the user's limits and modes to the stream's.

        offset: x, y, z of the user's G92; at (4,): x, y, z, e where the machine stands.
        """
        if self.firmware.begin_macro:
            start = [self.firmware.begin_macro]
        else:
            limits = self.limits
            start = [
                "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
                _limit(limits.velocity, limits.acceleration, SQUARE_CORNER_VELOCITY, 0.0),
            ]
        return [line.encode() for line in ["M400", *start, "G90", "M83", *_named(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """Back to the user's limits and to the modes and places that the file believes in."""
        restore: Restore = self.firmware.restore
        names = _named(state.offset, at[:E] - state.offset)
        if self.firmware.end_macro:
            stop = [self.firmware.end_macro]
        else:
            stop = [
                _limit(
                    restore.velocity, restore.acceleration,
                    restore.square_corner_velocity, restore.minimum_cruise_ratio,
                )
            ]  # fmt: skip
            if restore.shaper_freq_x or restore.shaper_freq_y:
                x, y = restore.shaper_freq_x, restore.shaper_freq_y
                stop.append(
                    f"SET_INPUT_SHAPER SHAPER_FREQ_X={plain(x, 6)} SHAPER_FREQ_Y={plain(y, 6)}"
                )
        return [line.encode() for line in ["M400", *stop, *names, *_modes(state)]]


def _named(offset: tuple[float, float, float], at: Array) -> list[str]:
    """G92 that names the place ``at``, of the axes whose name is not the machine's."""
    words = [f"{a}{plain(p, 3)}" for a, p, o in zip("XYZ", at, offset, strict=False) if o]
    return [" ".join(["G92", *words])] if words else []


def _limit(velocity: float, acceleration: float, corner: float, cruise_ratio: float) -> str:
    """SET_VELOCITY_LIMIT with everything that it can set."""
    values = {
        "VELOCITY": velocity,
        "ACCEL": acceleration,
        "SQUARE_CORNER_VELOCITY": corner,
        "MINIMUM_CRUISE_RATIO": cruise_ratio,
    }
    words = (f"{name}={plain(value, 6)}" for name, value in values.items())
    return " ".join(["SET_VELOCITY_LIMIT", *words])


def _modes(state: ModalState) -> list[str]:
    """Commands that bring the firmware to the modes and the E that a file believes in."""
    lines = [f"G1 F{plain(state.feed * 60.0, 1)}"]
    if state.absolute_e:
        lines += ["M82", f"G92 E{plain(state.e, 5)}"]
    if not state.absolute:
        lines.append("G91")
    return lines


def plain(value: float, decimals: int) -> str:
    """A number without exponent, trailing zeros or negative zero."""
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
