"""Options of commands in groups, and that none is paid for before a command runs."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from planner.errors import TaskError
from sim.cli.common import errors_for_people
from sim.cli.execution import ExecutionOptions
from sim.cli.options import with_options
from sim.cli.search import PlanOptions

RUN = CliRunner()


@dataclass(frozen=True, kw_only=True)
class Size:
    """A group of two options."""

    width: Annotated[float, typer.Option(help="In m.")] = 1.0
    many: Annotated[list[str] | None, typer.Option("--part", "-p")] = None


@dataclass(frozen=True, kw_only=True)
class Place:
    """A group of one option that has to be given."""

    where: Annotated[str, typer.Option(help="A name.")]


@pytest.fixture
def app() -> typer.Typer:
    """One command with a group between options of its own."""
    app = typer.Typer()

    @app.command()
    @errors_for_people()
    @with_options
    def build(name: str, *, size: Size, loud: bool = False) -> None:
        """Build it."""
        if size.width < 0:
            raise TaskError("the width is negative; give a positive one")
        typer.echo(f"{name} {size} {loud}")

    return app


def test_fields_of_a_group_are_options_with_their_defaults_and_help(app: typer.Typer) -> None:
    told = RUN.invoke(app, ["box"])
    assert told.output.strip() == "box Size(width=1.0, many=None) False"
    told = RUN.invoke(app, ["box", "--width", "2", "-p", "a", "--part", "b", "--loud"])
    assert told.output.strip() == "box Size(width=2.0, many=['a', 'b']) True"
    shown = RUN.invoke(app, ["--help"]).output
    assert "Build it." in shown
    assert "In m." in shown
    assert "--size" not in shown


def test_a_field_without_a_default_is_required() -> None:
    app = typer.Typer()

    @app.command()
    @with_options
    def build(*, place: Place) -> None:
        typer.echo(place.where)

    assert RUN.invoke(app, ["--where", "here"]).output == "here\n"
    told = RUN.invoke(app, [])
    assert told.exit_code == 2 and "Missing option '--where'" in told.output
    assert "MISSING" not in RUN.invoke(app, ["--help"]).output


def test_errors_of_such_a_command_are_for_people(app: typer.Typer) -> None:
    assert RUN.invoke(app, ["box", "--width", "wide"]).exit_code == 2
    told = RUN.invoke(app, ["box", "--width", "-1"])
    assert told.exit_code == 3


def test_the_same_options_make_the_same_task() -> None:
    given = PlanOptions(mass=0.2, fingers="thumb,index,ring", touch=["z>0"], expect_load="5,0.1")
    task = given.task("allegro_hand", "cylinder")
    assert task.object.mass == 0.2
    assert task.finger_names == ("thumb", "index", "ring")
    assert task.expected_load is not None
    assert (task.expected_load.force, task.expected_load.torque) == (5.0, 0.1)
    assert given.synthesis() == PlanOptions().synthesis()
    assert PlanOptions(rounds=0).synthesis().rounds == 0


def test_the_command_line_loads_no_engine_before_a_command_runs() -> None:
    code = "import sim.cli, sys; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"mujoco", "pinocchio", "coal", "casadi", "numpy"} & set(run.stdout.split())


def test_planning_reckons_with_the_encoders_of_the_error_model_unless_it_is_told() -> None:
    asked = ExecutionOptions(error_model="rough").reckoned(PlanOptions())
    assert asked.joint_error == pytest.approx(3.0)
    assert asked.task("allegro_hand", "sphere").joint_error == pytest.approx(np.deg2rad(3.0))
    told = PlanOptions(joint_error=0.0)
    assert ExecutionOptions(error_model="rough").reckoned(told).joint_error == 0.0
    assert ExecutionOptions().reckoned(PlanOptions()).joint_error == 0.0
    assert PlanOptions().task("allegro_hand", "sphere").joint_error == 0.0
