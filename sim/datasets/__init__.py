"""Sets of many executions: episodes for learning, and states in which a grasp holds."""
