"""`verify` measures the true reduction, and a wrong profile fails."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hframe_post.cli.main import main
from hframe_post.errors import HframeError
from hframe_post.identification.verify import Verdict, compare_runs, runs
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.coupled_printers import CoupledMachine, SharedMode
from tests.page.pages import data_of
from tests.profiles import with_plant, with_verification
from tests.random_printers import BEGUN, printer, recorded, traced
from tests.recordings import write_klipper
from tests.simulator import Axis, Chip, Machine, Mode, Playing

STRANGER = Machine(
    Axis((Mode(30.0, 0.05, 0.8), Mode(70.0, 0.05, 0.2)), delay=0.0013),
    Axis((Mode(38.0, 0.08),), delay=0.0013),
    racking=2e-8,
)
STIFF = replace(STRANGER, racking=0.0, kinematics="corexy")  # its gantry does not rack
CHIP = Chip(gains=(1.03, 0.97, 1.0))


def verdict(machine: Playing, profile: Printer, chip: Chip = CHIP) -> tuple[Verdict, float]:
    """Return the verdict and the true reduction."""
    both = runs(profile)
    found = compare_runs(profile, *recorded(machine, chip, both, 5))
    plain, compensated = (traced(machine, both[0].command, run.command) for run in both)
    return found, 1.0 - compensated / plain


@pytest.mark.parametrize(
    "changed", [{}, {"friction": 250.0}, {"play": 0.01}], ids=["linear", "friction", "play"]
)
def test_the_reduction_is_measured(changed: dict[str, float]) -> None:
    right = replace(printer(STRANGER), plant=STRANGER.exact())
    x, y = (replace(axis, **changed) for axis in (STRANGER.x, STRANGER.y))  # type: ignore[arg-type]
    found, true = verdict(replace(STRANGER, x=x, y=y), right)
    assert found.fault is None
    assert found.reduction == pytest.approx(true, rel=0.2)


@pytest.mark.parametrize(
    ("left", "good"), [(30.0, True), (50.0, True), (54.0, False), (60.0, False), (85.0, False)]
)
def test_a_profile_that_brings_far_less_than_predicted_fails(left: float, good: bool) -> None:
    """Of 100 µm, 80 are to go: less than 48 that go are a failure."""
    none = np.zeros(0)
    found = Verdict((100.0, left), (100.0, 20.0), 0.1, None, none, (none, none), (none, none))
    assert (found.fault is None) == good, f"{100.0 - left:g} of 80 µm removed: {found.fault}"
    if not good:
        assert f"removes {100.0 - left:.0f} % of the error, not the 80 %" in str(found.fault)


def test_little_reduction_and_much_that_is_not_explained_fail() -> None:
    """However right the model is about the reduction."""
    none = np.zeros(0)
    good = Verdict((100.0, 79.0), (100.0, 75.0), 0.3, None, none, (none, none), (none, none))
    assert good.fault is None
    assert "removes 19 % of the error" in str(replace(good, measured=(100.0, 81.0)).fault)
    assert "misses 36 %" in str(replace(good, unexplained=0.36).fault)


def test_a_delay_of_both_axes_does_no_harm() -> None:
    """A profile from TEST_RESONANCES has none, since nothing tells when its motion began."""
    x, y = (replace(axis, delay=0.0) for axis in (STRANGER.x, STRANGER.y))
    plant = replace(STRANGER, x=x, y=y).exact()
    found, true = verdict(STRANGER, replace(printer(STRANGER), plant=plant))
    assert found.fault is None
    assert found.reduction == pytest.approx(true, rel=0.05)


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_a_wrong_profile_fails(scale: float) -> None:
    def off(axis: Axis) -> Axis:
        return replace(axis, modes=tuple(replace(m, hz=scale * m.hz) for m in axis.modes))

    other = replace(STRANGER, x=off(STRANGER.x), y=off(STRANGER.y))
    found, _ = verdict(STRANGER, replace(printer(STRANGER), plant=other.exact()))
    assert found.fault is not None


def test_wrong_racking_fails() -> None:
    """Compensation still helps here, since ringing is so much larger than racking."""
    exact = STRANGER.exact()
    assert exact.Gxtheta is not None
    plant = replace(exact, x_c=exact.x_c + 60.0)
    found, true = verdict(STRANGER, replace(printer(STRANGER), plant=plant))
    assert true > 0.5
    assert found.fault is not None
    assert "racking, the other way" in found.fault


def test_a_coupling_that_is_no_more_fails() -> None:
    """On another day x moves y the other way, and its compensation makes that worse."""
    pair = [
        SharedMode(hz, 0.06, (1.0, 0.0), (0.0, size)) for hz, size in ((45.0, 0.2), (75.0, -0.2))
    ]
    modes = (
        SharedMode(45.0, 0.06, (1.0, 0.0), (1.0, 0.0)),
        SharedMode(33.0, 0.08, (0.0, 1.0), (0.0, 1.0)),
    )
    today = CoupledMachine((*modes, *pair))
    profile = replace(printer(STIFF), plant=today.exact())
    right, _ = verdict(today, profile)
    assert right.fault is None
    assert right.coupling is not None
    assert right.coupling[0] == pytest.approx(1.0, abs=0.1)
    assert right.coupling[1] < 0.05
    other = CoupledMachine((*modes, *(replace(one, moves=(0.0, -one.moves[1])) for one in pair)))
    wrong, _ = verdict(other, profile)
    assert wrong.coupling is not None
    assert wrong.coupling[0] == pytest.approx(-1.0, abs=0.1)
    assert "move each other, as by racking, the other way" in str(wrong.fault)
    assert "coupling / model" in wrong.as_text()


def test_another_printers_profile_fails() -> None:
    found, true = verdict(STRANGER, printer(STRANGER))
    assert true < 0.0
    assert found.fault is not None


# ---------------------------------------------------------------------- the command line


def invoked(*arguments: str | Path) -> Result:
    words = [*map(str, arguments)]
    if "--gcode" in words:
        words[words.index("--gcode")] = "-o"
        return CliRunner().invoke(main, ["measure", "--for", "verify", *words])
    return CliRunner().invoke(main, ["check", *words])


def record(held: Path, machine: Machine) -> list[Path]:
    """Write what Klipper records, by a sensor that is turned and mirrored."""
    files = []
    for k, name in enumerate(("plain", "compensated")):
        rows = np.loadtxt(held / f"v.verify-{name}.csv", delimiter=",", skiprows=1)
        made = CHIP.record(machine, rows[:, 1:], k)
        ended = round(1e6 * (BEGUN + rows[-1, 0]))
        path = held / f"adxl345-verify-{name}-t{ended}.csv"
        files.append(write_klipper(path, replace(made, a=made.a[:, [1, 0, 2]] * [1.0, -1.0, 1.0])))
    return files


def test_a_good_profile_is_marked(tmp_path: Path) -> None:
    mine, marked, held = tmp_path / "mine.toml", tmp_path / "marked.toml", tmp_path / "held"
    held.mkdir()
    windows = load("paper").compensation.windows
    mine.write_text(with_plant("paper", STRANGER.exact(), windows, []))
    done = invoked("-p", mine, "--gcode", held / "v.gcode")
    assert done.exit_code == 0, done.output
    assert f"  hframe-post check -p {mine} {held}/*verify-plain*.csv " in done.output
    files, report = record(held, STRANGER), tmp_path / "report.html"
    done = invoked("-p", mine, held, "-o", marked, "--report", report)
    assert done.exit_code == 0, done.output
    assert data_of(report)["cards"][0]["kind"] == "best"
    plain, compensated = data_of(report)["sections"][0]["charts"][0]["lines"]
    assert max(plain["y"]) > 2.0 * max(compensated["y"]) > 0.0
    assert "VERDICT     good" in done.output
    mark = load(str(marked)).verified
    assert mark is not None
    assert 0.5 < mark.reduction <= 1.0
    assert mark.firmware == "klipper"
    done = invoked("-p", "paper", held, "-o", tmp_path / "wrong.toml", "--report", report)
    assert done.exit_code == 1
    assert data_of(report)["cards"][0]["kind"] == "bad"
    assert not (tmp_path / "wrong.toml").exists()
    files[1].unlink()
    done = invoked("-p", mine, held)
    assert done.exit_code == 1
    assert "not both recordings of 'hframe-post measure --for verify'" in done.output


def test_motions_that_cannot_be_a_test_are_errors() -> None:
    paper = load("paper")
    weak = replace(paper, motors=replace(paper.motors, belt_velocity=100.0))
    with pytest.raises(HframeError, match=r"even with 0.35 of limits.acceleration"):
        runs(weak)


def test_a_mark_holds_for_its_model_alone(tmp_path: Path) -> None:
    (tmp_path / "plain.toml").write_text('extends = "paper"\n')
    text = with_verification(str(tmp_path / "plain.toml"), "2026-01-02", 0.9)
    (tmp_path / "mine.toml").write_text(text)
    mine = load(str(tmp_path / "mine.toml"))
    assert mine.verified is not None
    unmarked = text.partition("[verified]")[0]
    (tmp_path / "plain.toml").write_text(unmarked)
    assert mine.digest == load(str(tmp_path / "plain.toml")).digest
    (tmp_path / "other.toml").write_text(text.replace("n_up = 44", "n_up = 43"))
    assert load(str(tmp_path / "other.toml")).verified is None


def test_usage(tmp_path: Path) -> None:
    assert invoked("-p", "missing", "--gcode", tmp_path / "v.gcode").exit_code == 1
