"""The MuJoCo world of a task: hand on its gantry or arm, object, table; its physics; exports."""
