"""``Reading``: where the object is, how far it has turned and what touches it, as a robot knows it.

What a robot decides by is read here: whether a turn is made, where the hand must carry the object,
which fingers may be lifted. What a run is judged by is the truth (``ManipulationRecorder``).
Without a reality both are the same, to the last bit.
"""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.kinematics.state import MovingHand
from planner.spatial import SE3, FloatArray, signed_twist
from sim.contacts import hand_contacts
from sim.controllers import Observation
from sim.manipulation.log import ManipulationRecorder
from sim.simulation import Simulation


class Reading:
    """What is read of one simulation, for ``ManipulationSim``."""

    def __init__(
        self, simulation: Simulation, recorder: ManipulationRecorder, axis: FloatArray
    ) -> None:
        """Begin.

        Args:
            simulation: What is read.
            recorder: Knows the truth, which is read where nothing stands between.
            axis: Axis of the turn (3,), unit, palm.
        """
        self._simulation, self._recorder, self._axis = simulation, recorder, axis
        task = simulation.plan.task
        self._fingers = task.finger_names
        self._hand = MovingHand(task.hand, simulation.plan.q)
        self._reference: SE3 | None = None
        self._turn = 0.0

    def mark_reference(self) -> None:
        """From now on movement is counted from how the object lies in the palm now."""
        self._recorder.mark_reference()
        seen = self._seen()
        self._turn, self._reference = 0.0, None if seen is None else self._in_palm(seen)

    def note(self) -> None:
        """Follow the turn, which is counted beyond half turns; call it now and then."""
        if self._reference is not None:
            self.turned()

    def turned(self) -> float:
        """Turn in the palm since the mark, rad."""
        seen = self._seen()
        if seen is None or self._reference is None:
            return self._recorder.moved()[0]
        turn = self._in_palm(seen).rotation @ self._reference.rotation.T
        self._turn = signed_twist(turn, self._axis, near=self._turn)
        return self._turn

    def deviation(self) -> float:
        """Believed standard deviation of the object's rotation about the turn's axis now, rad.

        0 where no estimator tells it.
        """
        seen = self._seen()
        if seen is None or seen.uncertainty is None:
            return 0.0
        turn = (seen.T_world_base * self._hand.move(seen.q).T_base_palm).rotation
        axis = turn @ self._axis
        return float(np.sqrt(max(0.0, axis @ seen.uncertainty.covariance[3:, 3:] @ axis)))

    def T_world_object(self) -> SE3:
        """Pose of the object."""
        seen = self._seen()
        return self._simulation.T_world_object if seen is None else seen.T_world_object

    def normal_forces(self) -> FloatArray:
        """Normal force (n,) that each finger feels, N."""
        seen = self._seen()
        return self._simulation.normal_forces() if seen is None else seen.normal_forces

    def contacts(self) -> ContactSet:
        """Contacts of the hand with the object, world, with their forces along the normals.

        Of pads that are read there is one for each finger that takes part; what else touches the
        object they do not feel.
        """
        seen = self._seen()
        if seen is None:
            return hand_contacts(self._simulation.scene, self._simulation.data)
        pads = seen.pads
        felt = np.flatnonzero(pads.normal_force > 0)
        forces = np.zeros((len(felt), 4))
        forces[:, 0] = pads.normal_force[felt]
        return ContactSet.from_arrays(
            pads.position[felt],
            pads.normal[felt],
            center=seen.T_world_object.translation,
            forces=forces,
            fingers=[self._fingers[i] for i in felt],
        )

    def _seen(self) -> Observation | None:
        """What the sensors say now; None where they say the truth."""
        simulation = self._simulation
        truth = simulation.observe(simulation.phase, 1.0)
        seen = simulation.sensed(truth)
        return None if seen is truth else seen

    def _in_palm(self, seen: Observation) -> SE3:
        """Pose of the object in the palm, by the joints that were read."""
        T_world_palm = seen.T_world_base * self._hand.move(seen.q).T_base_palm
        return T_world_palm.inverse() * seen.T_world_object
