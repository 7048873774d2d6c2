"""``python -m hframe_post``, and the installed command."""

import os
import signal
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line and end the process.

    Until the imports are done, Ctrl-C ends the process without a traceback.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # numpy would start a thread for each processor, which takes 0.1 s of them; all work uses one
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from hframe_post.cli.main import run

    run()


if __name__ == "__main__":
    main()
