"""The library: what ``import hframe_post`` offers, and that it is what the tool does."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hframe_post as hp
from hframe_post.arrays import TS, Array
from hframe_post.printer.settings import Printer
from tests.command_line import run
from tests.conftest import SAMPLES

RECTANGLE = SAMPLES / "rectangle.gcode"


def body(gcode: bytes) -> list[bytes]:
    """Lines without the stamp and the summary."""
    lines = gcode.splitlines()
    return [line for line in lines if not line.startswith((b"; processed", b"; hframe-post"))]


def stroke(start: tuple[float, float], by: tuple[float, float], n: int) -> Array:
    """A move from rest to rest, (n, 2)."""
    share = np.arange(n) / (n - 1)
    smooth = share - np.sin(2 * np.pi * share) / (2 * np.pi)
    moved: Array = np.asarray(start) + smooth[:, None] * np.asarray(by)
    return moved


def test_import_costs_nothing_until_a_name_is_used() -> None:
    program = (
        "import sys, hframe_post as hp; heavy = {'numpy', 'scipy', 'click', 'ruckig'};"
        "assert not heavy & set(sys.modules); assert set(hp.__all__) <= set(dir(hp));"
        "hp.TransferFunction; assert 'numpy' in sys.modules and 'ruckig' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("name", hp.__all__)
def test_every_name_offered_is_there_and_says_what_it_is(name: str) -> None:
    """A dataclass without a docstring gets its signature as one, which says nothing."""
    offered = getattr(hp, name)
    if name != "__version__":
        assert offered.__doc__, f"{name} has no docstring"
        assert not offered.__doc__.startswith(f"{name}("), f"{name} has only a generated docstring"


@pytest.mark.parametrize("name", ["paper", "example-corexy", "example-cartesian"])
@pytest.mark.parametrize("acceleration", [500.0, 10_000.0])
def test_strokes_get_as_much_rest_as_compensation_can_use(name: str, acceleration: float) -> None:
    """With a second of rest around it, a stroke begins and ends no more exactly."""
    profile = hp.load_printer(name)
    printer = replace(profile, limits=replace(profile.limits, acceleration=acceleration))
    up = np.arange(0.0, 60.0, acceleration * TS)  # mm/s
    s = TS * np.cumsum(np.concatenate([up, np.full(300, 60.0), up[::-1]]))
    xy = np.array([140.0, 100.0]) + s[:, None] * np.array([0.6, 0.8])
    rested = np.pad(xy, ((1000, 1000), (0, 0)), mode="edge")
    short, long = (
        hp.contour_error(hp.predict(hp.compensate(each, printer), printer), each)
        for each in (xy, rested)
    )
    for ends in (slice(0, 30), slice(-30, None)):
        worse = np.abs(short[ends]).max() - np.abs(long[1000:-1000][ends]).max()
        assert worse < 1e-3, f"{1e3 * worse:.2f} µm"


def test_contour_error_is_the_distance_to_the_path_and_rests_do_not_count() -> None:
    xy = stroke((0, 0), (30, 40), 200)
    aside = xy + 0.1 * np.array([-0.8, 0.6])
    late = np.concatenate([xy[:1], xy[:-1]])
    far = np.full((50, 2), 1e3)
    np.testing.assert_allclose(hp.contour_error(aside, xy), 0.1, atol=1e-9)
    np.testing.assert_allclose(hp.contour_error(late, xy), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        hp.contour_error(np.concatenate([far, aside, far]), xy), 0.1, atol=1e-9
    )


@pytest.mark.parametrize(
    "wrong", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[0.0, np.nan]], np.zeros((0, 2)), [[1], [2, 3]]]
)
def test_what_is_no_path_is_refused(paper: Printer, wrong: list[float]) -> None:
    with pytest.raises(hp.HframeError, match="xy must be"):
        hp.compensate(wrong, paper)
    with pytest.raises(hp.HframeError, match="command must be"):
        hp.predict(wrong, paper)


def test_mistakes_in_arguments_are_value_errors_of_the_tool(paper: Printer) -> None:
    off_at_rest = hp.TransferFunction(np.zeros(0, complex), np.array([0.5 + 0.0j]), 1.0)
    for mistake in (
        lambda: hp.TransferFunction(np.zeros(0, complex), np.array([1.2 + 0.0j]), 1.0),
        lambda: hp.Plant(off_at_rest, paper.plant.Gyy, None, 0.0),  # type: ignore[arg-type]
        lambda: hp.Window(L=5, n_C=10, n_up=20, effort=1.0),
        lambda: hp.Lpfbs(paper.plant.Gxx, hp.Window(L=20, n_C=11, n_up=5, effort=0.0)),
        lambda: hp.compensate("a path", paper),
        lambda: hp.Lpfbs(paper.plant.Gxx, paper.compensation.windows[0]).command(np.zeros((5, 2))),
        lambda: hp.Options(limits="non"),  # type: ignore[arg-type]
        lambda: hp.simulate([b"G1 X1\n"], paper, model_error=(5,)),
    ):
        with pytest.raises(hp.HframeError) as raised:
            mistake()
        assert isinstance(raised.value, ValueError)


def test_convert_does_all_that_the_command_line_can(paper: Printer, tmp_path: Path) -> None:
    out, page = tmp_path / "by_library.gcode", tmp_path / "page.html"
    read = list[int]()
    options = hp.Options(
        force=True, firmware="klipper", tolerance=None,
        predict=("none", "fbs", "racking"), jobs=2,
    )  # fmt: skip
    report = hp.convert(
        RECTANGLE, out, replace(paper, invented=True), options, page=page,
        title="A rectangle", notes=["printed on the big one"], progress=read.append,
    )  # fmt: skip
    by_tool = tmp_path / "by_tool.gcode"
    run(RECTANGLE, "-q", "--tolerance", "0", "-o", by_tool)
    by_both = [body(path.read_bytes()) for path in (out, by_tool)]
    assert by_both[0] == by_both[1]
    assert set(report.contour) == {"none", "fbs", "racking", "shaper"}  # which the page shows
    assert sum(read) == RECTANGLE.stat().st_size
    assert b"A rectangle" in page.read_bytes()
    assert b"printed on the big one" in page.read_bytes()


def test_convert_that_fails_leaves_the_target(paper: Printer, tmp_path: Path) -> None:
    target = tmp_path / "part.gcode"
    target.write_bytes(b"G1 X10 Y10 Z1 F6000\nG1 X1000\n")
    before = target.read_bytes()
    wrongs = {"strategy": "raking"}, {"predict": ("raking",)}, {"format": "rtf"}
    for wrong in ({}, *wrongs):
        with pytest.raises(hp.HframeError):
            hp.convert(target, target, paper, hp.Options(**wrong))
        assert target.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["part.gcode"]
