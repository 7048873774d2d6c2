"""``python -m hframe_post``, and the installed command."""

import signal
import sys
from typing import NoReturn


def main() -> NoReturn:
    """Runs the command line. Imports take a while: till then an interrupt just ends it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if getattr(sys, "frozen", False):  # as one file, which is each of its processes, too
        from multiprocessing import freeze_support

        freeze_support()

    from hframe_post.cli.main import main as command
    from hframe_post.cli.process import run

    run(command)


if __name__ == "__main__":
    main()
