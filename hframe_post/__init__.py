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
    >>> hp.load_printer("paper").plant.Gxx.order
    4
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hframe_post.version import __version__

if TYPE_CHECKING:
    from hframe_post.conversion.options import Options
    from hframe_post.conversion.print_report import Report
    from hframe_post.errors import HframeError
    from hframe_post.identification.identify import MeasurementSettings, Run, identify
    from hframe_post.library import (
        compensate,
        contour_error,
        convert,
        load_printer,
        predict,
        simulate,
    )
    from hframe_post.model.impulse_response import ImpulseResponse
    from hframe_post.model.lpfbs import Lpfbs, Window
    from hframe_post.model.plant import Plant
    from hframe_post.model.transfer_function import TransferFunction
    from hframe_post.printer.settings import Printer

__all__ = [
    "HframeError",
    "ImpulseResponse",
    "Lpfbs",
    "MeasurementSettings",
    "Options",
    "Plant",
    "Printer",
    "Report",
    "Run",
    "TransferFunction",
    "Window",
    "__version__",
    "compensate",
    "contour_error",
    "convert",
    "identify",
    "load_printer",
    "predict",
    "simulate",
]

_ROOMS = {  # name → module
    "HframeError": "errors",
    "ImpulseResponse": "model.impulse_response",
    "Lpfbs": "model.lpfbs",
    "MeasurementSettings": "identification.identify",
    "Options": "conversion.options",
    "Plant": "model.plant",
    "Printer": "printer.settings",
    "Report": "conversion.print_report",
    "Run": "identification.identify",
    "TransferFunction": "model.transfer_function",
    "Window": "model.lpfbs",
    "compensate": "library",
    "contour_error": "library",
    "convert": "library",
    "identify": "identification.identify",
    "load_printer": "library",
    "predict": "library",
    "simulate": "library",
}


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
