"""Cura's plugin: put the post-processing script where Cura's own plugin finds scripts."""

import os
import shutil

from UM.Extension import Extension
from UM.Resources import Resources

SCRIPT = "HframePost.py"


def getMetaData():  # noqa: N802
    return {}


def register(app):
    """Copy the script: PostProcessingPlugin reads no folder of other plugins."""
    folder = os.path.join(Resources.getStoragePath(Resources.Resources), "scripts")
    os.makedirs(folder, exist_ok=True)
    here = os.path.dirname(os.path.abspath(__file__))
    shutil.copyfile(os.path.join(here, "script", SCRIPT), os.path.join(folder, SCRIPT))
    return {"extension": Extension()}
