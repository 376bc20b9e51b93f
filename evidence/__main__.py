"""Run a study, write its file, and update the page that shows the figures."""

import argparse
import os
from pathlib import Path

from . import FOLDER, PAGE, ROOT, STUDIES, page, record, write


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m evidence", description=__doc__)
    parser.add_argument(
        "name",
        nargs="?",
        choices=STUDIES,
        help="name of the study; if none is given, all are listed",
    )
    parser.add_argument("--size", type=int, help="number of repetitions")
    parser.add_argument("--seed", type=int, help="seed of the random numbers")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for the file NAME.json")
    arguments = parser.parse_args()
    if arguments.name is None:
        for study in STUDIES.values():
            print(f"{study.name}  {study.meaning}")
        return
    # As on the command line: checks by callbacks would exclude programs from the compilation cache.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
    study = STUDIES[arguments.name]
    size = study.size if arguments.size is None else arguments.size
    seed = study.seed if arguments.seed is None else arguments.seed
    content = record(study, size, seed)
    path = write(content, arguments.out)
    print("\n".join(study.table(content["figures"])))
    print(f"written to {path}, in {content['seconds']:.0f} s")
    if arguments.out.resolve() == FOLDER:
        PAGE.write_text(page(STUDIES.values()), encoding="utf-8")


if __name__ == "__main__":
    main()
