"""Play a G-code file through the real Klipper host, without hardware.

The host plans the motion exactly as on a printer. Recorded are the planner's trapezoids,
which give positions at any time, and the commands for the controller, which give the times
of the motors' steps. Times are Klipper's print time in seconds, lengths are millimetres.
"""

import json
import os
import re
from collections.abc import Mapping
from configparser import RawConfigParser
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.command_server import call
from tests.klipper.batch import CLOCK_FREQ, COMMANDS, KLIPPER, dictionary

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TEMPLATE = Path(__file__).with_name("printer.cfg")
BATCH = "tests.klipper.batch"
BEFORE_2024 = bool(KLIPPER) and "minimum_cruise_ratio" not in (
    Path(KLIPPER, "klippy", "toolhead.py").read_text()
)
"""Whether the host knows max_accel_to_decel only; then configurations and files are translated."""
TIMEOUT_S = 300.0
TAIL_LINES = 25
FULL_STEPS = 200  # per turn: klippy's default, which the template keeps
MOTORS = {"A": "stepper_x", "B": "stepper_y", "z": "stepper_z", "e": "extruder"}
SUSPICIOUS = re.compile(
    r"unknown command|warn|error|exception|traceback|shutdown|invalid|malformed|exceed"
    r"|out of range|must home|below minimum|overextrude|deprecated",
    re.IGNORECASE,
)

MOVE = np.dtype(
    [
        ("print_time", "f8"),  # s, where the move starts
        ("accel_t", "f8"),  # s
        ("cruise_t", "f8"),  # s
        ("decel_t", "f8"),  # s
        ("start", "f8", (3,)),  # mm, x y z; of the extruder: e 0 0
        ("ratio", "f8", (3,)),  # unit vector; of the extruder: 1 and pressure advance's settings
        ("start_v", "f8"),  # mm/s
        ("cruise_v", "f8"),  # mm/s
        ("accel", "f8"),  # mm/s^2, the same in both ramps; the extruder's has a sign, as its speeds
    ]
)
"""One planner move: a ramp, a cruise, a ramp, along a straight line."""


