"""The version, for every room to read."""

try:
    from hframe_post._version import __version__  # which the installation writes
except ImportError:  # run from a folder in which nothing was installed
    __version__ = "0.0"

__all__ = ["__version__"]
