"""The version of this installation, as its metadata have it."""

from importlib.metadata import version

__version__ = version("giajax")
