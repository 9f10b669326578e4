"""How MuJoCo computes: solver, integrator, cone, friction and contact stiffness, with reasons.

Sets of these numbers have names, those below and others that are registered; a file holds one too,
TOML or JSON with fields of ``PhysicsOptions`` under their names (``sim.presets``)::

    simulate(plan, physics="mujoco-default")
    simulate(plan, physics="my_scene.toml")

    # my_scene.toml
    preset = "mujoco-default"
    impratio = 100
    cone = "elliptic"

What the numbers do to a held object is derived in ``sim.creep``.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias, get_args

import mujoco

from planner.arrays import checked_count, checked_number, finite
from planner.contacts import MOST_FRICTION
from planner.errors import TaskError, shown
from planner.spatial import FloatArray
from sim.presets import Presets

__all__ = [
    "PRESETS",
    "AnyPhysics",
    "PhysicsOptions",
    "named_physics",
    "register_physics",
]

OURS = "ours"
"""Name of the defaults."""

CONTACT_SOLREF = (0.005, 1.0)
"""Time constant (s) and damping ratio (-) of contacts: 2.5 time steps, about as stiff as the step
allows (MuJoCo needs at least two)."""

CONTACT_SOLIMP = (0.5, 0.99, 0.0001, 0.5, 2.0)
"""Impedance of contacts: from 0.5 at touch to 0.99 at 0.1 mm of penetration, as published for the
Shadow hand. Pads sink in by some hundredths of a millimetre under the usual forces."""

MU_ROLLING = 0.001
"""Rolling friction (m) of the object on table and obstacles: a ball of 35 mm radius starts to roll
at a push of 3 % of its weight. It resembles felt more than glass, and lets an object stand still
until the fingers have closed."""

Cone = Literal["elliptic", "pyramidal"]
Integrator = Literal["euler", "implicit", "implicitfast"]

CONES, INTEGRATORS = get_args(Cone), get_args(Integrator)
"""By MuJoCo's names. Runge-Kutta is left out: it ignores the servos' damping, and MuJoCo advises
against it where there are contacts."""

CONDIMS = (3, 4, 6)
"""Dimensions of a contact that a grasp can live with: sliding; and torsion; and rolling. 1 has no
friction."""

TIMESTEPS = (1e-6, 0.1)
"""Range of a time step, s: below it a trial takes hours, above it no contact is met in time."""

IMPRATIOS = (1e-6, 1e6)
"""Range of ``impratio`` (-): the solver's matrices lose their digits beyond it."""

MOST_ITERATIONS = 10_000
"""Most iterations of a solver per step (-): MuJoCo's own limit is 100, and 20 to 50 are usual."""

TIME_CONSTANTS = (1e-9, 1e3)
"""Range of the time constant of contacts, s; MuJoCo raises what is below two time steps."""

DAMPING_RATIOS = (1e-9, 1e6)
"""Range of the damping ratio of contacts (-)."""

LARGEST_DEPTH, LARGEST_POWER = 1e3, 1e3
"""Largest depth (m) and power (-) in ``solimp``."""

LARGEST_NUMBER = 1e6
"""Largest number of ``solref`` and ``solimp`` that is looked at."""

