"""One file per class of hostile inputs; see ``tests.fuzz``."""
