"""``hframe-post speed``: print time against permitted error."""

from __future__ import annotations

from pathlib import Path

import click

from hframe_post import library
from hframe_post.cli.json_summary import json_option, open_json
from hframe_post.cli.options import (
    bar,
    chosen_printer,
    conversion_options,
    files_read,
    help_all_option,
    page_option,
    printer_option,
)
from hframe_post.conversion.options import Options
from hframe_post.writers.outputs import Outputs


@click.command()
@click.argument("source", metavar="IN.GCODE", type=click.Path(path_type=Path))
@printer_option
@conversion_options("limits", "extrusion", "max_width_error")
@help_all_option
@json_option
@page_option
def speed(
    source: Path, printer: str, options: Options, json_file: Path | None, report_file: Path | None
) -> None:
    """Show how long a file takes within each error, and what limits its speed.

    Each row is a print that 'hframe-post convert --max-error' would make, with the file's feed
    rates and with --speed-up max. The report also has the width of the lines and what limits each
    row. Nothing is written.

    \b
    Example:
      hframe-post speed part.gcode -p my.toml --report speed.html
    """
    from hframe_post.page.speed_page import speed_page
    from hframe_post.studies.speed_curve import curve_as_json, curve_as_text

    profile, choice = library.load_printer(printer), chosen_printer()
    with Outputs(files_read(source, printer)) as outputs:
        write_json = open_json(outputs, json_file)
        html = outputs.open(report_file) if report_file is not None else None
        with bar(1.0, source.name) as advance:
            found = library.speed_curve(source, profile, options, advance)
        write_json({**choice.as_json(), **curve_as_json(found)})
        if html is not None:
            html.write(speed_page(found, profile, source.name))
    text = "\n".join([choice.as_text(), curve_as_text(found)])
    click.echo(text, err=str(json_file) == "-")
