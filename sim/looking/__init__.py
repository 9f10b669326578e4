"""Pictures and windows: what a person sees of a simulation."""
