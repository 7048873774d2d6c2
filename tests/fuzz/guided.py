"""``python -m tests.fuzz.guided TARGET``: coverage-guided fuzzing with atheris (extra ``fuzz``).

Other arguments are libFuzzer's: -max_total_time=1800, and a folder that keeps what it learned.
Lines are read one by one: it would not see the coverage of compiled loops. It ends at the first
defect, and writes it to crash-…; once it is corrected, that belongs into found/TARGET.
"""

from __future__ import annotations

import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any


def main() -> None:
    """Fuzz one target until libFuzzer ends the process."""
    atheris: Any = import_module("atheris")
    name, *options = sys.argv[1:]
    with atheris.instrument_imports(include=["hframe_post"]):
        targets: Any = import_module("tests.fuzz.targets")
        batching: Any = import_module("hframe_post.gcode.batching")
    batching.plain_moves = import_module("tests.gcode_tools").one_by_one
    with tempfile.TemporaryDirectory() as folder:
        for k, seed in enumerate(targets.seeds(name)):
            Path(folder, str(k)).write_bytes(seed)
        kept = [option for option in options if not option.startswith("-")]
        flags = [option for option in options if option.startswith("-")]
        atheris.Setup(
            [sys.argv[0], "-timeout=60", *flags, *kept, folder],
            lambda data: targets.check(name, data),
        )
        atheris.Fuzz()


if __name__ == "__main__":
    main()
