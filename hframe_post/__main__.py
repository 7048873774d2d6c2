"""``python -m hframe_post``, and the installed command."""

import os
import signal
import sys
from typing import NoReturn

from hframe_post.version import __version__


def main() -> NoReturn:
    """Run the command line and end the process.

    Until the imports are done, Ctrl-C ends the process without a traceback.
    """
    if sys.argv[1:] == ["--version"]:  # which other programs ask for: answered without imports
        try:
            os.write(1, f"hframe-post, version {__version__}\n".encode())
        except OSError as error:
            sys.exit(f"Error: {error.strerror}")
        sys.exit()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # numpy would start a thread for each processor, which takes 0.1 s of them; all work uses one
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")

    from hframe_post.cli.main import run

    run()


if __name__ == "__main__":
    main()
