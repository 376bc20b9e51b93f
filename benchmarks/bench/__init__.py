"""Compare giajax with MuJoCo, CasADi and scipy on one chain, in one run: `make bench`.

Every contender solves the same problem: 25 s of the paper's 20-link arm with joints 1 and 2 driven.
Each uses the coarsest step or tolerance that keeps the error of the tip below 1e-4 m, relative to a
tight reference. The table shows this setting. The times are the minimum and the median wall time of
the repeats. The contenders take turns, so other load on the machine affects all of them. Compare
ratios, not seconds.

    python -m benchmarks.bench [--quick] [--out FILE] [--record] [--check]
"""
