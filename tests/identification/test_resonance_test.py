"""The motion of TEST_RESONANCES as printer.cfg describes it; tests/klipper compares it."""

from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.errors import IdentificationError
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.identification.recordings.resonance_test import ResonanceTest
from tests.resonance_recordings import BELTS, klipper


def config(folder: Path, section: str) -> KlipperConfig:
    path = folder / "printer.cfg"
    path.write_text(f"[printer]\nmax_accel: 7000\n[resonance_tester]\n{section}\n")
    return KlipperConfig(path)


def test_printer_cfg_overrides_the_defaults(tmp_path: Path) -> None:
    cfg = config(
        tmp_path, "probe_points:\n  110, 120, 20\n  30,40,20\nmin_freq: 10\naccel_per_hz: 50"
    )
    today = ResonanceTest.from_config(cfg, (3.0, -4.0))
    assert today == ResonanceTest(
        (0.6, -0.8), (110.0, 120.0), 10.0, 135.0, 1.0, 50.0, 400.0, 1.2, stop_accel=7000.0
    )
    elsewhere = ResonanceTest.from_config(cfg, (1.0, 0.0), (5.0, 6.0))
    assert (elsewhere.point, elsewhere.accel_per_hz) == ((5.0, 6.0), 50.0)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("", "probe_points: '' is not a list of points"),
        ("probe_points: 1, 2", "is not a list of points: write 100, 100, 20"),
        ("probe_points: 1,2,3\nhz_per_sec: 0", "hz_per_sec is 0; it must be 0.05 to 20"),
        ("probe_points: 1,2,3\nmax_freq: nan", "max_freq is nan; it must be 1 to 300"),
        ("probe_points: 1,2,3\nmin_freq: 150", "max_freq 135 is below min_freq 150"),
    ],
)
def test_impossible_options_are_refused(tmp_path: Path, section: str, message: str) -> None:
    with pytest.raises(IdentificationError, match=message):
        ResonanceTest.from_config(config(tmp_path, section), (1.0, 0.0))


@pytest.mark.parametrize("period", [0.0, 1.2])
def test_pulses_and_sweeping_add_up_to_a_motion_from_rest_to_rest(period: float) -> None:
    test = klipper(BELTS[1], hz_per_sec=2.0, max_freq=60.0, sweeping_period=period)
    pulses, sweeping = test.pulses(), test.sweeping()
    along = (test.command() - test.point) @ BELTS[1]
    assert along == pytest.approx(pulses + sweeping, abs=1e-9)
    assert np.abs(np.diff(along)[[0, -1]]).max() < 1e-3
    assert np.abs(np.diff(pulses, 2)).max() / TS**2 == pytest.approx(60.0 * 60.0, rel=0.02)
    assert np.abs(np.diff(sweeping, 2)[:20000]).max(initial=0.0) / TS**2 == pytest.approx(
        400.0 if period else 0.0
    )
