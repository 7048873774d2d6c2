"""Changes to a profile's TOML text that leave the rest of it, and its comments, alone."""

from __future__ import annotations

import re
from pathlib import Path

from hframe_post.errors import PrinterError
from hframe_post.lpfbs import Window
from hframe_post.printer import parse, shipped

_SECTION = re.compile(r"^\s*\[\s*compensation\s*\]", re.MULTILINE)
_NEXT = re.compile(r"^\s*\[", re.MULTILINE)


def with_windows(name_or_path: str, windows: tuple[Window, Window]) -> str:
    """The text of that profile with these windows. A shipped one is extended, not copied.

    Raises PrinterError where the text is laid out so that it cannot be changed safely.
    """
    x, y = windows
    values = {
        "L": f"{x.L}",
        "n_C": f"{x.n_C}",
        "n_up": f"{x.n_up}",
        "effort": f"[{float(x.effort)}, {float(y.effort)}]",
    }
    settings = [f"{key} = {value}" for key, value in values.items()]
    if name_or_path in shipped():
        return "\n".join([f'extends = "{name_or_path}"', "", "[compensation]", *settings, ""])
    text = Path(name_or_path).read_bytes().decode("utf-8")  # the ends of its lines stay
    newline = "\r\n" if "\r\n" in text else "\n"
    section = _SECTION.search(text)
    if section is None:
        changed = newline.join([text.rstrip(), "", "[compensation]", *settings, ""])
    else:
        following = _NEXT.search(text, section.end())
        end = following.start() if following else len(text)
        body = text[section.end() : end]
        for key, value in values.items():
            setting = re.compile(rf"^(\s*{key}\s*=\s*)[^#\n]*?(\s*(?:#.*)?)$", re.MULTILINE)
            if setting.search(body):
                body = setting.sub(rf"\g<1>{value}\g<2>", body, count=1)
            else:
                first, _, rest = body.partition("\n")
                body = f"{first.rstrip()}{newline}{key} = {value}{newline}{rest}"
        changed = text[: section.end()] + body + text[end:]
    try:
        if parse(changed, "tuned").compensation.windows == windows:
            return changed
    except PrinterError:
        pass
    raise PrinterError(
        f"write these lines yourself: {', '.join(settings)}", "compensation", name_or_path
    )
