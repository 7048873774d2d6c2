"""A profile's settings: a frozen dataclass for each table. Lengths in mm, times in s."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from datetime import date

from hframe_post.errors import ArgumentError
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.printer.firmware_tables import FirmwareSettings
from hframe_post.printer.schema import not_negative, positive, within

PLACES = {"least": -1e4, "most": 1e4, "ascending": True}  # mm of travel
SHARE = {"least": 0.0, "most": 0.99}
STOPS = {"fast": 2, "exact": 8}  # samples for which the path rests before and after a stop
MAX_RAMP_S = 60.0  # s
# Share of the file's acceleration on outer walls, on printers that rack. Their error there, with a
# model that is 5 % off, falls by 8 to 20 %; slices still take about the firmware's own time, which
# with 0.75 one of them exceeds by 0.7 % on Klipper's host
RACKING_WALLS = 0.8
CHIP_NAME = re.compile(r"[A-Za-z0-9_-]+")  # of an accelerometer in Klipper's commands
MAX_PREVIEW_SAMPLES = 2000  # samples; the matrix of a window has as many rows and columns
MAX_ADVANCE_S, MAX_SMOOTHING_S = 10.0, 0.2  # s
# times the path's speed, the guess of a belt's limit; times that, the stream's, never to limit it
VELOCITY_HEADROOM = 1.1
CORNER_S = 0.002  # s for a change of speed at a corner: with an effort of 1 to 10 it errs least
SMOOTH_TIME_S = 0.04  # s, Klipper's default


@dataclass(frozen=True, slots=True)
class Travel:
    """Where the nozzle may go: (minimum, maximum) of x, y and, if limited, z; mm."""

    x: tuple[float, float] = field(metadata=PLACES)
    y: tuple[float, float] = field(metadata=PLACES)
    z: tuple[float, float] = field(default=(-math.inf, math.inf), metadata=PLACES)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the planned path; mm, s. The shipped profiles explain each.

    velocity, acceleration, square_corner_velocity and junction_deviation bind what a file asks only
    where they differ from the firmware's own, in its table (`Firmware.caps`).
    flow (mm³/s) limits what ``calibrate-print`` prints. filament_density (g/cm³) makes a moving bed
    heavier.
    outer_walls: share of the file's acceleration there; 0: RACKING_WALLS if the printer racks.
    jerk: mm/s³; 0: as much as real slices need to take the firmware's time.
    Raises ArgumentError if reaching full speed would take more than MAX_RAMP_S.
    """

    velocity: float = within(1.0, 1e4)
    acceleration: float = within(1.0, 1e6)
    square_corner_velocity: float = not_negative(most=1e4)
    z_velocity: float = within(0.01, 1e4)
    z_acceleration: float = within(0.1, 1e6)
    extruder_velocity: float = within(0.01, 1e4)
    extruder_acceleration: float = within(0.1, 1e6)
    extruder_corner_velocity: float = within(1e-3, 1e4, default=1.0)
    jerk: float = not_negative(0.0, most=1e12)
    junction_deviation: float = within(1e-6, 1e3, default=math.inf)
    flow: float = within(0.1, 1e3, default=15.0)
    filament_diameter: float = within(0.5, 5.0, default=1.75)
    filament_density: float = within(0.1, 25.0, default=1.24)
    outer_walls: float = not_negative(0.0, most=1.0)

    @property
    def filament_mass(self) -> float:
        """Return the mass of a mm of filament, kg."""
        return 1e-6 * self.filament_density * (math.pi / 4.0 * self.filament_diameter**2)

    def __post_init__(self) -> None:
        if not self.jerk:
            # a ramp takes 1 ms at 10 000 mm/s², and less above: the moves of fast printers are
            # short. With 1e7, slices for 20 000 mm/s² took up to 5.0 % longer
            object.__setattr__(self, "jerk", 1e7 * max(1.0, self.acceleration / 1e4) ** 3)
        ramps = {
            "acceleration": self.velocity / self.acceleration + self.acceleration / self.jerk,
            "z_acceleration": self.z_velocity / self.z_acceleration,
            "extruder_acceleration": self.extruder_velocity / self.extruder_acceleration,
        }
        for name, seconds in ramps.items():
            if MAX_RAMP_S < seconds < math.inf:  # a limit may be left out of a plan
                raise ArgumentError(
                    f"with this {name} full speed takes {seconds:g} s; "
                    f"at most {MAX_RAMP_S:g} s are possible"
                )