class KlippyError(RuntimeError):
    """klippy stopped before the end of the file; the message holds the end of its log."""


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of one motor: ``time`` (n,) in s, ``direction`` (n,) of +1 or -1, ``size`` mm."""

    time: Floats
    direction: NDArray[np.int8]
    size: float

    def position(self, t: ArrayLike) -> Floats:
        """Return the motor position (n,) in mm at times ``t`` (n,) in s, in steps from 0."""
        counts = np.concatenate([[0], np.cumsum(self.direction, dtype=np.int64)])
        position: Floats = self.size * counts[np.searchsorted(self.time, t, side="right")]
        return position


@dataclass(frozen=True, eq=False)
class Playback:
    """Motion that the host planned for a file.

    moves : (n,) of ``MOVE``, the toolhead's motion queue in order of time
    extruder : (m,) of ``MOVE``, the extruder's, with the filament position in ``start[:, 0]``
    warnings : suspicious lines of the log, such as ``Unknown command:"M9999"``
    print_time : s, where the host saw the end of the file (with dwells; rounded to 1 ms)
    """

    moves: NDArray[np.void]
    extruder: NDArray[np.void]
    warnings: tuple[str, ...]
    print_time: float
    _stream: bytes = field(repr=False)

    @property
    def start(self) -> float:
        """Return the time in s at which the first move begins, 0 without any."""
        return min((float(queue["print_time"][0]) for queue in self._queues()), default=0.0)

    @property
    def end(self) -> float:
        """Return the time in s at which the last move ends, 0 without any."""
        return max((_end(queue[-1]) for queue in self._queues()), default=0.0)

    @property
    def duration(self) -> float:
        """Return the time in s from ``start`` to ``end``, rests in between included."""
        return self.end - self.start

    def position(self, t: ArrayLike) -> Floats:
        """Return the planned tool position (n, 3) in mm at times ``t`` (n,) in s.

        Between moves and after the last it is where the move before ended.
        """
        return evaluated(self.moves, t)

    def extruded(self, t: ArrayLike) -> Floats:
        """Return the planned filament (n,) in mm at times ``t`` (n,) in s, 0 before any move."""
        return evaluated(self.extruder, t)[:, 0]

    def steps(self) -> dict[str, Steps]:
        """Return the steps of the motors ``A`` (x + y), ``B`` (x - y), ``z`` and ``e``.

        Decoded from the commands to the controller, hence with the host's step compression
        (25 us at most). Counts start at 0 where the first G28 declared the origin. A motor
        that rests for more than 2^32 ticks (1073 s) comes out early by as much.
        """
        stepping = _Stepping(_integers(self._stream))
        config = RawConfigParser(strict=False, inline_comment_prefixes=("#", ";"))
        config.read_string(TEMPLATE.read_text())
        trains = {}
        for motor, section in MOTORS.items():
            motor_config = config[section]
            pin = int(motor_config["step_pin"].removeprefix("gpio"))
            steps_per_turn = FULL_STEPS * int(motor_config["microsteps"])
            size = float(motor_config["rotation_distance"]) / steps_per_turn
            trains[motor] = Steps(*stepping.train(pin), size)
        return trains

    def _queues(self) -> list[NDArray[np.void]]:
        return [queue for queue in (self.moves, self.extruder) if len(queue)]


def play(
    gcode: Path, *, limits: Mapping[str, float] | None = None, workdir: Path, sections: str = ""
) -> Playback:
    """Play the file ``gcode`` on the printer of ``printer.cfg``.

    ``limits`` overrides options of its section [printer]: max_velocity (mm/s), max_accel
    (mm/s^2), square_corner_velocity (mm/s), minimum_cruise_ratio and so on; ``sections`` are
    added to it as they are. ``workdir`` is
    created if need be and takes the working files, over those of an earlier call. The file
    has to home (G28) before it moves; that makes the current position the origin.

    Raises ``KlippyError`` if klippy does not get to the end of the file.
    """
    workdir = workdir.resolve()
    workdir.mkdir(parents=True, exist_ok=True)
    config, messages = workdir / "printer.cfg", workdir / "messages.json"
    log, stream = workdir / "klippy.log", workdir / "stream.bin"
    log.unlink(missing_ok=True)  # klippy appends
    config.write_text(_configuration(limits or {}) + sections)
    messages.write_text(json.dumps(dictionary()))
    if BEFORE_2024:
        gcode = _translated(gcode, workdir / "translated.gcode")
    klippy = [config, "-i", gcode.resolve(), "-o", stream, "-d", messages, "-l", log]
    body, print_time = run_klippy(BATCH, workdir, [str(each) for each in klippy], log)
    return Playback(
        moves=np.fromfile(workdir / "toolhead.moves", MOVE),
        extruder=np.fromfile(workdir / "extruder.moves", MOVE),
        warnings=tuple(line for line in body.splitlines() if SUSPICIOUS.search(line)),
        print_time=print_time,
        _stream=stream.read_bytes(),
    )


def _configuration(limits: Mapping[str, float]) -> str:
    """Return the template with ``limits``; klippy takes the last value of an option."""
    lines = [f"{option}: {float(value)!r}" for option, value in limits.items()]
    text = "\n".join([TEMPLATE.read_text(), "[printer]", *lines, ""])
    return _without_cruise_ratio(text) if BEFORE_2024 else text


def _translated(gcode: Path, target: Path) -> Path:
    """Write ``target``, the file with ACCEL_TO_DECEL in place of MINIMUM_CRUISE_RATIO."""

    def translated(command: re.Match[bytes]) -> bytes:
        braking = float(command[1]) * (1.0 - float(command[3]))
        return b"ACCEL=%b%bACCEL_TO_DECEL=%.6f" % (command[1], command[2], braking)

    cruise_ratio = rb"\bACCEL=(\S+)(.*)MINIMUM_CRUISE_RATIO=(\S+)"
    target.write_bytes(re.sub(cruise_ratio, translated, gcode.read_bytes()))
    return target


def _without_cruise_ratio(text: str) -> str:
    """Return the configuration in terms of max_accel_to_decel, as Klipper computes it since."""
    accel = float(re.findall(r"^max_accel: *(\S+)", text, re.MULTILINE)[-1])
    return re.sub(
        r"^minimum_cruise_ratio: *(\S+)",
        lambda option: f"max_accel_to_decel: {accel * (1.0 - float(option[1]))!r}",
        text,
        flags=re.MULTILINE,
    )


def run_klippy(program: str, workdir: Path, arguments: list[str], log: Path) -> tuple[str, float]:
    """Run a module that starts klippy, such as ``batch``, with a folder and klippy's arguments.

    Returns klippy's log after the configuration and its last print time in s.
    """
    try:
        result = call(
            program, [program, str(workdir), *arguments], os.environ,
            folder=workdir, prepared=BATCH, timeout=TIMEOUT_S,
        )  # fmt: skip
    except TimeoutError as error:
        raise _failure(f"still busy after {TIMEOUT_S:.0f} s", _messages(log)) from error
    body = _messages(log)
    finished = re.search(r"^Exiting \(print time ([\d.]+)s\)$", body, re.MULTILINE)
    # A traceback alone does not stop klippy: it plays unreadable input as an empty file.
    if result.returncode or not finished or "Traceback" in body:
        raise _failure(f"exit status {result.returncode}", body + result.stderr.decode())
    return body, float(finished[1])


def _messages(log: Path) -> str:
    """Return the log without the configuration, which it repeats between rules."""
    text = log.read_text(errors="replace") if log.exists() else ""
    return re.split(r"^={23}$", text, flags=re.MULTILINE)[-1]


def _failure(reason: str, output: str) -> KlippyError:
    tail = "\n".join(output.splitlines()[-TAIL_LINES:])
    return KlippyError(f"klippy failed ({reason}); the end of its log:\n{tail}")


def _end(move: np.void) -> float:
    """Return the time in s at which a move ends."""
    return float(move["print_time"] + move["accel_t"] + move["cruise_t"] + move["decel_t"])


def evaluated(moves: NDArray[np.void], t: ArrayLike) -> Floats:
    """Return positions (n, 3) in mm at times ``t`` (n,) in s; zeros if there are no moves."""
    times = np.atleast_1d(np.asarray(t, dtype=np.float64))
    if not len(moves):
        return np.zeros((len(times), 3))
    last_begun = np.searchsorted(moves["print_time"], times, side="right") - 1
    move = moves[np.maximum(last_begun, 0)]
    # Clipping the time spent in each phase makes one formula hold before, in and after it.
    elapsed = times - move["print_time"]
    accel = np.clip(elapsed, 0.0, move["accel_t"])
    cruise = np.clip(elapsed - move["accel_t"], 0.0, move["cruise_t"])
    decel = np.clip(elapsed - move["accel_t"] - move["cruise_t"], 0.0, move["decel_t"])
    distance = (
        (move["start_v"] + 0.5 * move["accel"] * accel) * accel
        + move["cruise_v"] * cruise
        + (move["cruise_v"] - 0.5 * move["accel"] * decel) * decel
    )
    position: Floats = move["start"] + distance[:, None] * move["ratio"]
    return position


def _integers(stream: bytes) -> Ints:
    """Return all integers (n,) of the stream of blocks, message ids and parameters alike.

    A block is its length, a sequence byte, whole messages, a checksum of two bytes and a sync
    byte. An integer is big-endian in groups of 7 bits, bit 7 set on all bytes but the last; a
    first byte with bits 5 and 6 set makes it negative.
    """
    payload = bytearray()
    at = 0
    while at < len(stream):
        payload += stream[at + 2 : at + stream[at] - 3]
        at += stream[at]
    data = np.frombuffer(payload, np.uint8).astype(np.int64)
    ends = np.flatnonzero(data < 0x80)
    starts = np.concatenate([[0], ends[:-1] + 1])
    digits = data & 0x7F
    digits[starts] -= np.where(digits[starts] >= 0x60, 0x80, 0)
    place = np.repeat(ends, ends - starts + 1) - np.arange(len(data))
    integers: Ints = np.add.reduceat(digits << (7 * place), starts)
    return integers


class _Stepping:
    """Return the messages that concern steppers, picked from the stream's integers."""

    def __init__(self, integers: Ints) -> None:
        ids = {text.split()[0]: i for i, text in enumerate(COMMANDS, start=1)}
        lengths = [0, *(1 + text.count("=") for text in COMMANDS)]
        flat = integers.tolist()
        starts, at = [], 0
        while at < len(flat):
            starts.append(at)
            at += lengths[flat[at]]
        self._integers = integers
        self._starts = np.array(starts, dtype=np.int64)
        self._ids = integers[self._starts]
        self._queue_step, self._set_dir = ids["queue_step"], ids["set_next_step_dir"]
        config = self._starts[self._ids == ids["config_stepper"]]
        self._oid_of_pin = {int(integers[at + 2]): int(integers[at + 1]) for at in config}

    def train(self, step_pin: int) -> tuple[Floats, NDArray[np.int8]]:
        """Return times (n,) in s and directions (n,) of the steps on a pin.

        reset_step_clock is not looked at: it comes once, with clock 0, since nothing homes.
        """
        integers = self._integers
        relevant = np.isin(self._ids, (self._queue_step, self._set_dir))
        rows, ids = self._starts[relevant], self._ids[relevant]
        own = integers[rows + 1] == self._oid_of_pin[step_pin]
        rows, is_step = rows[own], ids[own] == self._queue_step
        # klippy sends a direction before the first step, so each step has a row to look back to.
        dir_row = np.maximum.accumulate(np.where(is_step, 0, np.arange(len(rows))))
        direction = np.where(integers[rows[dir_row] + 2] != 0, 1, -1)[is_step]
        interval, count, add = (integers[rows[is_step] + column] for column in (2, 3, 4))
        interval = interval & 0xFFFFFFFF  # sent as a signed number
        ticks = interval * count + add * (count * (count - 1) // 2)
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 1
        begin, interval, add = (
            np.repeat(column, count) for column in (np.cumsum(ticks) - ticks, interval, add)
        )
        clock = begin + interval * number + add * (number * (number - 1) // 2)
        return clock / CLOCK_FREQ, np.repeat(direction, count).astype(np.int8)
