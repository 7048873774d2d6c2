"""What a recording must show of a resonance test that was found in it."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.chirp_line import ChirpLine
from hframe_post.identification.recordings.resonance_match import RATE, Match
from hframe_post.identification.recordings.resonance_test import ResonanceTest

LEAST_LIKE = 0.6  # share of the recording at low frequencies that the motion explains
LEAST_GROWTH = -0.5  # of the level at low frequencies, as a power of the frequency: sines have -1
LEAST_MOVED = 0.2  # of the level expected: sensors and settings differ less
LEAST_PEAK = 1.5  # of the level; with shaping 1.2, without 2.9 and more on 20 drawn printers
REST = 0.05  # s before the motion that a whole recording has
ELSEWHERE = (
    "the sensor did not move with this axis (it sat on the frame, on another head, or on the head "
    "while the bed moves, or the other way round)"
)


def rests_before(a: Array, start: float) -> bool:
    """Return whether the printer of a recording rests before a motion that starts at s."""
    first = int((start - REST) * RATE)
    moving = float(a[max(first, 0) :][: int(RATE)].std(axis=0).max())
    return first > 0 and float(a[:first].std(axis=0).max()) < 0.5 * moving


def check_motion(fit: Match, line: ChirpLine, hz: Array, level: Array) -> None:
    """Raise IdentificationError if what a recording shows at low frequencies is another motion."""
    grows = f"the recording's frequency grows by {line.slope:.3g} Hz/s as in a resonance test, but"
    if float(np.polyfit(np.log(hz), np.log(level), 1)[0]) < LEAST_GROWTH:
        raise IdentificationError(
            f"{grows} its acceleration does not grow with it: this is another program's sweep"
        )
    if fit.like < LEAST_LIKE:
        raise IdentificationError(
            f"{grows} only {100.0 * max(fit.like, 0.0):.0f} % of what it shows below "
            f"{hz[-1]:.0f} Hz is that motion. Either {ELSEWHERE}, or input shaping was on "
            "(INPUT_SHAPING=1), or another program made it"
        )


def check_level(fit: Match, level: float, expected: ResonanceTest) -> None:
    """Raise IdentificationError if the sensor moved far less than the axis did.

    A test of weak pulses still has its sweeping in full.
    """
    share = level / expected.accel_per_hz
    sweeps = bool(fit.test.sweeping_period)
    if share >= LEAST_MOVED:
        return
    if sweeps and np.linalg.norm(fit.sweeping) > 2.0 * LEAST_MOVED * expected.sweeping_accel:
        return
    cause = ELSEWHERE
    if not sweeps and level > 1.0:
        cause = (
            f"either {ELSEWHERE}, or the test was run with ACCEL_PER_HZ={level:.2g}: set "
            f"accel_per_hz in [resonance_tester], which is {expected.accel_per_hz:g}"
        )
    raise IdentificationError(
        f"the recording shows {100.0 * share:.0f} % of the acceleration that the test makes: "
        f"{cause}"
    )


def check_shaping(hz: Array, level: Array, base: float) -> None:
    """Raise IdentificationError if a printer that falls behind its motors resonates nowhere."""
    if level.max() < LEAST_PEAK * base and level.min() < 0.5 * base:
        fades = float(hz[np.flatnonzero(level < 0.5 * base)[0]])
        raise IdentificationError(
            f"the recording shows no resonance, and from {fades:.0f} Hz on less than half of the "
            "test's motion. Either input shaping was on (repeat TEST_RESONANCES without "
            "INPUT_SHAPING=1), or something soft lies between motors and sensor, such as a slack "
            "belt or a sensor that is not screwed on"
        )
