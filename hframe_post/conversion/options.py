"""The options of a conversion, each declared once: its default, its values and its help.

The library takes them as ``Options``. The command line makes its own from the fields that are
``Shown`` (`cli.parameters.conversion_options`); ``Options.words`` turns them back into words, for
the processes of a batch.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

from hframe_post.errors import ArgumentError, OptionError
from hframe_post.gcode.commands import STAMP
from hframe_post.gcode.state import Extrusion, LimitSource
from hframe_post.model.strategies import STRATEGIES
from hframe_post.model.strategies import strategy as strategy_of
from hframe_post.printer.firmware_tables import TABLES
from hframe_post.printer.schema import digest_of
from hframe_post.printer.settings import Printer, Speed
from hframe_post.process import processor_count
from hframe_post.version import __version__

if TYPE_CHECKING:
    from hframe_post.model.shapers import Shaping

# mm; a fast and a slow slice on a measured Voron: 0.007 leaves 1.98 and 0.84 µm RMS with the exact
# model, this 1.88 and 0.71 with 1.12 times the lines, 0.004 0.05 less with 1.17 and 1.25 times
TOLERANCE = 0.005
UNITS = {"um": 1e-3, "µm": 1e-3, "mm": 1.0}

Kind = Literal["gcode", "steps", "samples"]


def error_bound(text: str) -> float:
    """Read ``30um`` or ``0.03mm`` as mm; ``off`` is 0."""
    if text == "off":
        return 0.0
    match = re.fullmatch(r"(\d+(?:\.\d+)?|\.\d+)\s*(um|µm|mm)", text.strip())
    if match is None:
        raise ArgumentError(f"{text!r} is not an error of the whole print such as 30um")
    found = float(match[1]) * UNITS[match[2]]
    if not 1e-4 <= found <= 10.0:
        raise ArgumentError(f"{text!r} is not between 0.1um and 10mm")
    return found


def known_firmware(text: str) -> str:
    """Return the name of a firmware."""
    if text not in TABLES:
        raise ArgumentError(f"{text!r} is not one of {', '.join(TABLES)}")
    return text


@dataclass(frozen=True, slots=True)
class Shown:
    """How a field appears on the command line.

    default: of the field. flags: its names, the long one last. choices: its values by word. read:
    turns a word into a value; raises ArgumentError. unit: of a number as a word. rare: shown by
    --help-all only. least: that a whole number may be. unset: returns the value where the command
    line does not give it, if that is not the default. decides: whether it is part of what decides
    the output.
    """

    default: Any
    flags: tuple[str, ...]
    help: str
    metavar: str | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)
    read: Callable[[str], Any] | None = None
    unit: str = ""
    rare: bool = False
    least: int | None = None
    unset: Callable[[], Any] | None = None
    decides: bool = False

    def word(self, value: Any) -> str | None:
        """Return the word for a value; None if it is not one of the choices."""
        return next((word for word, known in self.choices.items() if known == value), None)


def option(default: Any, *flags: str, **shown: Any) -> Any:
    """Return a field that is ``Shown``."""
    return field(default=default, metadata={"shown": Shown(default, flags, **shown)})


def named(choices: Iterable[str]) -> dict[str, str]:
    """Return choices that are called by their own names."""
    return {word: word for word in choices}


@dataclass(frozen=True, slots=True)
class Options:
    """What a user asks of a conversion; where nothing is asked, the printer's profile decides.

    strategy: whose commands are written; empty: the profile's. predict: strategies whose contour
    error is reported; None: ``none`` and the chosen one. clamp: compensate less where a command
    would exceed a limit, instead of raising LimitError. tolerance: how far, in mm, a written
    segment may be off the samples; None or 0 writes every sample. max_error: mm; 0: the file's
    accelerations.

    The last fields are for the stages. speed: set by ``resolved``. pace: factor on the file's
    accelerations. picture: collect the path with its predicted errors. shaping: an input shaper,
    with which a simulation predicts errors, too.

    Raises OptionError for values that make no sense.
    """

    strategy: str = option(
        "", "-c", "--compensation", decides=True, choices=named(STRATEGIES),
        help="What to cancel: nothing, ringing, or ringing and racking. Default: the profile's.",
    )  # fmt: skip
    predict: tuple[str, ...] | None = option(
        None, "--predict", rare=True,
        choices={"chosen": None, "all": tuple(STRATEGIES), "off": ()},
        help="Contour errors to predict: without compensation and with the chosen one, with all, "
        "or none.",
    )  # fmt: skip
    _: KW_ONLY
    limits: LimitSource = option(
        "file", "--limits", decides=True, rare=True, choices=named(get_args(LimitSource)),
        help="Limits to obey in the file: those that the firmware obeys (Klipper: M204, "
        "SET_VELOCITY_LIMIT; Marlin: M201, M203, M204, M205), all of these (file-all), or only "
        "the profile's (printer).",
    )  # fmt: skip
    clamp: bool = option(
        True, "--on-limit", decides=True, rare=True, choices={"error": False, "clamp": True},
        help="If the compensated motion would leave the bed or exceed a motor's limits: stop with "
        "an error, or compensate less there and say so.",
    )  # fmt: skip
    tolerance: float | None = option(
        TOLERANCE, "--tolerance", decides=True, rare=True, metavar="MM",
        help="How far G-code for Klipper may differ from the computed motion, at most 0.1 mm; 0 "
        "writes a line for every millisecond, and begins lifts at rest.",
    )  # fmt: skip
    extrusion: Extrusion | None = option(
        None, "--extrusion", decides=True, rare=True, choices=named(get_args(Extrusion)),
        help="Meaning of E before the first M82 or M83 in the file, if a start macro of the "
        "printer sets it.",
    )  # fmt: skip
    format: Kind | None = option(
        None, "--format", rare=True, choices=named(get_args(Kind)),
        help="Output format: G-code, motor steps, or samples every millisecond. Default: by the "
        "suffix of the output: .csv steps, .npz samples, any other G-code.",
    )  # fmt: skip
    firmware: str | None = option(
        None, "--firmware", rare=True, metavar="NAME", read=known_firmware,
        help="Firmware that plays the G-code: klipper or marlin. Default: the profile's.",
    )  # fmt: skip
    force: bool = option(
        False, "--force",
        help="Convert even if the model is of another printer.",
    )  # fmt: skip
    max_error: float | None = option(
        None, "--max-error", metavar="ERROR", read=error_bound, unit="mm",
        help="Print as fast as this error allows, such as 30um, or 'off'. Default: "
        "speed.max_error of the profile.",
    )  # fmt: skip
    jobs: int = option(
        1, "--jobs", rare=True, metavar="N", least=1, unset=processor_count,
        help="Number of processes. Default: one per processor.",
    )  # fmt: skip
    speed: Speed | None = None
    pace: float = 1.0
    picture: bool = False
    shaping: Shaping | None = None

    def __post_init__(self) -> None:
        for name in ("limits", "extrusion", "format"):
            given, choices = getattr(self, name), SHOWN[name].choices
            if given is not None and given not in choices:
                raise OptionError(f"{name} must be one of {', '.join(choices)}, not {given!r}")
        if not self.tolerance:
            object.__setattr__(self, "tolerance", None)
        elif not 1e-4 <= self.tolerance <= 0.1:
            raise OptionError(
                f"--tolerance must be 0, or from 0.0001 to 0.1, not {self.tolerance:g}"
            )

    @property
    def strategies(self) -> tuple[str, ...]:
        """Return the strategies whose commands are computed: the chosen one first.

        What a print is without compensation is judged on the firmware's own motion instead.
        """
        others = (name for name in self.predict or () if name != "none")
        return tuple(dict.fromkeys((self.strategy, *others)))

    def resolved(self, printer: Printer) -> Options:
        """Return the options with the profile's where nothing was asked.

        Raises OptionError, and HframeError for a strategy that does not exist.
        """
        strategy = strategy_of(self.strategy or printer.compensation.strategy).name
        speed = printer.speed
        if self.max_error is not None:
            speed = replace(speed, max_error=self.max_error)
        reported = (strategy,) if self.predict is None else self.predict
        if speed.max_error:
            reported = (strategy, *reported)  # whose error the bound is for
        reported = ("none", *reported) if reported else ()  # to compare with
        predict = tuple(dict.fromkeys(strategy_of(name).name for name in reported))
        return replace(
            self, strategy=strategy, predict=predict, speed=speed if speed.max_error else None
        )

    def digest(self, profile: str) -> str:
        """Return a hash of all that decides the output in addition to the input.

        profile: the digest of the printer's. Predictions do not change the output.
        """
        values = {name: getattr(self, name) for name, shown in SHOWN.items() if shown.decides}
        return digest_of({**values, "speed": self.speed, "profile": profile})

    def words(self) -> list[str]:
        """Return the words of a command line that mean the same, for the options of a batch."""
        found = list[str]()
        for name, shown in SHOWN.items():
            value = getattr(self, name)
            if value is True and not shown.choices:
                found.append(shown.flags[-1])
            elif value != shown.default or shown.unset:
                found += [shown.flags[-1], shown.word(value) or f"{value}{shown.unit}"]
        return found


def stamp(printer: Printer, options: Options) -> str:
    """Return what made an output: version, printer and a hash of all settings."""
    return f"{__version__}, printer {printer.name}, settings {options.digest(printer.digest)}"


def first_line(printer: Printer, options: Options) -> bytes:
    """Return the first line in G-code of a conversion with these options, ``resolved``.

    A file that has it was converted by this version with the same profile and settings. Only the
    comments with which the sliced file begins precede it.
    """
    return b"%s %s\n" % (STAMP, stamp(printer, options).encode())


SHOWN: dict[str, Shown] = {
    each.name: each.metadata["shown"] for each in fields(Options) if each.metadata
}
