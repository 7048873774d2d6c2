"""Live on the real Klipper host: its steps are the kernel's, whatever a print does meanwhile."""

import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.firmware.klipper.live import bounds_of, kernel_file, klipper_name, live_kernel
from hframe_post.hosts.klipper.kernel_file import EDGE, HEADERS, compiled
from hframe_post.model.kernel import played as spline
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.klipper.host import KlippyError, Playback, play

PRINTER = replace(load("paper"), invented=False)
Limits = dict[str, float]
LIMITS = {"max_velocity": 300.0, "max_accel": 10000.0, "square_corner_velocity": 5.0}


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = kernel_file(PRINTER)
    assert data is not None
    (path := tmp_path_factory.mktemp("kernel") / "printer.kernel").write_bytes(data)
    return path


def played(
    lines: list[str], folder: Path, kernel: Path | None, more: str = "", limits: Limits = LIMITS
) -> Playback:
    folder.mkdir(parents=True, exist_ok=True)
    # in batch mode a host stops before the end of a motion
    lines = ["G28", "G90", "M83", *lines, "M400", "G4 P1500", ""]
    (file := folder / "file.gcode").write_text("\n".join(lines))
    section = f"\n[hframe_live]\nkernel: {kernel}\n" if kernel is not None else ""
    return play(file, limits=limits, workdir=folder, sections=section + more)


def belts(playback: Playback, t: np.ndarray) -> np.ndarray:
    """Return positions of A and B by the steps (2, n), mm."""
    steps = playback.steps()
    return np.stack([steps[motor].position(t) for motor in "AB"])


def wanted(playback: Playback, printer: Printer, t: np.ndarray) -> np.ndarray:
    """Return where the kernel takes A and B (2, n) for the host's own moves, at whole ms.

    The first begins in a corner of the bed, where the command fades into the path.
    """
    (made, figures), path = live_kernel(printer), playback.position(t)[:, :2]
    u = np.clip(np.minimum(path, (280.0, 295.0) - path) / (EDGE * figures.deviation), 0.0, 1.0)
    command = path + u * u * (3.0 - 2.0 * u) * (made.command(path) - path)
    return printer.kinematics.belts(*spline(command).T)


@pytest.mark.slow
@pytest.mark.klipper
@pytest.mark.parametrize("kind", ["hbot", "cartesian", "hybrid-corexy", "corexz"])
def test_the_hosts_steps_are_the_kernels(kind: str, tmp_path: Path) -> None:
    printer = load("example-corexy")
    printer = replace(printer, kinematics=Kinematics(kind), travel=PRINTER.travel, invented=False)
    printer = PRINTER if kind == "hbot" else printer
    data, bounds = kernel_file(printer), bounds_of(printer)
    assert data is not None
    (kernel := tmp_path / "printer.kernel").write_bytes(data)
    lines = [f"G1 X{x} Y{y} F9000 E0.5" for x, y in
             ((170, 75), (200, 75), (200, 95), (170, 95), (150, 60), (240, 61))]  # fmt: skip
    limits = {"max_velocity": bounds.velocity, "max_accel": bounds.acceleration}
    name = f"\n[printer]\nkinematics: {klipper_name(kind)}\n"
    live, bare = (
        played(lines, tmp_path / folder, path, name, LIMITS if kind == "hbot" else limits)
        for folder, path in (("live", kernel), ("bare", None))
    )
    assert live.warnings == ()
    t = np.arange(int(1e3 * live.start) - 200, int(1e3 * live.end) + 100) * 1e-3
    size = live.steps()["A"].size  # its step compression may be 25 us late
    assert np.abs(belts(live, t) - wanted(live, printer, t)).max() < 0.6 * size + 0.005
    assert len(live.steps()["e"].time) == len(bare.steps()["e"].time)
    assert live.duration == pytest.approx(bare.duration, rel=3e-3)


@pytest.mark.slow
@pytest.mark.klipper
def test_the_edge_of_the_bed_asks_no_more_of_the_motors(kernel: Path, tmp_path: Path) -> None:
    places = ((0, 0), (100, 0), (100, 1), (0, 1), (0, 0), (140, 100), (0, 1), (100, 60), (0, 0))
    live = played([f"G1 X{x} Y{y} F9000" for x, y in places], tmp_path, kernel)
    t = np.arange(live.start, live.end + 1.0, 5e-3)
    for axis in np.array([[0.5, 0.5], [0.5, -0.5]]) @ belts(live, t):
        assert axis.min() > -0.05
    rates = np.diff(belts(live, t), n=2, axis=1) / 5e-3**2
    assert np.abs(rates).max() <= PRINTER.motors.belt_acceleration  # 60 000 where it is cut


