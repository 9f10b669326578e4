"""An exported scene executed by another physics engine: a second witness of a grasp."""
