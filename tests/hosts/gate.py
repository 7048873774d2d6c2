"""Run a command once a file is absent: ``python gate.py FILE COMMAND...``.

It ends, as hframe-post does, when its standard input closes.
"""

import os
import select
import sys

if __name__ == "__main__":
    while os.path.exists(sys.argv[1]):
        if select.select([0], [], [], 0.1)[0]:
            sys.exit(1)
    os.execvp(sys.argv[2], sys.argv[2:])
