"""What slices become on three printers, in four outputs, stays the same to the byte.

``make bytes`` compares, ``make bytes UPDATE=1`` rewrites the manifest. The stamp does not count,
and a summary in the file only as numbers. Other libraries may round another way: where the
manifest comes from other versions or another processor, its figures must agree instead.
"""

import gzip
import hashlib
import json
import platform
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

from hframe_post import convert, load_printer
from hframe_post.conversion.options import Options
from hframe_post.gcode.commands import STAMP
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import Printer
from tests.conftest import ROOT, SAMPLES
from tests.slices import SLICES

HERE = Path(__file__).parent
MANIFEST = HERE / "manifest.json"
PRINTERS = "paper", "corexy", "bed"
OUTPUTS = "klipper", "2.1", "ft-motion", "steps"
# a whole file, or as many of its first lines
FILES = {
    SAMPLES / "rectangle.gcode": 0, SAMPLES / "cube.gcode": 700, SAMPLES / "prism.gcode": 700,
    ROOT / "tests/quirks/arcs.gcode": 0,
    HERE / "hops.gcode.gz": 0, HERE / "retraction.gcode.gz": 0, HERE / "vase.gcode.gz": 0,
}  # fmt: skip
WRITTEN = "orcaslicer", "prusaslicer", "bambu", "superslicer", "cura"
CASES = {path.name.split(".")[0]: path for path in FILES}


def made_with() -> str:
    """Return what decides how numbers are rounded."""
    packages = (f"{name} {version(name)}" for name in ("numpy", "ruckig", "scipy"))
    return ", ".join([platform.machine(), *platform.libc_ver(), *packages])


def lines_of(name: str) -> list[bytes]:
    if name in SLICES:
        return SLICES[name].lines
    path = CASES[name]
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    return data.splitlines(keepends=True)[: FILES[path] or None]


def printer_for(name: str, output: str) -> Printer:
    printer = load_printer(HERE / f"{name}.toml")
    own = printer.firmware
    if output in ("klipper", "steps"):
        return replace(printer, firmware=replace(own, dialect="klipper"))
    marlin = own.table(MarlinTable)
    assert marlin is not None
    table = replace(marlin, planner=output)
    return replace(printer, firmware=replace(own, dialect="marlin", tables=(table,)))


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def made_of(name: str, folder: Path) -> dict[str, str]:
    """Return the digests of text and report, and figures, of each printer and output."""
    found: dict[str, str] = {}
    lines = lines_of(name)
    for printer in PRINTERS:
        for output in OUTPUTS:
            target = folder / ("out.csv" if output == "steps" else "out.gcode")
            options = Options(format="steps" if output == "steps" else None)
            report = convert(lines, target, printer_for(printer, output), options).as_json()
            own = STAMP, b"; hframe-post:", b"#version", b"#settings"
            kept = [each for each in target.read_bytes().splitlines() if not each.startswith(own)]
            errors = report["contour_error_um"].values()
            row = [
                digest(b"\n".join(kept)), digest(json.dumps(report, sort_keys=True).encode()),
                len(kept), report["print_time_s"]["after"], report["filament_mm"]["after"],
                *(round(each["rms"], 1) for each in errors),
            ]  # fmt: skip
            found[f"{printer} {output}"] = " ".join(map(str, row))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CASES, *WRITTEN])
def test_bytes(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    now, manifest = made_of(name, tmp_path), json.loads(MANIFEST.read_text())
    if request.config.getoption("--update-golden"):
        slices = manifest["slices"] if manifest["made with"] == made_with() else {}
        manifest = {"made with": made_with(), "slices": {**slices, name: now}}
        MANIFEST.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n")
    then = manifest["slices"][name]
    if manifest["made with"] == made_with():
        assert now == then, "say in the commit what changed and why, after make bytes UPDATE=1"
        return
    for case, row in now.items():  # lines, seconds, mm and µm
        found, known = ([*map(float, each.split()[2:])] for each in (row, then[case]))
        assert found == pytest.approx(known, rel=0.01, abs=0.3), case
