"""Displays of runs, arms and models in notebooks and with `rich`."""

import io
import re

import equinox as eqx
import numpy as np
import pytest
import rich.console

from giajax import ArmModel, HysteresisModel, Run, takeichi_20m
from giajax.mechanics.arm import Hardening
from giajax.mechanics.hysteresis import PrandtlIshlinskii


def printed(thing):
    file = io.StringIO()
    rich.console.Console(file=file, width=300).print(thing)
    return file.getvalue()


def cells(thing):
    """Return the rows of the table, as HTML text."""
    rows = re.findall(r"<tr>(.*?)</tr>", thing._repr_html_())
    return [re.findall(r"<t[dh]>(.*?)</t[dh]>", row) for row in rows]


def run_of(links, name="run"):
    values = {f"link{link:02d}_z_mm": np.zeros(3) for link in range(1, links + 1)}
    frame = {"time_s": [0.0, 1.0, 2.5], "joint01_command_deg": np.zeros(3), **values}
    definition = {"arm": {"links": links}, "noise": {"link01_z_mm": 4.0}}
    return Run.from_frame(frame, name=name, definition=definition)


@pytest.mark.quick
def test_a_run_shows_its_channels_in_their_units():
    run = run_of(2)
    assert cells(run) == [
        ["channel", "unit", "part", "noise"],
        ["joint01_command", "deg", "command", ""],
        ["link01_z", "mm", "measured", "4"],
        ["link02_z", "mm", "measured", ""],
    ]
    assert "run: arm run, 3 samples over 2.5 s" in run._repr_html_()
    assert "run: arm run, 3 samples over 2.5 s" in printed(run)
    many = cells(run_of(40))
    assert (len(many), many[-1]) == (26, ["17 more"])


def test_arms_without_numbers_of_one_arm_are_shown_as_python_does():
    arm = takeichi_20m(2)
    batch = eqx.filter_vmap(lambda length: takeichi_20m(2, mass=0.1))(np.ones(3))
    for each in (batch, eqx.partition(arm, eqx.is_array)[1], eqx.filter_eval_shape(lambda: arm)):
        assert "Arm(" in each._repr_html_()
        assert "Arm(" in printed(each)


def test_an_arm_shows_what_it_is_and_what_is_free():
    arm = takeichi_20m(
        3,
        length=[0.5, 0.4, 0.3],
        diameter=0.1,
        mass=0.25,
        joint_axes=["pitch", "yaw", [1.0, 0.0, 0.0]],
        joint_laws=[Hardening()],
        parameters={
            "air.drag_coefficient": 0.9,
            "joints.pitch_stiffness": 2.0,
            "joints.yaw_stiffness": 2.0,
            "joints.damping": 0.1,
        },
    )
    rows = dict(cells(arm))
    assert rows["length"] == "1.2 m"
    assert rows["mass"].startswith("0.75 kg")
    assert rows["joints"] == "1 pitch, 1 yaw, 1 other"
    assert rows["joint laws"] == "Spring, Damper, Hardening"
    assert rows["drag"] == "CentreDrag, C_D 0.9, in air of density 1.204 kg/m^3"
    assert rows["also"] == "-"
    assert "air.drag_coefficient 0.9; " in f"{rows['free']}; "
    assert dict(cells(ArmModel(arm))) == rows
    assert "CentreDrag" in printed(arm)


def test_a_model_of_another_kind_shows_what_is_free():
    loop = PrandtlIshlinskii(elastic=0.6, weights=[0.2, 0.3], thresholds=[0.1, 0.4])
    rows = dict(cells(HysteresisModel("play", loop)))
    assert "elastic 0.6 output/input; weights 0.2 .. 0.3 output/input" in rows["free"]
    assert rows["held"] == "2 parameters"


@pytest.mark.quick
def test_markup_is_text():
    run = run_of(1, "<b>[red]run[/red]</b>")
    assert "&lt;b&gt;[red]run[/red]&lt;/b&gt;: arm run" in run._repr_html_()
    assert "<b>[red]run[/red]</b>: arm run" in printed(run)