SAFE_STEPS = 2.0
"""Least time constant of a contact in time steps; MuJoCo silently raises what is shorter."""


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """How MuJoCo computes. The defaults state their reason; a report repeats what was used.

    Solref, solimp, condim and friction are those of every contact of the object. The constraint
    Jacobian is always dense: mujoco 4.0.0 factorises sparse Hessians wrongly.

    Attributes:
        name: What the set of numbers is called in reports.
        timestep: s. Twice as short as DexGraspBench's 4 ms; the servo loop runs at the same rate.
        integrator: "implicitfast" takes the servos' damping implicitly; "euler" only the joints'.
        cone: "elliptic" is Coulomb's; "pyramidal" has four or six facets, and creeps faster.
        condim: Dimensions of contacts between object and hand: 3 slides, 4 also twists, 6 also
            rolls.
        mu: Sliding friction between hand, object, table and obstacles (-). 0.6 where planning
            relies on 0.5 is the margin that a plan has.
        mu_torsion: Torsional friction (m): MuJoCo's default, at every mu. It is generous: a patch
            of radius a under Hertz's pressure resists turning by 3 pi / 16 mu a per newton (2/3 mu
            a under an even pressure; Johnson, Contact Mechanics, 1985), so at mu 0.6 these 5 mm are
            a patch of 14 mm (12.5 mm), wider than a fingertip of 8 mm. Soft rubber (1.3 MPa) on a
            tip of 8 mm under 5 N has 2.8 mm, or 1.0 mm of torsional friction. Planning counts on
            none.
        mu_rolling: Rolling friction (m), where contacts have 6 dimensions: those of table and
            obstacles always have.
        impratio: Ratio of frictional to normal impedance (-): 10 makes friction hold instead of
            creep, and is what the peers use.
        noslip_iterations: Extra iterations that take the rest of the creep out of friction. A ball
            held by four fingers creeps 100 um/s with 0, 22 with 2, 6 with 5 or 10; the time is the
            same.
        iterations: Limit of solver iterations per step.
        solref: Time constant (s) and damping ratio (-) of contacts.
        solimp: Impedance of contacts: at touch (-), at depth (-), the depth (m), midpoint (-),
            power (-).
    """

    name: str = OURS
    timestep: float = 0.002
    integrator: Integrator = "implicitfast"
    cone: Cone = "elliptic"
    condim: int = 4
    mu: float = 0.6
    mu_torsion: float = 0.005
    mu_rolling: float = MU_ROLLING
    impratio: float = 10.0
    noslip_iterations: int = 10
    iterations: int = 100
    solref: tuple[float, float] = CONTACT_SOLREF
    solimp: tuple[float, float, float, float, float] = CONTACT_SOLIMP

    def __post_init__(self) -> None:
        """Check every number."""
        _number("timestep", self.timestep, *TIMESTEPS, "s")
        _number("impratio", self.impratio, *IMPRATIOS)
        for name in ("mu", "mu_torsion", "mu_rolling"):
            _number(f"{name} in simulation", getattr(self, name), 0.0, MOST_FRICTION)
        for name, lowest in (("noslip_iterations", 0), ("iterations", 1)):
            value, most = getattr(self, name), MOST_ITERATIONS
            checked_count(name, value, least=lowest, most=most, error=TaskError)
        for name, allowed in (("integrator", INTEGRATORS), ("cone", CONES), ("condim", CONDIMS)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, str | int) or value not in allowed:
                known = ", ".join(str(a) for a in allowed)
                raise TaskError(f"{name} is {shown(value)}; give one of {known}")
        if not isinstance(self.name, str) or not self.name:
            raise TaskError(f"name is {shown(self.name)}; give a text for reports")
        object.__setattr__(self, "solref", _numbers("solref", self.solref, 2))
        object.__setattr__(self, "solimp", _numbers("solimp", self.solimp, 5))
        _number("the time constant, solref[0],", self.solref[0], *TIME_CONSTANTS, "s")
        _number("the damping ratio, solref[1],", self.solref[1], *DAMPING_RATIOS)
        low, high, width, middle, power = self.solimp
        impedances = 0 < low < 1 and 0 < high < 1 and 0 < middle < 1
        if not (impedances and 0 < width <= LARGEST_DEPTH and 1 <= power <= LARGEST_POWER):
            raise TaskError(
                f"solimp is {list(self.solimp)}; give impedances in (0, 1) at touch and at depth, "
                f"the depth in m > 0, up to {LARGEST_DEPTH:g}, a midpoint in (0, 1), and a power "
                f">= 1, up to {LARGEST_POWER:g}"
            )

    @property
    def friction(self) -> tuple[float, float, float]:
        """Sliding, torsional and rolling friction as MuJoCo writes them: -, m, m."""
        return (self.mu, self.mu_torsion, self.mu_rolling)

    @property
    def time_constant(self) -> float:
        """Time constant (s) of contacts that MuJoCo uses: never below two time steps."""
        return max(self.solref[0], SAFE_STEPS * self.timestep)

    @property
    def label(self) -> str:
        """Its name; of a preset that was changed with what differs: "ours with mu 0.8"."""
        preset = PRESETS.get(self.name, self)
        changed = [
            f"{name} {_listed(value) if isinstance(value, tuple) else value}"
            for name, value in asdict(self).items()
            if value != getattr(preset, name)
        ]
        return f"{self.name} with {', '.join(changed)}" if changed else self.name

    def to_dict(self) -> dict[str, Any]:
        """Label (as "name") and all numbers as plain data, by the names of the fields."""
        return {**finite(asdict(self)), "name": self.label}

    def __str__(self) -> str:
        """One line with every number that decides whether a grasp holds."""
        return (
            f"{self.label} ({self.timestep:g} s, {self.integrator}, {self.cone} cones, condim "
            f"{self.condim}, impratio {self.impratio:g}, noslip {self.noslip_iterations}, friction "
            f"{self.mu:g} and {self.mu_torsion:g} m, solref {_listed(self.solref)}, solimp "
            f"{_listed(self.solimp[:3])})"
        )

    def apply(self, spec: Any, gravity: FloatArray) -> None:
        """Write the options into a ``mujoco.MjSpec``, with gravity (3,) in m/s2."""
        option = spec.option
        option.timestep = self.timestep
        option.gravity = gravity
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        option.impratio = self.impratio
        option.noslip_iterations = self.noslip_iterations
        option.iterations = self.iterations
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _number(name: str, value: Any, least: float, most: float, unit: str = "") -> None:
    checked_number(name, value, least=least, most=most, unit=unit, error=TaskError)


