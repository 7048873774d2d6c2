"""Build ``dist/HframePost-VERSION.curapackage``, which Cura installs when it is dropped on it.

    python tools/cura_package.py [FOLDER]

The same file is what Cura's Marketplace takes. It holds the script that ``hframe-post cura-script``
installs, and a plugin that puts it in its place.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from importlib.metadata import metadata
from pathlib import Path

from hframe_post.cli.integrations import script

ROOT = Path(__file__).resolve().parents[1]
NAME = "HframePost"
SDK = "8.0.0"  # of Cura 5
FIRST = (1980, 1, 1, 0, 0, 0)  # the same bytes each time


def build(folder: Path) -> Path:
    """Build the package in that folder and return its path."""
    about = metadata("hframe-post")
    found = re.match(r"\d+\.\d+(\.\d+)?", about["Version"])
    version = found[0] if found and found[1] else f"{found[0] if found else '0.0'}.0"
    author = about["Author"]
    urls = dict(each.split(", ", 1) for each in about.get_all("Project-URL") or ())
    said = {"description": about["Summary"], "supported_sdk_versions": [SDK]}
    package = {
        "package_id": NAME, "package_type": "plugin", "display_name": "hframe-post",
        "package_version": version, "sdk_version": int(SDK[0]), "sdk_version_semver": SDK,
        "description": about["Summary"], "website": urls.get("Homepage", ""),
        "author": {"author_id": "hframepost", "display_name": author, "email": "", "website": ""},
    }  # fmt: skip
    plugin = {"name": "hframe-post", "author": author, "version": version, "api": 8, **said}
    place = f"files/plugins/{NAME}"
    files = {
        "package.json": json.dumps(package, indent=2),
        f"{place}/plugin.json": json.dumps(plugin, indent=2),
        f"{place}/__init__.py": (ROOT / "integrations/cura/__init__.py").read_text("utf-8"),
        f"{place}/script/{NAME}.py": script("hframe-post", ""),
        f"{place}/LICENSE": (ROOT / "LICENSE").read_text("utf-8"),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{NAME}-{version}.curapackage"
    with zipfile.ZipFile(path, "w") as packed:
        for name, text in files.items():
            packed.writestr(zipfile.ZipInfo(name, FIRST), text)
    return path


if __name__ == "__main__":
    print(build(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist").absolute()))
