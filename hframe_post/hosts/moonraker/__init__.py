"""Moonraker's component: convert what is uploaded, measure the printer, keep its model right.

Moonraker imports this folder through a link in its components folder. Whatever takes time runs as
a process (``__main__``) in Moonraker's Python, which in turn runs hframe-post: nothing of that is
imported here, and Moonraker's loop never waits.

While a file is converted it is in FOLDER, and its place is taken by a line of G-code that Klipper
answers with an error, and a comment that names the kept file (``originals``). The sliced file
stays in FOLDER afterwards, so that it can be converted again with a newer profile (``originals``,
``again``), and so does the page of its conversion (``answering``). ``measuring`` lets Klipper
record its accelerometers and hframe-post compute the model.
"""

from __future__ import annotations

from typing import Any

from .component import HframePost


def load_component(config: Any) -> HframePost:
    return HframePost(config)
