"""Tables without a row are tables."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.identification.recordings.number_table import read_table


def test_no_rows_are_no_warning() -> None:
    assert read_table([], delimiter=",").size == 0
    np.testing.assert_array_equal(read_table(["1,2"], delimiter=","), [[1.0, 2.0]])
    with pytest.raises(ValueError, match="could not convert"):
        read_table(["1,x"], delimiter=",")
