"""``python -m tests.identification.strangers``: drawn printers are swept, identified and judged.

Each is drawn by its seed (`tests.strangers.drawn`), swept as whole motor steps of 20.6 µm, and
identified. A rectangle and the first layers of a cube then tell, on the true printer, what is left
without compensation, with the profile that was found, and with the exact model in the same window.
Rows are appended to --rows as they come, and seeds that it holds are not done again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hframe_post.errors import HframeError
from hframe_post.identification.identify import Identified
from tests.strangers import CLASSES, drawn, identified, judged, printer, swept

PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)  # mm of x
STEP = 0.0206  # mm of belt
PATHS = ("rectangle", "cube")


def main() -> int:
    """0 where no printer is worse off than without compensation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="how many printers")
    parser.add_argument("--seed", type=int, default=0, help="of the first")
    parser.add_argument("--rows", type=Path, default=Path("strangers.jsonl"))
    given = parser.parse_args()
    done = {row["seed"] for row in _rows(given.rows)}
    for seed in range(given.seed, given.seed + given.count):
        if seed not in done:
            row = judge(seed)
            with given.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row, file=sys.stderr, flush=True)
    rows = _rows(given.rows)
    print(table(rows))
    return int(any(_worse(row) for row in rows))


def judge(seed: int) -> dict[str, Any]:
    """What was made of one printer, µm RMS on the true one."""
    begun = time.process_time()
    machine, chip, fault = drawn(seed)
    row: dict[str, Any] = {"seed": seed, "class": fault, "kinematics": machine.kinematics}
    try:
        found = identified(machine, swept(machine, chip, PLACES, PLACES[:3:2], seed, step=STEP))
        refused = found.refusal
    except HframeError as error:
        found, refused = None, str(error)
    row["refused"] = refused
    if found is not None:
        gains = zip("xy", chip.gains, strict=False)
        row["gain_off"] = max(abs(found.gains[axis] / gain - 1.0) for axis, gain in gains)
        row["told"] = told(found)
    if found is not None and refused is None:
        profile = printer(machine)
        own = replace(profile, plant=found.plant(machine.x_c))
        for path in PATHS:
            errors = judged(machine, own, path)
            row[path] = {"none": errors.none, "compensated": errors.compensated}
            if fault == "linear":
                exact = replace(profile, plant=machine.exact())
                row[path]["exact"] = judged(machine, exact, path).compensated
    return row | {"cpu_s": round(time.process_time() - begun, 1)}


def told(found: Identified) -> list[str]:
    """Causes and warnings."""
    causes = [found.nonlinearity.cause] if found.nonlinearity else []
    causes += ["along x"] if found.mode_shift else []
    if causes:
        return causes
    return [text for fit in found.fits.values() for text in fit.warnings]


def table(rows: Iterable[dict[str, Any]]) -> str:
    """Markdown, a line for each class of printers."""
    lines = [
        "| class | printers | refused | worse | rectangle | cube | to exact | gain off by | told |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in CLASSES:
        own = [row for row in rows if row["class"] == name]
        if own:
            lines.append(f"| {name} | {len(own)} | {' | '.join(_columns(own))} |")
    return "\n".join(lines)


def _columns(rows: list[dict[str, Any]]) -> list[str]:
    refused = sum(row["refused"] is not None for row in rows)
    judged = [row for row in rows if "cube" in row]
    columns = [str(refused), str(sum(_worse(row) for row in rows))]
    for path in PATHS:
        none, left = ([row[path][name] for row in judged] for name in ("none", "compensated"))
        columns.append(f"{np.median(none):.0f} → {np.median(left):.1f} µm" if judged else "–")
    ratios = [
        row[path]["compensated"] / row[path]["exact"]
        for row in judged
        for path in PATHS
        if "exact" in row[path]
    ]
    columns.append(f"{np.median(ratios):.2f}, at most {max(ratios):.2f}" if ratios else "–")
    gains = [row["gain_off"] for row in rows if "gain_off" in row]
    columns.append(f"{100 * max(gains):.1f} %" if gains else "–")
    causes = sorted({text[:40] for row in rows for text in row.get("told", [])})
    counted = [f"{cause} {sum(cause in _short(row) for row in rows)}" for cause in causes]
    return [*columns, ", ".join(counted) or "nothing"]


def _short(row: dict[str, Any]) -> list[str]:
    return [text[:40] for text in row.get("told", [])]


def _worse(row: dict[str, Any]) -> bool:
    parts = [row[path] for path in PATHS if path in row]
    return any(part["compensated"] > part["none"] for part in parts)


def _rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


if __name__ == "__main__":
    sys.exit(main())
