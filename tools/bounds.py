"""Write docs/bounds.csv: what each bound of an identification is, and what halving it changes.

make bounds

rectangle: RMS contour error that the response of a published CoreXY leaves 18 days later, and the
later one on the first day, where they change: 120 × 20 mm at 10 000 mm/s². response: change of a
response at most, as a print weighs it (a share of G − 1): of a published test of resonances, and of
simulated recordings: a test whose time stamps wander, a Marlin printer with a sharp mode, an H-bot
with friction at three places, strokes with friction, a check after drift, and recordings that are
refused. refused: one that is taken is not. other words: the report says something else, or a
figure in it.
"""

from __future__ import annotations

import ast
import csv
import importlib
import inspect
import lzma
import multiprocessing
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import date
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from hframe_post.arrays import TS, Array, Complex, X
from hframe_post.errors import HframeError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.check import CheckReport, drifts
from hframe_post.identification.check import runs as check_runs
from hframe_post.identification.estimation.measured import MeasurementSettings
from hframe_post.identification.gather import Gathered, gather
from hframe_post.identification.identify import Run, identify
from hframe_post.identification.recordings.accelerometer import Recording, repaired
from hframe_post.identification.recordings.resonance_search import find
from hframe_post.identification.recordings.strokes import runs
from hframe_post.identification.recordings.written_sweep import played
from hframe_post.identification.report import IdentificationReport
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.printer.settings import Travel
from tests.identification import test_unknown_start as published
from tests.identification.test_written_sweep import at, motion
from tests.printers import ender
from tests.random_printers import BAND, drawn, printer, recorded
from tests.recordings import SV08_CONFIG
from tests.resonance_recordings import SENSORS, drawn_sensor, klipper, wandering
from tests.resonance_recordings import recorded as recorded_test
from tests.simulator import Axis, Chip, Machine, Mode

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "hframe_post.identification"
SV08 = ROOT / "tests/identification/data/raw_data_y_20250601_120000.csv.xz"
HZ = np.arange(5.0, 100.0, 0.25)
TEST = klipper(min_freq=8.0, max_freq=105.0, hz_per_sec=2.0)
HEAD = ("module", "bound", "value", "unit and source", "halved: rectangle, µm", "halved: response",
        "doubled: rectangle, µm", "doubled: response")  # fmt: skip
# value of the one of 15 published recordings that is nearest to the bound
NEAREST = {
    "UNEXPLAINED": "0.30", "CLOCK_DRIFT": "0.016", "GAIN_ERROR_TEST": "0.15",
    "TEST_GROWTH": "−0.04", "TEST_PEAK": "3.5", "GAIN_ERROR_STROKES": "0.05", "SPREAD": "0.3",
    "SHOWN": "0.86", "LAG_S": "0.003", "UNRECORDED_S": "0.08", "LONGEST_GAP_S": "0.03",
    "LOST": "0.003",
}  # fmt: skip


# ---------------------------------------------------------------------- figures

Figures = dict[str, Any]  # µm, responses at HZ, or words


def rectangle() -> Figures:
    """Return µm that the responses of a day leave on another day."""
    days, path = [published.identified(day) for day in (1, 2)], published.outline()
    left = {}
    for known, truth, which in ((days[0], 1, "later"), (days[1], 0, "before")):
        ours, around = published.compensated(known, path)
        left[which] = published.contour(truths()[truth], ours, around)
    return dict(left)


@cache
def truths() -> list[published.Axes]:
    return [published.identified(day) for day in (1, 2)]


