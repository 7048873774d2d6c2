"""``python -m tests.fuzz.guided TEST``: coverage-guided fuzzing with atheris (extra ``fuzz``).

TEST is one of test_fuzz.py; other arguments are libFuzzer's, as -max_total_time=1800. It ends at
the first defect. Once that is corrected, its G-code belongs into the folder ``found``.
"""

import sys
from importlib import import_module
from typing import Any


def main() -> None:
    """Fuzz one test until libFuzzer ends the process."""
    atheris: Any = import_module("atheris")
    name, *options = sys.argv[1:]
    with atheris.instrument_imports(include=["hframe_post"]):
        tests: Any = import_module("tests.fuzz.test_fuzz")
    test = getattr(tests, name).hypothesis.fuzz_one_input
    atheris.Setup([sys.argv[0], "-timeout=60", *options], test)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
