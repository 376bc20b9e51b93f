"""The word for what ended a fit; its sentence is the message."""

from typing import Literal

Reason = Literal[
    "optimum",
    "iterations",
    "budget",
    "rough",
    "wall",
    "crawl",
    "cannot_fit",
    "no_response",
    "interrupted",
    "",
]
"""As `FitResult.reason` has it; empty in a file of an earlier version."""
