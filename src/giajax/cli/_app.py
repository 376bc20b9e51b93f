"""The commands of `giajax`.

Each command registers itself. Slow imports are inside its function, so that `giajax --help` and
`giajax check` start without JAX.
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

# Each imported file registers its commands.
for _path in sorted(Path(__file__).parent.glob("_[a-z]*.py")):
    import_module(f".{_path.stem}", __package__)

_EXAMPLES = """\b
Examples:
  giajax check --data run.csv
                            summarise a recording and check its values
  giajax init --data run.csv
                            write a sidecar template for the run
  giajax parameters         list the parameters, with unit and bounds
  giajax simulate --ramp 1=30 --to run.csv
                            simulate a run
  giajax examples           list the supplied runs and fit definitions
  giajax joint --out DIR    compute muscle forces and equilibria of a joint
  giajax fit --data run.csv
                            fit drag, stiffness and damping to the run
  giajax report giajax-out/run
                            write a page with the verdict and the estimates
  giajax view giajax-out/run
                            show the fitted arm and the recorded markers
  giajax compare giajax-out/run giajax-out/other
                            test whether two fits agree to within their errors
  giajax suspects giajax-out/run
                            test for effects that the model omits
  giajax bootstrap giajax-out/run
                            check the standard errors by repeating the fit
  giajax influence giajax-out/run
                            show how each marker and run changes the estimates
  giajax sweep plan.toml --workers 4
                            run fits with different values, runs or options
  giajax profile giajax-out/run
                            compute profile-likelihood intervals
  giajax posterior giajax-out/run
                            sample the posterior of the parameters
  giajax predict giajax-out/run --data other.csv
                            test how well the fit predicts another run
  giajax choose --data loops.csv
                            select a hysteresis model for a joint
  giajax compensate fit --target target.csv --to command.csv
                            compute commands that compensate for hysteresis
  giajax design giajax-out/run --parameter air.drag_coefficient --out next
                            design the command and markers of an experiment
  giajax shape command.csv --model giajax-out/run --out shaped
                            shape a command to reduce the residual swing
  giajax plan giajax-out/run --pose 1=20 --out planned
                            plan the fastest command to a pose within limits
  giajax track run.csv --model giajax-out/run --wind 0,0.2,0 --out tracked
                            estimate the arm's motion from noisy measurements
  giajax wind --data resting.csv --wind 0,0.2,0
                            fit mean flow and gusts to a resting arm's motion
  giajax fill --out DIR     simulate the filling of 20 balloons with helium
  giajax mission missions/naraha.toml
                            use a camera to steer the tip through an opening
  giajax life missions/naraha.toml --out DIR
                            simulate unrolling, filling, mission and deflation
  giajax hysteresis --out DIR
                            simulate the paper's experiment on one link
  giajax paper all --out DIR
                            reproduce the paper's figures and tables

A run is a CSV file with one column for each channel (such as time_s,
joint01_command_deg or link06_z_m). A sidecar file with the same name and the
extension .toml can describe the run."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `giajax` with these arguments (default: those of the process); return the exit status."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    return run(typer.main.get_command(_app_for(words)), words)


def command_names() -> list[str]:
    """Return the names of all commands, in the order of the help."""
    order = list(GROUPS)
    return sorted(COMMANDS, key=lambda name: (order.index(COMMANDS[name].group), name))


def old_forms() -> Iterator[tuple[str, str]]:
    """Yield every old command line together with its current form."""
    names = command_names()
    group: Any = typer.main.get_command(_app_for(names))
    for name in names:
        yield from forms_of(group.commands[name], COMMANDS[name]).values()


def _app_for(words: Sequence[str]) -> typer.Typer:
    """Return the app, in which only commands that are among the words have their options.

    Typer reads the signatures of all commands before it selects one. This takes half of the time of
    `giajax --help`, which shows no options of commands.
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
    raise AssertionError("internal error: this command has no implementation")


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
