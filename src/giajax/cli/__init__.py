"""Command line of giajax; every command only reads its options and calls the library."""

from ._app import main as main
