"""Conversions by the workers of a Dask cluster: https://distributed.dask.org

A worker runs the same process for a file as this machine would, so the bytes are the same. The
scheduler gives the file of a worker that was lost to another one.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hframe_post.cli.batch.job import Job, begins_with
from hframe_post.cli.batch.one_file import Conversion, Ended
from hframe_post.errors import HframeError
from hframe_post.version import __version__

PATIENCE = 10  # s for the scheduler to answer, and for a worker to be there


@dataclass(frozen=True, slots=True)
class Sent:
    """What a worker needs to know. content: of the source; profile: the profile's text.

    Both are None where the worker reads the files itself.
    """

    source: str
    target: str
    printer: str
    options: tuple[str, ...]
    content: bytes | None = None
    profile: bytes | None = None
    version: str = __version__


@dataclass(frozen=True, slots=True)
class Fetched:
    """What a worker gives back. content: of the output, where it did not write it itself."""

    ended: Ended
    worker: str
    content: bytes = b""


def convert_there(sent: Sent) -> Fetched:
    """Runs on a worker. Raises HframeError where it cannot convert as the sender would."""
    from distributed import get_worker

    worker = str(get_worker().address)
    if sent.version != __version__:
        raise HframeError(f"worker {worker} has hframe-post {__version__}, not {sent.version}")
    options = (*sent.options, "--jobs", "1")  # a thread of the worker is one processor
    if sent.content is None:
        converted = Conversion(sent.source, sent.target, ("-p", sent.printer, *options))
        return Fetched(converted.ended(), worker)
    with tempfile.TemporaryDirectory(prefix="hframe-post-") as folder:
        place = Path(folder)
        source, target = place / Path(sent.source).name, place / "out" / Path(sent.target).name
        target.parent.mkdir()
        source.write_bytes(sent.content)
        printer = sent.printer
        if sent.profile is not None:
            (place / "profile").mkdir()
            file = place / "profile" / Path(printer).name
            file.write_bytes(sent.profile)
            printer = str(file)
        ended = Conversion(str(source), str(target), ("-p", printer, *options)).ended()
        return Fetched(ended, worker, target.read_bytes() if ended.status == 0 else b"")


class Cluster:
    """The workers of a scheduler. Raises HframeError where there are none.

    stamped: the first line that what they write must have. send: files go and come by content.
    """

    def __init__(
        self, scheduler: str, files: int | None, printer: str, options: Sequence[str],
        stamped: bytes, send: bool,
    ) -> None:  # fmt: skip
        self._client = _connected(scheduler)
        threads = sum(self._client.nthreads().values())
        self.files = files or threads
        self._options, self._stamped, self._send = tuple(options), stamped, send
        own = Path(printer)
        self._printer = str(own.absolute()) if own.is_file() else printer
        self._profile = own.read_bytes() if send and own.is_file() else None

    def convert(self, job: Job) -> Job:
        """The job, done or failed."""
        source, target = job.source.absolute(), job.target.absolute()
        try:
            content = source.read_bytes() if self._send else None
            sent = Sent(
                str(source), str(target), self._printer, self._options, content, self._profile
            )
            fetched: Fetched = self._client.submit(convert_there, sent, pure=False).result()
            ended = replace(fetched.ended.of(job), worker=fetched.worker)
            if ended.state == "done":
                self._take(fetched, target)
        except Exception as error:  # whatever befell one file, the others go on
            return replace(job, state="failed", error=_cause(error))
        return ended

    def _take(self, fetched: Fetched, target: Path) -> None:
        """The output is here, whole, and as this machine would have written it."""
        from hframe_post.writers.files.atomic_file import Outputs

        if self._send:
            with Outputs() as outputs:
                outputs.open(target).write(fetched.content)
        elif not target.is_file():
            raise HframeError(
                f"{fetched.worker} wrote {target}, which is not there: storage that is not "
                "shared needs --send"
            )
        if not begins_with(target, self._stamped):
            raise HframeError(f"{fetched.worker} converted it with other settings")

    def stop(self) -> None:
        """Nothing to do: what has begun on a worker ends there."""


def _connected(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise HframeError(
            "--scheduler needs dask.distributed: pip install 'hframe-post[cluster]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # errors are told of once, by us
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=PATIENCE, set_as_default=False
        )
        client.wait_for_workers(1, timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise HframeError(
            f"{scheduler}: no cluster with a worker answers ({error}); start one with "
            "'dask scheduler' and 'dask worker'"
        ) from None
    return client


def _cause(error: Exception) -> str:
    """A line."""
    if type(error).__name__ == "KilledWorker":
        return "every worker that tried it was killed: is there enough memory?"
    if isinstance(error, ModuleNotFoundError):
        return f"the worker's Python lacks a package: {error}"
    return " ".join(str(error).split()) or type(error).__name__
