"""Write the page that shows the stored figures."""

from collections.abc import Iterable

from ._record import FOLDER, read
from ._study import Study

PAGE = FOLDER / "README.md"

_INTRODUCTION = """\
# Evidence

This page lists the results of studies that take too long for a test. `make evidence NAME` computes
a study and writes its figures to the JSON file that is linked below its table, together with the
commit, the versions and the random seed. `make test-long` repeats a fiftieth of each
study, or some of its cases, with other random numbers, and compares the results. If an interrupted
study was resumed, the time that is given covers only the last run.
"""


def page(studies: Iterable[Study]) -> str:
    """Return the text of the page.

    Arguments:
        studies: studies in the order of the page; those without a stored file are left out.
    """
    return "\n".join([_INTRODUCTION, *(_section(study) for study in studies if _is_stored(study))])


def _is_stored(study: Study) -> bool:
    return (FOLDER / f"{study.name}.json").exists()


def _section(study: Study) -> str:
    content = read(study)
    versions = content["versions"]
    commit = (content["commit"] or "unknown")[:12]
    run = (
        f"{content['size']} {'repetition' if content['size'] == 1 else 'repetitions'} in "
        f"{content['seconds']:.0f} s, seed {content['seed']}, "
        f"commit {commit}, jax {versions['jax']}, Python {versions['python']}: "
        f"[{study.name}.json]({study.name}.json)."
    )
    rows = "\n".join(study.table(content["figures"]))
    title = study.title or study.name.replace("_", " ").capitalize()
    return f"## {title}\n\n{study.meaning}\n\n{rows}\n\n{run}\n"
