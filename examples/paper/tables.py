"""Markdown tables: the paper's numbers next to ours, and which of ours were calibrated.

    python -m examples.paper.tables [PRISM.GCODE]

in the folder of this project. With a slice of the paper's prism, sample_gcode/prism.gcode, it
prints the widths of Fig. 11, too.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

import hframe_post as hp
from examples.paper import results
from examples.paper.results import Approximation, Preview, TimeResponse, Widths
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.native.linear import one_blas_thread
from hframe_post.printer.settings import Printer

Row = tuple[str, ...]
COMPARED = ("", "paper", "ours", "calibrated")  # columns

# Tables I and II, descending powers of z without the cancelled root at the origin, with the
# two signs corrected (b_2 of Gxx, a_4 of Gxθ). As text, for the number of their digits.
PRINTED = {
    "Gxx": ("0.07632 -0.231 0.236 -0.0813", "1 -3.577 4.774 -2.815 0.6175"),
    "Gxtheta": (
        "4.246 -29.27 87.51 -147 149.9 -92.76 32.26 -4.865",
        "1 -5.866 14.86 -21 17.83 -9.06 2.535 -0.2987",
    ),
    "Gyy": (
        "0.1646 -0.8951 1.975 -2.199 1.231 -0.2764",
        "1 -4.813 9.386 -9.344 4.845 -1.14 0.06512",
    ),
}


@one_blas_thread()
def computed(printer: Printer, prism: Sequence[bytes] | None) -> str:
    """Return all tables. prism: lines of the slice for Fig. 11, if any."""
    xy = results.path(printer)
    texts = [
        coefficients(coefficients_off()),
        approximation(results.approximations(printer, xy)),
        time_response(results.time_responses(printer, xy)),
        previews(results.previews(printer, xy)),
    ]
    if prism is not None:
        texts.append(
            width_errors([results.widths(printer, prism, printed) for printed in (False, True)])
        )
    return "\n".join(texts)


def markdown(title: str, head: Row, rows: Sequence[Row]) -> str:
    """Return a Markdown table under its title, columns aligned."""
    cells = [head, *rows]
    width = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = [f"{title}\n"]
    for number, row in enumerate(cells):
        lines.append("| " + " | ".join(c.ljust(w) for c, w in zip(row, width, strict=True)) + " |")
        if number == 0:
            lines.append("|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(lines) + "\n"


def transfer_functions() -> dict[str, TransferFunction]:
    """Return Gxx, Gyy, Gxtheta as the profile of the paper's printer writes them."""
    text = files("hframe_post.printer").joinpath("profiles/paper.toml").read_text("utf-8")
    plant = tomllib.loads(text)["plant"]
    roots = {
        name: [[complex(*pair) for pair in plant[name][key]] for key in ("zeros", "poles")]
        for name in PRINTED
    }
    return {
        name: TransferFunction(np.array(zeros), np.array(poles), plant[name]["gain"])
        for name, (zeros, poles) in roots.items()
    }


def coefficients_off() -> dict[str, float]:
    """Return the largest distance of each printed coefficient, in half units of its last digit.

    At most 1: the model is among those that the printed tables may mean.
    """
    off = {}
    functions = transfer_functions()
    for name, texts in PRINTED.items():
        G = functions[name]
        gain = G.gain * (1e3 if name == "Gxtheta" else 1.0)  # rad/mm to rad/m
        worst = 0.0
        for text, roots, factor in zip(texts, (G.zeros, G.poles), (gain, 1.0), strict=True):
            printed = np.array(text.split(), dtype=float)
            digits = np.floor(np.log10(np.abs(printed))) - 3  # four significant ones are printed
            ours = factor * np.poly(roots).real
            worst = max(worst, float((np.abs(ours - printed) / (0.5 * 10.0**digits)).max()))
        off[name] = worst
    return off


def coefficients(off: dict[str, float]) -> str:
    """Return the distances of the model's coefficients from those printed in Tables I and II."""
    calibrated = "chosen inside the rounding; two signs corrected"
    rows = [(n, "within 1 (rounding)", f"{worst:.2f}", calibrated) for n, worst in off.items()]
    title = "Tables I, II: coefficients off the print, in half units of a digit"
    return markdown(title, COMPARED, rows)


def approximation(rows: Sequence[Approximation]) -> str:
    head = (
        "n / E", "n", "decoupled µm", "coupled µm", "decoupled ms", "coupled ms", "times as fast",
    )  # fmt: skip
    cells = []
    for row in rows:
        um, ms = [1e3 * rms for rms in row.rms], [1e3 * seconds for seconds in row.seconds]
        numbers = (f"{um[0]:.2f}", f"{um[1]:.2f}", f"{ms[0]:.1f}", f"{ms[1]:.1f}")
        cells.append((f"{row.share:.2f}", f"{row.n}", *numbers, f"{ms[1] / ms[0]:.1f}"))
    title = "Fig. 8: decoupled (eq. 12, 19) and coupled (eq. 18), RMS contour error"
    return markdown(title, head, cells)


def time_response(responses: Sequence[TimeResponse]) -> str:
    um = {response.name: response.rms * 1e3 for response in responses}
    rows = [
        ("no compensation, µm", "not given", f"{um['none']:.1f}", "no"),
        ("without racking compensation, µm", "117", f"{um['fbs']:.1f}",
         "yes: slope of Gxθ at rest"),
        ("with racking compensation, µm", "9", f"{um['racking']:.1f}", "no"),
        ("ratio of the last two", "13", f"{um['fbs'] / um['racking']:.1f}", "no"),
    ]  # fmt: skip
    return markdown("Fig. 9: RMS contour error, n = 125", COMPARED, rows)


def previews(ways: Sequence[Preview]) -> str:
    rows = [(way.name, f"{way.rms * 1e3:.2f}", f"{way.seconds * 1e3:.1f}") for way in ways]
    head = ("", "RMS contour error, µm", "time, ms")
    return markdown("Appendix C: limited preview, the profile's window, Fig. 7's path", head, rows)


def width_errors(prisms: Sequence[Widths]) -> str:
    rows = []
    for measure, printed in (("RMS", ("43 %", "68 %")), ("median", ("61 %", "78 %"))):
        for prism in prisms:
            um = {
                name: 1e3 * (prism.rms(name) if measure == "RMS" else prism.median(name))
                for name in prism.error
            }
            rows += [
                (
                    f"{measure} of Δw, {prism.window} window, below {name}",
                    paper,
                    f"{100 * (1 - um['racking'] / um[name]):.0f} % "
                    f"({um[name]:.0f} → {um['racking']:.1f} µm)",
                    "no",
                )
                for name, paper in zip(("fbs", "none"), printed, strict=True)
            ]
    title = "Fig. 11: width of the prism (paper: printed parts; ours: simulated)"
    return markdown(title, COMPARED, rows)


if __name__ == "__main__":
    slices = [Path(name).read_bytes().splitlines(keepends=True) for name in sys.argv[1:2]]
    print(computed(hp.load_printer("paper"), slices[0] if slices else None), end="")
