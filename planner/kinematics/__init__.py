"""Forward kinematics in numbers and in symbols, and inverse kinematics of an arm."""
