"""Changes to a profile's TOML text that leave the rest of it, and its comments, alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hframe_post.arrays import TS, Complex
from hframe_post.errors import PrinterError
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.profile import parse, shipped
from hframe_post.printer.settings import Printer

_HEADER = re.compile(
    r"^[ \t]*\[[ \t]*([A-Za-z_][\w.\- \t]*?)[ \t]*\][ \t]*(?:#.*)?\r?$", re.MULTILINE
)


def with_windows(name_or_path: str, windows: tuple[Window, Window]) -> str:
    """The text of that profile with these windows. A shipped one is extended, not copied.

    Raises PrinterError where the text is laid out so that it cannot be changed safely.
    """
    own, newline = _own(name_or_path)
    changed = _set_windows(own, windows)
    printer = _parsed(changed, name_or_path)
    if printer is None or printer.compensation.windows != windows:
        lines = ", ".join(f"{key} = {value}" for key, value in _settings(windows).items())
        raise PrinterError(f"write these lines yourself: {lines}", "compensation", name_or_path)
    return changed.replace("\n", newline)


def with_plant(
    name_or_path: str, plant: Plant, windows: tuple[Window, Window], notes: Sequence[str]
) -> str:
    """The text of that profile with this plant, told about in ``notes``, and these windows.

    A shipped one is extended. Raises PrinterError where the text cannot be changed safely.
    """
    own, newline = _own(name_or_path)
    kept = _without(own, "plant").rstrip()
    changed = f"{_set_windows(kept, windows).rstrip()}\n\n{_plant(plant, notes)}"
    printer = _parsed(changed, name_or_path)
    if printer is None or printer.compensation.windows != windows:
        raise PrinterError(
            "this file cannot be changed: extend a shipped profile", "", name_or_path
        )
    return changed.replace("\n", newline)


def _own(name_or_path: str) -> tuple[str, str]:
    """What that profile's own file says, and how its lines end. A shipped one is extended."""
    if name_or_path in shipped():
        return f'extends = "{name_or_path}"\n', "\n"
    text = Path(name_or_path).read_bytes().decode("utf-8")
    if 0 < text.count("\n") == text.count("\r\n"):
        return text.replace("\r\n", "\n"), "\r\n"
    return text, "\n"


def _parsed(text: str, source: str) -> Printer | None:
    try:
        return parse(text, source)
    except PrinterError:
        return None


def _settings(windows: tuple[Window, Window]) -> dict[str, str]:
    x, y = windows
    return {
        "L": f"{x.L}",
        "n_C": f"{x.n_C}",
        "n_up": f"{x.n_up}",
        "effort": f"[{float(x.effort)}, {float(y.effort)}]",
    }


def _set_windows(text: str, windows: tuple[Window, Window]) -> str:
    """The text with these values in its table ``compensation``, which is added if need be."""
    sections = list(_HEADER.finditer(text))
    own = [k for k, header in enumerate(sections) if header[1] == "compensation"]
    if not own:
        lines = "".join(f"{key} = {value}\n" for key, value in _settings(windows).items())
        return f"{text.rstrip()}\n\n[compensation]\n{lines}"
    start = sections[own[0]].end()
    end = sections[own[0] + 1].start() if own[0] + 1 < len(sections) else len(text)
    body = text[start:end]
    for key, value in reversed(_settings(windows).items()):
        setting = re.compile(rf"^(\s*{key}\s*=\s*)[^#\n]*?(\s*(?:#.*)?)$", re.MULTILINE)
        if setting.search(body):
            body = setting.sub(rf"\g<1>{value}\g<2>", body, count=1)
        else:
            body = f"\n{key} = {value}{body}"
    return text[:start] + body + text[end:]


def _without(text: str, table: str) -> str:
    """The text without a table and those within it."""
    sections = list(_HEADER.finditer(text))
    ends = [*(header.start() for header in sections[1:]), len(text)]
    kept = [text[: sections[0].start()] if sections else text]
    for header, end in zip(sections, ends, strict=False):
        if header[1] != table and not header[1].startswith(f"{table}."):
            kept.append(text[header.start() : end])
    return "".join(kept)


def _plant(plant: Plant, notes: Sequence[str]) -> str:
    """The table ``plant`` with notes, and its transfer functions.

    What does not rack says so by a gain of zero: the profile that is extended may rack.
    """
    silent = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)
    functions = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta or silent}
    comments = "".join(f"# {note}".rstrip() + "\n" for note in notes)
    head = f"[plant]\n{comments}Ts = {TS}\nx_c = {plant.x_c!r}\n"
    return head + "".join(_transfer_function(name, G) for name, G in functions.items())


def _transfer_function(name: str, G: TransferFunction) -> str:
    roots = {"zeros": G.zeros, "poles": G.poles}
    lists = "".join(f"{key} = [{_pairs(values)}]\n" for key, values in roots.items())
    return f"\n[plant.{name}]\ngain = {G.gain!r}\n{lists}"


def _pairs(roots: Complex) -> str:
    pairs = (f"    [{root.real!r}, {root.imag!r}],\n" for root in (roots + 0.0).tolist())
    return "\n" + "".join(pairs) if len(roots) else ""
