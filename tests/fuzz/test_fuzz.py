"""Any input is refused with a clean error that names its line, or it becomes the same print.

A few examples in every run, a hundred in ``make slow``; ``make fuzz`` and ``make guided`` seek
more.
"""

import gzip
import io
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import GcodeError, HframeError, LimitError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import KlipperSource
from hframe_post.firmware.marlin.m503 import MarlinSettings
from hframe_post.firmware.marlin.marlin_source import from_marlin
from hframe_post.printer.new_profile import Known, profile_text
from hframe_post.printer.profile import load, parse, shipped
from tests.conftest import SAMPLES
from tests.fuzz.strategies import LINES, broken, edited, gcode
from tests.gcode_tools import converted
from tests.klipper.host import KlippyError, play
from tests.printers import M503, REAL, profile_of
from tests.recordings import klipper_csv, read
from tests.same_print import PLACE, assert_same_print, unstamped

KLIPPER_FILAMENT = 5e-3  # mm; a step of the extruder is 0.7e-3
FOUND = sorted(Path(__file__).with_name("found").iterdir())
RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
PRINTERS = {"klipper": load("paper"), "marlin": load("paper-marlin")}
WITHOUT_LINE = (
    "empty", "not a single move", "binary", "not a text file", "UTF-16", "mm of filament",
)  # fmt: skip

EXAMPLES = int(os.environ.get("EXAMPLES", "12"))
few = settings(max_examples=EXAMPLES, derandomize="EXAMPLES" not in os.environ, database=None)
slow = pytest.mark.slow


def refused(error: HframeError) -> None:
    """Assert that an error is printable, names its line, and is not a bug's."""
    message = str(error)
    assert message.isprintable(), message
    assert len(message) < 6000, message
    if isinstance(error, GcodeError | LimitError):
        assert "line " in message or any(cause in message for cause in WITHOUT_LINE), message
    assert "would be lost" not in message, message
    assert "report this" not in message, message


def check_gcode(text: bytes, strategy: str, firmware: str, clamp: bool) -> bytes:
    """Convert a file; return the output, or nothing if it is refused."""
    lines = io.BytesIO(text).readlines()  # a carriage return alone does not end one
    options = Options(strategy, clamp=clamp, extrusion="absolute")
    try:
        output = converted(lines, PRINTERS[firmware], options)[0]
    except HframeError as error:
        refused(error)
        return b""
    assert_same_print(text, output, firmware)
    return output


cases = given(
    gcode(), st.sampled_from(("racking", "fbs", "none")), st.sampled_from(sorted(PRINTERS)),
    st.booleans(),
)  # fmt: skip


@few
@cases
def test_gcode(text: bytes, strategy: str, firmware: str, clamp: bool) -> None:
    check_gcode(text, strategy, firmware, clamp)


@few
@given(gcode())
def test_output_is_a_file_like_any_other(text: bytes) -> None:
    """Without its stamp it is converted again, or refused where nothing in it moves as planned."""
    output = check_gcode(text, "fbs", "klipper", True)
    if output:
        check_gcode(unstamped(output), "fbs", "klipper", True)


@few
@given(st.sampled_from(sorted(shipped().values())).flatmap(lambda text: edited(text.encode())))
def test_profiles(text: bytes) -> None:
    def use(path: Path) -> None:
        printer = replace(parse(path.read_text("latin-1"), "own"), name="own", invented=False)
        list(WholeFile(RECTANGLE[:40], printer, Options("fbs", clamp=True)).gcode())

    taken(text, "toml", use)


def _configured(path: Path) -> None:
    own, source = profile_of(KlipperConfig(path)), KlipperSource(path)
    for each in (own, load("paper")):
        list(source.findings(each, "change it", "write it"))


def _answered(path: Path) -> None:
    answer = MarlinSettings([path])
    travel = answer.travel() or {axis: Known((0.0, 220.0), "test") for axis in "xy"}
    profile_text(from_marlin(answer, travel), "own")
    answer.warnings()


def _recording() -> bytes:
    t, a = np.arange(0.0, 1.0, 1e-3), np.random.default_rng(0).normal(size=(1000, 3))
    return klipper_csv(np.column_stack([t, a]))


def taken(data: bytes, suffix: str, reader: Callable[[Path], object]) -> None:
    """Assert that a file is taken, or refused with a clean error."""
    with TemporaryDirectory() as folder:
        path = Path(folder, f"a.{suffix}")
        path.write_bytes(data)
        try:
            reader(path)
        except HframeError as error:
            refused(error)


RECORDING = _recording()
FILES: dict[str, tuple[st.SearchStrategy[bytes], str, Callable[[Path], object]]] = {
    "recording": (edited(RECORDING), "csv", read),
    "packed": (broken(gzip.compress(RECORDING, mtime=0)), "csv.gz", read),
    "cfg": (edited(REAL.read_bytes()), "cfg", _configured),
    "m503": (edited(M503.read_bytes()), "txt", _answered),
}


@few
@given(st.sampled_from(sorted(FILES)).flatmap(lambda n: st.tuples(st.just(n), FILES[n][0])))
def test_other_files(case: tuple[str, bytes]) -> None:
    _, suffix, reader = FILES[case[0]]
    taken(case[1], suffix, reader)


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_what_was_found_stays_mended(path: Path) -> None:
    for firmware in PRINTERS:
        for strategy in ("none", "racking"):
            check_gcode(path.read_bytes(), strategy, firmware, False)


@slow
@settings(few, max_examples=100)
@cases
def test_a_hundred(text: bytes, strategy: str, firmware: str, clamp: bool) -> None:
    check_gcode(text, strategy, firmware, clamp)


@slow
@pytest.mark.klipper
@settings(few, max_examples=20)
@given(gcode())
def test_klipper_plays_the_same_print(text: bytes) -> None:
    """Klipper ends at the same place with as much filament, if it plays the file at all."""
    text = b"M82\n" + text
    output = check_gcode(text, "racking", "klipper", True)
    if not output or b"G92 X" in text or b"G92\n" in text:
        return  # Klipper keeps to where it homed, and refuses moves past that edge
    with TemporaryDirectory() as folder:
        played = []
        for name, each in (("before", text), ("after", output)):
            path = Path(folder, name)
            path.mkdir()
            (path / "a.gcode").write_bytes(b"G28\n" + each)
            try:
                played.append(play(path / "a.gcode", workdir=path))
            except KlippyError:
                assert not played, "only the output is refused"
                return
    before, after = played
    ends = [each.position(each.end + 1.0)[0, :3] for each in played]
    assert ends[1] == pytest.approx(ends[0], abs=PLACE)
    fed = [float(each.extruded(each.end + 1.0)[0]) for each in (before, after)]
    assert fed[1] == pytest.approx(fed[0], abs=KLIPPER_FILAMENT)


def test_the_oracle_can_fail() -> None:
    text = b"G28\nM83\nG1 X10 Y10 Z0.2\nG1 X20 E0.5\n;LAYER:1\nG91\nUNHEARD_OF\nG90\n"
    assert_same_print(text, b"\n" + text, "klipper")
    changes = ((b"E0.5", b"E0.49"), (b";LAYER:1\n", b""), (b"G90\n", b""), (b"X20", b"X40"))
    for change in changes:
        if change[0] == b"X20":
            text = text.replace(b"UNHEARD_OF\n", b"")  # after which no place is known
        with pytest.raises(AssertionError):
            assert_same_print(text, b"\n" + text.replace(*change), "klipper")
    assert len(set(LINES)) == len(LINES)
