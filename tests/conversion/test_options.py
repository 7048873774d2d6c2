"""Options: declared once, the same from the library, the command line and a batch."""

import pickle
from dataclasses import replace
from typing import Any

import click
import pytest

from hframe_post.cli.parameters import shared
from hframe_post.conversion.options import SHOWN, Options, error_bound
from hframe_post.errors import ArgumentError, HframeError, OptionError
from hframe_post.printer.settings import Printer


def read(*words: str, names: tuple[str, ...] = tuple(SHOWN)) -> Options:
    """The options that a command with these words receives."""

    @click.command()
    @shared(*names)
    def command(options: Options) -> Options:
        return options

    found = command.main(list(words), standalone_mode=False)
    assert isinstance(found, Options)
    return found


def test_without_words_the_command_line_has_the_defaults_of_the_library() -> None:
    assert replace(read(), jobs=1) == Options()


@pytest.mark.parametrize(
    "options",
    [
        Options(),
        Options("fbs", limits="printer", clamp=False, force=True, jobs=3),
        Options("none", ("none", "fbs", "racking"), extrusion="relative"),
        Options(predict=(), format="steps", firmware="marlin", tolerance=0.05),
        Options(max_error=0.055),
    ],
)
def test_words_are_read_back_as_the_same_options(options: Options) -> None:
    assert read(*options.words()) == options
    assert pickle.loads(pickle.dumps(options)) == options


def test_every_option_is_read() -> None:
    words = (
        "--compensation racking --firmware klipper --limits file-all --extrusion absolute "
        "--on-limit error --force --tolerance 0 --predict off --jobs 2 "
        "--format samples --max-error 15um"
    )
    assert read(*words.split()) == Options(
        "racking", (), limits="file-all", clamp=False, tolerance=None, extrusion="absolute",
        format="samples", firmware="klipper", force=True,
        max_error=0.015, jobs=2,
    )  # fmt: skip


def test_what_does_not_go_together_is_wrong_usage() -> None:
    with pytest.raises(click.UsageError, match="--tolerance must be 0, or from"):
        read("--tolerance", "5")
    with pytest.raises(click.UsageError, match="'30' is not an error of the whole print"):
        read("--max-error", "30")


@pytest.mark.parametrize(
    "wrong",
    [{"limits": "non"}, {"extrusion": "x"}, {"format": "rtf"}, {"tolerance": 1.0}],
)
def test_wrong_values_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        Options(**wrong)


def test_the_profile_decides_where_nothing_is_asked(paper: Printer) -> None:
    found = Options().resolved(paper)
    assert (found.strategy, found.predict) == ("racking", ("none", "racking"))
    assert found.speed is None
    fast = replace(paper, speed=replace(paper.speed, max_error=0.1))
    assert Options().resolved(fast).speed == fast.speed
    assert Options(max_error=0.0).resolved(fast).speed is None
    assert Options(predict=(), max_error=0.1).resolved(paper).predict == ("none", "racking")
    with pytest.raises(HframeError, match="unknown strategy 'raking'"):
        Options("raking").resolved(paper)


def test_errors_are_read() -> None:
    assert error_bound("off") == 0.0
    assert error_bound("0.03mm") == 0.03
    assert error_bound("80um") == pytest.approx(0.08)
    for text in ("infill=3um", "0um", "30", "20mm"):
        with pytest.raises(ArgumentError):
            error_bound(text)
