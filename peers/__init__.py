"""Independent implementations of the arm: references for the tests and the benchmarks.

This folder is not part of the installed package. It needs MuJoCo and CasADi, which only the `bench`
extra installs. Tests and `python -m benchmarks.NAME` import it if they run in the root folder of
the project.
"""
