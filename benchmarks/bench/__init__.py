"""giajax beside MuJoCo, CasADi and scipy on one chain, in one run: `make bench`.

Every contender solves the same problem: the 20-link arm of the paper, joints 1 and 2 driven, 25 s.
Each takes the coarsest step or tolerance that keeps the tip within 1e-4 m of a tight reference;
the table shows which. Times are wall time, minimum and median of the repeats; contenders take
turns, so that another load on the machine falls on all of them. Compare ratios, not seconds.

    python -m benchmarks.bench [--quick] [--out FILE] [--record] [--check]
"""
