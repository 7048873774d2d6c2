"""Objects excluded in mid-print, in the dialects of six slicers, by Klipper's own modules.

As sliced, the head does not go to an excluded object again. Nor may it as converted.
"""

import re
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.printer.profile import load
from tests import gcode_tools
from tests.conftest import few
from tests.klipper.head import head

LABEL = re.compile(r"; (stop )?printing object (\w+)|(?:;MESH:|M486 S|;PRINTING_ID: )(\S+)")
OBJECTS = {"A": (60.0, 60.0), "B": (120.0, 60.0), "C": (90.0, 110.0)}
SIDE, LAYERS = 20.0, 4


def commands(name: str, ends: bool) -> str:
    return f"EXCLUDE_OBJECT_{'END' if ends else 'START'} NAME={name}"


def comments(name: str, ends: bool) -> str:
    return f"; {'stop ' if ends else ''}printing object {name}"


def meshes(name: str, ends: bool) -> str:
    return f";MESH:{'NONMESH' if ends else name}"


def numbers(name: str, ends: bool) -> str:
    return f"M486 S{-1 if ends else [*OBJECTS].index(name)}"


def both(name: str, ends: bool) -> str:
    pair = [comments(name, ends), commands(name, ends)]
    return "\n".join(pair[:: -1 if ends else 1])


def ideamaker(name: str, ends: bool) -> str:
    number = -1 if ends else [*OBJECTS].index(name)
    return f";PRINTING: {'NON-OBJECT' if ends else name}\n;PRINTING_ID: {number}"


def printed(label: Callable[[str, bool], str], lift: str, absolute: bool, inside: bool) -> str:
    """Return a print of objects. lift: how a travel begins; inside: travel follows its label."""
    lines = [*(f"EXCLUDE_OBJECT_DEFINE NAME={name}" for name in OBJECTS), "G28", "G90"]
    lines += ["M82" if absolute else "M83", "G92 E0", "G1 X20 Y20 Z0.2 F9000"]
    e = 0.0

    def fed(filament: float) -> str:
        nonlocal e
        e += filament
        return f"E{e if absolute else filament:.4f}"

    lines.append(f"G1 X100 Y20 {fed(4.0)} F1500")
    for layer in range(LAYERS):
        z = 0.2 * (layer + 1)
        for name, (x, y) in OBJECTS.items():
            travel = [f"G1 {fed(-0.8)} F2400", *(lift.format(z=f"{z + 0.6:.1f}").splitlines())]
            travel += [f"G1 X{x} Y{y} F12000", f"G1 Z{z:.1f} F600", f"G1 {fed(0.8)} F2400"]
            lines += [label(name, False), *travel] if inside else [*travel, label(name, False)]
            lines.append("G1 F4800")
            for u, v in ((SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE), (0.0, 0.5)):
                lines.append(f"G1 X{x + u} Y{y + v} {fed(0.7)}")
            lines.append(label(name, True))
    return "\n".join([*lines, "G1 Z5 F600", "G1 X10 Y150 F9000"])


SLICES = {
    "Klipper's commands": printed(commands, "", False, True),
    "Cura's meshes": printed(meshes, "G1 Z{z} F600", True, False),
    "OrcaSlicer": printed(both, "G17\nG3 Z{z} I1.2 J0 P1 F12000", False, True),
    "PrusaSlicer's comments": printed(comments, "G1 Z{z} F600", True, True),
    "M486": printed(numbers, "G1 Z{z} F600", False, True),
    "ideaMaker": printed(ideamaker, "", True, False),
}
INSIDE = [name for name in SLICES if name not in ("Cura's meshes", "ideaMaker")]
"""Those whose travel to an object is part of it."""


def as_lines(text: str) -> list[bytes]:
    return [line.encode() + b"\n" for line in text.splitlines()]


@cache
def converted(name: str) -> str:
    return gcode_tools.converted(as_lines(SLICES[name]), load("paper"))[0].decode()


@cache
def with_commands(text: str) -> list[str]:
    """Return the lines with Klipper's commands where Moonraker adds them behind other labels."""
    names, lines, within = [*OBJECTS], list[str](), ""
    for line in text.splitlines():
        lines.append(line)
        if line.startswith("EXCLUDE_OBJECT_") and "DEFINE" not in line:
            within = line.partition("START NAME=")[2]
        elif found := LABEL.match(line):
            name = "" if found[1] else found[2] or found[3]
            name = names[int(name)] if name.isdigit() else name
            if within:
                lines.append(f"EXCLUDE_OBJECT_END NAME={within}")
            within = name if name in OBJECTS else ""
            if within:
                lines.append(f"EXCLUDE_OBJECT_START NAME={within}")
    return lines


