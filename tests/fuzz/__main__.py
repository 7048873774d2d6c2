"""``python -m tests.fuzz``: checks of mutated slices, arcs, profiles and other files.

A seed gives the same case on any machine. Failing G-code is written into the folder of --keep.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from random import Random

from tests.conftest import ROOT, SAMPLES
from tests.fuzz import mutations
from tests.fuzz.cases import KINDS, begin, run


def main() -> int:
    """Return 0 if no case was a defect."""
    options = _arguments()
    folders = (SAMPLES, ROOT / "tests" / "quirks", *(options.seeds or []))
    defects = 0
    with ProcessPoolExecutor(options.jobs, initializer=begin, initargs=(folders,)) as pool:
        for kind in options.kind or KINDS:
            count = options.count if kind in ("gcode", "arcs") else max(options.count // 5, 1)
            cases = range(options.seed, options.seed + count)
            found: Counter[str] = Counter()
            slowest, largest = (0.0, 0), (0, 0)  # and their seeds
            one = partial(run, kind, folders, options.played)
            for seed, outcome in pool.map(one, cases, chunksize=5):
                found[outcome.word] += 1
                if found.total() % 500 == 0:
                    print(f"{kind}: {found.total()} cases", file=sys.stderr, flush=True)
                slowest = max(slowest, (outcome.seconds, seed))
                largest = max(largest, (outcome.memory, seed))
                if outcome.defect:
                    defects += 1
                    print(f"--- {kind} {seed}\n{outcome.defect}", flush=True)
                    if options.keep and kind == "gcode":
                        options.keep.mkdir(parents=True, exist_ok=True)
                        text = mutations.gcode(Random(seed), mutations.seeds(folders))
                        (options.keep / f"{seed}.gcode").write_bytes(text)
            print(f"{kind}: {count} cases, {dict(found.most_common())}")
            print(f"at most {slowest[0]:.1f} s of processor time (seed {slowest[1]})", end="")
            print(
                f" and {largest[0] >> 20} MB of additional memory (seed {largest[1]})", flush=True
            )
    return min(defects, 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", "--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seeds", type=Path, action="append", help="more folders of slices")
    parser.add_argument("--played", type=int, default=100, metavar="N",
                        help="Klipper plays one of N cases; 0: none")  # fmt: skip
    parser.add_argument("--keep", type=Path, help="folder for G-code that failed")
    return parser.parse_args()


if __name__ == "__main__":
    raise SystemExit(main())
