"""Processes, threads, the environment and files on disk: nothing here knows of grasps."""