def visits(lines: list[str], at: int, name: str) -> tuple[int, Array, float]:
    """Exclude an object before line ``at``; return how often the head is in it after that.

    That is counted from its next label on, once Klipper has seen the five extrusions that it needs.
    The results are that, where the head ends, and the filament inside.
    """
    places, before = head([*lines[:at], f"EXCLUDE_OBJECT NAME={name}", *lines[at:]])
    begun = f"EXCLUDE_OBJECT_START NAME={name}"
    extrusions = np.cumsum(np.diff(places[:, 3], prepend=0.0) > 0.0)
    known = int(np.searchsorted(extrusions, extrusions[before[at] - 1] + 5))
    later = (k for k in range(at, len(lines)) if lines[k] == begun and before[k] > known)
    since = before[next(later, len(lines) - 1) + 1] - 1
    corner = np.array(OBJECTS[name])
    off = np.abs(places[since:, :2] - corner - SIDE / 2)
    inside = (off < SIDE / 2 + 0.5).all(axis=1)
    fed = np.diff(places[since:, 3], prepend=places[since, 3])
    low = places[since:, 2] < 0.2 * LAYERS + 0.1
    return int((inside & low)[1:].sum()), places[-1], float(np.maximum(fed, 0.0)[inside].sum())


@pytest.mark.klipper
@pytest.mark.parametrize("name", few([*SLICES], 6))
@pytest.mark.parametrize("excluded", few([*OBJECTS], 1))
def test_the_head_does_not_go_to_an_excluded_object(name: str, excluded: str) -> None:
    """It ends where it ends as sliced, with as much filament.

    A travel in front of its label is made as sliced. OrcaSlicer's spiral lift would be inside.
    """
    results = []
    for text in (SLICES[name], converted(name)):
        lines = with_commands(text)
        other = "EXCLUDE_OBJECT_START NAME=" + ("B" if excluded != "B" else "C")
        at = [k for k, line in enumerate(lines) if line == other][1]
        results.append(visits(lines, at + 1, excluded))
    (as_sliced, end, fed), (found, our_end, ours) = results
    assert found <= (0 if name in INSIDE else as_sliced)
    assert ours == pytest.approx(fed, abs=1e-6)
    np.testing.assert_allclose(our_end, end, atol=0.01)


@pytest.mark.klipper
@pytest.mark.parametrize("name", few(INSIDE, 1))
@pytest.mark.parametrize("lines", [4, pytest.param(60, marks=pytest.mark.slow)])
def test_wherever_an_object_is_excluded_it_is_left_alone(name: str, lines: int) -> None:
    text = with_commands(converted(name))
    begun = next(k for k, line in enumerate(text) if "OBJECT_START" in line)
    rng = np.random.default_rng(lines)
    end = head(with_commands(SLICES[name]))[0][-1]
    for at in rng.integers(begun + 500, len(text) - 20, lines).tolist():
        found, place, _ = visits(text, at, str(rng.choice([*OBJECTS])))
        assert not found, at
        np.testing.assert_allclose(place[:3], end[:3], atol=0.01)


def test_labels_cost_hardly_any_time() -> None:
    """The move after an object is not compensated; the print takes as long as without labels."""
    texts = SLICES["M486"], re.sub("(?m)^M486.*\n", "", SLICES["M486"])
    both = (gcode_tools.converted(as_lines(text), load("paper"))[1].duration for text in texts)
    assert next(both) == pytest.approx(next(both), rel=0.005)


@pytest.mark.parametrize("then", ["G28", "G92 X0", "PAUSE"])
def test_a_release_right_after_a_copied_move_restores_the_users_limits(then: str) -> None:
    text = SLICES["Klipper's commands"].splitlines()
    at = [k for k, line in enumerate(text) if line == "EXCLUDE_OBJECT_START NAME=B"][1] + 3
    file = as_lines("\n".join([*text[:at], then]))
    out = gcode_tools.converted(file, load("paper"))[0].decode().splitlines()
    before = out[: max(k for k, line in enumerate(out) if line == then)]
    assert [line for line in before if line.startswith("SET_VELOCITY_LIMIT")][-1].split()[2] == (
        "ACCEL=10000"
    )
