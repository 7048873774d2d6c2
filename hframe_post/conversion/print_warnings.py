"""Warnings of a conversion's summary: what of its figures a person must not overlook."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase

from hframe_post.conversion.ledger import Ledger, percent
from hframe_post.gcode.reader import CHANGE_OF_OBJECT, START_OF_FILE

TOOL = re.compile(r"T[1-9]\d*")
FEW_RETRACTIONS = 9  # by G10 and G11, as macros have them
SLIGHT = 0.005  # share of the extrusion
REMEDIES = {  # of extrusion that is not compensated, by causes other than commands
    START_OF_FILE: "because its place is not known: begin with a move to X, Y and Z",
    CHANGE_OF_OBJECT: "because an object begins without a travel to it",
}


def warnings(
    ledger: Ledger, other_tools: tuple[str, ...] | None, lines_per_second: float
) -> Iterator[str]:
    """Yield a sentence for each.

    other_tools: commands after which the plant is not that of the tool that prints; None if the
    profile does not say. lines_per_second: that the firmware takes.
    """
    if not ledger.read.moves:
        yield (
            "nothing was compensated, because no move starts at a known position: move to an "
            "absolute X, Y and Z before printing"
        )
    yield from ledger.read.oddities.values()
    yield from _uncompensated(ledger, other_tools)
    if (busiest := ledger.written.busiest_second) > lines_per_second:
        yield (
            f"up to {busiest} lines in a second; the printer takes {lines_per_second:.0f} "
            "(lines_per_second in the profile), so it may stutter"
        )
    if (count := ledger.read.firmware_retractions) > FEW_RETRACTIONS:
        yield (
            f"estimated duration of {count} G10/G11: less is compensated next to them. Say in "
            "[retraction] of the profile what they do"
        )
    if (clamped := ledger.clamped).samples:
        share = 1e-3 * clamped.samples / (ledger.duration + ledger.elsewhere)
        yield (
            f"less is compensated on {percent(share)} of the print, first at line {clamped.line}, "
            f"by up to {clamped.most:.3f} mm: the bed's edge ([travel] of the profile) or the "
            "motors ([motors]) allow no more. If the motors can do more, raise "
            "motors.belt_acceleration"
        )


def _uncompensated(ledger: Ledger, other_tools: tuple[str, ...] | None) -> Iterator[str]:
    """Yield what to do about tools without a model, and about the main cause of the rest."""
    path, parts = ledger.path, ledger.path.uncompensated
    others = {
        cause: part.filament
        for cause, part in parts.items()
        if any(fnmatchcase(cause, name.upper()) for name in other_tools or ())
    }
    if other_tools is None and (tools := ", ".join(filter(TOOL.fullmatch, parts))):
        yield (
            f"the file changes tools ({tools}), and all are compensated with the model of one. "
            "If they are separate heads, list those that were not measured below [firmware] of "
            'the profile, such as other_tools = ["T1"]; otherwise write other_tools = []'
        )
    if filament := sum(others.values()):
        yield (
            f"{percent(filament / path.filament)} of the extrusion is not compensated: the "
            f"profile has no model of {', '.join(others)} (other_tools in the profile)"
        )
    cause = max(parts, key=lambda name: parts[name].filament, default="")
    if path.extrusion_share > SLIGHT and cause not in others:
        yield (
            f"{100.0 * path.extrusion_share:.1f} % of the extrusion is not compensated, "
        ) + REMEDIES.get(
            cause,
            f"mostly after {cause}. If {cause} does not move the head, add it to harmless in "
            "[firmware] of the profile; if the head comes back, add it to returns",
        )
