"""Hands: where their files are, what a description says, fingers, the hand itself and its arm."""