def _numbers(name: str, value: Any, count: int) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or len(value) != count:
        raise TaskError(f"{name} is {shown(value)}; give {count} finite numbers")
    for number in value:
        _number(f"a number of {name}", number, -LARGEST_NUMBER, LARGEST_NUMBER)
    return tuple(float(number) for number in value)


def _listed(values: tuple[float, ...]) -> str:
    return " ".join(f"{v:g}" for v in values)


PRESETS = Presets("physics", PhysicsOptions())
"""Presets by name."""

AnyPhysics: TypeAlias = PhysicsOptions | str
"""Physics, or what ``--physics`` takes: a preset's name or the path of a file."""

named_physics = PRESETS.named
register_physics = PRESETS.register

MUJOCO_DEFAULT = PRESETS.register(
    PhysicsOptions(
        name="mujoco-default",
        timestep=0.002,
        # MuJoCo's default is Euler, which takes servo damping explicitly: hands with light fingers
        # and strong dampers diverge (10 of 11 default grasps of the Shadow-type hand), whatever the
        # contacts do; a scene with such servos must ask for this one
        integrator="implicitfast",
        cone="pyramidal",
        condim=3,
        mu=1.0,
        mu_torsion=0.005,  # without effect in 3 dimensions
        mu_rolling=0.0001,
        impratio=1.0,
        noslip_iterations=0,
        iterations=100,
        solref=(0.02, 1.0),
        solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    )
)
"""What MuJoCo computes where a scene says nothing.

Source: the XML reference of MuJoCo, elements ``option`` and ``geom``; the numbers are read from a
fresh ``mujoco.MjSpec`` by a test.
"""

MENAGERIE = PRESETS.register(
    PhysicsOptions(
        name="menagerie",
        timestep=0.002,  # MuJoCo's default
        integrator="implicitfast",  # the LEAP hand asks for it; Euler: see MUJOCO_DEFAULT
        cone="elliptic",
        condim=6,
        # of the two scenes the smaller: 0.5 0.01 0.003 beside Shadow, 0.7 0.002 0.002 beside
        # Allegro
        mu=0.5,
        mu_torsion=0.002,
        mu_rolling=0.002,
        impratio=10.0,
        noslip_iterations=0,  # MuJoCo's default
        iterations=100,  # MuJoCo's default
        solref=(0.02, 1.0),
        solimp=(0.9, 0.95, 0.001, 0.5, 2.0),
    )
)
"""An object in the scene files that MuJoCo Menagerie ships beside its hands.

Source: https://github.com/google-deepmind/mujoco_menagerie, folders ``shadow_hand`` and
``wonik_allegro``, files ``scene_right.xml`` and ``right_hand.xml``.

The hands ask for elliptic cones and impratio 10, and their fingers for solref 0.005 and solimp 0.5
0.99 0.0001. The object of the scene has a higher priority than the fingers and says nothing of
solref and solimp: so MuJoCo's soft defaults decide, and what the fingers ask for has no effect.
"""

DEXGRASPBENCH = PRESETS.register(
    PhysicsOptions(
        name="dexgraspbench",
        timestep=0.004,
        integrator="implicitfast",
        cone="elliptic",
        condim=4,
        mu=0.6,
        mu_torsion=0.02,
        mu_rolling=0.0001,  # MuJoCo's default; without effect in 4 dimensions
        impratio=10.0,
        noslip_iterations=2,
        iterations=100,  # MuJoCo's default
        solref=(0.0125, 1.0),
        solimp=(0.7, 0.97, 0.00055, 0.5, 2.0),
    )
)
"""How DexGraspBench computes.

Source: https://github.com/JYChen18/DexGraspBench at commit 1e7a5a6, ``src/util/hand_util.py`` and
``config/task/eval.yaml``.

The benchmark gives solref 0.005 1 and solimp 0.5 0.99 0.0001 to the geoms of the hand. The object
has the same priority and MuJoCo's defaults, 0.02 1 and 0.9 0.95 0.001: MuJoCo takes the mean of the
two.
"""
