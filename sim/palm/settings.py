"""``PalmSettings``: numbers of the controller for an object that lies in the palm, with reasons."""

from __future__ import annotations

from dataclasses import dataclass

from planner.arrays import check_fields

MOST = 1e6
"""Largest number that a setting may be: beyond it matrices lose their digits."""

LONGEST = 60
"""Most steps of a horizon, sweeps, contacts and branches (-): more is no control."""

LONGEST_LOOK = 10.0
"""Longest opening and look ahead (s): each is simulated a dozen times before anything moves."""


@dataclass(frozen=True, kw_only=True)
class PalmSettings:
    """How ``PalmController`` models contact, what it wants, and what it does when it is stuck.

    Stiffnesses of object and contact are those of a step, not of matter: the object's weighs how
    far a force moves it in a step, the contact's how hard a gap that would close resists.

    Attributes:
        horizon: Steps ahead (-).
        step_s: Length of a step, s: a servo has settled after it.
        period_s: Time between solves, s; at most a step.
        reach_m: Gap (m) up to which a pair of geoms is a contact that may close.
        contacts: Most contacts, the nearest (-).
        mu: Friction of the pyramid (-), a little less than there is.
        object_stiffness: Of the object's position, N/m.
        turn_stiffness: Of its rotation, N m/rad.
        contact_stiffness: Diagonal K of the dual, N/m.
        smoothing_m: Gap (m) over which a contact fades in: width of the softplus.
        weight_share: Share of the object's weight in the model (-); all of it would have the model
            fall through soft contacts.
        position_cost: On the squared distance to the goal's position at the end, 1/m^2.
        rotation_cost: On the squared angle to the goal at the end, 1/rad^2.
        running_share: Of both in the steps before the end (-).
        tip_cost: On the squared distance of each fingertip to the object's centre, 1/m^2: the term
            that seeks contact.
        effort_cost: On the squared change of each command in a step, 1/rad^2.
        command_rad: Largest change of a command in a step, rad.
        lead_rad: Largest distance of a command from its joint, rad: bounds the force. They begin
            where the joints are, so that no squeeze is stored.
        goal_rad: Largest turn asked for at a time, rad: the goal moves on along the shortest way,
            since contacts are frozen over the horizon.
        slow_deg: Angle to the goal (degrees) below which commands become slower in proportion.
        slowest: Least share of ``command_rad`` that remains (-).
        still_deg: Angle (degrees) to the goal within which the commands stay.
        sweeps: Gauss-Newton steps per solve (-), each from where the last solve ended.
        progress_deg: Gain (degrees) that counts as progress; near the goal less does.
        ahead_s: How far a look ahead goes, s, and how long its best branch is done; both after
            fingers have opened.
        branches: Openings of the fingers that a look tries (-) where going on gains too little.
        lapse_deg: Loss (degrees) by the best opening beyond which openings of some of the fingers
            are tried too, and beyond which fingers rather stay; after each look that finds the
            object where it was, by as much more.
        stall_s: Time (s) without progress after which going on is no branch.
        open_s: Time (s) that fingers take to open.
        scatter_rad: Standard deviation of the postures to which they open, rad.
        beyond: How far beyond the goal some openings ask to turn: a share of the way left (-).
        beside_rad: Standard deviation of the rotations beside the goal that others ask for, rad.
        free_m: Distance (m) of the object to its place that costs nothing in a look ahead.
        far_deg: What more of it costs at first, degrees per m; it grows with the square, and is
            twice as much at ``free_m`` more.
    """

    horizon: int = 4
    step_s: float = 0.1
    period_s: float = 0.1
    reach_m: float = 0.03
    contacts: int = 32
    mu: float = 0.5
    object_stiffness: float = 50.0
    turn_stiffness: float = 0.1
    contact_stiffness: float = 0.5
    smoothing_m: float = 0.005
    weight_share: float = 0.1
    position_cost: float = 1000.0
    rotation_cost: float = 12.5
    running_share: float = 0.1
    tip_cost: float = 1.0
    effort_cost: float = 0.1
    command_rad: float = 0.2
    lead_rad: float = 0.2
    goal_rad: float = 0.6
    slow_deg: float = 20.0
    slowest: float = 0.3
    still_deg: float = 3.5
    sweeps: int = 2
    progress_deg: float = 3.0
    ahead_s: float = 1.0
    branches: int = 8
    lapse_deg: float = 30.0
    stall_s: float = 3.0
    open_s: float = 0.5
    scatter_rad: float = 0.15
    beyond: float = 1.0
    beside_rad: float = 0.6
    free_m: float = 0.015
    far_deg: float = 2000.0

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            TaskError: One is out of range.
        """
        whole = ("horizon", "contacts", "sweeps", "branches")
        check_fields(self, whole, above=0, most=LONGEST)
        free = (
            *("weight_share", "running_share", "tip_cost", "still_deg", "mu"),
            *("scatter_rad", "beyond", "beside_rad"),
        )
        check_fields(self, free, least=0.0, most=MOST)
        rest = [name for name in self.__dataclass_fields__ if name not in (*free, *whole)]
        check_fields(self, rest, above=0.0, most=MOST)
        check_fields(self, ("period_s",), most=self.step_s, unit="s")
        check_fields(self, ("slowest",), most=1.0)
        check_fields(self, ("ahead_s", "open_s"), most=LONGEST_LOOK, unit="s")