@dataclass(frozen=True, slots=True)
class Motors:
    """Limits of every command: speed and acceleration of the belts A and B.

    In a profile, a limit that its owner has not stated is missing.
    """

    belt_velocity: float = within(1.0, 1e5, default=math.inf)
    belt_acceleration: float = within(1.0, 1e8, default=math.inf)

    @property
    def stated(self) -> Motors:
        """Return the limits that somebody stated; infinite where there is a guess."""
        return self

    def completed(
        self, kinematics: Kinematics, velocity: float, acceleration: float, corner: float
    ) -> Motors:
        """Return the limits, with a guess of those that nobody stated.

        What the firmware plays today, the motors can do: a path with these limits in any direction.
        corner: speed through a right angle, mm/s.

        Compensation moves harder than the path: a cube at max_accel and a higher jerk, on simulated
        printers with modes from 18 to 55 Hz, needs up to 2.5 times max_accel. Where racking is
        compensated, slices at 5000 mm/s² ask up to 41 000 of the belts of the paper's H-bot; with
        2.5 times, commands were cut by up to 5 mm, and 31 µm were left instead of 5.

        The acceleration that a slow printer's owner allows says nothing of its motors: at every
        corner they change their speed at once, for which a command takes CORNER_S.
        """
        belts = 1.0 / kinematics.min_speed_ratio
        more = 5.0 if kinematics.racks else 1.5
        harder = acceleration + more * min(acceleration, 8000.0)
        turned = acceleration + corner / CORNER_S
        guess = round(belts * VELOCITY_HEADROOM * velocity, 1), round(belts * max(harder, turned))
        stated = self.belt_velocity, self.belt_acceleration
        limits = [s if s < math.inf else g for s, g in zip(stated, guess, strict=True)]
        return self if math.inf not in stated else GuessedMotors(limits[0], limits[1], guess)


@dataclass(frozen=True, slots=True)
class GuessedMotors(Motors):
    """Limits of which a guess fills in those that nobody stated. Another value is stated."""

    guess: tuple[float, float] = (math.inf, math.inf)

    @property
    def stated(self) -> Motors:
        limits = self.belt_velocity, self.belt_acceleration
        return Motors(*(math.inf if x == g else x for x, g in zip(limits, self.guess, strict=True)))


