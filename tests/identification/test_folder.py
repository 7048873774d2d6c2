"""Folders of recordings: what is found under the names that tools give, and what is left aside."""

import gzip
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.folder import Aside, Measurement, contents
from hframe_post.identification.recordings.formats import command_csv
from hframe_post.identification.recordings.names import RecordingName, day_of, parsed, stem
from tests import recordings
from tests.recordings import klipper_csv

Contents = tuple[list[Measurement], list[Aside]]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
A, B = (0.7071, -0.7071, 0.0), (0.7071, 0.7071, 0.0)


@pytest.mark.parametrize(
    ("name", "direction", "point", "chip", "date"),
    [
        ("raw_data_x_20250805_220709.csv", X, None, "", "20250805220709"),
        ("raw_data_y_100.000_110.500_20.000_t1.csv", Y, (100.0, 110.5), "", ""),
        ("raw_data_x_adxl345_hotend_20240101_120000.csv", X, None, "adxl345_hotend",
         "20240101120000"),
        ("raw_data_x_hotend_20240101_120000.csv", X, None, "hotend", "20240101120000"),
        ("raw_data_x_at_80_150_20240101_120000.csv", X, (80.0, 150.0), "", "20240101120000"),
        ("raw_data_y_bed_5.000_6.000_7.000_20240101_120000.csv", Y, (5.0, 6.0), "bed",
         "20240101120000"),
        ("raw_data_y_lis2dw_bed_5.000_6.000_7.000_a.csv", Y, (5.0, 6.0), "lis2dw_bed", ""),
        ("raw_data_x_adxl345_test1.csv", X, None, "adxl345", ""),
        ("raw_data_axis=1.000,-1.000,0.000_a.csv", A, None, "", ""),
        ("raw_data_axis=1.000,1.000_adxl345_20240101_120000.csv", B, None, "adxl345",
         "20240101120000"),
        ("raw_data_x_at_80_150.csv", X, (80.0, 150.0), "", ""),
        ("resonances_20231016_101500_X.csv", X, None, "", "20231016101500"),
        ("belt_20231016_101500_A.csv", A, None, "", "20231016101500"),
        ("belts_20240501_101500_B.csv", B, None, "", "20240501101500"),
        ("beltscomparison_20240620_101500_A.csv", A, None, "", "20240620101500"),
        ("shaketune-axis_Y_20240620_101500.csv", Y, None, "", "20240620101500"),
        ("inputshaper_20250101_101500_axis_X.stdata", X, None, "", "20250101101500"),
        ("belt_B_20250101_101500", B, None, "", "20250101101500"),
        ("raw_data_z_1.csv", Z, None, "", ""),
    ],
)  # fmt: skip
def test_names_of_resonance_tests(
    name: str,
    direction: tuple[float, float, float],
    point: tuple[float, float] | None,
    chip: str,
    date: str,
) -> None:
    found = parsed(name)
    assert found.direction == pytest.approx(direction, abs=1e-4)
    assert (found.point, found.chip, found.date) == (point, chip, date)
    assert found.certain
    assert found.other == ""


@pytest.mark.parametrize("name", ["sv08_x_1.csv.xz", "X.csv", "test x.csv", "x2.csv", "my-X-3.csv"])
def test_other_names_may_contain_the_axis(name: str) -> None:
    assert parsed(name) == RecordingName(X)


@pytest.mark.parametrize("name", ["x_to_y.csv", "exit.csv", "1.csv", "raw_data_axis=1_a.csv"])
def test_other_names_say_nothing(name: str) -> None:
    assert parsed(name).direction is None


# ---------------------------------------------------------------------- folders


def shaken(seed: int, seconds: float = 1.0) -> Array:
    """Return time and three accelerations of a sensor, (n, 4)."""
    rng = np.random.default_rng(seed)
    t = 50.0 + np.arange(round(seconds * 800.0)) / 800.0
    return np.column_stack([t, rng.normal([0.0, 0.0, 9800.0], 300.0, (len(t), 3))])


def samples(seed: int, seconds: float = 1.0) -> bytes:
    return klipper_csv(shaken(seed, seconds))


def stdata(*names: str) -> bytes:
    return recordings.stdata(*((name, shaken(seed)) for seed, name in enumerate(names, 100)))


def command(axis: int, seconds: float = 2.0) -> bytes:
    motion = np.full((round(seconds / TS), 2), 100.0)
    motion[500:-500, axis] += np.sin(np.arange(len(motion) - 1000) / 50.0)
    return b"".join(command_csv(motion))


def folder(path: Path, files: Mapping[str, bytes]) -> Path:
    for name, content in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    return path


def by_name(found: Contents) -> dict[str, Measurement]:
    return {Path(one.label).name: one for one in found[0]}


