"""The next experiment: the command and the markers that tell most of chosen parameters."""

from ._criterion import Criterion as Criterion, covariance_of as covariance_of
from ._design import Design as Design, Expected as Expected
from ._experiment import design_experiment as design_experiment
from ._limits import Limits as Limits
from ._question import joint_count as joint_count
from ._search import Evaluation as Evaluation
