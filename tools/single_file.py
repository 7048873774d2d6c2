"""Build ``dist/hframe-post``, the tool as one file, for users without Python.

    python tools/single_file.py [FOLDER]

PyInstaller builds it in a new virtual environment, for the present system and newer ones: run it
on the oldest system to support. docs/install.md says why PyInstaller was chosen.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILDER = "pyinstaller>=6.10,<7"
EXTRAS = "watch"  # others make the file larger, and its start slower
UNUSED = (  # modules that SciPy and NumPy mention but never import here
    "numpy.testing", "scipy.io", "scipy.spatial.transform", "setuptools", "tkinter",
    "unittest", "pydoc",
)  # fmt: skip
ENTRY = "from hframe_post.__main__ import main\n\nmain()\n"


def build(folder: Path) -> Path:
    """Build the file in that folder and return its path. Raises CalledProcessError."""
    with tempfile.TemporaryDirectory(prefix="hframe-post-build-") as temporary:
        place = Path(temporary)
        venv.create(place / "venv", with_pip=True)
        python = place / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
        run(python, "-m", "pip", "install", "-q", "--no-compile", f"{ROOT}[{EXTRAS}]", BUILDER)
        entry = place / "hframe-post.py"
        entry.write_text(ENTRY)
        excluded = [word for name in UNUSED for word in ("--exclude-module", name)]
        run(
            python, "-m", "PyInstaller", "--onefile", "--name", "hframe-post", "--log-level=WARN",
            "--collect-data", "hframe_post", "--collect-submodules", "hframe_post",
            "--recursive-copy-metadata", "hframe-post", *excluded,
            "--distpath", folder, "--workpath", place / "work", "--specpath", place, entry,
        )  # fmt: skip
    return folder / ("hframe-post.exe" if sys.platform == "win32" else "hframe-post")


def run(*command: str | Path) -> None:
    subprocess.run([str(word) for word in command], check=True, cwd=ROOT)


if __name__ == "__main__":
    built = build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist").absolute())
    print(f"{built}: {built.stat().st_size / 1e6:.0f} MB")
