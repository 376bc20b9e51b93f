"""The commands of `giajax`, one line each.

A command lives in its own file and imports what is heavy inside its function: `giajax --help`
and `giajax check` start without JAX.
"""

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from . import (
    _check,
    _choose,
    _compensate,
    _examples,
    _fit,
    _hysteresis,
    _init,
    _joint,
    _parameters,
    _predict,
    _sensitivity,
    _simulate,
    _synth,
)
from ._errors import Commands, run

app = typer.Typer(
    name="giajax",
    cls=Commands,
    help="Simulate very long, very light robot arms, and fit their parameters to recordings.",
    epilog="""\b
Examples:
  giajax check run.csv      what a recording holds
  giajax init run.csv       write a sidecar for it, to fill in
  giajax parameters         what a fit can find, with unit and bounds
  giajax simulate --ramp 1=30 --out run.csv
                            a run made by the model
  giajax examples           runs and fit definitions to start from
  giajax joint --out DIR    one joint at rest: paths, forces, equilibria
  giajax fit --data run.csv
                            fit drag, stiffness and damping to it
  giajax predict --model giajax-out/run --data other.csv
                            how well the fit predicts another run
  giajax choose --data loops.csv
                            which hysteresis model describes a joint
  giajax compensate --model fit --target target.csv --out command.csv
                            commands that undo the hysteresis
  giajax hysteresis --out DIR
                            the paper's 1-link experiment, simulated

A run is a CSV file with one column a channel (time_s, joint01_command_deg,
link06_z_m, ...) and, beside it, an optional sidecar of the same name ending .toml.""",
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)

app.command("check", epilog=_check.EXAMPLES)(_check.check)
app.command("fit", epilog=_fit.EXAMPLES)(_fit.fit)
app.command("choose", epilog=_choose.EXAMPLES)(_choose.choose)
app.command("compensate", epilog=_compensate.EXAMPLES)(_compensate.compensate)
app.command("hysteresis", epilog=_hysteresis.EXAMPLES)(_hysteresis.hysteresis)
app.command("init", epilog=_init.EXAMPLES)(_init.init)
app.command("joint", epilog=_joint.EXAMPLES)(_joint.joint)
app.command("parameters", epilog=_parameters.EXAMPLES)(_parameters.parameters)
app.command("predict", epilog=_predict.EXAMPLES)(_predict.predict)
app.command("sensitivity", epilog=_sensitivity.EXAMPLES)(_sensitivity.sensitivity)
app.command("simulate", epilog=_simulate.EXAMPLES)(_simulate.simulate)
app.command("synth", epilog=_synth.EXAMPLES)(_synth.synth)
app.command("examples", epilog=_examples.EXAMPLES)(_examples.examples)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `giajax` with these arguments (those of the process by default).

    Returns the exit status: 0, 2 for bad input or usage, 130 when interrupted, else what the
    command says.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    return run(typer.main.get_command(app), given)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"giajax {version('giajax')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _giajax(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
