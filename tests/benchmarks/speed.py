"""Time conversions in pairs with slicing, `gzip -9` and, if there is one, another version.

make results PREVIOUS=/path/to/another/bin/hframe-post
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.benchmarks.models import SPREAD, models

CURA = Path("/usr/share/cura/resources/definitions/fdmprinter.def.json")
PAIRS = 3  # the least of each counts: other processes only add
HEAD = ("print", "printer", "convert, s", "÷ slicing", "÷ gzip -9", "÷ previous")


def rows(
    printers: Sequence[str], slices: Sequence[Path], previous: str | None
) -> Iterator[list[str]]:
    """Yield a row for each print and printer, as HEAD names its cells; "–": not measured here."""
    with tempfile.TemporaryDirectory() as folder:
        for sliced, slicing in prints(slices, Path(folder)):
            for printer in printers:
                cells = row(sliced, slicing, printer, Path(folder) / "out.gcode", previous)
                yield [sliced.stem, Path(printer).stem, *cells]


def prints(slices: Sequence[Path], folder: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield slices, and models with the command that slices each if CuraEngine is installed."""
    yield from ((sliced, []) for sliced in slices)
    if shutil.which("CuraEngine") is None or not CURA.exists():
        return  # Debian: apt install cura
    for name, (surface, settings) in models().items():
        model, sliced = folder / f"{name}.stl", folder / f"{name}.gcode"
        model.write_bytes(surface)
        chosen = [word for item in (SPREAD | settings).items() for word in ("-s", "=".join(item))]
        files = ["-l", str(model), "-o", str(sliced)]
        slicing = ["CuraEngine", "slice", "-j", str(CURA), *chosen, *files]
        processor_s(slicing)
        yield sliced, slicing


def row(
    sliced: Path, slicing: list[str], printer: str, out: Path, previous: str | None
) -> Iterator[str]:
    """Yield the processor time of a conversion and its ratios to what ran in turn with it."""
    options = [str(sliced), "-q", "--force", "--jobs", "1", "-p", printer, "-o", str(out)]
    commands = [
        ["hframe-post", *options],
        slicing,
        ["gzip", "-9", "-c", str(sliced)],
        [previous, *options] if previous else [],
    ]
    turns = [[processor_s(each) for each in commands] for _ in range(PAIRS)]
    ours, *others = (min(times) for times in zip(*turns, strict=True))
    yield f"{ours:.2f}"
    yield from (f"{ours / other:.2f}" if other else "–" for other in others)


def processor_s(command: Sequence[str]) -> float:
    """Run a command and return the CPU seconds of it and its children; 0 for no command."""
    if not command:
        return 0.0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return used.ru_utime + used.ru_stime