@pytest.mark.slow
@pytest.mark.klipper
def test_a_file_that_asks_for_too_much_is_slowed(kernel: Path, tmp_path: Path) -> None:
    lines = [line for line in drawn(3, 300, 60.0, 0.0) if "F600" not in line or "F6000" in line]
    asked = ["M204 S100000", "SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=100 VELOCITY=2000", *lines]
    live = played([*asked, "SET_HFRAME_LIVE"], tmp_path / "live", kernel)
    t = np.arange(live.start, live.end, 1e-3)
    c = live_kernel(PRINTER)[0].command(live.position(t)[:, :2])
    v, a = (np.abs(np.diff(PRINTER.kinematics.belts(*c.T), n=k)).max() * 1e3**k for k in (1, 2))
    assert v <= PRINTER.motors.belt_velocity
    assert a <= 1.15 * PRINTER.motors.belt_acceleration  # the reserve is that of other strokes
    bare = played(asked, tmp_path / "bare", None)
    path = PRINTER.kinematics.belts(*bare.position(t)[:, :2].T)
    assert np.abs(np.diff(path, n=2)).max() * 1e6 > PRINTER.motors.belt_acceleration


FAULTS = (
    "SET_KINEMATIC_POSITION X={x:.3f} Y={y:.3f}", "G4 P{ms}", "M400", "M204 S3000",
    "M84\nSET_KINEMATIC_POSITION X={x:.3f} Y={y:.3f} Z=1",
    "SET_INPUT_SHAPER SHAPER_FREQ_X=40 SHAPER_FREQ_Y=50",
    "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
)  # fmt: skip
TOGGLES = (*(f"SET_HFRAME_LIVE ENABLE={on}" for on in (0, 1)),
           *(f"SET_HFRAME_LIVE TOWER={band}" for band in (0, 1, 2)))  # fmt: skip


def drawn(seed: int, count: int, longest: float, faults: float) -> Iterator[str]:
    """Yield random moves, with a share of faults and toggles between them."""
    rng = random.Random(seed)
    x, y = 100.0, 100.0
    yield f"G1 X{x} Y{y} F9000"
    for _ in range(count):
        draw = rng.random()
        if draw < faults:
            text = rng.choice(FAULTS if draw < faults / 2.0 else TOGGLES)
            yield text.format(x=x, y=y, ms=rng.choice([1, 10, 300, 1500]))
            continue
        length = rng.uniform(0.02, longest)
        x = min(max(x + rng.uniform(-length, length), 0.0), 280.0)
        y = min(max(y + rng.uniform(-length, length), 0.0), 290.0)
        yield f"G1 X{x:.3f} Y{y:.3f} F{rng.choice([600, 6000, 18000])}"
    yield "G1 X100 Y100 F6000"


@pytest.mark.slow
@pytest.mark.klipper
@pytest.mark.parametrize(
    ("count", "longest", "faults"),
    [(2000, 60.0, 0.0), (4000, 30.0, 0.5), (10_000, 1.0, 0.0)],  # 1 000 toggles
)
def test_no_step_is_lost_and_no_motor_outrun(
    kernel: Path, tmp_path: Path, count: int, longest: float, faults: float
) -> None:
    lines = list(drawn(1, count, longest, faults))
    live = played(lines, tmp_path / "live", kernel)
    bare_lines = [line for line in lines if not line.startswith("SET_HFRAME_LIVE")]
    bare = played(bare_lines, tmp_path / "bare", None)
    assert live.warnings == ()
    for motor in "AB":
        ends = [int(each.steps()[motor].direction.astype(int).sum()) for each in (live, bare)]
        assert ends[0] == ends[1]
        trains = live.steps()[motor]
        t = np.arange(live.start, live.end, 5e-3)
        speed = np.abs(np.diff(trains.position(t))).max() / 5e-3
        assert speed <= PRINTER.motors.belt_velocity


