"""`giajax cache`: what is kept between processes."""

from pathlib import Path
from typing import Annotated

import typer
from ._registry import command


@command("""\b
Examples:
  giajax cache              where it is, how many programs it holds, and their size
  giajax cache --clear      removes them; the next fit traces and compiles again""")
def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove what is there.")] = False,
) -> None:
    """Show or clear the programs that are kept between commands.

    Each command finds those of its model and its data there. A file that is of another version of
    giajax, or was damaged, is not used; none is ever removed but by --clear. The folder is giajax
    in the user's cache directory, or what JAX_COMPILATION_CACHE_DIR says: of that, only what
    giajax alone wrote is removed.
    """
    from .._errors import InputError
    from .._kept_files import SUFFIX
    from ._jax import PROGRAMS, compilation_cache
    from ._output import print_table

    directory, stated = compilation_cache()
    if directory is None:
        typer.echo(
            "there is no folder for a cache, and nothing is kept: set XDG_CACHE_HOME to one that "
            "can be written"
        )
        return
    traced = sorted((directory / PROGRAMS).glob(f"*{SUFFIX}"))
    compiled = sorted(directory.glob("*-cache"))
    if clear:
        removed = traced if stated else [*traced, *compiled]
        for path in removed:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise InputError(
                    f"{path} cannot be removed ({error.strerror}): remove the folder yourself"
                ) from None
        typer.echo(f"{directory}: removed {len(removed)} of {len(traced) + len(compiled)} programs")
        return
    typer.echo(str(directory))
    print_table(
        ["", "programs", "MB"],
        [
            (name, len(paths), _megabytes(paths))
            for name, paths in (("traced", traced), ("compiled", compiled))
        ],
    )


def _megabytes(paths: list[Path]) -> str:
    # Another process may remove one meanwhile.
    return f"{sum(path.stat().st_size for path in paths if path.exists()) / 1e6:.1f}"
