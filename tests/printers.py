"""What firmware says of itself: a printer.cfg and answers of Marlin, and profiles of them."""

from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.source import from_klipper, kinematics_in
from hframe_post.printer.new_profile import Known, profile_text
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from tests.conftest import ROOT

REAL = ROOT / "tests" / "klipper" / "printer.cfg"  # which Klipper itself runs with in other tests
M503 = ROOT / "tests" / "printer" / "m503.txt"  # with the answer to M115


def profile_of(config: KlipperConfig, kinematics: str = "") -> Printer:
    """Return the new profile of a printer.cfg; by default with the safest kinematics."""
    kind = kinematics or kinematics_in(config)[0]
    tables = {"kinematics": {"type": Known(kind, "test")}, **from_klipper(config)}
    return parse(profile_text(tables, "own"), "own")
