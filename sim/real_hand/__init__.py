"""A hand as controllers see it, read and write, and a loop that runs at a fixed rate."""
