"""The way to a grasp: open fingers, the pre-grasp, and the path of an arm."""