def reason(found: Contents, name: str) -> str:
    (text,) = (one.reason for one in found[1] if name in one.label)
    return text


def test_tests_of_resonances_are_found_and_repeated_ones_are_sessions(tmp_path: Path) -> None:
    names = [
        "raw_data_x_20250805_220709.csv", "raw_data_x_20250101_101010.csv",
        "raw_data_y_20250805_221010.csv", "sub/belt_20231016_101500_A.csv",
    ]  # fmt: skip
    files = {name: samples(seed) for seed, name in enumerate(names)}
    files |= {"raw_data_x_20250801_090000.csv.gz": gzip.compress(samples(9))}
    files |= {"beltscomparison_20250101_10.stdata": stdata("belt_A_20250101_1", "belt_B_2")}
    found = contents([folder(tmp_path, files)])
    assert found[1] == []
    assert {name: one.session for name, one in by_name(found).items()} == {
        "raw_data_x_20250101_101010.csv": 1,
        "raw_data_x_20250801_090000.csv.gz": 2,
        "raw_data_x_20250805_220709.csv": 3,
        "raw_data_y_20250805_221010.csv": 1,
        "belt_20231016_101500_A.csv": 1,
        "beltscomparison_20250101_10.stdata: belt_A_20250101_1": 2,
        "beltscomparison_20250101_10.stdata: belt_B_2": 1,
    }
    assert all(one.command is None and not one.recording.started for one in found[0])


def test_our_sweeps_are_paired_with_their_commands(tmp_path: Path) -> None:
    files = {
        "sweep-x.x-at-80.csv": command(0), "sweep-x.x-at-180.csv": command(0, 2.1),
        "sweep-y.y-at-80.csv": command(1),
        "adxl345-x-at-80.csv": samples(1, 2.0), "adxl345-x-at-180.csv": samples(2, 2.1),
        "adxl345-y-at-80.csv": samples(3, 2.0),
        "raw_data_y_1.csv": samples(4, 2.0),
    }  # fmt: skip
    found = by_name(contents([folder(tmp_path, files)]))
    paired = {n: one.command.path.name if one.command else None for n, one in found.items()}
    assert paired == {
        "adxl345-x-at-80.csv": "sweep-x.x-at-80.csv",
        "adxl345-x-at-180.csv": "sweep-x.x-at-180.csv",
        "adxl345-y-at-80.csv": "sweep-y.y-at-80.csv",
        "raw_data_y_1.csv": None,
    }
    assert found["adxl345-x-at-80.csv"].recording.started
    assert found["adxl345-x-at-80.csv"].name.chip == "adxl345"


def test_other_programs_recordings_are_paired_by_the_axis(tmp_path: Path) -> None:
    other = {f"marlin_y_{k}.csv": samples(k, 1.9).replace(b"#time", b"time") for k in (1, 2)}
    files = {"marlin_y_command.csv.gz": gzip.compress(command(1)), **other}
    found = by_name(contents([folder(tmp_path, files)]))
    assert [one.session for one in found.values()] == [1, 2]
    assert all(one.command and not one.recording.started for one in found.values())
    files |= {"again_y.csv": command(1, 2.2), "long_y.csv": samples(5, 150.0)}
    found_more = contents([folder(tmp_path, files)])
    assert "several commands may be its motion" in reason(found_more, "marlin_y_1")
    assert by_name(found_more)["long_y.csv"].command is None  # it lasts far longer


def test_one_sensor_is_used_where_two_recorded(tmp_path: Path) -> None:
    names = [f"raw_data_{axis}_{chip}_20250101_101010.csv"
             for axis in "xy" for chip in ("adxl345", "adxl345_bed")]  # fmt: skip
    held = folder(tmp_path, {name: samples(seed) for seed, name in enumerate(names)})
    assert set(by_name(contents([held]))) == {names[0], names[2]}
    found = contents([held], chips={"x": "adxl345", "y": "adxl345_bed"})
    assert set(by_name(found)) == {names[0], names[3]}
    assert {one.label for one in found[1]} == {names[1], names[2]}


def test_klipper_names_a_sensor_by_the_last_word_of_its_section(tmp_path: Path) -> None:
    names = [f"raw_data_{axis}_{chip}_20250101_101010.csv"
             for axis in "xy" for chip in ("hotend", "bed")]  # fmt: skip
    held = folder(tmp_path, {name: samples(seed) for seed, name in enumerate(names)})
    found = contents([held], chips={"x": "adxl345_hotend", "y": "lis2dw_bed"})
    assert set(by_name(found)) == {names[0], names[3]}


