"""Fly a mission: bring the arm into an opening with the picture of a camera at the tip."""

from ._cases import Case as Case, Cases as Cases, Tally as Tally, fly_cases as fly_cases
from ._certificate import (
    FEWEST_CASES as FEWEST_CASES,
    Certificate as Certificate,
    RestedCase as RestedCase,
    Resting as Resting,
    Waiting as Waiting,
    certificate as certificate,
    fly_rested as fly_rested,
)
from ._controller import (
    AbstractController as AbstractController,
    Opening as Opening,
    Picture as Picture,
    Scene as Scene,
    opening_of as opening_of,
    within_limits as within_limits,
)
from ._mission import (
    CONTROLLERS as CONTROLLERS,
    Mission as Mission,
    Outcome as Outcome,
    Touched as Touched,
    motion as motion,
    recorded as recorded,
)
from ._operator import (
    Operator as Operator,
    Sight as Sight,
    Tracking as Tracking,
    posed as posed,
)
from ._report import (
    CASES_FILES as CASES_FILES,
    CERTIFICATE_FILES as CERTIFICATE_FILES,
    MISSION_FILES as MISSION_FILES,
    cases_files as cases_files,
    cases_json as cases_json,
    certificate_figure as certificate_figure,
    certificate_files as certificate_files,
    certificate_json as certificate_json,
    mission_figure as mission_figure,
    mission_files as mission_files,
    mission_json as mission_json,
)
from ._steer import (
    Steering as Steering,
    SteeringMemory as SteeringMemory,
    box_least_squares as box_least_squares,
)
