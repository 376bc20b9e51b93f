"""The arm again, by others: what the tests compare giajax with, and the benchmarks measure it by.

Not a part of the package: it needs MuJoCo and scipy, which only the `bench` extra installs. The
tests find it from the root of the project, and so does `python -m benchmarks.NAME` there.
"""
