"""The command line. Thin: every command reads its options and calls the library."""

from ._app import main as main
