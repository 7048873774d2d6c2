"""Call every compiled loop with arguments that do not fit each other.

Run as ``python bad_arguments.py LIBRARY ROUNDS``: an own process, since a loop without checks ends
it. It prints what it calls before it does. Each array lies between guards; a loop that wrote past
one is found even where that does no harm. Built with -fsanitize=address, reading is found, too.
"""

from __future__ import annotations

import faulthandler
import importlib.util
import random
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

GUARD = 64  # items
CANARY = 0x5A
Arguments = list[Any]
rng = np.random.default_rng(1)


def guarded(values: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a copy of the values between guards, each in a buffer of its own."""
    values = np.asarray(values, dtype)
    size = values.dtype.itemsize
    whole = np.frombuffer(bytearray([CANARY]) * (values.nbytes + 2 * GUARD * size), np.uint8)
    inner: NDArray[Any] = (
        whole[GUARD * size : GUARD * size + values.nbytes].view(dtype).reshape(values.shape)
    )
    inner[...] = values
    return inner


def intact(array: NDArray[Any]) -> bool:
    """Return whether nothing was written outside an array made by ``guarded``."""
    whole = array
    while isinstance(whole.base, np.ndarray):
        whole = whole.base
    buffer = np.frombuffer(memoryview(whole.base), np.uint8)  # type: ignore[arg-type]
    size = GUARD * array.itemsize
    return bool((buffer[:size] == CANARY).all() and (buffer[-size:] == CANARY).all())


def floats(*shape: int) -> NDArray[Any]:
    return guarded(np.linspace(0.5, 1.5, int(np.prod(shape))).reshape(shape))


def numbers(*values: int) -> NDArray[Any]:
    return guarded(values, np.int64)


def zeros(*shape: int, dtype: Any = np.int64) -> NDArray[Any]:
    return guarded(np.zeros(shape), dtype)


def bits(n: int) -> NDArray[Any]:
    return zeros(n, dtype=np.uint8)


def right() -> dict[str, Arguments]:
    """Return arguments of every loop that it takes."""
    text = b"G1 X1 Y2 F600\nG1 X2 E.1 ; a comment\nG1 Y3\n"
    n, stepper = 4, guarded([1e6, 0.0, 0.0, 1.0, 0.0, 0.0, 120.0])
    steps, t = guarded([9.0, 20.0, 30.0, 12.0]), guarded([0.01, 0.02, 0.02, 0.01])
    stop = (
        floats(60, 2), numbers(*range(24, 30)), 6, 2, 3, floats(6), bits(6), floats(6, 2),
        floats(1, 6), numbers(0, 1), 1, floats(3, 6, 4), numbers(0, 0, 1, 2), 4, floats(8, 2), 8,
        floats(8, 4), floats(6, 4), numbers(*[0, 4] * 8), floats(6), floats(11), 24, 2, 3, 10,
        guarded([0.01, 0.05, 1.5, 10.0, 0.7, 0.4, 2.0, 5.0, 1.2, 0.2, 1e-14, 0.02]),
        floats(45_000), floats(4, 2),
    )  # fmt: skip
    return {
        "breakpoints": [floats(6, 4), bits(6), 6, 0.1, 8.0, 1.0, 1e-6, zeros(6), floats(6, 6)],
        "count_turns": [floats(6, 2), 2, 6, 1e-9, zeros(7)],
        "deviation": [
            floats(6, 2), 2, 6, numbers(*range(7)), floats(6, 2), 2, 6, 0, numbers(*range(6)), 6,
            3, 1, floats(6, 2),
        ],
        "farthest": [floats(5, 4), floats(5, 2), 5],
        "find_runs": [
            floats(5, 4), floats(6), 5, 1e3, 1e3, 0.0, 0.9, 2, floats(8, 6), floats(6), zeros(6),
            floats(6),
        ],
        "fitted": [floats(9, 4), 9, numbers(3, 6, 8), 3, 4, floats(3, 4), floats(6, 3)],
        "follow": [guarded([0.0, 1.0, 2.0]), floats(3, 4), 2, floats(2), 2, floats(2, 4), zeros(2)],
        "joined_pieces": [
            zeros(10, 6, dtype=np.float32), 10, 6, 2, 6, 1.0, 0.1, 0.1, 3, zeros(6),
        ],
        "junctions": [floats(6, 4), floats(5, 4), 5, 1.0, 1.0, 1.0, 1.0, 1.0, floats(6)],
        "klipper_durations": [
            floats(6, 4), 5, floats(5), bits(6), 1.0, 1.0, floats(8), floats(62), floats(5),
        ],
        "klipper_feeds": [
            floats(6, 4), 5, floats(5), bits(6), 1.0, 1.0, floats(8), 3, 1e-5, 0.04, 60.0,
            floats(62), zeros(5), floats(5),
        ],
        "least_squares": [*stop],
        "finite_filter": [
            floats(4), 4, floats(12), 12, 7, 2, 1.0, 0.5, floats(10), floats(7),
        ],
        "lower_moves": [floats(5, 4), 4, floats(13), floats(4), floats(4)],
        "run_seconds": [
            floats(6), 6, numbers(0, 2, 5), floats(3), floats(2), floats(2), 2, floats(2),
        ],
        "smoothed_runs": [
            floats(6), 6, numbers(0, 2, 5), floats(2), floats(2), floats(2), 2, floats(12),
            floats(3), floats(2), floats(2),
        ],
        "limit_moves": [
            floats(6, 4), floats(5), floats(5), floats(5), 5, floats(23), floats(5, 4),
        ],
        "marlin_block_times": [n, steps, *(floats(n) for _ in range(4)), stepper, floats(n)],
        "marlin_blocks": [
            floats(6, 4), 5, floats(8), floats(2, 2), 1.0, 0.9, floats(5), floats(5), floats(5),
            floats(6),
        ],
        "marlin_feed_rates": [
            n, steps, floats(n), floats(n), floats(n + 1), t, 0.0, 0, stepper, 3,
            guarded([3.0, 0.01, 0.05, 0.9, 1e15]), floats(3, n), floats(n),
        ],
        "line_pieces": [
            floats(5, 4), floats(5, 2), floats(5), 5, 0.4, floats(4), zeros(5), floats(5),
        ],
        "marlin_segment_ends": [zeros(8, 2), 8, 2, 2, 24, 1, 1, zeros(54), zeros(8)],
        "marlin_slow_ends": [
            floats(9, 2), zeros(9, 2), zeros(9, 2), 8, numbers(1, 3, 0, 4), numbers(4, 4), 2, 2, 1,
            floats(63), zeros(9), bits(9),
        ],
        "marlin_times": [
            n, steps, floats(n), floats(n), floats(n + 1), floats(n), floats(n), 0.0, 0, stepper,
            floats(n),
        ],
        "misses": [floats(2, 7), floats(2, 7), floats(2), floats(2), 2, 1.0, bits(2)],
        "motion_lines": [
            zeros(4, 4), numbers(1, 2, 3), 3, 0, numbers(3, 3, 3, 5, 1), numbers(*[10**6] * 5),
            bits(240), zeros(3),
        ],
        "motion_segments": [
            floats(3, 4), numbers(2, 4, 6), 3, bits(7), 7, floats(4), zeros(4), 0, 1, 1e-3,
            zeros(4, 4), zeros(3), floats(3), zeros(3),
        ],
        "moving": [floats(5, 4), 5, 0, 1, zeros(5), bits(5)],
        "path_lengths": [floats(6, 4), 4, 0, 5, 1.0, 9.0, floats(5)],
        "phases": [
            floats(2, 7), floats(2, 7), floats(3), floats(3), 2, 0.0, 1.0, 1e-9, floats(84),
            floats(1),
        ],
        "plain_moves": [
            text, len(text), 0, 1, 4, floats(10), floats(16), floats(4, 8), zeros(2),
        ],
        "product": [floats(12), 4, floats(4, 2), 3, 4, 2, floats(3, 2)],
        "ramps": [
            floats(2), floats(2), floats(2), 2, 1.0, floats(2, 7), floats(2, 7), floats(2),
        ],
        "recursion": [floats(3, 3), floats(4, 3), 4, 3, floats(5, 3)],
        "safe": [
            floats(5, 4), floats(5, 2), 5, floats(2, 2), floats(8), floats(2, 2), 1e-3, floats(4),
        ],
        "sliding_sums": [floats(3), 3, floats(2 + 40), 40, floats(40)],
        "move_at_rest": [floats(7), floats(2, 4), 0, 5, 4, 1e-3, floats(5, 4)],
        "too_thick": [
            floats(9, 4), 9, numbers(3, 6, 8), 3, 0.4, 0.1, 2.4, zeros(3), floats(1), floats(2, 3),
        ],
    }  # fmt: skip


INTEGERS = (
    -1, 0, 1, 2, -2, 3, 7, 1000, 1 << 31, -(1 << 31), 1 << 32, 1 << 62, -(1 << 62), (1 << 63) - 1,
    -(1 << 63), 1 << 70,
)  # fmt: skip
NO_INDICES = (-1, 0, 5, 6, 7, 8, 9, 1000, -1000, 1 << 62, -(1 << 63), (1 << 63) - 1)


TAKE_AS_LONG_AS_THE_MOTION = ("marlin_block_times", "marlin_feed_rates", "marlin_times")


def fresh(arguments: Arguments) -> Arguments:
    """Return the arguments with copies of the arrays."""
    return [guarded(v, v.dtype) if isinstance(v, np.ndarray) else v for v in arguments]


def wrong_values(value: Any, name: str) -> Iterator[Any]:
    """Yield what could stand in place of an argument of a loop."""
    yield from (None, "text", b"", 1.5, [1.0], np.empty(3, "S0"), np.empty(3, object))
    if isinstance(value, int):
        yield from (each for each in INTEGERS if each != value)
        yield from (value - 1, value + 1)
    elif isinstance(value, bytes):
        yield from (value[:-1], value[:5], bytearray(value))
    elif isinstance(value, np.ndarray):
        flat = value.ravel()
        yield from (guarded(flat[:k], value.dtype) for k in (0, 1, len(flat) // 2, len(flat) - 1))
        yield guarded(np.repeat(flat, 2), value.dtype)[::2]
        yield flat.astype(np.float32 if value.dtype == np.float64 else np.float64)
        yield flat.astype(value.dtype.newbyteorder())
        frozen = guarded(flat, value.dtype)
        frozen.flags.writeable = False
        yield frozen
        if value.dtype == np.int64:
            for index in NO_INDICES:
                for at in (0, len(flat) // 2, len(flat) - 1):
                    changed = guarded(flat, np.int64)
                    changed[at] = index
                    yield changed
            yield guarded(flat[::-1], np.int64)
        if value.dtype == np.float64:
            odd_numbers = (np.nan, -1.0, 0.0, np.inf, 1e300)
            for odd in odd_numbers[: 3 if name in TAKE_AS_LONG_AS_THE_MOTION else 5]:
                changed = guarded(flat)
                changed[rng.integers(0, len(flat))] = odd
                yield changed


def shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.ravel()[:8].tolist()}"
    return repr(value)[:40]


def call(library: Any, name: str, arguments: Arguments, change: str) -> bool:
    """Call a loop; return whether it took the arguments."""
    print(name, change, flush=True)
    faulthandler.dump_traceback_later(20.0, exit=True)
    try:
        getattr(library, name)(*arguments)
    except (TypeError, ValueError):
        return False
    finally:
        faulthandler.cancel_dump_traceback_later()
        arrays = (each for each in arguments if isinstance(each, np.ndarray))
        for each in arrays:
            if isinstance(each.base, np.ndarray) and not intact(each):
                raise AssertionError("written outside an array")
    return True


def main() -> None:
    """Call each loop with right arguments, with each one wrong, and with two or three wrong."""
    path, rounds = sys.argv[1], int(sys.argv[2])
    spec = importlib.util.spec_from_file_location("hframe_post.native._kernels", path)
    assert spec is not None
    assert spec.loader is not None
    library = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(library)
    loops, all_right = {name for name in dir(library) if name[0].islower()}, right()
    assert loops == set(all_right), loops ^ set(all_right)
    draw = random.Random(1)
    for name, ours in sorted(all_right.items()):
        assert call(library, name, fresh(ours), "as they should be")
        wrong = [list(wrong_values(value, name)) for value in ours]
        for k, values in enumerate(wrong):
            for value in values:
                arguments = fresh(ours)
                arguments[k] = value
                call(library, name, arguments, f"{k}={shown(value)}")
        for _ in range(rounds):
            arguments, changes = fresh(ours), []
            for k in draw.sample(range(len(ours)), draw.choice((2, 3))):
                arguments[k] = draw.choice(wrong[k])
                changes.append(f"{k}={shown(arguments[k])}")
            call(library, name, arguments, " ".join(changes))
    print("all loops survived")


if __name__ == "__main__":
    main()
