"""The tool's exceptions reach the process that waits for a worker, with all they say."""

import copy
import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hframe_post
from hframe_post.errors import HframeError

SAMPLES: dict[str, Any] = {
    "str": "a cause", "bytes": b"G1 X1", "int": 12, "int | None": 34, "float": 5.5,
    "bool": True, "Path": Path("a file"),
}  # fmt: skip


def kinds(base: type[Exception]) -> Iterator[type[Exception]]:
    yield base
    for kind in base.__subclasses__():
        yield from kinds(kind)


def all_kinds() -> list[type[Exception]]:
    """Return HframeError and its subclasses, wherever in the package they are."""
    for module in pkgutil.walk_packages(hframe_post.__path__, "hframe_post."):
        if not module.name.startswith(("hframe_post.hosts.", "hframe_post.__main__")):
            importlib.import_module(module.name)
    ours = [kind for kind in kinds(HframeError) if kind.__module__.startswith("hframe_post")]
    return sorted(set(ours), key=lambda kind: kind.__name__)


def example(kind: type[Exception]) -> Exception:
    """Return an error with a value for every argument, also those with a default."""
    annotations = [each.annotation for each in inspect.signature(kind).parameters.values()]
    names = [each.__name__ if isinstance(each, type) else str(each) for each in annotations]
    return kind(*(SAMPLES[name] for name in names))


def test_errors_are_the_same_after_pickling() -> None:
    found = all_kinds()
    assert len(found) >= 8
    for kind in found:
        error = example(kind)
        error.add_note("where it was noticed")
        for again in (
            *(pickle.loads(pickle.dumps(error, n)) for n in range(pickle.HIGHEST_PROTOCOL + 1)),
            copy.copy(error),
        ):
            assert type(again) is kind
            assert (str(again), again.args) == (str(error), error.args), kind.__name__
            assert vars(again) == vars(error), kind.__name__