def test_what_is_left_aside_has_one_reason_each(tmp_path: Path) -> None:
    files = {
        "raw_data_x_1.csv": samples(1),
        "copy_of_x.csv": samples(1),
        "resonances_x_20250101_101010.csv": b"freq,psd_x,psd_y,psd_z,psd_xyz\n1,2,3,4,5\n",
        "raw_data_y_1.csv": samples(2)[:-20],
        "raw_data_y_2.csv.gz": gzip.compress(samples(2))[:-50],
        "raw_data_z_1.csv": samples(3),
        "axesmap_20250101_101010.stdata": stdata("axesmap_X_1"),
        "vibrationsprofile_20250101_101010.stdata": b"",
        "staticfrequency_20250101_101010.stdata": b"",
        "measured.csv": samples(4),
        "notes.csv": b"a,b\n1,2\n",
        "empty.csv": b"",
        "picture.png": b"not looked at",
    }
    found = contents([folder(tmp_path, files)])
    assert list(by_name(found)) == ["copy_of_x.csv"]
    for name, words in {
        "raw_data_x_1": "a copy of",
        "resonances_x": "a spectrum that Klipper has computed",
        "raw_data_y_1": "line 801: too few columns",
        "raw_data_y_2": "the compressed file is cut off",
        "raw_data_z": "z moves",
        "axesmap": "sensor's axes",
        "vibrations": "constant speeds",
        "staticfreq": "constant frequency",
        "measured": "neither its name nor a command next to it shows which axis moved",
        "notes": "not a Klipper accelerometer file",
        "empty": "the file is empty",
    }.items():
        assert words in reason(found, name)
        assert str(tmp_path) not in reason(found, name) or words == "a copy of"
    assert len(found[1]) == 11


def test_folders_without_recordings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match=r"no recordings here.*TEST_RESONANCES"):
        contents([tmp_path])
    folder(tmp_path, {f"{k}.csv": b"" for k in range(501)})
    with pytest.raises(IdentificationError, match="501 files are too many"):
        contents([tmp_path])
    shutil.rmtree(tmp_path)
    with pytest.raises(IdentificationError, match="no recordings here"):
        contents([folder(tmp_path, {"a/b/c/d/raw_data_x.csv": samples(1)})])


@contextmanager
def not_root() -> Iterator[None]:
    """Do without root's right to read everything."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)  # nobody
    try:
        yield
    finally:
        os.seteuid(user)


def test_an_unreadable_file_is_left_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = folder(tmp_path, {"raw_data_x.csv": samples(1), "raw_data_y.csv": samples(2)})
    (held / "raw_data_x.csv").chmod(0)
    held.chmod(0o755)
    monkeypatch.chdir(held)  # only root may go through the folders above
    with not_root():
        found = contents([Path()])
    assert reason(found, "raw_data_x") == "Permission denied"


COPIED = date(2026, 2, 3)


def dated(folder: Path, name: str, content: bytes) -> Path:
    """Write a file and let it be one that was copied on COPIED."""
    path = folder / name
    path.write_bytes(content)
    at = datetime(COPIED.year, COPIED.month, COPIED.day, 12, tzinfo=UTC).timestamp()
    os.utime(path, (at, at))
    return path


@pytest.mark.parametrize(
    ("name", "day"),
    [
        ("raw_data_x_20250526_101500.csv", date(2025, 5, 26)),
        ("raw_data_x_adxl345_100.000_110.000_20.000_20250526_101500.csv", date(2025, 5, 26)),
        ("0_2025-05-26_10.15.00.csv", date(2025, 5, 26)),
        ("20240101_backup_of_raw_data_x_20250526_101500.csv", date(2025, 5, 26)),
        ("raw_data_x_20251345_101500.csv", COPIED),  # no such day
        ("raw_data_x_20980526_101500.csv", COPIED),  # a clock that was wrong
        ("raw_data_x_1.csv", COPIED),
        ("adxl345-measure-at-140-t2025111512.csv", COPIED),  # 34 minutes
    ],
)
def test_the_date_in_the_name_counts_first(tmp_path: Path, name: str, day: date) -> None:
    """Else that of the last copy; none is in the numbers of a recording, or in a print time."""
    assert day_of(parsed(name), dated(tmp_path, name, b"#time\n1.0,20200101.0\n")) == day


def test_then_the_date_of_the_measurement_in_the_file(tmp_path: Path) -> None:
    ((found,), _) = contents([dated(tmp_path, "x.stdata", stdata("axis_X_20250526_101500"))])
    assert found.day == date(2025, 5, 26)


def test_a_print_time_is_no_date() -> None:
    found = parsed("adxl345-measure-at-140-t2025111512.csv")
    assert found.ended == pytest.approx(2025.111512)
    assert found.date == ""
    assert stem("adxl345-measure-at-140-t2025111512.csv") == "adxl345-measure-at-140"
