"""Write docs/results.md: errors and times of the sample prints, on the machine that runs it.

make results; with PREVIOUS=/path/to/another/bin/hframe-post beside that version
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

import hframe_post as hp
from examples.paper import results as paper
from examples.paper import tables
from tests.benchmarks import speed

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_gcode"
PRINTS = ("cube", "prism")  # the rectangle is too large for a small bed
OWNERS = ROOT / "tests" / "benchmarks" / "owners"  # as `identify` wrote them from recordings
PRINTERS = (
    str(OWNERS / "corexy-3000.toml"), str(OWNERS / "corexy-10000.toml"), "example-ender", "paper",
)  # fmt: skip
OFF = (0.05, 0.1, 0.2)  # shares by which random printers differ from the model
HEAD = """\
# Results

`make results` computes this page: the predicted contour error of the sample prints on two
measured printers and two shipped profiles, the time of conversions, and the paper's
rectangle. The profiles' plants are exact here; [identify.md](identify.md#how-far-to-trust-it) says
what is left on real printers.
"""


def rows() -> Iterator[str]:
    yield HEAD
    yield from errors()
    yield from inexact()
    yield from speeds()
    yield "## The paper's rectangle\n"
    yield "[derivations.md](derivations.md#the-papers-figures) has the paper's other tables.\n"
    printer = hp.load_printer("paper")
    yield tables.time_response(paper.time_responses(printer, paper.path(printer)))


def errors() -> Iterator[str]:
    yield "## Contour error\n"
    yield "While extruding, RMS µm: as the firmware plays the sliced file, without compensation and"
    yield "with the best input shaper; as converted. The time is what the conversion changes.\n"
    yield table_head("print", "printer", "mm/s²", "none", "best shaper", "converted", "time")
    for part in PRINTS:
        for name in PRINTERS:
            printer, found = hp.load_printer(str(name)), converted(part, name)
            errors = {
                key: f"{each.micrometres()['rms']:.1f}" for key, each in found.contour.items()
            }
            acceleration, change = (
                printer.limits.acceleration,
                f"{100.0 * found.time.change:+.1f} %",
            )
            rms = (errors[each] for each in ("none", "shaper", "racking"))
            yield line(part, Path(name).stem, f"{acceleration:.0f}", *rms, change)
    yield ""


def inexact() -> Iterator[str]:
    yield "## An inexact model\n"
    yield "The rectangle on the paper's printer: 50 random printers that differ by up to a share.\n"
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
    yield "with the version that `PREVIOUS` names.\n"
    previous = os.environ.get("PREVIOUS")
    shown = len(speed.HEAD) if previous else -1
    yield table_head(*speed.HEAD[:shown])
    yield from (line(*cells[:shown]) for cells in speed.rows(PRINTERS, previous))
    yield ""


def converted(part: str, name: str = "paper") -> hp.Report:
    target = ROOT / "build" / f"{part}.gcode"
    target.parent.mkdir(exist_ok=True)
    options = hp.Options(force=True)
    return hp.convert(SAMPLES / f"{part}.gcode", target, hp.load_printer(name), options)


def table_head(*names: str) -> str:
    return f"{line(*names)}\n{line(*['---'] * len(names))}"


def line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def main(written: Sequence[str]) -> None:
    (ROOT / "docs" / "results.md").write_text("\n".join(written), "utf-8")


if __name__ == "__main__":
    main([*rows()])
