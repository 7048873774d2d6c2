"""The printer.cfg of the virtual Klipper printer."""

from __future__ import annotations

from tests.conftest import ROOT

REAL = ROOT / "tests" / "klipper" / "printer.cfg"  # which Klipper itself runs with in other tests
