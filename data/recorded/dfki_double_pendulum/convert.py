"""Convert an original recording into a run: `python convert.py ORIGINAL.csv OUT.csv`.

Position, velocity and torque as measured; angles are 0 where the arm hangs, the second one is
relative to the first link.
"""

import sys

import polars as pl

COLUMNS = {
    "time": "time_s",
    "tau_meas1": "joint01_torque_N_m",
    "tau_meas2": "joint02_torque_N_m",
    "pos_meas1": "joint01_angle_rad",
    "pos_meas2": "joint02_angle_rad",
    "vel_meas1": "joint01_rate_rad_per_s",
    "vel_meas2": "joint02_rate_rad_per_s",
}

if __name__ == "__main__":
    source, target = sys.argv[1:]
    table = pl.read_csv(source).select(pl.col(old).alias(new) for old, new in COLUMNS.items())
    table.with_columns(pl.all().round_sig_figs(8)).write_csv(target)
