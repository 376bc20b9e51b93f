"""What a fit leaves over, and what of it the model holds, switches off or leaves out."""

from ._records import LEVEL as LEVEL, Suspects as Suspects
from ._suspects import suspects as suspects
