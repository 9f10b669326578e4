"""Readers and writers of other tools' files, one folder per tool."""
