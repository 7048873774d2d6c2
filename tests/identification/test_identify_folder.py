"""`identify` with a folder: what owners have, under the names that their tools gave."""

import json
import lzma
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hframe_post.cli.main import main
from hframe_post.errors import IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import text_from_klipper
from hframe_post.identification.estimation.measured import MeasurementSettings, axis_responses
from hframe_post.identification.gather import Gathered, gather
from hframe_post.printer.profile import load, parse
from hframe_post.printer.settings import Printer
from tests.printers import with_plant
from tests.recordings import SV08_CONFIG, write_klipper
from tests.resonance_recordings import LIS2DW, drawn_sensor, klipper, linear_printer

REAL = Path(__file__).parent / "data" / "raw_data_y_20250601_120000.csv.xz"
BELT = REAL.parent / "belt_b_of_2023.csv.xz"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "printer.cfg"
    path.write_text(SV08_CONFIG)
    return path


@pytest.fixture
def held(tmp_path: Path) -> Path:
    """Return an empty folder for recordings."""
    (path := tmp_path / "held").mkdir()
    return path


def gathered(held: Path, config: Path) -> Gathered:
    printer = KlipperConfig(config)
    return gather([held], printer, parse(text_from_klipper(printer), "mine").travel)


def invoked(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["identify", *map(str, arguments)])


def check_refused(folder: Path, message: str, *arguments: str | Path, status: int = 1) -> None:
    mine = folder / "refused.toml"
    done = invoked(*arguments, "-o", mine)
    assert done.exit_code == status, done.output
    assert re.search(message, done.output), done.output
    assert not mine.exists()


@pytest.mark.slow
def test_a_real_recording_becomes_a_profile(tmp_path: Path, held: Path, config: Path) -> None:
    """A Sovol SV08, its sensor's −z along y, thinned to 333 samples a second."""
    mine = tmp_path / "mine.toml"
    shutil.copy(REAL, held)
    (held / "resonances_y.csv").write_text("freq,psd_x,psd_y,psd_z,psd_xyz\n1,2,3,4,5\n")
    summary, page = tmp_path / "summary.json", tmp_path / "page.html"
    more = ("--json", summary, "--report", page)
    done = invoked(held, "--printer-cfg", config, "-o", mine, *more)
    assert done.exit_code == 0, done.output
    settings = r"min_freq 1 .default: 5., max_freq 100 .default: 135., accel_per_hz (\d+) "
    shown = re.search(settings + ".printer.cfg: 90", done.output)
    assert shown is not None, done.output
    assert float(shown[1]) == pytest.approx(50.0, rel=0.1)
    assert "left aside   resonances_y.csv: a spectrum that Klipper has computed" in done.output
    assert "x was not recorded, so the profile compensates nothing in it" in done.output
    found = json.loads(summary.read_text())
    assert [one["file"] for one in found["recordings"]] == [REAL.name]
    assert [one["file"] for one in found["left_aside"]] == ["resonances_y.csv"]
    strongest = found["functions"]["Gyy"]["modes"][0]
    assert strongest["hz"] == pytest.approx(40.0, rel=0.04)
    assert strongest["damping"] == pytest.approx(0.05, rel=0.3)
    exact, around = found["predicted"]["racking"]["rms"], found["predicted_under_model_error"]
    assert exact < around["median_um"] <= around["worst_um"] < found["predicted"]["none"]["rms"]
    assert f"up to {around['worst_um']:.1f} as the printer changes" in done.output
    profile = load(str(mine))
    assert not profile.invented
    assert profile.travel.x == (0.0, 350.0)
    measured = mine.with_suffix(".model.toml").read_text()
    assert REAL.name in measured
    assert str(tmp_path) not in mine.read_text() + measured
    assert "left aside" in page.read_text()


def test_folders_that_give_nothing_are_refused_in_one_line(
    tmp_path: Path, held: Path, config: Path
) -> None:
    lines = lzma.decompress(REAL.read_bytes()).splitlines(keepends=True)
    rng = np.random.default_rng(0)
    noise = [
        b"%.3f,%.0f,%.0f,%.0f\n" % (0.003 * k, *rng.normal(0.0, 800.0, 3)) for k in range(9999)
    ]
    for text, words in (
        (b"".join(lines[:12000]), "cut"),
        (lines[0] + b"".join(lines[9000:]), "begins in the middle of the resonance test"),
        (b"".join(lines)[:-12], r"too few columns.*cut off"),
        (lines[0] + b"".join(noise), "shows no resonance test"),
        (b"freq,psd_x,psd_y,psd_z,psd_xyz\n1,2,3,4,5\n", "a spectrum"),
    ):
        (held / "raw_data_y_1.csv").write_bytes(text)
        check_refused(tmp_path, rf"raw_data_y_1\.csv: .*{words}", held,
                      "--printer-cfg", config)  # fmt: skip
    (held / "raw_data_y_1.csv").unlink()
    check_refused(tmp_path, "no recordings here", held, "--printer-cfg", config)
    check_refused(tmp_path, "give the folder", "--printer-cfg", config, status=2)


