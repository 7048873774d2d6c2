"""Tables of what varies, to which installed packages add rows of their own.

A package adds one by an entry point of the group ``hframe_post.firmwares``, ``hframe_post.shapers``
or ``hframe_post.kinematics``. Its name is what an owner writes in a profile or on the command line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from hframe_post.errors import HframeError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class Registry(Mapping[str, T]):
    """A table by name: this tool's own rows, then those of installed packages.

    kind: of what it holds, the group's last word. own: rows that no package can replace. read:
    returns the row for an entry point's object, or None if the object is none. Packages are
    searched only for a name that is not an own one, or when all names are listed, since that takes
    a while. Raises HframeError, which names the package, for a broken one.
    """

    def __init__(self, kind: str, own: Mapping[str, T], read: Callable[[Any], T | None]) -> None:
        self._kind, self._read = kind, read
        self._own = self._known = dict(own)

    def __getitem__(self, name: str) -> T:
        if name not in self._known:
            self._known = {**self._known, name: self._loaded(name, self._added()[name])}
        return self._known[name]

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._added()

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from sorted(self._added().keys() - self._own.keys())

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _added(self) -> dict[str, EntryPoint]:
        """Return the entry points by name."""
        from importlib.metadata import entry_points  # which takes as long as all other imports

        found: dict[str, EntryPoint] = {}
        for point in entry_points(group=f"hframe_post.{self._kind}"):
            other = found.setdefault(point.name, point)
            if other.value != point.value:
                raise HframeError(
                    f"{_package(other)} and {_package(point)} both add {point.name!r} to the "
                    f"{self._kind} of hframe-post. Uninstall one"
                )
        return found

    def _loaded(self, name: str, point: EntryPoint) -> T:
        where = f"{_package(point)}, which adds {name!r} to the {self._kind} of hframe-post"
        remedy = "Update it, or uninstall it"
        try:
            found = point.load()
        except Exception as error:  # of code that is not ours
            cause = f"{type(error).__name__}: {error}"
            raise HframeError(f"{where}, cannot be loaded: {cause}. {remedy}") from None
        row = self._read(found)
        if row is None:
            raise HframeError(f"{where}, offers another object: {point.value}. {remedy}")
        return row


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else "a package"
