"""Feedforward compensation of racking and ringing for H-frame 3D printers.

Lengths are mm, times s, one sample is 1 ms. ``help(hframe_post.convert)`` and so on say more.

    load_printer(name_or_path)      a shipped profile or a TOML file, checked: a Printer
    compensate(xy, printer)         path (n, 2) -> command for the motors
    predict(command, printer)       command -> where the nozzle goes
    contour_error(nozzle, path)     distance of the nozzle to the path
    convert(source, target, ...)    G-code file -> G-code, steps or samples; a Report
    simulate(source, printer, ...)  predicted errors of every strategy for a print
    identify(runs, settings)        recordings -> the printer's plant

    >>> import hframe_post as hp
    >>> hp.load_printer("paper").kinematics.racks
    True
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hframe_post.version import __version__

if TYPE_CHECKING:
    from hframe_post.conversion.options import Options as Options
    from hframe_post.conversion.print_report import Report as Report
    from hframe_post.errors import HframeError as HframeError
    from hframe_post.identification.identify import MeasurementSettings as MeasurementSettings
    from hframe_post.identification.identify import Run as Run
    from hframe_post.identification.identify import identify as identify
    from hframe_post.library import compensate as compensate
    from hframe_post.library import contour_error as contour_error
    from hframe_post.library import convert as convert
    from hframe_post.library import load_printer as load_printer
    from hframe_post.library import predict as predict
    from hframe_post.library import simulate as simulate
    from hframe_post.model.impulse_response import ImpulseResponse as ImpulseResponse
    from hframe_post.model.lpfbs import Lpfbs as Lpfbs
    from hframe_post.model.lpfbs import Window as Window
    from hframe_post.model.plant import Plant as Plant
    from hframe_post.model.transfer_function import TransferFunction as TransferFunction
    from hframe_post.printer.settings import Printer as Printer

_OFFERED = {  # names by module
    "conversion.options": "Options",
    "conversion.print_report": "Report",
    "errors": "HframeError",
    "identification.identify": "MeasurementSettings Run identify",
    "library": "compensate contour_error convert load_printer predict simulate",
    "model.impulse_response": "ImpulseResponse",
    "model.lpfbs": "Lpfbs Window",
    "model.plant": "Plant",
    "model.transfer_function": "TransferFunction",
    "printer.settings": "Printer",
}
_ROOMS = {name: room for room, names in _OFFERED.items() for name in names.split()}
__all__ = [*_ROOMS, "__version__"]


def __getattr__(name: str) -> Any:
    """Import a name when it is first used, so that importing the package is cheap (PEP 562)."""
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return all names, imported or not."""
    return sorted({*globals(), *__all__})
