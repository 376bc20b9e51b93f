"""Measurements, each a command: `python -m benchmarks.NAME` in the root of the project."""
