"""Run a command once a file is absent: ``python gate.py FILE COMMAND...``.

It ends, as hframe-post does for Moonraker, when the pipe that is its standard input closes.
"""

import os
import select
import stat
import sys

if __name__ == "__main__":
    # /dev/null, which OctoPrint's plugin gives, is always readable
    watched = [0] if stat.S_ISFIFO(os.fstat(0).st_mode) else []
    while os.path.exists(sys.argv[1]):
        if select.select(watched, [], [], 0.1)[0]:
            sys.exit(1)
    os.execvp(sys.argv[2], sys.argv[2:])
