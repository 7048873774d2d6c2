"""Files of accelerometers as Klipper, Shake&Tune and other programs write them."""

import gzip
import lzma
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import GRAVITY
from hframe_post.identification.recordings.formats import (
    MAX_SIZE,
    command_csv,
    read_command,
    read_tables,
    unpacked,
)
from tests.conftest import few
from tests.recordings import klipper_csv, read, stdata


@pytest.fixture(scope="module")
def rows() -> Array:
    """Return time and three accelerations of a sensor that shakes, (n, 4)."""
    rng = np.random.default_rng(0)
    t = 100.0 + np.arange(2000) / 1600.0
    return np.column_stack([t, rng.normal([300.0, -200.0, 9800.0], 500.0, (2000, 3))])


@pytest.mark.parametrize(
    "pack", [gzip.compress, lzma.compress, zstandard.ZstdCompressor().compress]
)
def test_compressed_files_are_read_whatever_their_name(
    tmp_path: Path, rows: Array, pack: Callable[[bytes], bytes]
) -> None:
    path = tmp_path / "raw.csv"
    path.write_bytes(pack(klipper_csv(rows)))
    np.testing.assert_allclose(read(path).a, rows[:, 1:], atol=1e-6)
    path.write_bytes(pack(klipper_csv(rows))[:-3000])
    with pytest.raises(IdentificationError, match=r"cut off|file is empty"):
        read(path)
    path.write_bytes(pack(klipper_csv(rows))[:20] + bytes(range(200)))
    with pytest.raises(IdentificationError, match=r"raw\.csv"):
        read(path)


def test_a_compressed_command_is_read(tmp_path: Path) -> None:
    command = np.column_stack([np.sin(np.arange(1500) / 100.0), np.zeros(1500)])
    path = tmp_path / "command.csv.gz"
    path.write_bytes(gzip.compress(b"".join(command_csv(command))))
    np.testing.assert_allclose(read_command(path), command, atol=1e-6)


def test_shaketune_files_hold_several_measurements(tmp_path: Path, rows: Array) -> None:
    path = tmp_path / "beltscomparison.stdata"
    path.write_bytes(stdata(("belt_A_20250101_101010", rows), ("belt_B_20250101_101110", -rows)))
    first, second = read_tables(path, unpacked(path), None)
    assert (first.name, second.name) == ("belt_A_20250101_101010", "belt_B_20250101_101110")
    np.testing.assert_array_equal(first.values, rows)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b'{"name": "axis_X", "samples": [[1, 2, 3, 4], [2', "measurement 1 is not complete"),
        (b'{"name": "axis_X", "samples": []}', "axis_X: 0 samples are too few"),
        (b'{"name": "axis_X"}', "measurement 1 does not consist of"),
        (b'{"name": "axis_X", "samples": [[1, 2, 3]]}', "does not consist of"),
        (b'{"name": "axis_X", "samples": [[1, 2, 3, "word"]]}', "does not consist of"),
        (b'{"name": "axis_X", "samples": 5}', "does not consist of"),
        (b"{" * 5000, "not complete"),
    ],
)
def test_broken_shaketune_files_are_refused(tmp_path: Path, text: bytes, words: str) -> None:
    path = tmp_path / "broken.stdata"
    path.write_bytes(zstandard.ZstdCompressor().compress(text))
    with pytest.raises(IdentificationError, match=words):
        read(path)


@pytest.mark.parametrize(
    ("head", "scale"),
    [
        (b"time,accel_x,accel_y,accel_z\n", 1.0),
        (b"Time (s),Acceleration_X (m/s^2),Acceleration_Y (m/s^2),Acceleration_Z (m/s^2)\n", 1e3),
        (b"timestamp,ax_g,ay_g,az_g\n", GRAVITY),
        (b"t,x_acc [g],y_acc [g],z_acc [g]\n", GRAVITY),
        (b'"Time (s)","Acceleration x (g)","Acceleration y (g)","Acceleration z (g)"\n', GRAVITY),
        (b"time, x, y, z\n", GRAVITY),  # of adxl345spi and adxl345usb; gravity tells the unit
    ],
)
def test_columns_say_what_they_are(tmp_path: Path, rows: Array, head: bytes, scale: float) -> None:
    path = tmp_path / "logged.csv"
    path.write_bytes(klipper_csv(rows / [1.0, scale, scale, scale], head))
    found = read(path)
    np.testing.assert_allclose(found.a, rows[:, 1:], atol=1e-6 * scale)
    assert not found.started


ZEROS = bytes(1 << 24)  # 16 MB
TIMES = 17  # 272 MB, more than MAX_SIZE


def stdata_of_rows() -> bytes:
    rows = b"[]," * (5 << 20)
    line = b'{"name": "axis_X", "samples": [' + rows[:-1] + b"]}\n"
    return zstandard.ZstdCompressor(level=1).compress(line)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    few(
        [
            ("x.csv.gz", lambda: TIMES * gzip.compress(ZEROS, 1), "too large"),
            ("x.stdata", stdata_of_rows, "too many"),
            ("x.csv.xz", lambda: TIMES * lzma.compress(ZEROS, preset=0), "too large"),
            ("x.csv.zst", lambda: TIMES * zstandard.ZstdCompressor().compress(ZEROS), "too large"),
        ],
        2,
    ),
)
def test_no_file_unpacks_to_more_than_the_limit(
    tmp_path: Path, name: str, content: Callable[[], bytes], words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content())
    assert path.stat().st_size < 3 << 20
    tracemalloc.start()
    try:
        with pytest.raises(IdentificationError, match=rf"x\..*{words}"):
            read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.2 * MAX_SIZE, f"{peak >> 20} MB of memory"


def reprap(rows: Array, end: bytes) -> bytes:
    """Return what M956 writes: numbers of samples, and g."""
    lines = [
        b"%d,%.4f,%.4f,%.4f\n" % (k, *a) for k, a in enumerate((rows[:, 1:] / GRAVITY).tolist())
    ]
    return b"Sample,X,Y,Z\n" + b"".join(lines) + end


def test_samples_of_reprapfirmware_have_the_time_of_their_rate(tmp_path: Path, rows: Array) -> None:
    path = tmp_path / "0.csv"
    path.write_bytes(reprap(rows, b"Rate 1391, overflows 0\n"))
    found = read(path)
    np.testing.assert_allclose(found.t, np.arange(len(rows)) / 1391.0)
    np.testing.assert_allclose(found.a, rows[:, 1:], atol=0.5)
    path.write_bytes(reprap(rows, b""))
    with pytest.raises(IdentificationError, match="does not tell the rate of its samples"):
        read(path)
