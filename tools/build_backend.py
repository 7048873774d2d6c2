"""The build backend: setuptools, with a C compiler from the package index where none is found."""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

COMPILER = "ziglang>=0.13"  # 99 MB to download, 411 MB unpacked, for the time of the build only


def compiler_is_missing() -> bool:
    """Return whether setuptools would find no C compiler. On Windows it says so itself."""
    compiler = os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc"
    return sys.platform != "win32" and shutil.which(compiler.split()[0]) is None


MISSING = [COMPILER] if compiler_is_missing() else []  # before setup.py names it as CC


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    return [*build_meta.get_requires_for_build_wheel(config_settings), *MISSING]


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    return [*build_meta.get_requires_for_build_editable(config_settings), *MISSING]