def objects(excluded: int) -> Iterator[str]:
    """Yield a print of four objects, one of which is excluded in its second layer."""
    rng = random.Random(excluded)
    yield from (f"EXCLUDE_OBJECT_DEFINE NAME=part{k}" for k in range(4))
    for layer in range(3):
        yield f"G1 Z{layer + 1} F600"
        for k in range(4):
            yield f"EXCLUDE_OBJECT_START NAME=part{k}"
            for _ in range(20):
                x, y = (80 + 60 * each + rng.uniform(0.0, 30.0) for each in divmod(k, 2))
                yield f"G1 X{x:.3f} Y{y:.3f} E0.1 F9000"
                if layer == 1 and k == excluded and rng.random() < 0.1:
                    yield f"EXCLUDE_OBJECT NAME=part{k}"
            yield f"EXCLUDE_OBJECT_END NAME=part{k}"
    yield "G1 X100 Y100"


RESONANCES = (
    "\n[adxl345]\nrate: 3200\n[resonance_tester]\nprobe_points: 100,100,5\naccel_chip: adxl345\n"
    "max_freq: 8\n"
)


@pytest.mark.slow
@pytest.mark.klipper
def test_objects_and_tests_leave_motors_where_they_were(kernel: Path, tmp_path: Path) -> None:
    test = [*drawn(7, 20, 30.0, 0.0), "TEST_RESONANCES AXIS=X OUTPUT=raw_data"]
    for number, lines in enumerate([*map(list, map(objects, range(4))), [*test, *test]]):
        folder = tmp_path / str(number)
        live, bare = (
            played(lines, folder / name, path, RESONANCES)
            for name, path in (("live", kernel), ("bare", None))
        )
        assert live.warnings == bare.warnings
        for motor in "ABze":
            both = [int(each.steps()[motor].direction.astype(int).sum()) for each in (live, bare)]
            assert both[0] == both[1]


@pytest.mark.slow
@pytest.mark.klipper
def test_what_is_wrong_at_the_start_is_an_error(kernel: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.kernel"
    damaged.write_bytes(kernel.read_bytes().replace(b"10000", b"20000"))
    cases = (
        (damaged, "", "was edited: write it again with 'hframe-post identify'"),
        (kernel, "[printer]\nkinematics: cartesian\n", "write it with this printer's profile"),
        (kernel, "[printer]\nkinematics: none\n", "kinematics none is not supported"),
        (kernel, "[printer]\nmax_accel: 20000\n", "run 'hframe-post setup'"),
    )
    for number, (path, more, said) in enumerate(cases):
        with pytest.raises(KlippyError, match=said):
            played(["G1 X10 F6000"], tmp_path / str(number), path, more)
    assert played(["G1 X10 F6000"], tmp_path / "none", tmp_path / "no.kernel").warnings == ()


def headers(folder: Path) -> Path:
    from tests.klipper.batch import klippy_module

    source = Path(klippy_module("chelper").__file__).parent
    for name in HEADERS:
        shutil.copy(source / name, folder)
    return folder


def test_an_unknown_klipper_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="not known"):
        compiled(tmp_path / "elsewhere", tmp_path)
    known = headers(tmp_path)
    changed = known / "trapq.h"
    changed.write_text(changed.read_text().replace("half_accel", "jerk"))
    with pytest.raises(ValueError, match="does not compile"):
        compiled(known, tmp_path)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ValueError, match="gcc is missing"):
        compiled(known, tmp_path)
    assert not [*tmp_path.glob("*.tmp"), *tmp_path.glob("*.so")]


@pytest.mark.slow
def test_the_c_is_clean_under_sanitizers() -> None:
    program = (
        "import sys, pytest, hframe_post.hosts.klipper.kernel_file as n\n"
        "n.GCC += ('-g', '-fsanitize=address,undefined', '-fno-sanitize-recover')\n"
        "sys.exit(pytest.main(['-q', '-p', 'no:cacheprovider', 'tests/live/test_native.py']))"
    )
    asan = subprocess.check_output(["gcc", "-print-file-name=libasan.so"], text=True).strip()
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=Path(__file__).parents[2],
        env={"PATH": "/usr/bin:/bin", "LD_PRELOAD": asan, "ASAN_OPTIONS": "detect_leaks=0"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
