"""Simulated experiments: what no public recording exists for."""

from ._bouc_wen_benchmark import (
    BoucWenBenchmark as BoucWenBenchmark,
    bouc_wen_benchmark as bouc_wen_benchmark,
    decibels as decibels,
)
from ._figure_12 import figure_12 as figure_12
from ._files import (
    ONE_LINK_FILES as ONE_LINK_FILES,
    one_link_table as one_link_table,
    write_one_link as write_one_link,
)
from ._history import (
    History as History,
    history as history,
    other_history as other_history,
    paper_history as paper_history,
)
from ._one_link import (
    OneLink as OneLink,
    Trial as Trial,
    one_link as one_link,
    record_joint as record_joint,
)
from ._simulated_joint import SimulatedJoint as SimulatedJoint
