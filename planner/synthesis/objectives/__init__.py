"""Objectives of grasp synthesis: what a grasp can be made good at, one registration each."""
