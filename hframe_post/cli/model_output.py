"""The profile, the model and the kernel that a measuring command writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hframe_post.cli.options import write_kernel
from hframe_post.errors import HframeError
from hframe_post.printer.model_file import model_path, texts

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer
    from hframe_post.writers.outputs import Outputs


class ModelOutput:
    """A profile and its model, opened before the work so that it is not done in vain.

    output: the profile's file. source: name or file of the profile that is completed. text: of
    that, if it is in no file.
    """

    def __init__(
        self, outputs: Outputs, output: Path, source: str, text: str | None = None
    ) -> None:
        if output.suffix != ".toml":
            raise HframeError(
                f"{output}: the model is written beside the profile, whose name must end in .toml"
            )
        self._outputs, self._output, self._source, self._text = outputs, output, source, text
        self._profile = outputs.open(output, Path(source) if text is None else None)
        self._model = outputs.open(model_path(output), model_path(output))

    def write(self, printer: Printer, notes: Sequence[str] | None = None) -> None:
        """Write the plant, windows and marks of a printer. notes: None keeps the present ones."""
        found = texts(printer, self._source, self._output, notes, self._text)
        self._profile.write(found.profile.encode())
        self._model.write(found.model.encode())
        write_kernel(self._outputs, self._output, found.printer)
