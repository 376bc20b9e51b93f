"""Whether likelihoods of results are of the same values under the same noise."""

import json
from collections.abc import Sequence
from typing import Any

from ..fitting import FitResult, RunFit

# What must be the same, beside the data, where likelihoods are compared.
_ASSUMED = ("noise", "loss", "prior")


def obstacles(results: Sequence[FitResult], names: Sequence[str]) -> list[str]:
    """Sentences on why the likelihoods of some results cannot be compared; none where they can.

    Arguments:
        results: each is compared with the first.
        names: of each.
    """
    said = []
    first = results[0]
    for result, name in zip(results[1:], names[1:], strict=True):
        if not (_known(first) and _known(result)):
            said.append(
                f"{names[0]} or {name} was fitted to a run without a file: whether their data are "
                "the same is not known, so chi-square and BIC cannot be compared"
            )
        elif _data(first) != _data(result):
            said.append(
                f"{names[0]} and {name} were fitted to different data: chi-square and BIC cannot "
                "be compared, parameters can"
            )
        elif differing := [what for what in _ASSUMED if _of(first, what) != _of(result, what)]:
            said.append(
                f"{names[0]} and {name} assume another {' and another '.join(differing)}: "
                "chi-square, BIC and standard errors cannot be compared"
            )
    for result, name in zip(results, names, strict=True):
        if result.status != "converged":
            said.append(f"{name} has not converged: its values are not those of an optimum")
    return said


def _known(result: FitResult) -> bool:
    return all(run.sha256 for run in result.runs)


def _data(result: FitResult) -> list[Any]:
    """What was fitted: files, windows, channels and how many values of each."""
    return sorted(
        (*_place(run, about), sorted((name, c.n) for name, c in run.channels.items()))
        for run, about in _described(result)
    )


def _described(result: FitResult) -> list[tuple[RunFit, dict[str, Any]]]:
    """The runs with what the configuration says of each; nothing where it does not."""
    said = [*result.config.get("runs", []), *({} for _ in result.runs)]
    return list(zip(result.runs, said, strict=False))


def _place(run: RunFit, about: dict[str, Any]) -> tuple[str, float]:
    """File and window of a run, by which runs are ordered: fits name them in any order."""
    return str(run.sha256), about.get("from_s") or 0.0


def _of(result: FitResult, what: str) -> str:
    """What a fit took for granted, as text."""
    config = result.config
    ordered = sorted(_described(result), key=lambda described: _place(*described))
    stated = [about.get("noise") for _, about in ordered]
    assumed = {
        "noise": [stated, config.get("noise_model"), config.get("noise_per_run")],
        "loss": config.get("loss"),
        "prior": config.get("priors") or None,
    }
    return json.dumps(assumed[what], sort_keys=True)
