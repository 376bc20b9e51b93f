"""Studies that take too long for a test; their figures are stored in `docs/evidence`.

    python -m evidence           list the studies
    python -m evidence coverage  run one and write docs/evidence/coverage.json (`make evidence`)

The documentation quotes these files. The tests repeat a fiftieth of each study with other random
numbers, and check that its figures are consistent with the stored ones. A new study is a module
with a `Study`, and a line in `STUDIES`.
"""

from ._bootstrap import BOOTSTRAP
from ._certificate import CERTIFICATE
from ._coverage import COVERAGE
from ._design import DESIGN
from ._explained import EXPLAINED
from ._influence import INFLUENCE
from ._kills import KILLS
from ._ladder import LADDER
from ._ladder_friction import LADDER_FRICTION
from ._leaks import LEAKS
from ._missions import MISSIONS
from ._noise import NOISE
from ._omissions import OMISSIONS
from ._page import PAGE as PAGE, page as page
from ._plans import PLANS
from ._posterior import POSTERIOR
from ._profile import PROFILE
from ._record import (
    FOLDER as FOLDER,
    ROOT as ROOT,
    read as read,
    record as record,
    write as write,
)
from ._right_models import RIGHT_MODELS
from ._shaping import SHAPING
from ._station import HOLDING
from ._steering import STEERING
from ._study import Study as Study
from ._suspects import SUSPECTS
from ._sweep import SWEEP, SWEEP_SPEED
from ._tracking import TRACKING

_ALL = (
    COVERAGE,
    NOISE,
    KILLS,
    SUSPECTS,
    OMISSIONS,
    EXPLAINED,
    RIGHT_MODELS,
    LADDER,
    LADDER_FRICTION,
    BOOTSTRAP,
    INFLUENCE,
    PROFILE,
    SWEEP,
    SWEEP_SPEED,
    POSTERIOR,
    DESIGN,
    MISSIONS,
    SHAPING,
    PLANS,
    STEERING,
    HOLDING,
    CERTIFICATE,
    TRACKING,
    LEAKS,
)
STUDIES = {study.name: study for study in _ALL}
