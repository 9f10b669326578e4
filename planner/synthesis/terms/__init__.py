"""Terms of the grasp problem, one family a file; ``registry`` has them all by name."""
