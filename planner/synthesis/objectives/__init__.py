"""Objectives of grasp synthesis, one registration each."""
