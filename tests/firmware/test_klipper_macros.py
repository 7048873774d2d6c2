"""The macros for printer.cfg: what they set, and that the docs name them."""

import re
from dataclasses import replace
from pathlib import Path

from hframe_post.firmware.klipper.code import KlipperCode
from hframe_post.firmware.klipper.macros import BEGIN, WRAPPERS, macros
from hframe_post.printer.firmware_tables import END_MACRO, RECORDED
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder

DOCS = Path(__file__).parents[2] / "docs" / "klipper.md"


def test_the_beginning_sets_what_the_stream_would_set() -> None:
    paper = load("paper")
    begin = macros(paper).split("[gcode_macro _HFRAME_BEGIN]")[1].split("\n\n")[0]
    for line in KlipperCode.from_printer(paper).limits_of_stream:
        assert f"    {line}\n" in f"{begin}\n"


def test_they_set_and_restore_the_averaging_of_pressure_advance() -> None:
    text = macros(replace(load("paper"), extruder=Extruder(0.05)))
    begin, end = (
        text.split(f"[gcode_macro {name}]")[1] for name in ("_HFRAME_BEGIN", "_HFRAME_END")
    )
    assert "SMOOTH_TIME=0.02\n" in begin.split("\n\n")[0]
    own = "SMOOTH_TIME={own.extruder.pressure_advance_smooth_time}\n"
    assert own in end.split("\n\n")[0]


def test_the_docs_name_each_macro() -> None:
    names = {*re.findall(r"\[gcode_macro ([A-Z]\w+)\]", macros(load("paper")))}
    names |= {BEGIN, END_MACRO, RECORDED, *WRAPPERS}
    assert len(names) == 9
    assert not [name for name in names if f"`{name}`" not in DOCS.read_text(encoding="utf-8")]