@dataclass(frozen=True, slots=True)
class Steps:
    """Step size of the motors: mm of x-y belt, z and filament; and the frequency of the step clock.

    direction_setup: s between a change of direction and the next step.
    """

    belt: float = within(1e-6, 10.0)
    z: float = within(1e-6, 10.0)
    e: float = within(1e-6, 10.0)
    clock_hz: float = within(1e3, 9.9e9, default=1e5)
    direction_setup: float = not_negative(0.0, most=1.0)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Strategy, window of the limited-preview filtered B-splines, and method for stops.

    Raises ArgumentError if the window is impossible or longer than MAX_PREVIEW_SAMPLES.
    """

    L: int = positive(5, most=500)
    n_C: int = positive(88, most=1000)
    n_up: int = positive(44, most=1000)
    effort: tuple[float, float] = not_negative((10.0, 10.0))
    strategy: str = field(default="racking", metadata={"choices": tuple(STRATEGIES)})
    degree: int = within(2, 9, default=5)
    stops: str = field(default="fast", metadata={"choices": tuple(STOPS)})

    def __post_init__(self) -> None:
        for window in self.windows:
            if window.L_C > MAX_PREVIEW_SAMPLES:
                raise ArgumentError(
                    f"L = {self.L} and n_C = {self.n_C} are a window of {window.L_C} samples; "
                    f"at most {MAX_PREVIEW_SAMPLES} are possible"
                )

    @property
    def windows(self) -> tuple[Window, Window]:
        x, y = (Window(self.L, self.n_C, self.n_up, e, self.degree) for e in self.effort)
        return x, y


def chip_name(text: str) -> str:
    """Return a CHIP_NAME. Raises ArgumentError for any other text."""
    if not CHIP_NAME.fullmatch(text):
        raise ArgumentError(
            f"{text!r} is not a chip's name: for [adxl345 hotend] in printer.cfg write hotend"
        )
    return text


@dataclass(frozen=True, slots=True)
class Sweep:
    """What measures a printer. Raises ArgumentError if the settings do not fit together.

    end_hz, rate_hz_per_s, amplitude (mm/s²): of the sweep for Marlin. chip_x, chip_y: names of the
    accelerometers that record the axes, empty where unknown.
    """

    # above resonances of printers; at most five samples per period, joined by straight lines
    end_hz: float = within(30.0, 200.0, default=120.0)
    rate_hz_per_s: float = positive(3.4)
    amplitude: float = positive(5000.0)
    chip_x: str = ""
    chip_y: str = ""

    def __post_init__(self) -> None:
        for chip in filter(None, (self.chip_x, self.chip_y)):
            chip_name(chip)
        seconds = self.end_hz / self.rate_hz_per_s
        if not 1.0 <= seconds <= 900.0:
            raise ArgumentError(
                f"at {self.rate_hz_per_s:g} Hz/s a sweep takes {seconds:.0f} s; 1 to 900 s are "
                "possible"
            )


@dataclass(frozen=True, slots=True)
class Retraction:
    """What G10 and G11 do: mm of filament and mm/s. return_speed 0: the same as speed."""

    length: float = within(0.01, 100.0)
    speed: float = within(0.1, 1e3)
    return_speed: float = not_negative(0.0, most=1e3)
    extra: float = field(default=0.0, metadata={"least": -1.0, "most": 10.0})


@dataclass(frozen=True, slots=True)
class Extruder:
    """How late the flow follows the extruder, s, and the time over which advance is averaged.

    advance: Klipper's pressure_advance, Marlin's K. stream_smooth_time: Klipper averages over this
    time while the stream runs, if it is shorter; below 0.02 s lines get no more even.
    """

    advance: float = not_negative(0.0, most=MAX_ADVANCE_S)
    smooth_time: float = within(1e-3, MAX_SMOOTHING_S, default=SMOOTH_TIME_S)
    stream_smooth_time: float = within(1e-3, MAX_SMOOTHING_S, default=0.02)


@dataclass(frozen=True, slots=True)
class Speed:
    """Trading accuracy for speed, unless options say otherwise.

    max_error: largest error (mm); 0: the file's accelerations. error_measure: statistic compared
    with it. acceleration: largest mm/s² of the path, with corners no faster than
    limits.square_corner_velocity; 0: what the motors allow.
    """

    max_error: float = not_negative(0.0, most=10.0)
    error_measure: str = field(default="p95", metadata={"choices": ("p95", "rms", "peak")})
    acceleration: float = not_negative(0.0, most=1e6)


@dataclass(frozen=True, slots=True)
class Verified:
    """The result of `check`. date: of the recording, ISO; reduction: share of the contour error
    that compensation removes; model: digest of the plant and window that were verified."""

    date: str
    reduction: float = field(metadata={"least": -1e3, "below": 1.001})
    firmware: str
    model: str


@dataclass(frozen=True, slots=True)
class Printer:
    """A whole profile.

    motors: complete. digest: identifies the contents, apart from ``verified``. verified: None
    unless this plant and window were verified. invented: the plant was not measured on this
    printer. uncertainty: share by which the printer may differ from its plant; None if it was not
    measured. measured: day of the recordings, if known. model: digest of plant and window, which
    `check` marks.
    """

    name: str
    description: str
    travel: Travel
    limits: Limits
    kinematics: Kinematics
    motors: Motors
    compensation: Compensation
    firmware: FirmwareSettings
    plant: Plant
    sweep: Sweep
    digest: str
    steps: Steps | None = None
    verified: Verified | None = None
    invented: bool = False
    speed: Speed = Speed()
    retraction: Retraction | None = None
    extruder: Extruder | None = None
    uncertainty: float | None = None
    measured: date | None = None
    model: str = ""

    @property
    def outer_walls(self) -> float:
        """Return the share of the file's acceleration with which outer walls are printed."""
        return self.limits.outer_walls or (RACKING_WALLS if self.kinematics.racks else 1.0)

    def with_windows(self, windows: tuple[Window, Window]) -> Printer:
        """Return the printer, compensated with these windows of x and y, of the same sizes."""
        x, y = windows
        effort = float(x.effort), float(y.effort)
        chosen = replace(self.compensation, L=x.L, n_C=x.n_C, n_up=x.n_up, effort=effort)
        return replace(self, compensation=chosen)

    def uncertainty_on(self, day: date) -> float:
        """Return the uncertainty of the plant on a later day, at least the one it has.

        Printers differ by 3 % from their model a day after it was measured, and then by the fifth
        root of the days more: the figures are in docs/identify.md.
        """
        days = max((day - self.measured).days, 0) if self.measured else 0
        drifted: float = min(0.03 * days**0.2, 0.2)
        return max(self.uncertainty or 0.0, drifted)

    def warnings(self) -> list[str]:
        """Return what must be known before a print that is compensated with this model."""
        if not self.invented:
            return []
        return [
            "not your printer: its resonances were not measured, so its figures do not hold there "
            "and the result must not be printed. Begin with 'hframe-post setup'"
        ]

    @property
    def fastest_path(self) -> tuple[float, float]:
        """Return acceleration, mm/s², and corner speed, mm/s, at most of a print made faster.

        The path may use half of the belts' acceleration; compensation needs the rest.
        """
        belts = self.motors.belt_acceleration * self.kinematics.max_speed_ratio
        most = self.speed.acceleration
        corner = self.limits.square_corner_velocity if most else math.inf
        return min(0.5 * belts, most or math.inf), corner
