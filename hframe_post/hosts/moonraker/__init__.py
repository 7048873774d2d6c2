"""Moonraker's component: measure the printer and keep its model right.

Moonraker imports this folder through a link in its components folder. Whatever takes time runs as
a process (``recordings``) in Moonraker's Python, which in turn runs hframe-post: nothing of that is
imported here, and Moonraker's loop never waits. Klipper records its accelerometers while it plays
a file (``component``), and hframe-post computes the model (``recordings``).
"""

from __future__ import annotations

from typing import Any

from .component import HframePost


def load_component(config: Any) -> HframePost:
    return HframePost(config)
