"""A hand by name, description or model: sliders, postures, reasons, findings."""

from __future__ import annotations

from planner.describe import check_hand, propose
from planner.hand_loading import load_hand
from planner.hands.catalog import MODEL_SUFFIXES, find_hand, foreign_hand_names, hand_names
from planner.pages.described import comments_of, reasons_by_key
from planner.pages.hand_page import hand_page
from planner.pages.page import Page
from sim.viewing.kinds import Kind, ViewOptions
from sim.viewing.target import Target

SCHEMES = ("menagerie:", "robot_descriptions:", "package:")
"""Beginnings of names of models in packages."""

DESCRIPTION_FILE = "hand.toml"

ROOTS = (b"<mujoco", b"<robot")
"""Root elements of models, MJCF and URDF."""


def _recognises(target: Target) -> bool:
    if target.text in (*hand_names(), *foreign_hand_names()):
        return True
    if target.path is None:
        return target.text.startswith(SCHEMES)
    if target.is_folder:
        return target.holds(DESCRIPTION_FILE)
    if target.names_body:
        return False
    return any(root in target.head for root in ROOTS) or "schema" in (target.table or {})


def _shown(target: Target, options: ViewOptions) -> Page:
    hand, path = load_hand(target.text), find_hand(target.text)
    if path.suffix.lower() in MODEL_SUFFIXES:
        proposal = propose(target.text)
        reasons, questions = reasons_by_key(proposal.reasons), proposal.open_questions
    else:
        reasons, questions = comments_of(path), ()
    return hand_page(hand, reasons=reasons, questions=questions, check=check_hand(hand))


KIND = Kind(name="a hand (name, hand.toml, MJCF or URDF)", recognises=_recognises, shown=_shown)
"""See ``sim.viewing.kinds``."""
