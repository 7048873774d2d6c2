"""Commands, printers, and what each must answer: matrix.txt shows it at one look.

Each command has a cell that does its work; what it refuses is tested where it is refused.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from tests.matrix.cells import Cell

# name: exit status, and the last line
OUTCOMES = {
    "unmeas": (1, r"Error: .*: this printer is not measured yet"),
    "marlin": (1, r"Error: .* firmware\.dialect: marlin "),
    "baud": (1, r"Error: .* firmware\.marlin\.baud: OctoPrint prints over a serial line"),
    "klippr": (1, r"Error: .* firmware\.dialect: this profile is for klipper; only boards that"),
    "norec": (1, r"Error: .*not a Klipper accelerometer file"),
}  # fmt: skip

TABLE = Path(__file__).with_name("matrix.txt")


@dataclass(frozen=True)
class Done:
    """The last line of a command that has done its work, and the files that it writes."""

    last_line: str
    files: str = ""


SUMMARY = (
    r"belts   .*at most |limited by  .*(in the file|in the profile)|if you stop it   send M501"
)
WITH_MODEL = r"(\w+\.kernel )?\w+\.model\.toml \w+\.toml"  # the kernel is Klipper's
NAMES = r"(x|y)-at-[\d_]+"
DONE = {
    "convert {print} -o out.gcode": Done(SUMMARY, "out.gcode"),
    "{print}": Done(SUMMARY, "my part.gcode"),
    "batch {print} -o out": Done("1 converted, 0 skipped, 0 failed", "out/my part.gcode"),
    "simulate {print}": Done(r"1( +[\d.]+){3}"),
    "simulate": Done(r"0( +[\d.]+){3}"),
    "simulate --shapers": Done("."),
    "measure --for check -o c.gcode": Done(
        "", r"((c\.check-[-\w]+\.csv|c-[xy]\.gcode) ?)+(c\.gcode)?"
    ),
    "check": Done("uncertainty  ±"),
    "check {checked}": Done("Nothing is written. To keep it"),
    "identify {recordings} -o mine.toml": Done(".", WITH_MODEL),
    "calibrate-print --heat 210,60 -o t.gcode": Done("Print t.gcode.", "t.form.toml t.gcode"),
    "calibrate-print --form {form} -o n.toml": Done(
        "Next: hframe-post calibrate-print -p n.toml --compare", WITH_MODEL
    ),
    "calibrate-print --compare 6% --heat 210,60 -o t.gcode": Done("Print t.gcode.", "t.gcode"),
    "calibrate-print --pick 6% 0 -o n.toml": Done("Next: compare once more", WITH_MODEL),
    "setup {config} -o new": Done(
        r"  .*hframe-post (identify|calibrate-print)|OctoPrint do that: ",
        r"config/hframe-post/config\.toml( new/hframe\.cfg)? new/printer\.toml",
    ),
    "doctor": Done("no problems found"),
    "measure -o m.gcode": Done(
        "", r"(m(-x|-y)?\.gcode ){1,2}(m\.measure(-x|-y)?-at-\d+\.csv ?){1,3}"
    ),
    "measure -o s.gcode": Done("", rf"(s\.gcode )?(s\.{NAMES}\.(csv|gcode) ?)+"),
    "connect klipper": Done("    _HFRAME_CANCEL_PRINT {rawparams}"),
    "measure --for planner -o c.gcode": Done("The part .lines. is 10000", "c.gcode"),
    "connect slicer": Done("OrcaSlicer: Process"),
    "connect cura --folder {folder}": Done("Restart Cura, then: ", "there/HframePost.py"),
    "connect octoprint --folder {folder}": Done(
        "Restart OctoPrint.", r"(there/plugins/hframe_post/\S+ ?){4}"
    ),
}


def cells(fast: bool) -> list[tuple[Cell, str]]:
    """Return the cells of the fast or of the slow suite, each with the name of its outcome."""
    rows = [line.split(" | ") for line in TABLE.read_text("utf-8").splitlines()[1:]]
    return [
        (Cell(words, printer), outcome.lower())
        for words, printer, outcome in rows
        if outcome[0].isupper() == fast
    ]


def expected(cell: Cell, outcome: str) -> tuple[int, re.Pattern[str], re.Pattern[str]]:
    """Return status, last line and the names of written files, as a cell's outcome says."""
    if outcome == "done":
        row = DONE[cell.words]
        return 0, re.compile(row.last_line), re.compile(row.files)
    status, last_line = OUTCOMES[outcome]
    return status, re.compile(last_line), re.compile("")
