"""Which recording determines which parameter, as text."""

from ..fitting import FitResult

# Without one of two equal recordings errors are 1.4 times as large; more than this is worth a word.
_NOTABLE = 2.0

# A factor is told up to here; beyond it hardly anything is known without the recording.
_LARGE = 1000.0


def source_lines(result: FitResult) -> list[str]:
    """A line for each recording that determines something which the others hardly do.

    Arguments:
        result: of a fit of several recordings; of one there is nothing to say.

    Returns:
        Such as `bench: nothing else determines alpha.offset`.
    """
    alone: dict[str, list[str]] = {}
    mostly: dict[str, list[str]] = {}
    for path, estimate in result.free.items():
        for recording, factor in estimate.sources.items():
            if factor is None:
                alone.setdefault(recording, []).append(path)
            elif factor > _NOTABLE:
                times = f"over {_LARGE:.0f}" if factor > _LARGE else f"{factor:.2g}"
                mostly.setdefault(recording, []).append(f"{path} ({times})")
    lines = []
    for recording in dict.fromkeys([*alone, *mostly]):
        parts = []
        if recording in alone:
            parts.append(f"nothing else determines {', '.join(alone[recording])}")
        if recording in mostly:
            listed = ", ".join(mostly[recording])
            parts.append(f"without it errors are as many times as large: {listed}")
        lines.append(f"{recording}: {'; '.join(parts)}")
    return lines
