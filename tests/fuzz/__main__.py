"""``python -m tests.fuzz``: mutated slices, arcs, profiles and recordings, as many as asked for.

A seed gives the same case anywhere; what fails is written into the folder of --keep.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from random import Random

from tests.conftest import ROOT, SAMPLES
from tests.fuzz import mutations
from tests.fuzz.cases import KINDS, run


def main() -> int:
    """0 where no case was a defect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", "--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seeds", type=Path, action="append", help="more folders of slices")
    parser.add_argument("--keep", type=Path, help="folder for what failed")
    given = parser.parse_args()
    folders = (SAMPLES, ROOT / "tests" / "quirks", *(given.seeds or []))
    defects = 0
    with ProcessPoolExecutor(given.jobs, max_tasks_per_child=500) as pool:
        for kind in given.kind or KINDS:
            count = given.count if kind in ("gcode", "arcs") else given.count // 5
            cases = range(given.seed, given.seed + count)
            found: Counter[str] = Counter()
            for seed, word, defect in pool.map(partial(run, kind, folders), cases, chunksize=20):
                found[word] += 1
                if defect:
                    defects += 1
                    print(f"--- {kind} {seed}\n{defect}", flush=True)
                    if given.keep and kind == "gcode":
                        given.keep.mkdir(parents=True, exist_ok=True)
                        text = mutations.gcode(Random(seed), mutations.seeds(folders))
                        (given.keep / f"{seed}.gcode").write_bytes(text)
            print(kind, dict(found), flush=True)
    return min(defects, 1)


if __name__ == "__main__":
    raise SystemExit(main())
