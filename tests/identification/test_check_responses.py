"""``hframe-post check`` and ``verify`` with profiles that hold impulse responses."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from datetime import date, datetime
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hframe_post.arrays import TS, Array, X
from hframe_post.cli.main import main
from hframe_post.errors import IdentificationError
from hframe_post.identification.checking.run import runs
from hframe_post.identification.recordings.accelerometer import Recording, oriented
from hframe_post.identification.verification import motion as verification
from hframe_post.identification.verification.drifted import drifted
from hframe_post.identification.verification.verdict import compare_runs
from hframe_post.model.impulse_response import Elsewhere, ImpulseResponse
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.identification.drifting import STEP, checked
from tests.profiles import with_plant
from tests.random_printers import drawn, printer, traced
from tests.recordings import write_klipper
from tests.simulator import Axis, Chip, Machine, Mode

MACHINE = Machine(
    Axis((Mode(44.5, 0.05, 0.7), Mode(52.0, 0.06, 0.2), Mode(80.0, 0.05, 0.1)), delay=0.0013),
    Axis((Mode(38.0, 0.08),), delay=0.0013),
    kinematics="corexy",
)
CHIP = Chip(gains=(1.03, 0.97, 1.0), rate_error=0.01)
HZ = np.arange(10.0, 100.0, 0.25)


def lagging(G: ImpulseResponse, lead: int, lag: float = 0.0, m: int = 440) -> ImpulseResponse:
    """Return the impulse response of G, its slow motion late by ``lag`` ms, by least squares."""
    hz = np.arange(2.0, 125.0, 0.25)
    omega = 2.0 * np.pi * TS * hz
    late = -float(np.angle(G.response(omega[:1]))[0] / omega[0])
    wanted = G.response(omega) * np.exp(1j * omega * (late - lag)) - 1.0
    wanted += lag * (1.0 - np.exp(-1j * omega))
    t = np.arange(-lead, m - lead)
    columns = -((2.0 * np.sin(omega / 2.0)) ** 2)[:, None] * np.exp(-1j * np.outer(omega, t))
    A, b = (np.concatenate([x.real, x.imag]) for x in (columns / hz[:, None], wanted / hz))
    decay = np.diag(1e-3 * 1.015 ** np.abs(t) / hz[-1])
    q = np.linalg.lstsq(np.vstack([A, decay]), np.concatenate([b, np.zeros(m)]), rcond=None)[0]
    return ImpulseResponse(q, lead, lag=lag)


@cache
def profile(lead: int = 32, lag: float = 0.0) -> Printer:
    exact = MACHINE.exact()
    Gxx, Gyy = (lagging(G, lead, lag) for G in (exact.Gxx, exact.Gyy))
    return replace(printer(MACHINE), plant=replace(exact, Gxx=Gxx, Gyy=Gyy))


def moved(hz: float, damping: float) -> Machine:
    """Return the machine with all frequencies and damping ratios of x times these factors."""
    modes = tuple(replace(m, hz=hz * m.hz, damping=damping * m.damping) for m in MACHINE.x.modes)
    return replace(MACHINE, x=replace(MACHINE.x, modes=modes))


def damped(machine: Machine) -> float:
    """Return by how many samples the damping of x makes the nozzle late at a constant speed."""
    return sum(2.0 * m.share * m.damping / (2.0 * np.pi * TS * m.hz) for m in machine.x.modes)


def off(found: ImpulseResponse, machine: Machine) -> float:
    """Return how far a response of x is from the machine's, of what deviates from the command."""
    true = lagging(machine.exact().Gxx, found.lead, found.lag)
    G, H = (one.response(2.0 * np.pi * TS * HZ) / HZ**2 for one in (found, true))
    return float(np.linalg.norm(G - H) / np.linalg.norm(H - 1.0 / HZ**2))


def measured(G: object) -> ImpulseResponse:
    assert isinstance(G, ImpulseResponse)
    return G


@pytest.mark.parametrize(
    ("lead", "noise", "lag"), [(0, 4.0, 0.0), (32, 4.0, 0.0), (32, 20.0, 0.0), (32, 4.0, 2.5)]
)
def test_a_response_follows_its_printer(lead: int, noise: float, lag: float) -> None:
    now, before_it = moved(0.97, 1.1), profile(lead, lag)
    found = checked(now, replace(CHIP, noise=noise), before_it, 3, axes=[X])["Gxx"]
    old, new = measured(before_it.plant.Gxx), measured(found.G)
    assert found.certain
    assert found.left[1] < 0.5 * found.left[0]
    assert off(old, now) > 0.3
    assert off(new, now) < 0.06
    assert (new.lead, len(new.deviation), new.dc_gain) == (old.lead, len(old.deviation), 1.0)
    # its damping makes it later, its delay stays
    assert new.lag == pytest.approx(lag + damped(now) - damped(MACHINE), abs=0.03)  # ms
    before, after = found.peak.hz
    assert after == pytest.approx(0.97 * before, abs=0.15)  # Hz
    assert found.peak.sd[0] < 0.15  # Hz


@pytest.mark.parametrize("seed", [0, 2])
def test_modes_that_move_by_themselves_are_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hz, damping = (1.0 + size * rng.uniform(-1.0, 1.0, 3) for size in (0.05, 0.3))
    modes = [
        replace(mode, hz=mode.hz * f, damping=mode.damping * z)
        for mode, f, z in zip(MACHINE.x.modes, hz.tolist(), damping.tolist(), strict=True)
    ]
    now = replace(MACHINE, x=replace(MACHINE.x, modes=tuple(modes)))
    found = checked(now, CHIP, profile(), seed, axes=[X])["Gxx"]
    assert found.certain
    assert found.modes[-1] == pytest.approx((80.0, modes[-1].hz), rel=0.02)
    assert off(measured(found.G), now) < min(0.08, 0.5 * off(measured(profile().plant.Gxx), now))


