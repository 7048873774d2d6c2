"""A bed that gets heavier by the print: y's model follows it, and nothing jumps."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import linalg

from examples.paper.tables import transfer_functions
from hframe_post.arrays import TS, Array, E, Y
from hframe_post.conversion import spans
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.model.plant import Bed
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from tests.paths import in_motion
from tests.plants import Filter
from tests.quantities import below

FBS = Options("fbs", limits="printer")
HZ, DAMPING, LAG = 30.0, 0.08, 1e-3  # of y in example-cartesian


WAY = [(100, 100), (160, 100), (160, 140), (100, 140), (100, 100), (160, 140), (130, 100),
       (100, 140), (110, 140), (110, 130), (120, 130), (120, 120), (100, 100)]  # fmt: skip
LAPS = 14
PER_MM = 0.033  # mm of filament
LAP = PER_MM * sum(math.dist(a, b) for a, b in pairwise(WAY))


def laps() -> list[bytes]:
    """Return lines of a rectangle with strokes of infill, again and again, a lift after each."""
    lines = [b"G28\n", b"M83\n", b"G1 Z0.2 F600\n", b"G0 X100 Y100 F9000\n"]
    for lap in range(LAPS):
        for at, to in pairwise(WAY):
            lines.append(b"G1 X%d Y%d E%.5f F6000\n" % (*to, PER_MM * math.dist(at, to)))
        lines += [b"G1 E-1 F2400\n", b"G1 Z%.1f F600\n" % (0.3 + 0.1 * (lap % 2)), b"G1 E1 F2400\n"]
    return lines


@pytest.fixture
def fixed() -> Printer:
    return load("example-cartesian")


@pytest.fixture
def slinger(fixed: Printer, monkeypatch: pytest.MonkeyPatch) -> Printer:
    """Return a printer whose bed of 1 kg gets heavier by 0.3 kg, a little at each of many spans."""
    monkeypatch.setattr(spans, "SPAN_S", 4.0)
    return replace(fixed, plant=replace(fixed.plant, bed=Bed(1.0, 0.3 / (LAPS * LAP))))


def bed(M: float) -> tuple[Array, Array]:
    """Return the step of M·ÿ + c·ẏ + k·(y − w) = 0 behind a lag, for a held command.

    k and c are those of a mode of HZ and DAMPING with 1 kg.
    """
    w, whole = 2.0 * math.pi * HZ, np.zeros((4, 4))
    whole[0, [0, 3]] = -1.0 / LAG, 1.0 / LAG
    whole[1, 2] = 1.0
    whole[2, :3] = w * w / M, -w * w / M, -2.0 * DAMPING * w / M
    step = linalg.expm(TS * whole)
    return step[:3, :3], step[:3, 3]


class Truth:
    """The bed itself, its mass that of each moment, its state the same when that changes."""

    def __init__(self, origin: float, filament: float) -> None:
        self._origin, self._filament, self._state = origin, filament, np.zeros(3)

    def run(self, command: Array, e: Array) -> Array:
        y = np.empty(len(command))
        A, held = bed(1.0)
        for k, u in enumerate((command - self._origin).tolist()):
            if k % 200 == 0:
                A, held = bed(1.0 + self._filament * float(e[k]))
            y[k] = self._state[1]
            self._state = A @ self._state + held * u
        return y + self._origin


def wandering(n: int) -> Array:
    """Return a command that accelerates at random, by some 1000 mm/s²."""
    return np.cumsum(np.cumsum(np.random.default_rng(0).normal(0.0, 5e-4, n)))


@pytest.mark.parametrize("factor", [1.0, 1.1, 1.3, 2.0])
def test_a_heavier_mode_is_that_of_a_heavier_bed(fixed: Printer, factor: float) -> None:
    u, G = wandering(3000), fixed.plant.Gyy.heavier(factor)
    off = Filter(G).run(u) - Truth(0.0, 1.0).run(u, np.full(len(u), factor - 1.0))
    assert np.ptp(u) > 50.0
    below(np.abs(off).max(), 0.0002, "greatest difference of the nozzle, mm")


def test_lags_and_delays_stay() -> None:
    """So does the lag at low speed, which does not depend on the mass."""
    delayed = TransferFunction(np.zeros(0, complex), np.array([0.0, 0.5], complex), 0.5)
    for G in (transfer_functions()["Gyy"], delayed):
        new, real = G.heavier(1.3), G.poles.imag == 0.0
        np.testing.assert_array_equal(new.poles[real], G.poles[real])
        assert new.lag == pytest.approx(G.lag, rel=0.01)


def errors(printer: Printer, filament: float) -> tuple[float, float]:
    """Return the RMS contour error, mm, on the bed itself: of the first and of the last quarter."""
    chunks = [c for c in WholeFile(iter(laps()), printer, FBS).samples() if len(c)]
    xyze, command = (
        np.concatenate(parts)
        for parts in ([c.xyze for c in chunks], [c.commands["fbs"] for c in chunks])
    )
    y = Truth(xyze[0, Y], filament).run(command[:, Y], xyze[:, E])
    nozzle = np.column_stack([xyze[:, 0], y])  # x as it is to be
    _, extruding = in_motion(xyze)
    at = np.flatnonzero(extruding)
    off = contour_error(xyze, nozzle, at)
    quarter = len(at) // 4
    first, last = (
        np.sqrt(np.square(off[:quarter]).mean()),
        np.sqrt(np.square(off[-quarter:]).mean()),
    )
    return float(first), float(last)


def test_the_last_layers_are_as_good_as_the_first(slinger: Printer, fixed: Printer) -> None:
    """The mass grows a hundred times as fast as in a real print, hence the second factor."""
    assert slinger.plant.bed is not None
    filament = slinger.plant.bed.filament
    exact, _ = errors(fixed, 0.0)
    first, last = errors(slinger, filament)
    assert last < 1.3 * first < 2.5 * exact
    assert errors(fixed, filament)[1] > 7.0 * last  # what the first layer's model leaves


def test_commands_stand_still_where_the_model_changes(slinger: Printer) -> None:
    last, ended, changes = None, False, 0
    for chunk in WholeFile(iter(laps()), slinger, FBS).samples():
        if len(chunk):
            command = chunk.commands["fbs"]
            if ended and last is not None:
                assert np.abs(command[:28] - last).max() < 1e-9
                changes += 1
            last, ended = command[-1], False
        ended |= chunk.ends_stretch
    assert changes >= LAPS - 1
