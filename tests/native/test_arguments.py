"""What a compiled loop refuses, and an installation without them."""

import importlib
import sys
import threading
from types import ModuleType

import numpy as np
import pytest

from hframe_post import native


@pytest.mark.slow
def test_an_argument_of_another_kind_layout_or_length_is_an_error(library: ModuleType) -> None:
    s, points, room = np.arange(3.0), np.zeros((3, 4)), (np.empty((2, 4)), np.empty(2, np.int64))
    right = [s, points, 2, s[:2], 2, *room]
    frozen = room[0].copy()
    frozen.flags.writeable = False
    of_another_kind = {
        0: (s[::2], s.astype(np.float32), s.tolist(), 1.0, None, b"0"),
        2: (2.0, s),
        5: (frozen, room[1]),
    }
    of_another_length = {0: (s[:2],), 2: (0, -1, 1 << 40, 1 << 70, -(1 << 70)), 5: (room[0][:1],)}
    assert library.follow(*right) == 2
    for error, wrong in ((TypeError, of_another_kind), (ValueError, of_another_length)):
        for k, values in wrong.items():
            for value in values:
                with pytest.raises(error, match=f"argument {k} of follow"):
                    library.follow(*right[:k], value, *right[k + 1 :])
    for count in (0, len(right) - 1):
        with pytest.raises(TypeError, match="must be given"):
            library.follow(*right[:count])
    for more in (1, 100):
        with pytest.raises(TypeError, match="argument"):
            library.follow(*right, *[1] * more)


@pytest.mark.slow
def test_another_thread_runs_during_a_loop(library: ModuleType) -> None:
    """Python itself would not switch threads for an hour."""
    n, before = 10_000, sys.getswitchinterval()
    arguments = np.arange(3.0), np.zeros((3, 4)), 2, np.zeros(n), n, np.empty((n, 4))
    moves, begin, ran = np.empty(n, np.int64), threading.Event(), threading.Event()

    def other() -> None:
        begin.wait()
        ran.set()

    thread = threading.Thread(target=other)
    sys.setswitchinterval(3600.0)
    try:
        thread.start()
        begin.set()
        for _ in range(10_000):
            library.follow(*arguments, moves)
            if ran.is_set():
                break
        assert ran.is_set()
    finally:
        sys.setswitchinterval(before)
        thread.join()


@pytest.mark.parametrize("name", ["missing", "another version"])
def test_missing_loops_say_what_to_do(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found = None if name == "missing" else ModuleType("_kernels")
    if found:
        found.BUILT_FOR = native.BUILT_FOR - 1  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "hframe_post.native._kernels", found)
    with pytest.raises(ImportError, match="pip install -e"):
        importlib.reload(native)
    monkeypatch.undo()
    importlib.reload(native)
