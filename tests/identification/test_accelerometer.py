"""Accelerometer files of all formats, and the sensor's axes."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording, axes_map
from tests.recordings import SIXTEEN_BITS, THIRTEEN_BITS, klipper_csv, read, sweep
from tests.simulator import Chip

NAMES = b"#time,accel_x,accel_y,accel_z\n"
COLUMNS = ("t", "ax", "ay", "az")


@pytest.fixture(scope="module")
def rows() -> Array:
    """Return time and three accelerations of a moving sensor, (n, 4)."""
    swept = sweep(rate=60.0)
    recording = Chip(drift=0.004, step=SIXTEEN_BITS).on_nozzle(swept, 0.0 * swept)
    return np.column_stack([recording.t, recording.a])


def file(folder: Path, text: bytes, name: str = "raw.csv") -> Path:
    path = folder / name
    path.write_bytes(text)
    return path


def refused(path: Path, words: str, columns: tuple[str, ...] | None = None) -> None:
    with pytest.raises(IdentificationError, match=words) as caught:
        read(path, columns)
    assert str(path) in str(caught.value)


# ------------------------------------------------------------------------ files


def test_klipper_file_is_read_and_begins_with_the_command(tmp_path: Path, rows: Array) -> None:
    recording = read(file(tmp_path, klipper_csv(rows)))
    assert recording.started
    np.testing.assert_allclose(recording.t, rows[:, 0], atol=5.1e-7)
    np.testing.assert_allclose(recording.a, rows[:, 1:], atol=5.1e-7)
    assert recording.period == pytest.approx(np.median(np.diff(rows[:, 0])), abs=1e-6)


@pytest.mark.parametrize("rate", [394.0, 1600.0, 3200.0])
def test_clipped_peaks_are_found_at_any_rate(tmp_path: Path, rate: float) -> None:
    """At 394 Hz a clipped peak at 50 Hz is two samples long."""
    t = np.arange(int(8.0 * rate)) / rate
    a = np.round(t * 1500.0 * np.sin(2.0 * np.pi * (40.0 + 2.0 * t) * t) / 38.0) * 38.0
    y, z = np.random.default_rng(0).normal(0.0, 60.0, (2, len(t)))
    rows = np.column_stack([t, a, y, z + GRAVITY])
    assert len(read(file(tmp_path, klipper_csv(rows))).t) == len(t)
    rows[:, 1] = np.clip(a, -9500.0, 9500.0)
    refused(
        file(tmp_path, klipper_csv(rows)), "the sensor's x is clipped at -?9500 mm/s².*ACCEL_PER_HZ"
    )


def test_klipper_file_by_its_columns_begins_anywhere(tmp_path: Path, rows: Array) -> None:
    columns = ("#time", "accel_x", "accel_y", "accel_z")
    assert not read(file(tmp_path, klipper_csv(rows)), columns).started


@pytest.mark.parametrize(
    ("scale", "delimiter", "end"),
    [(1.0, b",", b"\r\n"), (1e3, b";", b"\n"), (GRAVITY, b"\t", b"\r\n")],
    ids=["mm/s2", "m/s2", "g"],
)
def test_table_with_named_columns(
    tmp_path: Path, rows: Array, delimiter: bytes, end: bytes, scale: float
) -> None:
    head = b'\xef\xbb\xbf"az";note;t;ax; ay '.replace(b";", delimiter) + end
    body = [
        b";".join(b"%.17g" % v for v in (z / scale, 7.0, t, x / scale, y / scale))
        for t, x, y, z in rows.tolist()
    ]
    text = head + end.join(line.replace(b";", delimiter) for line in body) + end + end
    recording = read(file(tmp_path, text, "logged.txt"), COLUMNS)
    assert not recording.started
    np.testing.assert_allclose(recording.a, rows[:, 1:], rtol=1e-12)
    np.testing.assert_allclose(recording.t, rows[:, 0], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "empty"),
        (b" \n\n", "empty"),
        (NAMES, "0 samples are too few"),
        (NAMES.strip(), "0 samples are too few"),
        (NAMES + b"1,2,3,4\n" * 50, "50 samples are too few"),
        (b"t,x,y,z\n1,2,3,4\n", "1 samples are too few"),
        (b"G28\nG1 X1\n", "is not a Klipper accelerometer file.*--columns"),
        (b"freq,psd_x,psd_y,psd_z,psd_xyz,mzv\n1,2,3,4,5,6\n", "is a spectrum"),
        (b"\x00\xff\xfe" * 90, "is not a Klipper accelerometer file.*--columns"),
        (b"#time,accel_x,accel_y\n1,2,3\n", "is not a Klipper accelerometer file.*--columns"),
    ],
)
def test_text_without_a_recording_is_refused(tmp_path: Path, text: bytes, words: str) -> None:
    refused(file(tmp_path, text), words)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (b"1.0,2.0,x,4.0", "line 500: not a number: '1.0,2.0,x,4.0'"),
        (b"1.0,2.0,,4.0", "line 500: not a number"),
        (b"1.0,2.0", "line 500: too few columns"),
        (b"nan,2.0,3.0,4.0", "line 500: not a finite number"),
        (b"1235.0,2.0,inf,4.0", "line 500: not a finite number"),
        (b"1.0,2.0,3.0,4.0", "line 500: time does not increase"),
        (b"ACCELEROMETER \xff", "line 500: too few columns"),
    ],
)
def test_first_bad_line_is_named(tmp_path: Path, rows: Array, bad: bytes, words: str) -> None:
    lines = klipper_csv(rows).splitlines()
    lines[499] = bad
    lines[700] = b"this, too, is, bad" if b"2.0,x" in bad else lines[700]
    refused(file(tmp_path, b"\n".join(lines) + b"\n"), words)


def test_lines_are_counted_with_empty_ones(tmp_path: Path, rows: Array) -> None:
    lines = klipper_csv(rows).splitlines()
    lines[499] = lines[400]
    text = b"\n\n" + b"\n\n".join(lines)
    refused(file(tmp_path, text), "line 1001: time does not increase")


def test_file_that_is_cut_off(tmp_path: Path, rows: Array) -> None:
    text = klipper_csv(rows)
    cut = text[: text.rindex(b",") - 2]
    refused(file(tmp_path, cut), f"line {len(rows) + 1}: too few columns.*cut off")


def test_missing_samples_are_located(tmp_path: Path, rows: Array) -> None:
    lost = np.delete(rows, slice(1000, 1400), axis=0)
    refused(file(tmp_path, klipper_csv(lost)), "line 1002: samples are missing: 0.12.* s")
    often = rows[np.arange(len(rows)) % 50 > 2]
    refused(file(tmp_path, klipper_csv(often)), "samples are missing: 0.0012.* s .* 8 % .* in all")


def test_a_few_missing_samples_are_filled_and_reported(tmp_path: Path, rows: Array) -> None:
    some = np.delete(rows, [*range(1000, 1060), *range(3000, 3003)], axis=0)
    found = read(file(tmp_path, klipper_csv(some)))
    assert len(found.t) == len(rows)
    np.testing.assert_allclose(found.t, rows[:, 0], atol=2e-5)
    between = np.linspace(rows[999], rows[1060], 62)[1:-1, 1:]
    np.testing.assert_allclose(found.a[1000:1060], between, atol=1.0)
    (note,) = found.warnings()
    assert note.startswith("63 samples (")
    assert "the longest gap is 19" in note


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (("t", "x", "z", "w"), "there is no column w; the file has: t, x, y, z, y"),
        (("t", "x", "y", "z"), "y occurs twice"),
    ],
)
def test_wrong_columns(tmp_path: Path, columns: tuple[str, ...], words: str) -> None:
    refused(file(tmp_path, b"t,x,y,z,y\n1,2,3,4,5\n"), words, columns)


def test_timestamps_that_are_not_in_seconds_are_refused(tmp_path: Path, rows: Array) -> None:
    slow = rows.copy()
    slow[:, 0] = (rows[:, 0] - rows[0, 0]) * 1000.0
    refused(file(tmp_path, klipper_csv(slow)), "samples a second are too few.*in seconds")
    slow[:, 0] = rows[:, 0] + 1e12
    refused(file(tmp_path, klipper_csv(slow)), "timestamps are not in seconds")


@pytest.mark.parametrize("step", [SIXTEEN_BITS, THIRTEEN_BITS])
@pytest.mark.parametrize("column", [1, 2])
def test_clipping_is_refused(tmp_path: Path, step: float, column: int) -> None:
    swept = sweep(rate=60.0)
    recording = Chip(step=step, noise=3.0).on_nozzle(swept, swept)
    rows = np.column_stack([recording.t, recording.a])
    level = round(0.8 * np.abs(rows[:, column]).max() / step) * step
    rows[:, column] = np.clip(rows[:, column], -level, level)
    first = int(np.flatnonzero(np.abs(rows[:, column]) == level)[0])
    with pytest.raises(IdentificationError, match=f"sensor's {'xyz'[column - 1]} is clipped") as e:
        read(file(tmp_path, klipper_csv(rows)))
    line = int(str(e.value).split("line ")[1].split(":")[0])
    assert line >= first + 2  # that line, or the next at which it stays clipped


def test_the_end_of_a_range_is_clipping_and_a_greater_range_is_not(
    tmp_path: Path, rows: Array
) -> None:
    """A sensor of 32 g shows what one of 16 g would cut off."""
    full = rows.copy()
    full[1000:1020, 2] = -np.linspace(15.0, 20.0, 20) * GRAVITY
    assert len(read(file(tmp_path, klipper_csv(full))).t) == len(full)
    full[:, 2] = np.maximum(full[:, 2], -16.0 * GRAVITY)
    refused(file(tmp_path, klipper_csv(full)), "line 1006: .* y is clipped at -1569")


@pytest.mark.parametrize(
    ("step", "noise"),
    [(SIXTEEN_BITS, 0.0), (THIRTEEN_BITS, 0.3), (1e-3, 1.0), (THIRTEEN_BITS, 5.0)],
)
def test_peaks_in_coarse_steps_are_not_clipping(tmp_path: Path, step: float, noise: float) -> None:
    swept = sweep(rate=20.0)
    recording = Chip(step=step, noise=noise).on_nozzle(swept, swept)
    rows = np.column_stack([recording.t, recording.a])
    assert read(file(tmp_path, klipper_csv(rows))).started


# ------------------------------------------------------------------------- axes


def test_every_rotation_and_reflection_is_an_axes_map() -> None:
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.diag(signs)[:, np.argsort(order)]
            names = ("-" * (sign < 0.0) + "xyz"[k] for sign, k in zip(signs, order, strict=True))
            np.testing.assert_array_equal(axes_map(", ".join(names)), matrix)


@pytest.mark.parametrize(
    "text", ["", "x,y", "x,x,z", "x,y,w", "1,y,z", "xyz", "x,y,z,z", "--x,y,z", "x=x,y=y,z=z"]
)
def test_an_invalid_axes_map_is_refused(text: str) -> None:
    with pytest.raises(IdentificationError, match="invalid axes_map"):
        axes_map(text)


def resting() -> Recording:
    """Return 1 s of rest."""
    shown = np.tile(np.array([0.0, 0.0, GRAVITY]), (1000, 1))
    return Recording(np.arange(1000, dtype=np.float64) * 1e-3, shown, True)


@pytest.mark.parametrize(("scale", "shown"), [(1e-3, "0.0098"), (0.0, "0 m"), (1.3, "12.7")])
def test_implausible_gravity_is_a_warning(scale: float, shown: str) -> None:
    recording = resting()
    assert recording.warnings() == []
    wrong = Recording(recording.t, recording.a * scale, True)
    (text,) = wrong.warnings()
    assert shown in text
    assert "unit" in text


@pytest.mark.parametrize("factor", [8.0, 0.25])
def test_another_range_is_scaled_by_gravity(tmp_path: Path, rows: Array, factor: float) -> None:
    """Times 8, its values look clipped at 16 g."""
    wrong = rows * [1.0, factor, factor, factor]
    recording = read(file(tmp_path, klipper_csv(wrong)))
    np.testing.assert_allclose(recording.a, rows[:, 1:], atol=1e-4)
    (note,) = recording.warnings()
    assert "gravity reads" in note
    assert f"multiplied by {1.0 / factor:g}" in note
