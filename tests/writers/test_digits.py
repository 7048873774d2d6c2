"""Numbers from tables of digits equal those that Python formats."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.errors import HframeError
from hframe_post.native import digits

NOTHING = np.zeros((0, 3), np.int64)


def formatted(letter: str, value: int, decimals: int) -> str:
    """Return what Python writes for value·10^−decimals."""
    sign, digits = "-" if value < 0 else "", str(abs(value)).rjust(decimals + 1, "0")
    whole = digits[: len(digits) - decimals]
    fraction = digits[len(digits) - decimals :].rstrip("0")
    return f"{letter}{sign}{whole}" + (f".{fraction}" if fraction else "")


def extruded(values: list[int], decimals: int) -> bytes:
    """Return lines that extrude these lengths."""
    at = np.zeros((len(values) + 1, 4), dtype=np.int64)
    at[1:, 3] = np.cumsum(values)
    feeds = np.zeros(len(values), np.int64)
    kinds = np.zeros(len(values), np.uint8)
    return digits.motion_lines(at, feeds, kinds, 0, (3, 3, 3, decimals, 1), NOTHING, b"")[0]


@st.composite
def columns(draw: st.DrawFn) -> tuple[list[int], int]:
    decimals = draw(st.integers(0, 4))
    top = 10 ** (decimals + draw(st.sampled_from([1, 3, digits.WHOLE_DIGITS]))) - 1
    number = st.integers(-top, top) | st.integers(-9, 9).map(lambda k: k * 10**decimals)
    return draw(st.lists(number, min_size=1, max_size=30)), decimals


@settings(max_examples=100)
@given(columns())
def test_words_equal_numbers_formatted_by_python(column: tuple[list[int], int]) -> None:
    values, decimals = column
    words = (formatted(" E", value, decimals) if value else "" for value in values)
    expected = "".join(f"G1{word}\n" for word in words)
    assert extruded([7, *values], decimals).decode().split("\n", 1)[1] == expected


places = st.lists(st.integers(-2, 2), min_size=5, max_size=5)


kinds = st.sampled_from([digits.MOVES, digits.MOVES, digits.STANDS, digits.BEGINS, digits.JUMPS])


@given(st.lists(places, min_size=2, max_size=20), st.sampled_from([-1, 0, 2]), st.data())
def test_a_word_is_written_where_it_changes(
    rows: list[list[int]], feed: int, data: st.DataObject
) -> None:
    table, decimals = np.array(rows, dtype=np.int64), (3, 2, 1, 0, 5)
    between = np.array([(k, 0, 1) for k in range(len(rows))])  # a line feed before each, and behind
    kind = [0, *data.draw(st.lists(kinds, min_size=len(rows) - 1, max_size=len(rows) - 1))]
    of = table[:, :4].copy(), table[1:, 4].copy(), np.array(kind[1:], np.uint8), feed, decimals
    written, begun = digits.motion_lines(*of, between, b"\n")
    assert begun[0] == 0
    begin = 1
    for k, end in enumerate(begun[1:].tolist(), start=1):
        if kind[k] == digits.JUMPS:
            assert end == begin
            begin = end + 1
            continue
        changed = table[k] != table[k - 1]
        changed[:2] |= kind[k] == digits.BEGINS
        changed[4], feed = rows[k][4] != feed or kind[k] != digits.MOVES, rows[k][4]
        values = [*rows[k][:3], rows[k][3] - rows[k - 1][3], rows[k][4]]
        words = zip("XYZEF", values, decimals, changed, strict=True)
        line = "".join(formatted(f" {letter}", v, d) for letter, v, d, shown in words if shown)
        assert written[begin:end].decode() == f"G1{line}\n"
        begin = end + 1
    assert begin == len(written)


@pytest.mark.parametrize(
    "value", [10**8, -(10**8), 2**32, 2**32 + 5, -(2**32), 10**15, 2**63 - 1, -(2**63)]
)
def test_number_too_long_is_an_error(value: int) -> None:
    """-2⁶³ is what numpy makes of NaN."""
    with pytest.raises(HframeError):
        extruded([value], 3)


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
