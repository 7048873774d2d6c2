"""The printer.cfg of the virtual Klipper printer, and profiles of printer.cfg files."""

from __future__ import annotations

from hframe_post.printer.klipper_cfg import KlipperConfig
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from hframe_post.printer.setup import Known, from_klipper, kinematics_in, profile_text
from tests.conftest import ROOT

REAL = ROOT / "tests" / "klipper" / "printer.cfg"  # which Klipper itself runs with in other tests


def profile_of(config: KlipperConfig, kinematics: str = "") -> Printer:
    """Return the new profile of a printer.cfg; by default with the safest kinematics."""
    kind = kinematics or kinematics_in(config)[0]
    tables = {"kinematics": {"type": Known(kind, "test")}, **from_klipper(config, kind)}
    return parse(profile_text(tables, "own"), "own")
