"""``hframe-post calibrate-print``: a model without a sensor, from waves on printed walls."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from hframe_post.cli.model_output import Findings, Rows, publish
from hframe_post.cli.parameters import (
    READ,
    WRITTEN,
    ask,
    files_read,
    pair,
    percent,
    quoted,
    say,
    share,
    shared,
)
from hframe_post.errors import HframeError
from hframe_post.printer.model_file import measured
from hframe_post.printer.profile import check_identified, load
from hframe_post.writers.outputs import Outputs

if TYPE_CHECKING:  # these import SciPy, which takes a second
    from hframe_post.model.plant import Plant
    from hframe_post.printer.settings import Printer

FORM = ".form.toml"
NO_WINDOW = "the motors' limits are too low to compensate these waves: raise both under [motors]"


_heat = pair("°C of nozzle and bed, such as 210,60", (150.0, 320.0), (0.0, 130.0))


def _shift(text: str) -> float:
    """Read ``-6%`` or ``0`` as a share."""
    value = percent(text)
    if not -0.3 <= value <= 0.3:
        raise click.BadParameter(f"{text!r} is not a change of at most 30%, such as -6%")
    return value


@click.command("calibrate-print")
@click.option(
    "-o", "--output", required=True, type=WRITTEN, metavar="FILE",
    help="The G-code to print; with --form or --pick the profile to write.",
)  # fmt: skip
@shared("printer")
@click.option(
    "--form", type=READ, metavar="FORM.TOML", help="The form, filled in: what the walls show."
)
@click.option(
    "--compare", type=share, metavar="SHARE",
    help="Print three squares next to each other: for lower frequencies by this share, for the "
    "profile's, and for higher ones.",
)  # fmt: skip
@click.option(
    "--pick", type=(_shift, _shift), metavar="X Y",
    help="Change the model by what the best square has in x and in y, such as --pick -6% 0.",
)  # fmt: skip
@click.option(
    "--heat", type=_heat, metavar="NOZZLE,BED",
    help="Temperatures of what is printed, °C, such as 210,60 for PLA. Default: asked on a "
    "terminal.",
)  # fmt: skip
def calibrate_print(
    output: Path, printer: str, form: Path | None, compare: float | None,
    pick: tuple[float, float] | None, heat: tuple[float, float] | None,
) -> None:  # fmt: skip
    """Measure a printer by two small prints and a ruler, where there is no accelerometer.

    First print the tower, note in the form next to it how far apart its waves are, and read the
    form. Then print three squares, pick the better one in x and in y, and do that once more with
    half the share. The model has one resonance an axis and no racking.

    \b
    Examples:
      hframe-post calibrate-print --heat 210,60 -o tower.gcode
      hframe-post calibrate-print --form tower.form.toml -o printer.toml
      hframe-post calibrate-print --heat 210,60 --compare 6% -o three.gcode
      hframe-post calibrate-print --pick 0 6% -o printer.toml
    """
    if sum(choice is not None for choice in (form, compare, pick)) > 1:
        raise click.UsageError("give one of --form, --compare and --pick")
    profile = load(printer)
    if form is not None:
        _read(form, output, printer, profile)
        return
    if pick is not None or compare is not None:
        check_identified(profile)
    if pick is not None:
        _picked(pick, output, printer, profile)
    elif compare is not None:
        _compare(compare, output, printer, profile, heat or _asked())
    else:
        _tower(output, printer, profile, heat or _asked())


def _asked() -> tuple[float, float]:
    """Return °C of nozzle and bed, which only the owner knows."""
    question = "Temperatures of your filament, °C of nozzle and bed, such as 210,60"
    unknown = click.UsageError(
        "give the temperatures of your filament, °C of nozzle and bed: --heat 210,60 for PLA"
    )
    heat: tuple[float, float] = ask(question, unknown, value_proc=_heat)
    return heat


def _tower(output: Path, printer: str, profile: Printer, heat: tuple[float, float]) -> None:
    from hframe_post.identification.by_eye import form
    from hframe_post.identification.tower import bands, tower

    lines = tower(profile, heat)
    empty = form(bands(profile), profile.limits.acceleration)
    target = output.with_name(f"{output.stem}{FORM}")
    with Outputs(files_read(printer)) as outputs:
        outputs.open(output).write("\n".join([*lines, ""]).encode())
        outputs.open(target).write(empty.encode())
    say(
        f"Print {output}. Measure the waves on its right and back wall with a ruler, and fill in "
        f"{target}, which says how. Next: hframe-post calibrate-print -p {quoted(printer)} --form "
        f"{quoted(target)} -o {quoted(printer)}"
    )


def _read(form: Path, output: Path, printer: str, profile: Printer) -> None:
    from hframe_post.identification.by_eye import filled, uncertainty
    from hframe_post.model.plant import Plant

    sheet = filled(form.read_text("utf-8"), str(form))
    modes = sheet.modes()
    for axis, mode in modes.items():
        rows = (f"{axis}{k} {hz:.1f} Hz" for k, hz in enumerate(mode.rows, 1) if hz)
        say(f"rows         {', '.join(rows)}")
    for doubt in sheet.doubts(modes, profile.kinematics.bed_moves):
        say(f"LOOK AGAIN   {doubt}")
    if profile.kinematics.racks:
        say("note         a print does not show racking: the profile cancels ringing only")
    x, y = (mode.response() for mode in modes.values())
    plant = Plant(x, y, None, sum(profile.travel.x) / 2.0)
    off = uncertainty(modes.values())
    shown = [f"{axis}: {one.hz:.1f} Hz, damping ratio {one.damping:.2f}"
             for axis, one in modes.items()]  # fmt: skip
    by = max(6.0, 50.0 * off)  # %, as a ruler reads a frequency
    _publish(
        output, printer, profile, plant, off, [f"Read from {form.name}", *shown],
        f"hframe-post calibrate-print -p {quoted(output)} --compare {by:.0f}% -o three.gcode",
    )  # fmt: skip


def _compare(
    by: float, output: Path, printer: str, profile: Printer, heat: tuple[float, float]
) -> None:
    from hframe_post.identification.tower import squares

    if not 0.0 < by <= 0.3:
        raise click.UsageError("--compare takes a share above 0% and up to 30%")
    plants = [_shifted(profile.plant, change, change) for change in (-by, 0.0, by)]
    with Outputs(files_read(printer)) as outputs:
        outputs.open(output).writelines(squares(profile, plants, heat))
    low, high = f"-{100.0 * by:g}%", f"{100.0 * by:g}%"
    say(
        f"Print {output}. Which square has the fewest waves on its right wall (x), which on its "
        f"back wall (y)? The left one is {low}, the middle one 0, the right one {high}. For the "
        "left one in x and the middle one in y, run hframe-post calibrate-print -p "
        f"{quoted(printer)} --pick {low} 0 -o {quoted(printer)}"
    )


def _picked(pick: tuple[float, float], output: Path, printer: str, profile: Printer) -> None:
    x, y = pick
    plant = _shifted(profile.plant, x, y)
    note = f"Frequencies changed by {100.0 * x:+g} % in x and {100.0 * y:+g} % in y, by eye"
    off = profile.uncertainty or 0.05  # as far as printers usually are off their models
    again = "compare once more, with half the share, and pick again. Then convert a print"
    _publish(output, printer, profile, plant, off, [note], again)


def _shifted(plant: Plant, x: float, y: float) -> Plant:
    """Return the plant with frequencies changed by shares in x and in y."""
    return plant.perturbed(np.array([[1.0 + x, 1.0, 1.0], [1.0 + y, 1.0, 1.0], np.ones(3)]))


def _publish(
    output: Path, printer: str, profile: Printer, plant: Plant, off: float, notes: list[str],
    advice: str,
) -> None:  # fmt: skip
    """Write the profile with a plant, and with windows for printers that differ by a share."""

    def find() -> Findings:
        from hframe_post.studies.tuning import recommend

        found = recommend(plant, profile, off)
        if found is None:
            raise HframeError(NO_WINDOW)
        model = measured(profile, plant, round(off, 3), None).with_windows(found.windows)
        rows = [("read", "; ".join(notes)), ("uncertainty", f"±{100.0 * off:.0f} %")]
        report = Rows([*rows, *found.rows()], found.as_json())
        return Findings(report, model, notes=notes, advice=advice)

    publish(find, files_read(printer), printer, output)
