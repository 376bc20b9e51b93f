"""Simulated experiments: what no public recording exists for."""

from ._files import (
    NOISE as NOISE,
    ONE_LINK_FILES as ONE_LINK_FILES,
    BoucWenBenchmark as BoucWenBenchmark,
    bouc_wen_benchmark as bouc_wen_benchmark,
    decibels as decibels,
    figure_12 as figure_12,
    multisine as multisine,
    one_link_table as one_link_table,
    write_one_link as write_one_link,
)
from ._one_link import (
    History as History,
    OneLink as OneLink,
    SimulatedJoint as SimulatedJoint,
    Trial as Trial,
    history as history,
    one_link as one_link,
    other_history as other_history,
    paper_history as paper_history,
    record_joint as record_joint,
)
