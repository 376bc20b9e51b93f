"""A mission: an operator who sees what a camera at the tip shows brings the arm to an opening."""

from ._cases import Cases as Cases, fly_cases as fly_cases
from ._mission import Mission as Mission
from ._opening import Opening as Opening, opening_of as opening_of
from ._operator import Operator as Operator
from ._outcome import Outcome as Outcome, Touched as Touched
from ._recorded import motion as motion, recorded as recorded
from ._tally import Case as Case, Tally as Tally
from ._tracking import Sight as Sight, Tracking as Tracking
