"""``UdpHand``: a hand at the other end of a UDP socket, in packets of ``sim.real_hand.packets``.

Kinds of packets: "H" hello, "C" commands (then number of the phase in ``PHASES``, its progress, and
how fast that grows, per second), "S" torque off, "E" end; the other end sends "R" readings. The
times in them are those of the loop's clock: both ends on one machine share ``time.monotonic``.
There is no authentication: stay on 127.0.0.1, or on a cable that nobody else is on.
"""

from __future__ import annotations

import socket
import time
from contextlib import suppress

import numpy as np

from planner.errors import HandError
from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.controllers.base import PHASES, Phase
from sim.real_hand.interface import HandReading
from sim.real_hand.packets import Inbox, Packet, reading_of

LOCAL = "127.0.0.1"

LARGEST = 65536
"""Bytes that are received at once: more than any packet has."""

HELLO = 0.01
"""Time (s) between two hellos."""

REPEATED = 10
"""How often "torque off" is sent, since some may be lost."""


class UdpHand:
    """The interface of a hand in another process.

    Attributes:
        inbox: What has arrived, in counts.
        sent: Packets sent.
    """

    def __init__(
        self,
        hand: Hand,
        finger_names: tuple[str, ...],
        port: int,
        *,
        host: str = LOCAL,
        rate_hz: float = 200.0,
        patience: float = 10.0,
    ) -> None:
        """Say hello until readings come.

        Args:
            hand: Its model; both ends have its names in its order.
            finger_names: Fingers whose touch is read.
            port: Of the other end.
            host: Of the other end.
            rate_hz: Rate at which that sends readings, Hz.
            patience: How long to wait for the first reading, s.

        Raises:
            HandError: Nothing has arrived.
        """
        self._names = hand.joint_names, hand.actuation.names, finger_names
        self._rate_hz = rate_hz
        self.inbox, self.sent = Inbox(), 0
        self._way = np.zeros(3)
        self._stopped = False
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.connect((host, port))
        self._link.settimeout(HELLO)
        until = time.monotonic() + patience
        while self.inbox.newest is None:
            if time.monotonic() > until:
                self.close()
                raise HandError(
                    f"no reading has come from {host}:{port} within {patience:g} s; is the other "
                    "process running?"
                )
            self.send(b"H")
            with suppress(TimeoutError, ConnectionRefusedError):
                self.inbox.take(self._link.recv(LARGEST))
        self._link.setblocking(False)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Those of the hand's model."""
        return self._names[0]

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Those of the hand's model."""
        return self._names[1]

    @property
    def finger_names(self) -> tuple[str, ...]:
        """Fingers whose touch is read."""
        return self._names[2]

    @property
    def rate_hz(self) -> float:
        """Rate at which readings come, Hz."""
        return self._rate_hz

    def send(self, kind: bytes, *values: FloatArray) -> None:
        """Send a packet.

        Args:
            kind: One byte.
            values: Its numbers, one array after the other.
        """
        numbers = np.concatenate([np.zeros(0), *values])
        packet = Packet(kind=kind, number=self.sent, time=time.monotonic(), values=numbers)
        self._link.send(packet.to_bytes())
        self.sent += 1

    def read(self) -> HandReading:
        """The newest reading that has arrived; its time tells how old it is."""
        with suppress(BlockingIOError):
            while True:
                self.inbox.take(self._link.recv(LARGEST))
        newest = self.inbox.newest
        if newest is None:  # not after the constructor
            raise HandError("no reading has come yet")
        return reading_of(newest.values, newest.time, *map(len, self._names))

    def carry(self, phase: Phase, progress: float, per_second: float) -> None:
        """Tell with the next commands how the hand is moved as a whole."""
        self._way = np.array([PHASES.index(phase), progress, per_second])

    def write(self, commands: FloatArray) -> None:
        """Send commands (nu,).

        Raises:
            HandError: The torque was taken off.
        """
        if self._stopped:
            raise HandError("the torque of this hand was taken off; connect again to go on")
        self.send(b"C", commands, self._way)

    def stop(self) -> None:
        """Take the torque off."""
        self._stopped = True
        for _ in range(REPEATED):
            self.send(b"S")

    def close(self) -> None:
        """Close the socket."""
        self._link.close()
