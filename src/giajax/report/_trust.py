"""What a summary says of the verdict and of the noise."""

from ..fitting import FitResult


def verdict_lines(result: FitResult) -> list[str]:
    """Whether the model describes the data, and a line for each reason why it does not."""
    verdict = result.verdict
    reasons = [reason.sentence for reason in verdict.reasons]
    if verdict.status != "inadequate":
        return [verdict.sentence]
    return [f"inadequate: {reasons[0]}", *reasons[1:]]


def noise_lines(result: FitResult) -> list[str]:
    """What was taken for noise with a memory, and what it does to the standard errors."""
    if result.noise is None or not result.noise.widening:
        return []
    channels = [channel for run in result.runs for channel in run.channels.values()]
    times = [c.correlation_time_s for c in channels if c.correlated]
    names = {name for run in result.runs for name, c in run.channels.items() if c.correlated}
    shortest, longest = min(times), max(times)
    span = f"{shortest:.2g}" if shortest == longest else f"{shortest:.2g} to {longest:.2g}"
    factors = [factor for factor in result.noise.widening.values() if factor is not None]
    sentence = f"correlated over {span} s in {len(names)} of {_count(result)} channels"
    if factors:
        low, high = f"{min(factors):.2g}", f"{max(factors):.2g}"
        span = low if low == high else f"{low} to {high}"
        sentence += f"; the standard errors are {span} times those of white noise of the same size"
    return [sentence]


def _count(result: FitResult) -> int:
    return len({name for run in result.runs for name in run.channels})