def test() -> Figures:
    """Return the responses that a published test of resonances shows."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "printer.cfg")
        config.write_text(SV08_CONFIG)
        Path(folder, SV08.stem).write_bytes(lzma.decompress(SV08.read_bytes()))
        travel = Travel((0.0, 350.0), (0.0, 360.0))
        found = gather([Path(folder)], KlipperConfig(config), travel)
    settings = MeasurementSettings(BAND, racks=False)
    identified = identify(found.runs, settings)
    report = IdentificationReport(identified, identified.plant(0.0), None, found)
    return {
        "Gyy": at_hz(identified.fits["Gyy"].G),
        "words": [*report.remarks(), identified.refusal],
    }


def at_hz(response: ImpulseResponse) -> Complex:
    return response.response(2.0 * np.pi * TS * HZ)


def machine(hz: float) -> Machine:
    axis = Axis((Mode(hz, 0.06, 0.85), Mode(71.0, 0.05, 0.15)), friction=150.0)
    return Machine(axis, Axis((Mode(30.0, 0.08),)), kinematics="cartesian")


CHIP = Chip(gains=(1.03, 0.97, 1.0), rate_error=0.01)


def shown(runs: Sequence[Run], racks: bool = False) -> Figures:
    """Return the responses that runs show, and what is said of them."""
    found = identify(runs, MeasurementSettings(BAND, racks))
    report = IdentificationReport(found, found.plant(140.0), None, Gathered([], []))
    x_c = None if found.x_c is None else round(found.x_c, 1)
    return {
        "words": [found.refusal, x_c, *report.remarks()],
        **{name: at_hz(found.fits[name].G) for name in found.axes},
    }


@cache
def struck() -> list[Run]:
    planned = runs(printer(machine(40.0)), seconds=20.0)
    return recorded(machine(40.0), CHIP, planned[:1], 1)


def strokes() -> Figures:
    """Return the response that strokes show."""
    return shown(struck())


@cache
def at_places() -> list[Run]:
    hbot, chip, _ = drawn(11)  # with friction, which hides half of its racking
    return recorded(hbot, chip, runs(printer(hbot), seconds=20.0), 11, 0.0206)


def places() -> Figures:
    """Return the responses of an H-bot, and its racking."""
    return shown(at_places(), racks=True)


@cache
def swept() -> list[Run]:
    sharp = Machine(Axis((Mode(25.5, 0.03),)), Axis((Mode(30.0, 0.1),)), kinematics="cartesian")
    one, lines = played(ender(1000.0), *at(X, 110.0, 110.0), 10.0)
    moved = motion("\n".join(lines).encode())
    still = np.pad(moved, ((2000, 2000), (0, 0)), mode="edge")
    chip = replace(SENSORS["adxl345"], lead=3.0)
    return [Run("x", one.command, chip.record(sharp, still, 1))]


def marlin() -> Figures:
    """Return the response of a printer whose mode rings for more than 0.4 s."""
    return shown(swept())


@cache
def wandered() -> tuple[Array, Array]:
    """Return time stamps of a LIS2DW, and its samples."""
    made = recorded_test(machine(40.0), TEST, drawn_sensor(1, "lis2dw"), 3, 1).recording
    return made.t + wandering(made.t - made.t[0], 5e-3), made.a


def stamps() -> Figures:
    """Return the response that a test shows whose time stamps wander."""
    t, a, _ = repaired(*wandered())
    found = find(Recording(t, a, False), TEST)
    return shown([Run("x", found.test.command(), Recording(t, a, False), found.clock)])


@cache
def checked() -> list[Run]:
    return recorded(machine(38.0), CHIP, check_runs(printer(machine(40.0)))[:1], 2)


def check() -> Figures:
    """Return the response that a check shows, and whether it drifted."""
    plant = replace(printer(machine(40.0)).plant, Gxx=exact(40.0))
    found = drifts(plant, checked())
    report = CheckReport(printer(machine(40.0)), found, date(2026, 7, 1))
    return {"Gxx": at_hz(found["Gxx"].G), "words": [found["Gxx"].certain, list(report.moved)]}


@cache
def spoilt() -> list[list[Run]]:
    """Return strokes of noise and of a sensor 14 % wrong, and a check of another printer."""
    (one,) = struck()
    noise = np.random.default_rng(0).normal(0.0, 2000.0, one.nozzle.a.shape)
    wrong = replace(CHIP, gains=(1.14, 0.97, 1.0))
    return [
        [replace(one, nozzle=replace(one.nozzle, a=noise))],
        recorded(machine(40.0), wrong, runs(printer(machine(40.0)), seconds=20.0)[:1], 1),
        recorded(machine(33.0), CHIP, check_runs(printer(machine(40.0)))[:1], 2),
    ]


def refused() -> Figures:
    """Return what is said of recordings that are refused."""
    noise, wrong, other = spoilt()
    plant, words = replace(printer(machine(40.0)).plant, Gxx=exact(40.0)), list[Any]()
    for said in (lambda: shown(noise)["words"][0], lambda: drifts(plant, other)["Gxx"].certain):
        try:
            words.append(said())
        except HframeError as error:
            words.append(str(error))
    return {"words": [*words, shown(wrong)["words"][0]]}


@cache
def exact(hz: float) -> Any:
    linear = machine(hz)
    return replace(linear, x=replace(linear.x, friction=0.0)).exact().Gxx


BY_ROOM: dict[str, tuple[Callable[[], Figures], ...]] = {
    "identify": (test, check),
    "places": (test, places),
    "estimation.fit": (test, marlin),
    "estimation.regression": (rectangle, strokes, marlin),
    "estimation.response": (rectangle, strokes, marlin),
    "estimation.frequency_response": (test, strokes),
    "estimation.directions": (test, marlin),
    "estimation.measured": (test, marlin),
    "verdict": (test, check, refused),
    "check": (check, refused),
    "recordings.accelerometer": (test, stamps),
    "recordings.clock": (test, stamps),
    "recordings.resonance_search": (test, stamps),
}


# ---------------------------------------------------------------------- bounds


@dataclass(frozen=True)
class Bound:
    """A number of a module, or a part of one: at an index of a tuple, or a field."""

    room: str
    name: str
    part: str | int | None
    value: float
    source: str

    @property
    def label(self) -> str:
        return self.name if self.part is None else f"{self.name}[{self.part}]"

    def scaled(self, factor: float) -> None:
        """Scale it, in each module that has it."""
        old = getattr(self._module, self.name)
        new = _scaled(old, self.part, factor)
        for module in list(sys.modules.values()):
            if module.__name__.startswith(PACKAGE) and vars(module).get(self.name) is old:
                setattr(module, self.name, new)

    @property
    def _module(self) -> ModuleType:
        return importlib.import_module(f"{PACKAGE}.{self.room}")


def _scaled(value: Any, part: str | int | None, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(v * factor if k == part else v for k, v in enumerate(value))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{str(part): factor * getattr(value, str(part))})
    if isinstance(value, np.ndarray):  # consecutive samples
        first, last = value[0], value[-1] + 1.0
        ends = (first * factor, last) if part == "first" else (first, last * factor)
        return np.arange(*ends)
    return max(round(value * factor), 1) if isinstance(value, int) else value * factor


def bounds(room: str) -> Iterator[Bound]:
    """Yield the numbers of a module, with the comment beside each."""
    module = importlib.import_module(f"{PACKAGE}.{room}")
    source = inspect.getsource(module)
    lines = source.splitlines()
    for statement in ast.parse(source).body:
        if not isinstance(statement, ast.Assign | ast.AnnAssign):
            continue
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        comment = _comment(lines, statement.lineno - 1, statement.end_lineno or statement.lineno)
        for name in names:
            if isinstance(name, ast.Name):
                for part, value in _parts(getattr(module, name.id)):
                    yield Bound(room, name.id, part, value, comment)


def _comment(lines: list[str], first: int, end: int) -> str:
    _, _, beside = lines[end - 1].partition("  # ")
    above = list[str]()
    while first > 0 and lines[first - 1].startswith("# ") and "---" not in lines[first - 1]:
        first -= 1
        above.insert(0, lines[first][2:])
    return " ".join([*above, beside]).strip()


def _parts(value: Any) -> Iterator[tuple[str | int | None, float]]:
    """Yield the numbers of a bound, and which part of it each is."""
    if isinstance(value, int | float):
        yield None, float(value)
    elif isinstance(value, tuple) and len(value) == 2:
        yield from ((k, float(one)) for k, one in enumerate(value) if isinstance(one, int | float))
    elif isinstance(value, np.ndarray) and len(value) > 99 and np.all(np.diff(value) == 1.0):
        yield from (("first", float(value[0])), ("last", float(value[-1])))
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            one = getattr(value, field.name)
            if isinstance(one, int | float) and one:
                yield field.name, float(one)


# ---------------------------------------------------------------------- the table


def figures(job: tuple[Bound, float]) -> list[str]:
    """Return what changes as texts: of the rectangle, and of responses."""
    bound, factor = job
    bound.scaled(factor)
    micrometres, most, otherwise = list[str](), 0.0, ""
    for case in BY_ROOM[bound.room]:
        before = usual(case)
        if micrometres:  # what shapes a response of an unknown start does nothing to another one
            break
        try:
            now = case()
        except (HframeError, ValueError, ArithmeticError, IndexError, np.linalg.LinAlgError):
            return ["", "refused"]
        for key, value in now.items():
            if key == "words":
                otherwise = otherwise or (", other words" if value != before[key] else "")
            elif isinstance(value, float):
                micrometres += [f"{value:.2f}"] if abs(value - before[key]) > 5e-3 else []
            else:
                most = max(most, changed(value, before[key]))
    share = f"{100.0 * most:.1f} %" if most > 5e-4 else "0" * (not micrometres)
    return [", ".join(micrometres), share + otherwise]


@cache
def usual(case: Callable[[], Figures]) -> Figures:
    """Return the figures of a case with the bounds as they are."""
    return case()


def changed(response: Complex, before: Complex) -> float:
    off, usual_off = (np.linalg.norm(one / HZ**2) for one in (response - before, before - 1.0))
    return float(off / usual_off)


def main() -> None:
    """Compute each row in a process of its own, in which one number differs."""
    rooms = sys.argv[1:] or list(BY_ROOM)
    rows = [bound for room in rooms for bound in bounds(room)]
    left = ", ".join(f"{value:.2f}" for value in usual(rectangle).values())
    for case in {case for room in rooms for case in BY_ROOM[room]}:
        usual(case)  # before the processes are forked
    jobs = [(bound, factor) for bound in rows for factor in (0.5, 2.0)]
    with multiprocessing.get_context("fork").Pool(maxtasksperchild=1) as pool:
        found = pool.map(figures, jobs, chunksize=1)
    with (ROOT / "docs/bounds.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(HEAD)
        table.writerow(["", "all as they are", "", "", left, "", left, ""])
        for k, bound in enumerate(rows):
            nearest = NEAREST.get(bound.name, "") if bound.room == "verdict" else ""
            source = bound.source + (f"; nearest {nearest}" if nearest else "")
            changes = (*found[2 * k], *found[2 * k + 1])
            table.writerow([bound.room, bound.label, f"{bound.value:g}", source, *changes])


if __name__ == "__main__":
    main()
