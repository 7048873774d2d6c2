"""The profile and the model that a measuring command writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hframe_post.printer.model_file import model_path, texts

if TYPE_CHECKING:
    from hframe_post.printer.settings import Printer
    from hframe_post.writers.files import Outputs


class ModelOutput:
    """A profile and its model, opened before the work so that it is not done in vain.

    output: the profile's file. source: name or file of the profile that is completed. text: of
    that, if it is in no file.
    """

    def __init__(
        self, outputs: Outputs, output: Path, source: str, text: str | None = None
    ) -> None:
        self._output, self._source, self._text = output, source, text
        self._profile = outputs.open(output, Path(source) if text is None else None)
        self._model = outputs.open(model_path(output), model_path(output))

    def write(self, printer: Printer, notes: Sequence[str] | None = None) -> None:
        """Write the plant, windows and marks of a printer. notes: None keeps the present ones."""
        found = texts(printer, self._source, self._output, notes, self._text)
        self._profile.write(found.profile.encode())
        self._model.write(found.model.encode())
