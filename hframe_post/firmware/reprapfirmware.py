"""What RepRapFirmware (Duet) does with a stream, by its documentation; it was never run.

It plans trapezoids in time, as Klipper does, with M201, M203 and M204 as limits. A junction is
passed at the lower of two neighbours' speeds as long as no axis changes its speed by more than
M566, which is set beyond any change of x and y; that of the extruder stays the user's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z, lengths
from hframe_post.errors import PrinterError
from hframe_post.firmware import ramps
from hframe_post.firmware.decimate import breakpoints, fitted
from hframe_post.firmware.klipper.segments import StreamLimits
from hframe_post.firmware.player import Dwelling, Stroke, coordinates, plain
from hframe_post.printer.firmware_tables import RepRapFirmwareTable
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState

ACCEL_HEADROOM = 5.0  # times the motors' acceleration: the ramps must be short in a segment
JERK = 1000.0  # mm/s in x and y, more than any change; corners are the stream's business
MM_PER_MIN = 60.0  # M203 and M566 are in mm/min


@dataclass(frozen=True, slots=True)
class RepRapFirmware:
    """RepRapFirmware as a ``Player``. tolerance: mm that decimation may miss a sample by."""

    own: RepRapFirmwareTable
    limits: StreamLimits
    tolerance: float | None = None

    @classmethod
    def of(cls, printer: Printer, tolerance: float | None = None) -> RepRapFirmware:
        """As that printer has it. Raises PrinterError where its profile does not know it."""
        own = printer.firmware.reprapfirmware
        if own is None:
            cause = "the table is missing: RepRapFirmware's own settings"
            raise PrinterError(cause, "firmware.reprapfirmware", printer.name)
        limits = StreamLimits.of(printer.limits, printer.motors, printer.kinematics)
        highest = ACCEL_HEADROOM * printer.kinematics.reach * printer.motors.belt_acceleration
        return cls(own, replace(limits, acceleration=highest), tolerance)

    @property
    def lines_per_second(self) -> float:
        """See ``Player``, as all of these."""
        return self.own.lines_per_second

    # ------------------------------------------------------------------ commands

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """Shaping and pressure advance go off, limits up."""
        a, v = self.limits.acceleration, self.limits.velocity
        start = [
            "M400", 'M593 P"none"', "M572 D0 S0", *_limits((v, v), (a, a), a, a, (JERK, JERK)),
        ]  # fmt: skip
        return [line.encode() for line in [*start, "G90", "M83", *coordinates(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """G90 and G91 mean nothing to E."""
        own = self.own
        lines = [
            "M400",
            *_limits(
                own.max_velocity, own.max_acceleration, own.acceleration,
                own.travel_acceleration, own.jerk,
            ),
        ]  # fmt: skip
        if own.pressure_advance:
            lines.append(f"M572 D0 S{plain(own.pressure_advance, 5)}")
        if own.shaper:
            lines.append(f'M593 P"{own.shaper}" F{plain(own.shaper_freq, 3)}')
        lines += coordinates(state.offset, at[:E] - state.offset)
        lines.append(f"G1 F{plain(state.feed * MM_PER_MIN, 1)}")
        if state.absolute_e:
            lines += ["M82", f"G92 E{plain(state.e, 5)}"]
        if not state.absolute:
            lines.append("G91")
        return [line.encode() for line in lines]

    def modes_after(self, name: str) -> bytes:
        """Each mode is set by its own command alone; M566 and M572 of the file stay out."""
        jerk = " ".join(f"{axis}{plain(JERK * MM_PER_MIN, 0)}" for axis in "XY")
        own = {
            "G91": "G90", "M82": "M83", "M566": f"M566 {jerk}", "M572": "M572 D0 S0",
        }  # fmt: skip
        return f"{own[name]}\n".encode() if name in own else b""

    def labels_object(self, text: bytes) -> bool:
        """It leaves nothing out that it has been sent."""
        return False

    def rejoin(self, at: Array, way: Array, T: float) -> None:
        """It is where its commands are."""

    def reset_extruder(self) -> bytes:
        """Relative filament is not summed up."""
        return b""

    def lift_corner(self, at: Array, speed: float) -> float:
        """z comes to rest."""
        return 0.0

    def stroke(
        self, at: Array, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """From rest to rest, as asked."""
        return Stroke(speed, seconds)

    def dwell(self, seconds: float, beside: Dwelling) -> tuple[bytes, float] | None:
        """G4, which lets the queue run out first: beside a lift even of no time."""
        if not beside.lifts and seconds < TS / 2.0:
            return None
        waited = max(round(seconds, 3), 0.0)
        return b"G4 P%s\n" % plain(waited * 1e3, 0).encode(), waited

    # ------------------------------------------------------------------ motion

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Decimated to the tolerance."""
        if self.tolerance is None:
            return np.arange(1, len(points)), points[1:]
        ends = breakpoints(points, forced, self.tolerance)
        return ends, fitted(points, ends)

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        """All of it."""
        return T

    def feed_rates(
        self, at: Array, T: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Ramps in mind."""
        d, a, _, caps = self._trapezoids(at, rest)
        return ramps.speeds(d, T, a, caps, before)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Ramps and limits in mind."""
        d, a, top, caps = self._trapezoids(at, rest)
        return ramps.durations(d, np.minimum(v, top), a, caps, before)

    def _trapezoids(self, at: Array, rest: Flags) -> tuple[Array, Array, Array, Array]:
        """Length, acceleration and greatest speed of each segment, and the caps at their ends.

        z and filament, forwards too, lower acceleration and speed.
        """
        delta, limits = np.diff(at, axis=0), self.limits
        d = lengths(delta[:, :E])
        with np.errstate(divide="ignore"):
            per_z, per_e = d / np.abs(delta[:, Z]), d / np.abs(delta[:, E])
            corner = self.own.jerk_e / np.abs(np.diff(delta[:, E] / d))
        a = np.minimum(per_z * limits.z_acceleration, per_e * limits.extruder_acceleration)
        top = np.minimum(per_z * limits.z_velocity, per_e * limits.extruder_velocity)
        a, top = np.minimum(a, limits.acceleration), np.minimum(top, limits.velocity)
        corners = np.concatenate([[math.inf], corner, [math.inf]])  # the outer two are free
        return d, a, top, np.where(rest, 0.0, corners)


def _limits(
    velocity: tuple[float, float], acceleration: tuple[float, float], printing: float,
    travel: float, jerk: tuple[float, float],
) -> list[str]:  # fmt: skip
    """M201, M203, M204 and M566 of x and y; in mm and s."""

    def words(pair: tuple[float, float], scale: float = 1.0) -> str:
        return " ".join(f"{a}{plain(scale * p, 3)}" for a, p in zip("XY", pair, strict=True))

    return [
        f"M201 {words(acceleration)}",
        f"M203 {words(velocity, MM_PER_MIN)}",
        f"M204 P{plain(printing, 3)} T{plain(travel, 3)}",
        f"M566 {words(jerk, MM_PER_MIN)}",
    ]
