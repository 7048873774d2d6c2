"""Bounds of every verdict: what identify and check refuse, and what they warn of.

A bound is a share unless its name has a unit. Each message shows the number and its bound. A
recording is judged on its command's clock, however that was found; no step on the way refuses it.
"""

from __future__ import annotations

from hframe_post.errors import IdentificationError

# identify refuses
GAIN_ERROR_STROKES = 0.075  # of a sensor's gain; its start and its motion are known
GAIN_ERROR_TEST = 0.35  # likewise, where accel_per_hz may be wrong, too
UNEXPLAINED = 0.6  # of a measurement, by the model: of an SV08 after ten weeks 0.52
SPREAD = 0.4  # of the recordings of an axis; of a printer that was used for ten weeks: 0.3

# identify warns
TESTED_BAND = 0.8  # of the band that the model must explain, from which a test was long enough
# of a response, that its one linear model does not describe, or by which places along x differ from
# their mean; unexplained are of an SV08 0.37, of a Neptune and two Vorons 0.03 to 0.13
MISFIT = 0.2

# check refuses
FREQUENCY_CHANGE = 0.1  # of the main resonance, from which it is another printer

# a recording is refused
LONGEST_GAP_S, LOST = 0.1, 0.01  # of samples; what is lost in all is a share
UNRECORDED_S = 0.25  # of a motion's ends: Klipper of 2023 lost 0.03 s at the start, 0.08 at the end
CLOCK_DRIFT = 0.03  # of a sensor; the worst seen have 0.02
# of a recording's power, by its motion: 0.80 to 0.99 of those published; 0.02 or less of noise, of
# recordings of other motions, and of those that are played backwards
EXPLAINED = 0.4
TEST_GROWTH = -0.5  # of its level, as a power of the frequency; a sine of equal size has -1
# of a command's slow part, by any axis that the sensor rides; of a test's level, or its sweeping's,
# at least: settings differ less
SHOWN = 0.2
TEST_PEAK = 1.5  # of its resonance; 1.2 with input shaping, 2.9 and more without on 20 printers
LAG_S = 0.03  # of each part; printers have less


def check_covers(late: float, early: float) -> None:
    """Raise IdentificationError if a recording begins too late, s, or ends too early."""
    for off, words in ((late, "begins {:.2f} s after"), (early, "ends {:.2f} s before")):
        if off > UNRECORDED_S:
            raise IdentificationError(
                f"the recording {words.format(off)} its motion does, more than {UNRECORDED_S:g} s"
            )


def check_follows(share: float) -> None:
    """Raise IdentificationError if a motion explains too small a share of its recording."""
    if share < EXPLAINED:
        raise IdentificationError(
            "the recording does not follow the command, which explains "
            f"{100.0 * max(share, 0.0):.0f} % of it, not {100.0 * EXPLAINED:.0f} % or more. Check "
            "that it is of this motion, complete, and of a sensor that moves with this axis. With "
            "Marlin also check firmware.marlin.planner of the profile"
        )


def check_drift(drift: float) -> None:
    """Raise IdentificationError if a sensor's clock would have to be fast by too large a share."""
    if abs(drift) > CLOCK_DRIFT:
        raise IdentificationError(
            f"the sensor's clock would have to be {100.0 * abs(drift):.1f} % wrong, more than the "
            f"{100.0 * CLOCK_DRIFT:g} % that sensors are. Is the recording's time in seconds?"
        )


def check_shown(share: float) -> None:
    """Raise IdentificationError if a sensor shows too small a share of an axis' slow motion."""
    if share < SHOWN:
        raise IdentificationError(
            f"the recording shows {100.0 * share:.0f} % of the command's slow motion, not "
            f"{100.0 * SHOWN:.0f} % or more. Check that the sensor moves with both axes that move"
        )
