from ._controller import (
    first_turn as first_turn,
    step_size_controller as step_size_controller,
)
from ._linearly_implicit import (
    LinearlyImplicit as LinearlyImplicit,
    tableau as tableau,
)
from ._motion import (
    Inputs as Inputs,
    angle_after as angle_after,
    fastest_rate as fastest_rate,
    motion as motion,
    pull as pull,
    springs as springs,
    turns as turns,
)
from ._return_mapping import (
    with_return_mapping as with_return_mapping,
)
from ._signal import (
    LaggedSignal as LaggedSignal,
    Pressures as Pressures,
    SaturatedSignal as SaturatedSignal,
    Signal as Signal,
    check_muscles as check_muscles,
    constant as constant,
    followed as followed,
    lagged as lagged,
    last_before as last_before,
    logged as logged,
    ramps as ramps,
    steps as steps,
)
from ._simulate import (
    MAX_STEPS as MAX_STEPS,
    StepsFor as StepsFor,
    check_steps_for as check_steps_for,
    check_wind as check_wind,
    integrate as integrate,
    is_disturbance as is_disturbance,
    simulate as simulate,
)
from ._solvers import (
    SOLVERS as SOLVERS,
    Solver as Solver,
    check_method as check_method,
    solver as solver,
)
from ._stepper import Moment as Moment, Stepper as Stepper
from ._trajectory import (
    RESULTS as RESULTS,
    Contacts as Contacts,
    SimulationError as SimulationError,
    Trajectory as Trajectory,
    at_rest as at_rest,
    contacts as contacts,
    joint_ramps as joint_ramps,
    joint_steps as joint_steps,
)
