"""Start and rate of a sensor's clock, found from a motion whose frequency grows."""

import pytest

from hframe_post.arrays import TS
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.clock import acceleration, aligned
from tests.recordings import sweep
from tests.simulator import BEGUN, Chip


@pytest.mark.parametrize("drift", [0.0, 0.008])
def test_the_line_of_a_sweep_shows_the_start_and_a_large_drift(drift: float) -> None:
    """On a perfectly stiff machine, which has no delay."""
    swept = sweep(rate=4.0, marks=False)
    recording = Chip(drift=drift, lead=2.0).on_nozzle(swept, 0.0 * swept)
    found = aligned(acceleration(swept[:, None]), recording).clock
    assert found.drift == pytest.approx(drift, abs=5e-5)  # 1.5 ms in all
    assert found.start == pytest.approx(BEGUN, abs=0.02)


@pytest.mark.parametrize("seconds", [2.0, 30.0])
def test_what_draws_no_line_is_refused(seconds: float) -> None:
    """A motion of a moment, and a recording of noise."""
    swept = sweep(rate=4.0, marks=False)
    short = swept[: round(seconds / TS)]
    played = short if seconds < 3.0 else 0.0 * short
    recording = Chip(lead=2.0, noise=60.0).on_nozzle(played, played)
    with pytest.raises(IdentificationError, match="does not follow the command"):
        aligned(acceleration(short[:, None]), recording)
