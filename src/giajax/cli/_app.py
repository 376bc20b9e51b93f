"""The commands of `giajax`.

A command registers itself, and imports what is heavy inside its function: `giajax --help`
and `giajax check` start without JAX.
"""

import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from ._commands import (
    COMMANDS,
    GROUPS,
    Commands,
    command_of,
    old_forms as forms_of,
    run,
    with_options,
)

# Each file registers its commands.
for _path in sorted(Path(__file__).parent.glob("_[a-z]*.py")):
    import_module(f".{_path.stem}", __package__)

_EXAMPLES = """\b
Examples:
  giajax check --data run.csv
                            what a recording holds
  giajax init --data run.csv
                            write a sidecar for it, to fill in
  giajax parameters         what a fit can find, with unit and bounds
  giajax simulate --ramp 1=30 --to run.csv
                            a run made by the model
  giajax examples           runs and fit definitions to start from
  giajax joint --out DIR    one joint at rest: paths, forces, equilibria
  giajax fit --data run.csv
                            fit drag, stiffness and damping to it
  giajax report giajax-out/run
                            the fit as a page: whether to believe it, and why
  giajax view giajax-out/run
                            the arm as fitted, and what was seen, in a browser
  giajax compare giajax-out/run giajax-out/other
                            whether two fits agree to within their errors
  giajax suspects giajax-out/run
                            what of it the model leaves out
  giajax bootstrap giajax-out/run
                            whether its errors are right: the fit repeated
  giajax influence giajax-out/run
                            what each marker and run does to its numbers
  giajax sweep plan.toml --workers 4
                            many fits: other values, runs or options each time
  giajax profile giajax-out/run
                            how far each parameter can go, bounds and all
  giajax posterior giajax-out/run
                            what is known of its parameters, by sampling
  giajax predict giajax-out/run --data other.csv
                            how well the fit predicts another run
  giajax choose --data loops.csv
                            which hysteresis model describes a joint
  giajax compensate fit --target target.csv --to command.csv
                            commands that undo the hysteresis
  giajax design giajax-out/run --parameter air.drag_coefficient --out next
                            the next experiment: what to command and to film
  giajax shape command.csv --model giajax-out/run --out shaped
                            a command after which the arm does not swing
  giajax plan --model giajax-out/run --pose 1=20 --out planned
                            the fastest command to a pose within the limits
  giajax track run.csv --model giajax-out/run --wind 0,0.2,0 --out tracked
                            where the arm was, from late and noisy pictures
  giajax wind --data resting.csv --wind 0,0.2,0
                            the gusts that a resting arm undulates in
  giajax fill --out DIR     20 balloons filled with helium: fullness, lift
  giajax mission missions/naraha.toml
                            an operator, a camera at the tip, a 2 m opening
  giajax life missions/naraha.toml --out DIR
                            from the roll to the opening and back
  giajax hysteresis --out DIR
                            the paper's 1-link experiment, simulated
  giajax paper all --out DIR
                            the paper's figures and tables, made again

A run is a CSV file with one column a channel (such as time_s, joint01_command_deg
or link06_z_m) and, beside it, an optional sidecar of the same name ending .toml."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `giajax` with these arguments (those of the process by default); the exit status."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    return run(typer.main.get_command(_app_for(words)), words)


def command_names() -> list[str]:
    """The names of all commands, in the order of the help."""
    order = list(GROUPS)
    return sorted(COMMANDS, key=lambda name: (order.index(COMMANDS[name].group), name))


def old_forms() -> Iterator[tuple[str, str]]:
    """Each command line that is an old form, and the one that it is now."""
    names = command_names()
    group: Any = typer.main.get_command(_app_for(names))
    for name in names:
        yield from forms_of(group.commands[name], COMMANDS[name]).values()


def _app_for(words: Sequence[str]) -> typer.Typer:
    """The app, whose commands have their options if they are among the words.

    Typer reads the signatures of all commands before it looks for the one that is asked for: half
    of the time of `giajax --help`, which shows none of their options.
    """
    app = typer.Typer(
        name="giajax",
        cls=Commands,
        help="Simulate very long, very light robot arms, and fit their parameters to recordings.",
        epilog=_EXAMPLES,
        context_settings={"help_option_names": ["-h", "--help"]},
        rich_markup_mode=None,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    app.callback(invoke_without_command=True)(_giajax)
    for name in command_names():
        each = COMMANDS[name]
        if name in words:
            full = with_options(each)
            app.command(name, epilog=each.examples, cls=command_of(full, each))(full)
        else:
            app.command(name, epilog=each.examples, help=each.function.__doc__)(_only_listed)
    return app


def _only_listed() -> None:
    raise AssertionError("a command was called that was only to be listed")


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"giajax {version('giajax')}")
        raise typer.Exit


def _giajax(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
