"""Write docs/results.md: errors and times of the sample prints, on the machine that runs it.

make results; with PREVIOUS=/path/to/another/bin/hframe-post beside that version, with
TIMED="a.gcode b.gcode" for the time of these prints
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

import hframe_post as hp
from examples.paper import results as paper
from examples.paper import tables
from tests.benchmarks import accuracy, costs, speed

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_gcode"
MEASURED, HBOT = (next(p for p in accuracy.PROFILES if k in p) for k in ("corexy-10000", "hbot"))
OFF = (0.05, 0.1, 0.2)  # shares by which random printers differ from the paper's
HEAD = """\
# Results

`make results` computes this page: what conversions leave and take on four owners' printers, the
time of conversions, and the paper's rectangle.
"""
OWNERS = """\
## Owners' printers

The profiles are as `identify` wrote them: two CoreXY printers with Klipper, of published
recordings, whose max_accel is 3 000 and 10 000 mm/s²; a simulated bed-slinger with Marlin and
500 mm/s²; a simulated H-bot with Klipper and 3 000 mm/s², which racks as the paper's. *cube* is
in `sample_gcode`; `make results SLICES="a.gcode b.gcode"` adds other prints: here a slice by
an owner with OrcaSlicer, which is not part of this project.

Contour error while extruding, RMS µm. *None* and *best shaper*: the file as sliced, as the
firmware plays it by itself, without and with the input shaper that leaves least on this printer.
*Converted*: as this tool writes it, if the model is exact; *5 % off*, *10 % off*: the median of
eight printers that differ from the model by up to that. *Time*: what the conversion changes, as
its summary says it; *played*: the same, if Klipper's own host or a simulated Marlin board plays
both files.
"""


def rows() -> Iterator[str]:
    yield HEAD
    yield from owners()
    yield from inexact()
    yield from speeds()
    yield "## The paper's rectangle\n"
    yield "[derivations.md](derivations.md#the-papers-figures) has the paper's other tables.\n"
    printer = hp.load_printer("paper")
    yield tables.time_response(paper.time_responses(printer, paper.path(printer)))


def owners() -> Iterator[str]:
    yield OWNERS
    yield table_head(*accuracy.HEAD)
    yield from (line(*cells) for cells in accuracy.rows(slices("SLICES")))
    yield ""


def slices(variable: str) -> list[Path]:
    """Return the cube, and the files that a variable of the environment names."""
    return [SAMPLES / "cube.gcode", *map(Path, os.environ.get(variable, "").split())]


def inexact() -> Iterator[str]:
    yield "## An inexact model\n"
    yield "The rectangle on 50 random printers that differ from the paper's by up to a share.\n"
    yield table_head("off by up to", "median µm", "worst µm")
    printer = hp.load_printer("paper")
    found = hp.simulate(SAMPLES / "rectangle.gcode", printer, model_error=OFF, draws=50)
    for similar in found.model_error:
        rms = sorted(1e3 * each for each in similar.rms("racking"))
        yield line(f"{100 * similar.share:.0f} %", f"{rms[len(rms) // 2]:.1f}", f"{rms[-1]:.1f}")
    yield ""


def speeds() -> Iterator[str]:
    yield "## Speed\n"
    yield f"CPU on {platform.machine()} with Python {platform.python_version()}, each converted in"
    yield "turn with slicing by CuraEngine where it is installed, with `gzip -9` of the input, and"
    yield "with the version that `PREVIOUS` names. *figure*, *knot*, *gyroid* and *vase* are sliced"
    yield "for this, from `tests/benchmarks/models.py`; `TIMED` names other prints.\n"
    previous, timed = os.environ.get("PREVIOUS"), slices("TIMED")
    shown = len(speed.HEAD) if previous else -1
    yield table_head(*speed.HEAD[:shown])
    found = speed.rows((MEASURED, HBOT, "paper"), timed, previous)
    yield from (line(*cells[:shown]) for cells in found)
    yield f"\nWhat more of a print adds, on {Path(MEASURED).stem}:\n"
    yield table_head(*costs.HEAD)
    yield from (line(*cells) for cells in costs.rows(MEASURED))
    yield ""


def table_head(*names: str) -> str:
    return f"{line(*names)}\n{line(*['---'] * len(names))}"


def line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def main(written: Sequence[str]) -> None:
    (ROOT / "docs" / "results.md").write_text("\n".join(written), "utf-8")


if __name__ == "__main__":
    main([*rows()])
