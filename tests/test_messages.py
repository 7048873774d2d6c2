"""All messages of errors in one file: ``python -m pytest tests/test_messages.py --update-golden``.

Other tests check an error's type, line and key. Read the difference of the file: would an owner
understand each message at first reading?
"""

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

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
