"""Stable hand-object states from which reinforcement learning begins its episodes."""
