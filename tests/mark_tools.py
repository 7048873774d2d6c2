"""Lines that pass without a stop, one by one."""

from collections.abc import Iterable

from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import Event


def mark(index: int, text: bytes) -> Marks:
    """A single line."""
    return Marks.from_lines([Mark(index, text)])


def each(events: Iterable[Event]) -> list[Mark | Event]:
    """The same events, with each line on its own."""
    return [one for e in events for one in (e if isinstance(e, Marks) else [e])]
