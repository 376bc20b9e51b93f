"""What a fit leaves over, and what of it the model holds, switches off or leaves out."""

from ._diagnosed import (
    with_suspects as with_suspects,
    with_systematic_errors as with_systematic_errors,
)
from ._doubts import check_uncertainty as check_uncertainty
from ._ladder import TRIES as TRIES, ladder as ladder
from ._records import LEVEL as LEVEL, Suspects as Suspects, promising as promising
from ._rung import Ladder as Ladder, Rung as Rung
from ._suspects import suspects as suspects
from ._systematic import (
    deciding_conditions as deciding_conditions,
    systematic_errors as systematic_errors,
    together as together,
)
