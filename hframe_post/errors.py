"""The exceptions that a user can cause: each says where, what and what to do."""

from typing import Any


def one_line(text: str) -> str:
    """Return the text with line ends and other unprintable characters as escapes.

    The name or content of a file must not add lines to the output or control a terminal.
    """
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return text if text.isprintable() else "".join(shown)


def _place(line: int | None) -> str:
    return "" if line is None else f"line {line}: "


class HframeError(Exception):
    """Any error that a user can cause; its ``str`` is one line."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle text and attributes, for the process that waits for the one which raised it.

        Without this a subclass is called with its text alone, and most need more arguments.
        """
        return _unpickled, (type(self), self.args, self.__dict__)


def _unpickled(
    kind: type[HframeError], args: tuple[object, ...], attributes: dict[str, Any]
) -> HframeError:
    error = kind.__new__(kind)
    error.args = args
    error.__dict__.update(attributes)
    return error


class ArgumentError(HframeError, ValueError):
    """An argument of the library has a wrong shape or value."""


class OptionError(ArgumentError):
    """Options of a conversion do not make sense together; on the command line, wrong usage."""


class GcodeError(HframeError):
    """The input cannot be read as G-code, or must not be."""

    def __init__(self, cause: str, line: int | None = None, text: bytes = b"") -> None:
        self.cause, self.line, self.text = cause, line, text
        shown = text.strip()[:80].decode("latin-1")
        super().__init__(_place(line) + cause + (f": {shown!r}" if shown else ""))


class LeftAloneError(GcodeError):
    """The input is not to be converted: it says so, or it was converted already.

    stamp: what converted it, as ``conversion.options.stamp`` says it; empty if nothing did.
    """

    def __init__(self, cause: str, line: int, stamp: str = "") -> None:
        self.stamp = stamp
        super().__init__(cause, line)


class PrinterError(HframeError):
    """A printer profile is missing, malformed or out of bounds."""

    def __init__(self, cause: str, key: str = "", source: str = "") -> None:
        self.cause, self.key, self.source = cause, key, source
        super().__init__("".join(f"{part}: " for part in (source, key) if part) + cause)


class IdentificationError(HframeError):
    """A measurement from which no model can be identified."""


class LimitError(HframeError):
    """The command would leave the bed or outrun a motor."""

    def __init__(
        self, quantity: str, value: float, bound: float, line: int | None, advice: str
    ) -> None:
        self.quantity, self.value, self.bound, self.line = quantity, value, bound, line
        super().__init__(
            f"{_place(line)}{quantity} would be {value:.6g}, the printer's limit is {bound:.6g}; "
            + advice
        )
