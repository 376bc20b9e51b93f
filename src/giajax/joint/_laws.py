"""The laws of muscles by name."""

from ._braided import BraidedMuscle
from ._empirical import EmpiricalMuscle
from ._muscle import AbstractMuscle
from ._piston import Piston

MUSCLE_LAWS: dict[str, type[AbstractMuscle]] = {
    law.name: law for law in (BraidedMuscle, EmpiricalMuscle, Piston)
}
"""The laws by the name that files give them."""
