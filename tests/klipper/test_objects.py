"""What Klipper does to a stream in mid-print: objects left out, pauses, bed mesh, skew, pressure
advance. It ends where the file as sliced ends, with as much filament."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.firmware.klipper.macros import macros
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Retraction
from tests.conftest import few
from tests.gcode_tools import converted, strokes
from tests.klipper.host import Playback, play

pytestmark = pytest.mark.klipper

SECTIONS = """
[exclude_object]
[gcode_arcs]
[pause_resume]
[skew_correction]
[bed_mesh]
mesh_min: 20, 20
mesh_max: 260, 260
speed: 50
[bed_mesh tilted]
version: 1
points: 0.0, 0.05, 0.1
  0.0, 0.06, 0.12
  0.0, 0.07, 0.14
tension: 0.2
min_x: 20
algo: lagrange
y_count: 3
mesh_y_pps: 2
min_y: 20
x_count: 3
max_y: 260
mesh_x_pps: 2
max_x: 260
"""
HEAD = ["G28", "G90", "M83", "G92 E0"]
OBJECTS = {"a": (100.0, 100.0), "b": (140.0, 100.0), "c": (100.0, 140.0)}


def loop(x: float, y: float) -> list[str]:
    corners = ((x + 15, y), (x + 15, y + 15), (x, y + 15), (x, y))
    return ["G1 F4800", *(f"G1 X{px} Y{py} E.5" for px, py in corners)]


def objects(layers: int = 2) -> list[str]:
    """Return labelled objects as OrcaSlicer writes them, with its spiral lift."""
    lines = [f"EXCLUDE_OBJECT_DEFINE NAME={name}" for name in OBJECTS]
    for k in range(layers):
        z = 0.2 * (k + 1)
        for name, (x, y) in OBJECTS.items():
            lines += [f"EXCLUDE_OBJECT_START NAME={name}", "G1 E-.8 F2400", "G17"]
            lines += [f"G3 Z{z + 0.4:.1f} I1.2 J0 P1 F12000"] if (k, name) != (0, "a") else []
            lines += [f"G1 X{x} Y{y} Z{z + 0.4:.1f} F12000", f"G1 Z{z:.1f} F600", "G1 E.8 F2400"]
            lines += [*loop(x, y), f"EXCLUDE_OBJECT_END NAME={name}"]
    return [*lines, "G1 E-.8 F2400", "G1 Z5 F600", "G1 X50 Y60 F12000"]


def both(
    lines: list[str], folder: Path, sections: str = SECTIONS, retraction: Retraction | None = None
) -> tuple[Playback, Playback]:
    """Return the file as sliced and as converted, both played."""
    paper = load("paper")
    limits = replace(paper.limits, z_velocity=20.0, z_acceleration=500.0)
    printer = replace(paper, limits=limits, retraction=retraction)
    text, _ = converted([line.encode() + b"\n" for line in lines], printer)
    (folder / "sliced.gcode").write_text("\n".join(lines) + "\n")
    (folder / "ours.gcode").write_bytes(text)
    sliced, ours = (
        play(folder / f"{name}.gcode", workdir=folder / name, sections=sections)
        for name in ("sliced", "ours")
    )
    return sliced, ours


def left_out(name: str) -> list[str]:
    """Return the print with an object cancelled while another one is printed.

    Of the one being printed, Klipper loses count of filament in the file as sliced, too.
    """
    lines = objects()
    at = lines.index(f"EXCLUDE_OBJECT_START NAME={'a' if name == 'b' else 'b'}") + 8
    return [*HEAD, *lines[:at], f"EXCLUDE_OBJECT NAME={name}", *lines[at:]]


def paused() -> list[str]:
    lines = objects(1)
    at = lines.index("EXCLUDE_OBJECT_START NAME=b") + 7
    return [*HEAD, *lines[:at], "PAUSE", "G1 X20 Y20 F6000", "RESUME", *lines[at:]]


FILES = {
    "b left out": left_out("b"),
    "paused": paused(),
    "skew": ["G28", "SET_SKEW XY=100.4,99.8,70.8", *HEAD[1:], *objects(1)],
    "nothing left out": [*HEAD, *objects()],
    "a left out": left_out("a"), "c left out": left_out("c"),
    "pressure advance": [*HEAD, "SET_PRESSURE_ADVANCE ADVANCE=0.05", *objects(1)],
    "bed mesh": ["G28", "BED_MESH_PROFILE LOAD=tilted", *HEAD[1:], *objects(1)],
}  # fmt: skip


@pytest.mark.parametrize("name", few([*FILES], 1))
def test_the_stream_ends_where_the_file_ends(name: str, tmp_path: Path) -> None:
    sliced, ours = both(FILES[name], tmp_path)
    at_end = [played.position(played.end + 1.0) for played in (sliced, ours)]
    np.testing.assert_allclose(at_end[1], at_end[0], atol=0.01)
    filament = [played.extruded(played.end + 1.0) for played in (sliced, ours)]
    np.testing.assert_allclose(filament[1], filament[0], atol=2e-3)
    unknown = [w for w in ours.warnings if "Unknown" in w]
    assert not [w for w in unknown if w not in sliced.warnings and "INPUT_SHAPER" not in w]


def test_catching_up_on_a_left_out_object_has_the_users_limits(tmp_path: Path) -> None:
    """The long move after it has the printer's own acceleration, not the stream's."""
    _, ours = both(left_out("c"), tmp_path)
    moves = ours.moves
    seconds = moves["accel_t"] + moves["cruise_t"] + moves["decel_t"]
    length = seconds * moves["cruise_v"]
    long = length > 20.0
    assert long.any()
    assert moves["accel"][long].max() <= 10_000.0


# ---------------------------------------------------------------------- stopped anywhere

MOTORS = 50_000.0  # mm/s², of the profile
WINDOW = 2e-3  # s; what a belt does within is not the motors' but the teeth's business


def belts_acceleration(played: Playback) -> float:
    t = np.arange(played.start, played.end, 0.5e-3)
    h = round(WINDOW / 0.5e-3)
    belts = played.position(t)[:, :2] @ np.array([[1.0, 1.0], [1.0, -1.0]])
    return float(np.abs(belts[2 * h :] - 2 * belts[h:-h] + belts[: -2 * h]).max() / WINDOW**2)


def test_firmware_retraction_is_written_as_klipper_makes_it(tmp_path: Path) -> None:
    """As much filament, in hardly more time."""
    lines = strokes(7, 12)
    taken = [k for k, line in enumerate(lines) if line in ("G1 E-1.6 F2400", "G1 E1.6 F2400")]
    for k in taken:
        lines[k] = "G10" if "-" in lines[k] else "G11"
    lines[4:4] = ["G11"]  # what the file finds is the firmware's
    sections = (
        "[firmware_retraction]\nretract_length: 1.6\nretract_speed: 40\nunretract_speed: 25\n"
        "unretract_extra_length: 0.02\n"
    )
    sliced, ours = both(lines, tmp_path, sections, retraction=Retraction(1.6, 40.0, 25.0, 0.02))
    assert "\nG10\n" not in (tmp_path / "ours.gcode").read_text()
    ends = [played.extruded(played.end + 1.0)[0] for played in (sliced, ours)]
    assert ends[1] == pytest.approx(ends[0], abs=2e-3)
    assert ours.duration <= 1.03 * sliced.duration


PARK = [b"G90\n", b"G1 X20 Y20 F18000\n"]
WHOLE = {"max_accel": 10_000.0, "max_velocity": 300.0}


@pytest.fixture(scope="module")
def labelled() -> list[bytes]:
    """Return objects of strokes between retractions and lifts, converted, row by row."""
    rng, lines = (
        np.random.default_rng(5),
        [f"EXCLUDE_OBJECT_DEFINE NAME={name}" for name in OBJECTS],
    )
    for name, centre in OBJECTS.items():
        lines += [f"EXCLUDE_OBJECT_START NAME={name}"]
        for _ in range(12):
            (x, y), (u, v) = np.round(np.array(centre) + rng.uniform(-15.0, 15.0, (2, 2)), 3)
            lines += ["G1 E-.8 F2400", "G1 Z.7 F1200", f"G0 X{x} Y{y} F12000", "G1 Z.3 F1200"]
            lines += ["G1 E.8 F2400", f"G1 X{u} Y{v} E.5 F6000"]
        lines += [f"EXCLUDE_OBJECT_END NAME={name}"]
    file = [line.encode() + b"\n" for line in [*HEAD, "G1 Z.3 F600", "G1 X120 Y120 F9000", *lines]]
    text, _ = converted(file, load("paper"))
    return text.splitlines(keepends=True)


def interrupted(kind: str, rows: list[bytes], at: int) -> list[bytes]:
    """Return the rows with a pause, a cancelled print or a cancelled object before row ``at``."""
    if kind == "pause":
        return [*rows[:at], b"PAUSE\n", *PARK, b"RESUME\n", *rows[at:]]
    if kind == "cancel":
        return [*rows[:at], b"CANCEL_PRINT\n", *PARK]
    name = [row for row in rows[:at] if row.startswith(b"EXCLUDE_OBJECT_START")][-1].split(b"=")[1]
    return [*rows[:at], b"EXCLUDE_OBJECT NAME=" + name, *rows[at:]]


@pytest.mark.parametrize("kind", ["pause", "cancel", "object"])
@pytest.mark.parametrize(
    "moment", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 4))]
)
def test_whatever_stops_a_print_and_whenever_no_motor_is_asked_for_more_than_it_holds(
    kind: str, moment: int, labelled: list[bytes], tmp_path: Path
) -> None:
    """With the macros of ``klipper-macros`` in printer.cfg, and moves of the user's after it."""
    begun = next(k for k, row in enumerate(labelled) if row.startswith(b"EXCLUDE_OBJECT_START"))
    moves = [k for k in range(begun, len(labelled)) if labelled[k].startswith(b"G1 X")]
    at = int(np.random.default_rng([moment, len(kind)]).choice(moves[20:-20]))
    (tmp_path / "stopped.gcode").write_bytes(b"".join(interrupted(kind, labelled, at)))
    sections = SECTIONS.replace("[pause_resume]\n", "") + macros(load("paper"))
    played = play(
        tmp_path / "stopped.gcode", workdir=tmp_path / "work", sections=sections, limits=WHOLE
    )
    assert belts_acceleration(played) <= MOTORS
    assert not [w for w in played.warnings if "INPUT_SHAPER" not in w]
    t = np.arange(played.start, played.end + 2e-3, 1e-3)
    off = np.abs(played.position(t)[:, :2] - 20.0).max(axis=1)
    assert (off[t > played.start + 1.0].min() < 0.2) == (kind != "object")  # parked
