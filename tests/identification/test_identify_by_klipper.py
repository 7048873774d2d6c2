"""Identification of the paper's printer from sweeps that the Klipper host plays.

Its Gyy has a pole at 1.7 Hz, below the band, that almost cancels: an error of 0.1 ms in the delay
or of 0.5 % in the sensor's gain costs more than the whole error of the exact model.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_post.printer.settings import Printer
from tests.identification.bench import SHIPPED, Bench, check_recovered

AS_GOOD = 1.3  # times the exact model's error
SLOW_POLES = pytest.mark.xfail(
    strict=False,  # 17 to 60 is a matter of rounding
    reason="a sweep from 3 Hz on hardly tells poles at 1.7 and 6.5 Hz from a gain: 17 to 60 µm are "
    "left, the exact model leaves 9 to 15, without compensation 230 to 350",
)


@SLOW_POLES
@pytest.mark.klipper
@pytest.mark.slow
def test_the_papers_printer_is_recovered(tmp_path: Path, quick: Path, paper: Printer) -> None:
    bench = Bench(tmp_path, paper.plant, quick, klipper=True)
    check_recovered(bench, (80.0, 140.0, 200.0), times=AS_GOOD)


@SLOW_POLES
@pytest.mark.klipper
@pytest.mark.slow
def test_the_papers_printer_is_recovered_by_the_default_sweep(
    tmp_path: Path, paper: Printer
) -> None:
    bench = Bench(tmp_path, paper.plant, SHIPPED, klipper=True)
    check_recovered(bench, (80.0, 110.0, 140.0, 170.0, 200.0), times=1.5)
