"""Steps and samples from end to end: the pipeline's bytes, golden files, the command line."""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.files import Target, convert, with_format
from hframe_post.conversion.options import Kind, Options
from hframe_post.conversion.tables import SampleConversion, StepConversion
from hframe_post.errors import LimitError, PrinterError
from hframe_post.gcode import batching
from hframe_post.planner import sampling
from hframe_post.printer.profile import load, parse, shipped
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__
from hframe_post.writers import steps
from hframe_post.writers.files import Outputs
from hframe_post.writers.samples import COLUMNS, as_csv
from hframe_post.writers.step_file import MOTORS, inlined
from tests.command_line import run
from tests.conftest import SAMPLES, few
from tests.step_tools import read_steps

RECTANGLE = SAMPLES / "rectangle.gcode"
TURN = [
    b"M107\n", b"G28\n", b"G1 X100 Y100 Z1 F6000\n", b";TYPE:WALL\n", b"G1 X102 E0.1\n",
    b"M106 S128\n", b"G1 X103 Y101 E0.2\n", b"G4 P5\n", b"G1 Z1.2 F900\n", b"G1 X100 F6000\n",
]  # fmt: skip


def cube(last: int) -> list[bytes]:
    lines = (SAMPLES / "cube.gcode").read_bytes().splitlines(keepends=True)
    return lines[: lines.index(b";LAYER:%d\n" % last)]


def converted(lines: list[bytes], printer: Printer, kind: Kind, strategy: str = "racking") -> bytes:
    """The file of a format; events of step files are inline."""
    options = Options(strategy, clamp=False, format=kind)
    if kind == "samples":
        return b"".join(as_csv(SampleConversion(iter(lines), printer, options)))
    return b"".join(inlined(StepConversion(iter(lines), printer, options)))


FORMATS = ["steps", "samples"]


@pytest.mark.parametrize("kind", few(FORMATS, 1))
def test_output_does_not_depend_on_how_the_stream_is_cut(
    paper: Printer, monkeypatch: pytest.MonkeyPatch, kind: Kind
) -> None:
    for lines, cuts in (
        (TURN, [(1, 1), (7, 7), (100, 100), (10_000, 10_000)]),
        (cube(1), [(1, 100), (7, 10_000), (10_000, 1000)]),
    ):
        whole = converted(lines, paper, kind)
        for moves, samples in cuts:
            with monkeypatch.context() as patch:
                patch.setattr(batching, "MOVES_PER_ITEM", moves)
                patch.setattr(sampling, "SAMPLES_PER_CHUNK", samples)
                patch.setattr(steps, "SAMPLES_AT_ONCE", samples)
                assert converted(lines, paper, kind) == whole


def test_events_stand_in_order_of_time_among_the_steps(paper: Printer) -> None:
    lines = converted([*TURN, b"M600\n", *TURN[2:]], paper, "steps").splitlines()
    timed = [re.match(rb"(?:#\w+,)?(\d+),", line) for line in lines[10:]]
    ticks = [int(match[1]) for match in timed if match]
    assert len(ticks) == len(lines) - 10
    assert ticks == sorted(ticks)
    starts = [k for k, line in enumerate(lines) if line.startswith(b"#start")]
    yields = [k for k, line in enumerate(lines) if b",yielded," in line]
    assert len(starts) == 2
    assert yields[-1] < starts[-1]
    assert lines[yields[0]].endswith(b"G28")


@pytest.mark.parametrize("kind", FORMATS)
def test_same_input_gives_same_bytes(paper: Printer, kind: Kind) -> None:
    assert converted(cube(1), paper, kind) == converted(cube(1), paper, kind)


# ---------------------------------------------------------------------- golden files

COARSE = 'extends = "paper"\n[steps]\nbelt = 0.25\nz = 0.05\ne = 0.02\n'


@pytest.mark.parametrize("kind", FORMATS)
def test_golden(kind: Kind, golden: Callable[[str, bytes], bytes]) -> None:
    now = converted(TURN, parse(COARSE, "coarse"), kind, "none")
    assert_same(kind, now, golden(f"turn.{kind}.csv", now))


@pytest.mark.parametrize("kind", FORMATS)
def test_golden_comparison_can_fail(kind: Kind) -> None:
    now = converted(TURN, parse(COARSE, "coarse"), kind, "none")
    lines = now.splitlines()
    row = max(k for k, line in enumerate(lines) if line[:1].isdigit())
    for wrong in ([b"7" + lines[row]], [lines[row].replace(b",", b"1,", 1)], [], [lines[row]] * 2):
        with pytest.raises(AssertionError):
            assert_same(kind, b"\n".join(lines[:row] + wrong + lines[row + 1 :]), now)


