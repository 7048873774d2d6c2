"""What the recordings of strokes at constant speeds say, as text and JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hframe_post.identification.bands.find import Band, bands, to_avoid
from hframe_post.identification.bands.shaking import MotorShaking

MICRON = 1e3
MOTORS = "AB"


@dataclass(frozen=True, slots=True)
class BandsReport:
    """The shaking by each motor, its bands, and those that a profile avoids."""

    motors: tuple[MotorShaking, ...]
    found: tuple[Band, ...]
    avoid: tuple[tuple[int, int], ...]

    @classmethod
    def from_motors(cls, motors: Sequence[MotorShaking]) -> BandsReport:
        found = bands(motors)
        return cls(tuple(motors), tuple(found), to_avoid(found))

    def as_text(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        for motor in self.motors:
            slowest, fastest = motor.speed[[0, -1]]
            yield (
                f"motor {MOTORS[motor.motor]}   {len(motor.speed)} speeds of {slowest:.0f} to "
                f"{fastest:.0f} mm/s at the belt, strokes at {motor.angle:.0f}°"
            )
            of_motor = [band for band in self.found if band.motor == motor.motor]
            for band in of_motor:
                yield (
                    f"          {band.least:.0f} to {band.greatest:.0f} mm/s: the nozzle shakes by "
                    f"{MICRON * band.rms:.1f} µm RMS at {band.worst:.0f} mm/s, by "
                    f"{MICRON * band.usual:.1f} at other speeds nearby"
                )
            if not of_motor:
                yield "          no speed shakes the nozzle much more than those around it"
        shown = ", ".join(f"[{least}, {greatest}]" for least, greatest in self.avoid)
        yield f"avoid     [{shown}]" if shown else "avoid     nothing"

    def as_json(self) -> dict[str, Any]:
        return {
            "avoid": [list(band) for band in self.avoid],
            "bands": [
                {"motor": MOTORS[band.motor]}
                | {name: round(value, 6) for name, value in asdict(band).items() if name != "motor"}
                for band in self.found
            ],
            "motors": [
                {
                    "motor": MOTORS[motor.motor],
                    "angle": motor.angle,
                    "speed": motor.speed.tolist(),
                    "rms": [round(value, 6) for value in motor.rms.tolist()],
                }
                for motor in self.motors
            ],
        }
