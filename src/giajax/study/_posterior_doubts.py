"""What is wrong with draws, in sentences."""

from collections.abc import Mapping, Sequence

import numpy as np

from ._marginal import Marginal

# What draws must reach to be taken for what they are meant to be (Vehtari et al. 2021).
MOST_R_HAT, LEAST_ESS = 1.01, 400


def doubts(
    marginals: Mapping[str, Marginal],
    divergences: int,
    samples: np.ndarray,
    failed: Sequence[str],
    asked: int,
) -> list[str]:
    """One sentence for each thing that is wrong with draws.

    Arguments:
        marginals: by label.
        divergences: of all draws.
        samples: shape (chain, draw, parameter).
        failed: why chains were not drawn.
        asked: how many chains there were to be.
    """
    sentences = []
    chains = samples.shape[0]
    if chains < asked:
        why = f" ({failed[0]})" if failed else ""
        sentences.append(f"{asked - chains} of {asked} chains were not drawn{why}: run it again")
    stuck = [label for label, one in marginals.items() if one.r_hat is None]
    if stuck:
        sentences.append(
            f"the chains are stuck: the draws of {' and '.join(stuck)} in a chain are all equal; "
            "take a longer warm-up, and if that does not help give priors or bounds that keep away "
            "from where the model fails"
        )
    hats = {label: one.r_hat for label, one in marginals.items() if one.r_hat is not None}
    worst = max(hats, key=lambda label: hats[label], default=None)
    if worst is not None and hats[worst] > MOST_R_HAT:
        sentences.append(
            f"the chains have not found together: R-hat of {worst} is {hats[worst]:.3f}, above "
            f"{MOST_R_HAT:g}; take more draws and a longer warm-up"
        )
    sizes = {
        label: min(one.ess_bulk or 0.0, one.ess_tail or 0.0)
        for label, one in marginals.items()
        if one.r_hat is not None
    }
    least = min(sizes, key=lambda label: sizes[label], default=None)
    if least is not None and sizes[least] < LEAST_ESS:
        sentences.append(
            f"the draws of {least} are worth {sizes[least]:.0f} independent ones, and the ends of "
            f"an interval take {LEAST_ESS}: take more draws"
        )
    if divergences:
        sentences.append(
            f"{divergences} of {samples.shape[0] * samples.shape[1]} draws diverged, so a part of "
            "the posterior may be missing: free fewer parameters, or give priors or bounds that "
            "keep away from where the model fails"
        )
    return sentences