def assert_same(kind: Kind, now: bytes, then: bytes) -> None:
    """Equal but for the version, a tick, or a millionth of a mm: other machines round."""
    then = re.sub(rb"^#version,.*$", b"#version,%b" % __version__.encode(), then, flags=re.M)
    rows = now.splitlines(), then.splitlines()
    assert len(rows[0]) == len(rows[1])
    for a, b in zip(*rows, strict=True):
        numbers = a.split(b","), b.split(b",")
        if not (a[:1].isdigit() and b[:1].isdigit()):
            assert a == b
        elif kind == "samples":
            first, second = ([float(number) for number in row] for row in numbers)
            np.testing.assert_allclose(first, second, rtol=0.0, atol=1.1e-6)
        else:
            assert abs(int(numbers[0][0]) - int(numbers[1][0])) <= 1
            assert numbers[0][1:] == numbers[1][1:]


# ---------------------------------------------------------------------- what it says


def test_report_counts_what_is_in_the_file(paper: Printer) -> None:
    pieces = StepConversion(iter(cube(1)), paper, Options("racking"))
    rows = b"".join(piece for piece in pieces if isinstance(piece, bytes)).splitlines()
    report = pieces.report()
    steps = [row.split(b",") for row in rows if row[:1].isdigit()]
    assert report.steps is not None
    assert report.lines_written == len(rows)
    assert report.steps.rows == len(steps)
    for motor in MOTORS:
        count = sum(row[1] == motor.encode() for row in steps)
        assert report.steps.motors[motor] == count
    assert report.steps.ticks == round(report.time.after * report.steps.clock_hz)
    assert "steps " in report.as_text()
    assert report.as_json()["steps"]["motors"] == report.steps.motors
    assert report.filament_after == pytest.approx(report.read.filament, abs=0.0025)


@pytest.mark.parametrize(("percent", "warned"), [(0.49, False), (0.51, True), (32.9, True)])
def test_extrusion_that_is_not_compensated_is_a_warning_from_half_a_percent_on(
    paper: Printer, percent: float, warned: bool
) -> None:
    lines = [
        b"M83\n", b"G1 X100 Y100 Z0.2 F6000\n", b"G1 X150 E%.3f F3000\n" % (100.0 - percent),
        b"A_MACRO\n", b"G1 X160 E%.3f\n" % percent,
    ]  # fmt: skip
    conversion = GcodeConversion(lines, paper, Options("racking"))
    assert sum(isinstance(piece, bytes) for piece in conversion)
    report = conversion.report()
    found = report.as_json()["uncompensated"]["extrusion_percent"]
    assert found == pytest.approx(percent), f"{found} % of the extrusion instead of {percent} %"
    about = f"{percent:.1f} % of the extrusion is not compensated, mostly after A_MACRO"
    assert any(text.startswith(about) for text in report.warnings()) == warned, report.warnings()


def test_last_position_is_that_of_the_file(paper: Printer) -> None:
    _, xyze = read_steps(converted(TURN, paper, "steps"), paper)
    half = [0.0206 / 2, 0.0206 / 2, 0.0025 / 2, 0.0024 / 2]
    assert np.abs(xyze[-1] - [100.0, 101.0, 1.2, 0.2]) == pytest.approx(0.0, abs=max(half))
    assert (np.abs(xyze[-1] - [100.0, 101.0, 1.2, 0.2]) <= half).all()


def test_profile_without_steps_has_all_other_formats() -> None:
    text = re.sub(r"\[steps\].*?(?=\[compensation\])", "", PAPER_TEXT, flags=re.DOTALL)
    printer = parse(text, "mine")
    assert converted(TURN, printer, "samples")
    with pytest.raises(PrinterError, match="mine: steps: the table is missing"):
        converted(TURN, printer, "steps")


PAPER_TEXT = shipped()["paper"]


def test_clock_that_is_too_slow_names_the_line_of_the_file() -> None:
    slow = parse('extends = "paper"\n[steps]\nclock_hz = 4000\n', "slow")
    with pytest.raises(LimitError, match=r"line 5: speed of motor [AB]"):
        converted(TURN, slow, "steps", "none")


@pytest.mark.parametrize("name", ["example-corexy", "example-cartesian"])
def test_examples_step(name: str) -> None:
    _, xyze = read_steps(converted(cube(1), load(name), "steps"), load(name))
    samples = list(SampleConversion(iter(cube(1)), load(name), Options("racking")))
    end = samples[-1][-1]
    at = [end[COLUMNS.index(c)] for c in ("x_dm", "y_dm", "z", "e")]
    assert np.abs(xyze[-1] - at).max() <= 0.0125


