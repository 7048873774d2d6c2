"""Identification of the paper's printer, from sweeps that the Klipper host plays."""

from __future__ import annotations

from pathlib import Path

import pytest

from hframe_post.printer.settings import Printer
from tests.identification.bench import SHIPPED, Bench, check_recovered


@pytest.mark.klipper
def test_the_papers_printer_is_recovered(tmp_path: Path, quick: Path, paper: Printer) -> None:
    check_recovered(Bench(tmp_path, paper.plant, quick, klipper=True), (80.0, 140.0, 200.0))


@pytest.mark.klipper
@pytest.mark.slow
def test_the_papers_printer_is_recovered_by_the_default_sweep(
    tmp_path: Path, paper: Printer
) -> None:
    places = (80.0, 110.0, 140.0, 170.0, 200.0)
    check_recovered(Bench(tmp_path, paper.plant, SHIPPED, klipper=True), places)
