"""A run of least squares as one kernel: the residuals of a grasp and the steps, in loops."""