def test_a_corexy_that_racks_is_an_hbot(paper: Printer, config: Path) -> None:
    """Klipper calls both corexy."""
    text = text_from_klipper(KlipperConfig(config))
    windows = paper.compensation.windows
    written = with_plant(str(config), paper.plant, windows, [], None, text)
    assert parse(written, "mine").kinematics.type == "hbot"
    without = with_plant(str(config), replace(paper.plant, Gxtheta=None), windows, [], None, text)
    assert parse(without, "mine").kinematics.type == "corexy"


def test_what_axes_map_mirrored_is_undone(held: Path, config: Path) -> None:
    """Else the other axis, of which a test of one axis shows no sign, would lie opposite."""
    shutil.copy(REAL, held)
    (plain,) = gathered(held, config).runs
    config.write_text(f"{SV08_CONFIG}[adxl345]\naxes_map: -x, z, y\n")
    (undone,) = gathered(held, config).runs
    x, y, z = plain.nozzle.a.T
    np.testing.assert_array_equal(undone.nozzle.a, np.column_stack([-x, z, y]))
    config.write_text(f"{SV08_CONFIG}[adxl345]\naxes_map: x, y\n")
    with pytest.raises(IdentificationError, match="invalid axes_map"):
        gathered(held, config)


def test_a_real_belt_of_2023_is_taken(held: Path, config: Path) -> None:
    """A Voron 2.4, its LIS2DW at 394 Hz, up to 40 Hz: the stamps wander by 30 ms.

    The first 26 ms of its motion, around the point, are missing. The file holds tenths of
    milliseconds and steps of the sensor, as differences.
    """
    text = lzma.decompress(BELT.read_bytes()).decode()
    steps = np.loadtxt(text.splitlines(), delimiter=",").cumsum(axis=0)
    z = np.random.default_rng(0).normal(9575.0, 100.0, len(steps))
    rows = np.column_stack([23637.0 + 1e-4 * steps[:, 0], np.rint(LIS2DW * steps[:, 1:]), z])
    np.savetxt(held / "belt_20231129_B.csv", rows, "%.4f,%.0f,%.0f,%.0f",
               header="time,accel_x,accel_y,accel_z", comments="#")  # fmt: skip
    config.write_text(SV08_CONFIG.replace("accel_per_hz: 90", "accel_per_hz: 75\nmax_freq: 40"))
    found = gathered(held, config)
    (used,) = found.used
    assert used.motion == (
        "TEST_RESONANCES of Klipper before December 2024 of 1,1 at 175,175: min_freq 5, max_freq "
        "40, accel_per_hz 75"
    )
    assert used.notes[0].startswith("its time stamps wander by up to 30 ms")
    groups = axis_responses(found.runs, MeasurementSettings((3.0, 38.0), racks=False))
    for name, group in groups.items():
        (response,) = (run.response for run in group.runs)
        slow = response.within((10.0, 20.0))
        assert np.abs(slow.H.mean()) == pytest.approx(1.0, abs=0.15), name
        assert np.abs(slow.H - slow.H.mean()).mean() < 0.25, name
        assert np.median(response.within((30.0, 38.0)).coherence) > 0.9, name


@pytest.mark.slow
def test_exchanged_files_and_unusual_settings_are_noticed(tmp_path: Path, config: Path) -> None:
    config.write_text(SV08_CONFIG.replace("accel_per_hz: 90", "hz_per_sec: 2\nmax_freq: 100"))
    chip = replace(drawn_sensor(4, "lis2dw-394"), lead=0.4)
    tests = [klipper(way, hz_per_sec=2.0, max_freq=100.0) for way in ((1.0, 0.0), (0.0, 1.0))]
    tests[1] = replace(tests[1], accel_per_hz=100.0)
    made = [chip.record(linear_printer(4), test.command(), 1) for test in tests]
    for names, exchanged in (("xy", False), ("yx", True)):
        for name, recording in zip(names, made, strict=True):
            write_klipper(tmp_path / f"raw_data_{name}_1.csv", recording)
        used = gathered(tmp_path, config).used
        shown = ["the names of the two files are exchanged" in one.as_text() for one in used]
        assert shown == [exchanged, exchanged]
        assert re.search(r"accel_per_hz \d+ .default: 60.", used[not exchanged].motion)
        assert "accel_per_hz 60," in used[exchanged].motion