def test_a_response_that_changes_along_x_moves_everywhere() -> None:
    own = measured(profile().plant.Gxx)
    ends = tuple(Elsewhere(x, f, own.stretched(1.0 / f)) for x, f in ((40.0, 1.05), (240.0, 0.95)))
    along = replace(own, x=140.0, elsewhere=ends)
    before = replace(profile(), plant=replace(profile().plant, Gxx=along))
    found = checked(moved(0.97, 1.1), CHIP, before, 3, axes=[X])["Gxx"]
    assert found.certain
    assert off(replace(found.G, elsewhere=()), moved(0.97, 1.1)) < 0.06
    for place, one in zip(ends, found.G.elsewhere, strict=True):
        assert (one.x, one.frequency) == (place.x, place.frequency)
        assert off(one.G.stretched(one.frequency), moved(0.97, 1.0)) < 0.15  # by frequency only


@pytest.mark.parametrize("seed", range(3))
def test_an_unchanged_printer_is_reported_as_such(seed: int) -> None:
    chip = replace(CHIP, noise=8.0)
    found = checked(MACHINE, chip, profile(), seed, axes=[X])["Gxx"]
    assert not found.certain
    assert "stays at" in found.peak.as_text()


@pytest.mark.parametrize("seed", [2, 12])
def test_another_printer_is_refused(seed: int) -> None:
    machine, chip, _ = drawn(seed)
    with pytest.raises(IdentificationError, match="dentify again"):
        checked(machine, chip, profile(), seed)


@pytest.mark.parametrize("fault", [{"friction": 200.0}, {"play": 0.01}, {"third": 0.05}])
def test_the_printer_itself_is_never_refused(fault: dict[str, float]) -> None:
    machine = replace(MACHINE, x=replace(MACHINE.x, **fault))  # type: ignore[arg-type]
    found = checked(machine, CHIP, profile(), 9, axes=[X])["Gxx"]
    assert found.left[0] < 0.5


def test_the_sine_ends_where_the_axis_follows_no_more() -> None:
    def end_hz(run: Array) -> float:
        power = np.abs(np.fft.rfft(np.diff(run[:, X], 2))) ** 2
        hz = np.fft.rfftfreq(len(run) - 2, TS)
        return float(hz[np.searchsorted(np.cumsum(power), 0.98 * power.sum())])

    (run,) = runs(profile(), [X])
    assert 60.0 < end_hz(run.command) < 110.0  # Hz


# ---------------------------------------------------------------------- the command line


@pytest.mark.slow
def test_a_check_writes_the_new_response(tmp_path: Path) -> None:
    mine, summary = tmp_path / "my.toml", tmp_path / "check.json"
    windows = load("paper").compensation.windows
    mine.write_text(with_plant("example-corexy", profile().plant, windows, ["My printer"], 0.05,
                               None, date(2026, 6, 1)))  # fmt: skip
    check = ["check", "-p", str(mine)]
    done = CliRunner().invoke(main, [*check, "--gcode", str(tmp_path / "check.gcode")])
    assert done.exit_code == 0, done.output
    for k, axis in enumerate("xy"):
        rows = np.loadtxt(tmp_path / f"check.check-{axis}.csv", delimiter=",", skiprows=1)
        recording = CHIP.record(moved(0.97, 1.1), rows[:, 1:], k, STEP)
        path = write_klipper(tmp_path / f"adxl345-check-{axis}.csv", recording)
        at = datetime.fromisoformat("2026-07-01T12:00:00+00:00").timestamp()
        os.utime(path, (at, at))
    update = [*check, str(tmp_path), "-o", str(mine), "--json", str(summary)]
    before = load(str(mine)).plant
    done = CliRunner().invoke(main, update)
    assert done.exit_code == 0, done.output
    assert "the main resonance moved from 44.2 to 42.8 Hz (±0.1)" in done.output
    assert "nothing drifted, so the model stays" in done.output  # y
    resonance = json.loads(summary.read_text())["functions"]["Gxx"]["resonance"]
    assert resonance["hz"] == pytest.approx([44.2, 42.8], abs=0.15)
    after = load(str(mine))
    assert off(measured(after.plant.Gxx), moved(0.97, 1.1)) < 0.06
    assert (measured(after.plant.Gyy).deviation == measured(before.Gyy).deviation).all()
    assert after.measured == date(2026, 7, 1)
    done = CliRunner().invoke(main, update)
    assert done.output.count("nothing drifted") == 2, done.output


def verified(machine: Machine, printer: Printer) -> list[tuple[Array, Recording]]:
    """Return the plain and the compensated motion of a verification, and their recordings."""
    return [
        (run.command, oriented(CHIP.record(machine, run.command, 5 + k), quiet=0.5))
        for k, run in enumerate(verification.runs(printer))
    ]


@pytest.mark.parametrize("lead", [0, 32])
def test_verify_measures_the_reduction(lead: int) -> None:
    both = verified(MACHINE, profile(lead))
    found = compare_runs(profile(lead), *both)
    (plain, _), (compensated, _) = both
    true = 1.0 - traced(MACHINE, plain, compensated) / traced(MACHINE, plain, plain)
    assert found.fault is None
    assert found.reduction == pytest.approx(true, rel=0.1)
    assert true > 0.5


@pytest.mark.slow
def test_verify_finds_what_drifted() -> None:
    now = moved(0.97, 1.1)
    found = drifted(profile(), *verified(now, profile()))
    assert set(found) == {"Gxx"}
    assert off(measured(found["Gxx"].G), now) < 0.06
