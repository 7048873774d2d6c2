"""All messages of errors in one file: ``python -m pytest tests/test_messages.py --update-golden``.

Other tests check an error's type, line and key. Read the difference of the file: would an owner
understand each message at first reading? Errors also reach a process that waits, with all they say.
"""

import ast
import copy
import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hframe_post
from hframe_post.errors import HframeError
from tests.conftest import ROOT

RAISING = ("error", "fail", "refuse")  # methods that raise or return an error


def text_of(node: ast.expr) -> str:
    """Return a string as written, with what is filled in between braces; "" of anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.BinOp):
        return text_of(node.left) + text_of(node.right)
    if not isinstance(node, ast.JoinedStr):
        return ""
    return "".join(
        f"{{{ast.unparse(part.value)}}}" if isinstance(part, ast.FormattedValue) else text_of(part)
        for part in node.values
    )


def messages(path: Path) -> Iterator[str]:
    """Yield the messages of errors in a file."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else name
            if name.endswith(("Error", "UsageError", "BadParameter")) or name in RAISING:
                yield from filter(lambda text: " " in text, map(text_of, node.args))


def test_messages_are_those_of_the_file(golden: Callable[[str, bytes], bytes]) -> None:
    package = ROOT / "hframe_post"
    found = [
        f"{path.relative_to(package).with_suffix('')}: {text!r}\n"
        for path in sorted(package.rglob("*.py"))
        for text in dict.fromkeys(messages(path))
    ]
    assert len(found) > 100
    now = "".join(found).encode()
    assert now.decode().splitlines() == golden("messages.txt", now).decode().splitlines()


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
