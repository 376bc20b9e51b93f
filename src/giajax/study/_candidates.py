"""The hysteresis models that may be chosen, by name."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from ..models import hysteresis_keys
from ..runs import Definition, Run


@dataclasses.dataclass(frozen=True)
class CandidateModel:
    """A model that may be chosen.

    Attributes:
        section: what of `[hysteresis]` makes it.
        free: paths of the parameters to fit beside those that a fit frees by itself.
    """

    section: Mapping[str, Any]
    free: tuple[str, ...] = ()

    def applied_to(self, run: Run) -> Run:
        """A run with this model in its `[hysteresis]`, whose other keys stay."""
        sections, known = run.definition.contents(), hysteresis_keys(self.section["operator"])
        kept = {
            key: value
            for key, value in sections.get("hysteresis", {}).items()
            if key in known and key not in ("operator", "elements") and key not in self.section
        }
        sections["hysteresis"] = {**kept, **self.section}
        return dataclasses.replace(run, definition=Definition.parse(sections, run.name))


CANDIDATES: dict[str, CandidateModel] = {
    "play": CandidateModel({"operator": "prandtl_ishlinskii", "thresholds": 1}, ("thresholds",)),
    "stop": CandidateModel(
        {"operator": "prandtl_ishlinskii", "thresholds": 1, "elements": "stop"}, ("thresholds",)
    ),
    "prandtl_ishlinskii": CandidateModel({"operator": "prandtl_ishlinskii"}),
    "prandtl_ishlinskii_stop": CandidateModel(
        {"operator": "prandtl_ishlinskii", "elements": "stop"}
    ),
    "modified_prandtl_ishlinskii": CandidateModel({"operator": "modified_prandtl_ishlinskii"}),
    "preisach": CandidateModel({"operator": "preisach"}, ("bias",)),
    "bouc_wen": CandidateModel({"operator": "bouc_wen"}),
}
"""The models that may be chosen, by the names that `giajax choose` gives them."""
