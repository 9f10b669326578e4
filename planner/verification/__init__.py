"""The verdict on a grasp by the true geometry: pads, penetration, closure, forces, approach."""
