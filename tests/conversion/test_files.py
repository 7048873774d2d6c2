"""Steps and samples from end to end: the pipeline's bytes, the command line."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from hframe_post.conversion.options import Kind, Options
from hframe_post.conversion.whole_file import Target, WholeFile, convert, with_format
from hframe_post.gcode import batching
from hframe_post.planner import sampling
from hframe_post.printer.settings import Printer
from hframe_post.writers import steps
from hframe_post.writers.outputs import Outputs
from hframe_post.writers.tables import MOTORS, as_csv, inlined
from tests.command_line import run
from tests.conftest import SAMPLES, few
from tests.gcode_tools import layers

RECTANGLE = SAMPLES / "rectangle.gcode"
TURN = [
    b"M107\n", b"G28\n", b"G1 X100 Y100 Z1 F6000\n", b";TYPE:WALL\n", b"G1 X102 E0.1\n",
    b"M106 S128\n", b"G1 X103 Y101 E0.2\n", b"G4 P5\n", b"G1 Z1.2 F900\n", b"G1 X100 F6000\n",
]  # fmt: skip


def converted(lines: list[bytes], printer: Printer, kind: Kind, strategy: str = "racking") -> bytes:
    """The file of a format; events of step files are inline."""
    options = Options(strategy, clamp=False, format=kind)
    whole = WholeFile(iter(lines), printer, options)
    if kind == "samples":
        return b"".join(as_csv(whole.rows()))
    return b"".join(inlined(whole.steps()))


FORMATS = ["steps", "samples"]


@pytest.mark.parametrize("kind", few(FORMATS, 1))
def test_cuts_change_no_byte(paper: Printer, monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    for lines, cuts in ((TURN, [(1, 7), (100, 100)]), (layers("cube.gcode", 1), [(7, 1000)])):
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


def test_report_counts_what_is_in_the_file(paper: Printer) -> None:
    whole = WholeFile(iter(layers("cube.gcode", 1)), paper, Options("racking"))
    rows = b"".join(piece for piece in whole.steps() if isinstance(piece, bytes)).splitlines()
    report = whole.report
    steps = [row.split(b",") for row in rows if row[:1].isdigit()]
    assert report.steps is not None
    assert report.written.lines == len(rows)
    assert report.steps.rows == len(steps)
    for motor in MOTORS:
        count = sum(row[1] == motor.encode() for row in steps)
        assert report.steps.motors[motor] == count
    assert report.steps.ticks == round(report.duration * report.steps.clock_hz)
    assert "steps " in report.as_text()
    assert report.as_json()["steps"]["motors"] == report.steps.motors
    assert report.filament_after == pytest.approx(report.read.filament, abs=0.0025)


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


def test_a_conversion_replaces_what_an_earlier_one_wrote(tmp_path: Path, paper: Printer) -> None:
    options = with_format(Options("racking", force=True), paper, tmp_path / "out.csv", None)
    for folder, sources in (("once", [TURN]), ("again", [layers("cube.gcode", 1), TURN])):
        (tmp_path / folder).mkdir()
        out = tmp_path / folder / "out.csv"
        with Outputs() as outputs:
            target = Target(outputs, out)
            for lines in sources:
                convert(lines, target, paper, options.resolved(paper))
    for file in sorted((tmp_path / "once").iterdir()):
        assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes()


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
