"""Cross-check of a robot model: MuJoCo, Pinocchio and coal side by side, or two models.

``crosscheck`` takes any MJCF or URDF file, hand or not, and compares what MuJoCo, Pinocchio (built
from the compiled model by our bridge) and Pinocchio's own reader make of it. ``compare_models``
compares two models of the same thing part by part, a URDF with an MJCF for example. As a test in a
project's own CI:

    from sim.crosscheck import compare_models, crosscheck

    def test_engines_agree():
        report = crosscheck("robot.xml", seed=1)
        assert report.ok, report.faults

    def test_urdf_is_the_mjcf():
        report = compare_models("robot.xml", "robot.urdf", names={"elbow": "elbow_joint"})
        assert report.ok, report.faults

On the command line: ``opposable crosscheck robot.xml [--against robot.urdf]``, which ends with code
0 (all judged quantities agree), 1 (something differs) or 3 (bad input).
"""

from sim.crosscheck.check import BRIDGE, READER, compare_models, crosscheck
from sim.crosscheck.parts import QUANTITIES, Difference, Quantity, Tolerances
from sim.crosscheck.report import Cell, Column, CrosscheckReport, crosscheck_tables

__all__ = [
    "BRIDGE",
    "QUANTITIES",
    "READER",
    "Cell",
    "Column",
    "CrosscheckReport",
    "Difference",
    "Quantity",
    "Tolerances",
    "compare_models",
    "crosscheck",
    "crosscheck_tables",
]