# ---------------------------------------------------------------------- the command line


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_suffix_chooses_the_format(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv.gz", "d.npz", "f.gcode"):
        assert run(RECTANGLE, "-q", "-o", tmp_path / name).returncode == 0
    assert run(RECTANGLE, "-q", "-o", tmp_path / "g.csv", "--format", "samples").returncode == 0
    found = files(tmp_path)
    assert found["a.csv"].startswith(b"#hframe-post steps,1\n")
    assert gzip.decompress(found["b.csv.gz"]) == found["a.csv"]
    assert found["a.csv.events"] == found["b.csv.gz.events"]
    assert found["a.csv.events"].endswith(b",end,\n")
    assert len(np.load(tmp_path / "d.npz")["t"]) == found["g.csv"].count(b"\n") - 1
    assert b"; processed by" in found["f.gcode"]
    assert found["g.csv"].startswith(b"t,x_d,y_d")
    assert len(found) == 5 + 2  # with the events of two


def test_standard_output_has_the_events_among_the_steps(tmp_path: Path) -> None:
    out = tmp_path / "a.csv"
    run(RECTANGLE, "-q", "-o", out)
    done = run("-", "-q", "--format", "steps", stdin=RECTANGLE.read_bytes())
    inline = [line for line in done.stdout.splitlines(True) if line.startswith(b"#event,")]
    rest = [line for line in done.stdout.splitlines(True) if not line.startswith(b"#event,")]
    assert b"".join(rest) == out.read_bytes()
    events = (tmp_path / "a.csv.events").read_bytes().splitlines(True)[2:]
    assert [line.removeprefix(b"#event,") for line in inline] == events
    table = run("-", "-q", "--format", "samples", "-o", "-", stdin=RECTANGLE.read_bytes())
    assert table.stdout.startswith(b"t,x_d,y_d")


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.npz"])
def test_failure_leaves_every_file_as_it_was(tmp_path: Path, name: str) -> None:
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE.read_bytes() + b"G1 X150 Y100\nG55\n")
    (tmp_path / name).write_bytes(b"old")
    (tmp_path / f"{name}.events").write_bytes(b"old events")
    before = files(tmp_path)
    done = run(part, "-o", tmp_path / name)
    assert done.returncode == 1
    assert b"G55" in done.stderr
    assert files(tmp_path) == before


@pytest.mark.parametrize("name", ["out.gcode", "out.csv"])
def test_a_conversion_to_the_same_target_replaces_what_an_earlier_one_wrote(
    tmp_path: Path, paper: Printer, name: str
) -> None:
    options = with_format(Options("racking", force=True), paper, tmp_path / name, None)
    for folder, sources in (("once", [TURN]), ("again", [cube(1), TURN])):
        (tmp_path / folder).mkdir()
        out = tmp_path / folder / name
        with Outputs() as outputs:
            target = Target(outputs, out)
            for lines in sources:
                convert(lines, target, paper, options.resolved(paper))
    for file in sorted((tmp_path / "once").iterdir()):
        assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes()


def test_dry_run_tells_of_every_format_and_writes_nothing(tmp_path: Path) -> None:
    part = tmp_path / "part.gcode"
    part.write_bytes(RECTANGLE.read_bytes())
    for kind in FORMATS:
        done = run(part, "-n", "-q", "--format", kind, "--json", "-")
        summary = json.loads(done.stdout)
        assert ("steps" in summary) == (kind != "samples")
        assert summary["lines_written"] > 1000
    assert b"A 1" in run(part, "-n", "--format", "steps").stderr
    assert files(tmp_path) == {"part.gcode": RECTANGLE.read_bytes()}


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["--format", "steps"], b"name an output file with -o"),
        (["--format", "samples"], b"name an output file with -o"),
        (["-o", "a.npz", "--format", "steps"], b"holds samples"),
        (["-o", "a.npz", "--format", "gcode"], b"holds samples"),
        (["-o", "a.npz.gz"], b".npz is compressed already: leave out .gz"),
        (
            ["-o", "a.gcode.gz"],
            b"a.gcode.gz: gcode is not written compressed, because printers cannot read",
        ),
        (["-o", "a.csv", "--tolerance", "0"], b"for G-code"),
        (["-o", "a.csv", "--tolerance", "0.001"], b"for G-code"),
        (["-o", "a.csv", "--format", "pulses"], b"pulses"),
    ],
)
def test_formats_that_make_no_sense_are_wrong_usage(arguments: list[str], cause: bytes) -> None:
    done = run(RECTANGLE, *arguments)
    assert done.returncode == 2
    assert cause in done.stderr
