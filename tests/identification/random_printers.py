"""``python -m tests.identification.random_printers``: identify simulated printers and judge them.

A seed gives each printer and its faults (`tests.random_printers.drawn`). Its sweeps consist of
motor steps of 20.6 µm. A rectangle and the first layers of a cube are then played on the true one:
without compensation, with the identified profile, and with the exact model in the same window.
Each printer is a row that is appended to --rows; seeds with a row are skipped.
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
from tests.random_printers import CLASSES, drawn, identified, judged, places, printer, swept

STEP = 0.0206  # mm of belt
PATHS = ("rectangle", "cube")


def main() -> int:
    """Return 1 if a printer is worse than without compensation, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="number of printers")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first printer")
    parser.add_argument("--rows", type=Path, default=Path("random_printers.jsonl"))
    options = parser.parse_args()
    done = {row["seed"] for row in _rows(options.rows)}
    for seed in range(options.seed, options.seed + options.count):
        if seed not in done:
            row = judge(seed)
            with options.rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row, file=sys.stderr, flush=True)
    rows = _rows(options.rows)
    print(table(rows))
    return int(any(_worse(row) for row in rows))


def judge(seed: int) -> dict[str, Any]:
    """Identify one printer and return its row, errors in µm RMS."""
    start = time.process_time()
    machine, chip, fault = drawn(seed)
    row: dict[str, Any] = {"seed": seed, "class": fault, "kinematics": machine.kinematics}
    try:
        found = identified(machine, swept(machine, chip, *places(machine), seed, step=STEP))
        refused = found.refusal
    except HframeError as error:
        found, refused = None, str(error)
    row["refused"] = refused
    if found is not None:
        gains = zip("xy", chip.gains, strict=False)
        row["gain_off"] = max(abs(found.gains[axis] / gain - 1.0) for axis, gain in gains)
        row["causes"] = causes(found)
    if found is not None and refused is None:
        profile = printer(machine)
        own = replace(profile, plant=found.plant(machine.x_c))
        for path in PATHS:
            errors = judged(machine, own, path)
            row[path] = {"none": errors.none, "compensated": errors.compensated}
            if fault == "linear":
                exact = replace(profile, plant=machine.exact())
                row[path]["exact"] = judged(machine, exact, path).compensated
    return row | {"cpu_s": round(time.process_time() - start, 1)}


def causes(found: Identified) -> list[str]:
    """Return the causes of faults that were reported."""
    return ["along x"] if found.mode_shift else []


def table(rows: Iterable[dict[str, Any]]) -> str:
    """Return a Markdown table with a row for each class of printers."""
    lines = [
        "| class | printers | refused | worse | rectangle | cube | relative to exact | gain error "
        "| reported cause |",
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
    reported = sorted({text[:40] for row in rows for text in row.get("causes", [])})
    counted = [f"{cause} {sum(cause in _short(row) for row in rows)}" for cause in reported]
    return [*columns, ", ".join(counted) or "none"]


def _short(row: dict[str, Any]) -> list[str]:
    return [text[:40] for text in row.get("causes", [])]


def _worse(row: dict[str, Any]) -> bool:
    parts = [row[path] for path in PATHS if path in row]
    return any(part["compensated"] > part["none"] for part in parts)


def _rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


if __name__ == "__main__":
    sys.exit(main())
