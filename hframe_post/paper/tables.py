"""The paper's numbers beside ours, and what of ours was calibrated: Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence

from hframe_post.paper.results import Approximation, Preview, TimeResponse
from hframe_post.paper.widths import Widths

Row = tuple[str, ...]


def markdown(title: str, head: Row, rows: Sequence[Row]) -> str:
    """A table under its title, columns aligned."""
    cells = [head, *rows]
    width = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = [f"{title}\n"]
    for number, row in enumerate(cells):
        lines.append("| " + " | ".join(c.ljust(w) for c, w in zip(row, width, strict=True)) + " |")
        if number == 0:
            lines.append("|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(lines) + "\n"


def coefficients(off: dict[str, float]) -> str:
    """Tables I and II: how far the model's coefficients are from the printed ones."""
    rows = [
        (
            name,
            "within 1 (rounding)",
            f"{worst:.2f}",
            "chosen inside the rounding; two signs mended",
        )
        for name, worst in off.items()
    ]
    head = ("", "paper", "ours", "calibrated")
    return markdown(
        "Tables I, II: coefficients off the print, in half units of a digit", head, rows
    )


def approximation(rows: Sequence[Approximation]) -> str:
    """Fig. 8."""
    head = (
        "n / E",
        "n",
        "decoupled µm",
        "coupled µm",
        "decoupled ms",
        "coupled ms",
        "times as fast",
    )
    cells = []
    for row in rows:
        (rms, rms_c), (s, s_c) = row.rms, row.seconds
        cells.append(
            (
                f"{row.share:.2f}", f"{row.n}", f"{rms * 1e3:.2f}", f"{rms_c * 1e3:.2f}",
                f"{s * 1e3:.1f}", f"{s_c * 1e3:.1f}", f"{s_c / s:.1f}",
            )
        )  # fmt: skip
    return markdown(
        "Fig. 8: decoupled (eq. 12, 19) and coupled (eq. 18), RMS contour error", head, cells
    )


def time_response(responses: Sequence[TimeResponse]) -> str:
    """Fig. 9."""
    um = {response.name: response.rms * 1e3 for response in responses}
    rows = [
        ("no compensation, µm", "not told", f"{um['none']:.1f}", "no"),
        (
            "without racking compensation, µm",
            "117",
            f"{um['fbs']:.1f}",
            "yes: slope of Gxθ at rest",
        ),
        ("with racking compensation, µm", "9", f"{um['racking']:.1f}", "no"),
        ("ratio of the last two", "13", f"{um['fbs'] / um['racking']:.1f}", "no"),
    ]
    return markdown("Fig. 9: RMS contour error, n = 125", ("", "paper", "ours", "calibrated"), rows)


def previews(ways: Sequence[Preview]) -> str:
    """Appendix C with the profile's window."""
    rows = [(way.name, f"{way.rms * 1e3:.2f}", f"{way.seconds * 1e3:.1f}") for way in ways]
    head = ("", "RMS contour error, µm", "time, ms")
    return markdown("Appendix C: limited preview, the profile's window, Fig. 7's path", head, rows)


def width_errors(prisms: Sequence[Widths]) -> str:
    """Fig. 11."""
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
    return markdown(title, ("", "paper", "ours", "calibrated"), rows)
