"""Commands that take a joint to its targets."""

from ._compensator import (
    Compensator as Compensator,
    compensator_for_loop as compensator_for_loop,
    compensator_for_model as compensator_for_model,
    target_channel as target_channel,
)
