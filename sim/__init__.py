"""Opposable's simulation: MuJoCo scenes, controllers, trials, reports and the command."""
