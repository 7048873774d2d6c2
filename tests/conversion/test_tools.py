"""Files that change tools, on profiles with the model of one."""

import pytest

from hframe_post.conversion.print_report import Report
from hframe_post.printer.profile import parse
from tests import gcode_tools

PROFILE = 'extends = "paper"\n[plant]\ninvented = false\n[firmware]\n'
HALF = [f"G1 X{80 + 40 * (k % 2)} Y{80 + 5 * k} E{k + 1} F6000" for k in range(4)]
OTHER = [line.replace("X1", "X3") for line in HALF]  # beyond the bed of the first carriage


def converted(settings: str, lines: list[str]) -> tuple[str, Report]:
    """Return what a file becomes on a profile with these settings of [firmware]."""
    text = ["G90", "M82", "G1 X80 Y80 Z1 F3000", *lines]
    printer = parse(PROFILE + settings, "own")
    output, report = gcode_tools.converted([f"{line}\n".encode() for line in text], printer)
    return output.decode(), report


@pytest.mark.parametrize("tool", ["T1", "T3 ; the fourth"])
def test_a_file_that_changes_tools_gets_a_warning(tool: str) -> None:
    _, report = converted("", [*HALF, "G92 E0", tool, "G92 E0", *HALF])
    (warning,) = [w for w in report.warnings() if "changes tools" in w]
    assert (
        f"the file changes tools ({tool[:2]}), and all are compensated with the model of" in warning
    )
    for settings, lines in (
        ("", [*HALF, "T0"]),
        ("other_tools = []", [*HALF, tool, "G92 E0", *HALF]),
        ('harmless = ["T*"]', [*HALF, tool, "G92 E0", *HALF]),
    ):
        _, report = converted(settings, lines)
        assert "tool" not in "".join(report.warnings())


def test_what_another_tool_prints_is_left_to_the_firmware() -> None:
    lines = [*HALF, "T1", "G92 E0", *OTHER, "G1 Z2", *OTHER[::-1], "T0", "G92 E0", *HALF]
    text, report = converted('other_tools = ["T1"]', lines)
    before, _, rest = text.partition("\nT1\n")
    others, _, after = rest.partition("\nT0\n")
    assert [line for line in OTHER if line not in others] == []
    assert others.count("\nG1 X") == 2 * len(OTHER)
    assert all(part.count("\nG1 ") > 20 * len(HALF) for part in (before, after)), "lines"
    shares = report.as_json()["uncompensated"]["by_cause"]
    assert shares["T1"]["moves"] == 2 * len(OTHER) + 1
    (warning,) = [w for w in report.warnings() if "not compensated" in w]
    assert "the profile has no model of T1 (other_tools in the profile)" in warning
