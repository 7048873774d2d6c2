"""Numbers from tables of digits equal those that Python formats."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.errors import HframeError
from hframe_post.writers.stream import digits


def formatted(letter: str, value: int, decimals: int) -> str:
    """Return what Python writes for value·10^−decimals."""
    sign, digits = "-" if value < 0 else "", str(abs(value)).rjust(decimals + 1, "0")
    whole = digits[: len(digits) - decimals]
    fraction = digits[len(digits) - decimals :].rstrip("0")
    return f"{letter}{sign}{whole}" + (f".{fraction}" if fraction else "")


def words(letter: str, values: list[int], decimals: int, shown: list[bool] | None = None) -> bytes:
    flags = np.array(shown if shown is not None else [True] * len(values), dtype=bool)
    column = np.array([values], dtype=np.int64)
    return digits.command_lines(b"G1", letter.encode(), column, (decimals,), flags[None])[0]


@st.composite
def columns(draw: st.DrawFn) -> tuple[list[int], int]:
    decimals = draw(st.integers(0, 4))
    top = 10 ** (decimals + draw(st.sampled_from([1, 3, digits.WHOLE_DIGITS]))) - 1
    number = st.integers(-top, top) | st.integers(-9, 9).map(lambda k: k * 10**decimals)
    return draw(st.lists(number, min_size=1, max_size=30)), decimals


@settings(max_examples=300)
@given(columns())
def test_words_equal_numbers_formatted_by_python(column: tuple[list[int], int]) -> None:
    values, decimals = column
    expected = "".join("G1" + formatted(" X", value, decimals) + "\n" for value in values)
    assert words("X", values, decimals).decode() == expected


@settings(max_examples=300)
@given(columns())
def test_words_read_back_as_their_values(column: tuple[list[int], int]) -> None:
    values, decimals = column
    for row, value in zip(words("X", values, decimals).splitlines(), values, strict=True):
        number = row.removeprefix(b"G1 X")
        assert round(float(number) * 10**decimals) == value
        assert b"e" not in number
        assert number != b"-0"
        assert b"." not in number or not number.endswith((b"0", b"."))


@pytest.mark.parametrize(
    ("value", "decimals", "expected"),
    [
        (0, 3, "0"), (1, 3, "0.001"), (-1, 3, "-0.001"), (12500, 3, "12.5"),
        (-12000, 3, "-12"), (100, 0, "100"), (0, 0, "0"), (-7, 0, "-7"), (999999, 3, "999.999"),
        (1000000, 3, "1000"), (-99999999, 3, "-99999.999"), (5, 5, "0.00005"), (10, 1, "1"),
    ],
)  # fmt: skip
def test_numbers_are_written_plainly(value: int, decimals: int, expected: str) -> None:
    assert words("E", [value], decimals) == b"G1 E" + expected.encode() + b"\n"


@given(st.lists(st.tuples(st.integers(-99999, 99999), st.booleans()), min_size=1, max_size=20))
def test_hidden_words_are_not_written(rows: list[tuple[int, bool]]) -> None:
    values, shown = [value for value, _ in rows], [flag for _, flag in rows]
    expected = (f"G1{formatted(' Y', v, 2) if s else ''}\n" for v, s in rows)
    assert words("Y", values, 2, shown).decode() == "".join(expected)


@given(st.lists(st.tuples(st.integers(-10**6, 10**6), st.integers(0, 10**5)), min_size=1,
                max_size=20))  # fmt: skip
def test_lines_end_where_they_say(rows: list[tuple[int, int]]) -> None:
    x, f = (np.array(column, dtype=np.int64) for column in zip(*rows, strict=True))
    shown = np.array([np.ones(len(rows), dtype=bool), f % 2 == 0])
    written, ends = digits.command_lines(b"G1", b"XF", np.array([x, f]), (3, 1), shown)
    starts = [0, *ends[:-1].tolist()]
    for (a, b), start, end in zip(rows, starts, ends.tolist(), strict=True):
        feed = formatted(" F", b, 1) if b % 2 == 0 else ""
        assert written[start:end].decode() == "G1" + formatted(" X", a, 3) + feed + "\n"
    assert ends[-1] == len(written)


def test_no_rows_give_no_text() -> None:
    values, shown = np.zeros((1, 0), dtype=np.int64), np.zeros((1, 0), dtype=bool)
    written, ends = digits.command_lines(b"G1", b"X", values, (3,), shown)
    assert written == b""
    assert len(ends) == 0


@pytest.mark.parametrize(
    "value",
    [10**8, -(10**8), 2**32, 2**32 + 5, -(2**32), 10**15, 2**63 - 1, -(2**63)],
)
def test_number_too_long_is_an_error(value: int) -> None:
    """-2⁶³ is what numpy makes of NaN."""
    with pytest.raises(HframeError):
        words("X", [1, value, 2], 3)


def test_longest_number_is_written() -> None:
    assert words("X", [10**8 - 1, 1 - 10**8], 3) == b"G1 X99999.999\nG1 X-99999.999\n"


# ---------------------------------------------------------------------- columns of numbers


@given(st.lists(st.integers(0, 10**17), min_size=1, max_size=20), st.integers(1, 17))
def test_whole_numbers_equal_those_of_python(values: list[int], width: int) -> None:
    values = [value % 10**width for value in values]
    column = np.array(values, dtype=np.int64)
    end = digits.column(b"\n", len(values))
    assert digits.rows([digits.whole(column), end]) == b"".join(b"%d\n" % value for value in values)


@given(st.lists(st.floats(-1e5, 1e5) | st.floats(-1e-8, 1e-8), min_size=1, max_size=20),
       st.integers(0, 9))  # fmt: skip
def test_fixed_numbers_equal_those_of_python(values: list[float], decimals: int) -> None:
    units = [round(float(np.rint(value * 10.0**decimals))) for value in values]
    column = digits.fixed(np.array(values), decimals)
    rows = digits.rows([column, digits.column(b"\n", len(values))]).decode().splitlines()
    for row, unit in zip(rows, units, strict=True):
        shown = str(abs(unit)).rjust(decimals + 1, "0")
        whole, fraction = shown[: len(shown) - decimals], shown[len(shown) - decimals :]
        point = "." if decimals else ""
        assert row == ("-" if unit < 0 else "") + whole + point + fraction


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e15, -1e15])
def test_number_that_cannot_be_written_is_an_error(value: float) -> None:
    with pytest.raises(HframeError), np.errstate(invalid="ignore"):
        digits.fixed(np.array([1.0, value]), 6)
