"""``moving_hand``: a thread's own kinematics of a hand, for answers used at once."""

from __future__ import annotations

from planner.hands.hand import Hand
from planner.kinematics.state import MovingHand
from planner.system.threads import kept_by_thread


@kept_by_thread(8)
def moving_hand(hand: Hand) -> MovingHand:
    """A hand that whoever asks next in this thread moves elsewhere.

    ``HandState(hand, q)`` makes Pinocchio's data anew, which takes 0.1 ms; ``.move(q)`` takes 5 us.
    Take what is needed out of it before any other function of this package is called.
    """
    return MovingHand(hand, hand.q_lower)
