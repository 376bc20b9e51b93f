"""`giajax paper`: the paper's figures and tables, made again."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError

# As `giajax.paper` has them, which would import JAX for a help text.
NAMES = ("fig5", "fig6", "fig9", "fig10", "fig12", "fig19", "table3")
_ALL = "all"

EXAMPLES = """\b
Examples:
  giajax paper fig5 --out paper
  giajax paper all --out paper          everything, and index.html

\b
NAME is
  fig5      links 6, 12 and 20 after a step of the base joint, with and without air
  fig6      the controller in the whole arm: by pressures, and by commanded angles
  fig9      contraction and force of a muscle in a joint, without corrections
  fig10     the same with alpha and beta
  fig12     one link with hysteresis, without and with compensation
  fig19     links 2, 6, 12 and 20 in models and in a stand-in for the experiment
  table3    how well the models follow it: the concordance with and without air

Each writes NAME.png, NAME.csv and NAME.json, and says what is printed in the paper, assumed, or
reconstructed."""


def paper(
    name: Annotated[str, typer.Argument(metavar="NAME", help="See below, or 'all'.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for pictures and numbers.")],
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the tables only.")] = False,
) -> None:
    """Make a figure or a table of the paper again.

    From the functions that you would use for your own arm.
    """
    from ..runs import check_output_folder, make_folder, write_files

    if name not in (*NAMES, _ALL):
        raise InputError(f"there is no figure '{name}': use one of {', '.join(NAMES)}, {_ALL}")
    names = NAMES if name == _ALL else (name,)
    files = [f"{each}.{ending}" for each in names for ending in ("png", "csv", "json")]
    page = ["index.html"] if name == _ALL else []
    check_output_folder(out, [*files, *page], force=force)

    from ._jax import configure

    configure()
    from ..paper import reproduce, reproduced_files, reproduction_page
    from ._examples import examples_root
    from ._output import print_table

    progress = None if quiet else (lambda text: typer.echo(text, err=True))
    made = []
    recordings = examples_root() / "data" / "paper"
    for each, shown in reproduce(names, recordings, progress=progress):
        make_folder(out)
        contents = reproduced_files(each, shown)
        write_files({out / file: contents[file] for file in contents}, force=force)
        made.append((each, shown))
        print(shown.title)
        print_table(shown.headings, shown.rows)
        print()
    if page:
        write_files({out / page[0]: reproduction_page(made)}, force=force)
    if not quiet:
        print(f"wrote {out}: {', '.join([*page, *files])}")
