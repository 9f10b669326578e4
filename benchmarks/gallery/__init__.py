"""The gallery: every example with its picture or film, its page and what it prints.

``entries`` says which examples, ``watch`` runs one and films what it simulates, ``make`` runs them
all, ``pages`` writes the pages of the documentation.
"""
