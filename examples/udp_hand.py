"""A hand at the other end of a UDP socket, as ``20_hand_over_udp.py`` drives one.

Packets are little endian, without padding::

    mark      4 bytes   "OPH1"
    kind      1 byte    what it is; the two ends agree on it
    number    uint32    counts up: gaps are losses, an older number was overtaken
    time      float64   s, on the sender's clock
    n         uint16    how many numbers follow
    values    n float64
    checksum  uint32    CRC-32 of all before

``reading_values`` and ``reading_of`` are the numbers of a reading; NaN stands for what was not
read. Kinds of packets: "H" hello, "C" commands (then number of the phase in ``PHASES``, its
progress, and how fast that grows, per second), "S" torque off, "E" end; the other end sends "R"
readings. The times in them are those of the loop's clock: both ends on one machine share
``time.monotonic``. There is no authentication: stay on 127.0.0.1, or on a cable that nobody else is
on.
"""

from __future__ import annotations

import heapq
import socket
import struct
import time
import zlib
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from planner.arrays import checked_number
from planner.errors import HandError, TaskError, shown
from planner.hands.hand import Hand
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from sim.controllers.base import PHASES, Phase
from sim.real_hand.interface import HandReading

MARK = b"OPH1"

_HEAD, _TAIL = struct.Struct("<4scIdH"), struct.Struct("<I")

POSE = 7
"""Numbers of a pose: position (m), quaternion w, x, y, z."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Packet:
    """One message.

    Attributes:
        kind: One byte.
        number: In [0, 2^32).
        time: s.
        values: (n,), n < 2^16.
    """

    kind: bytes
    number: int
    time: float
    values: FloatArray

    def to_bytes(self) -> bytes:
        """As it is sent."""
        values = np.asarray(self.values, dtype="<f8")
        head = _HEAD.pack(MARK, self.kind, self.number, self.time, len(values))
        body = head + values.tobytes()
        return body + _TAIL.pack(zlib.crc32(body))

    @classmethod
    def of(cls, data: bytes) -> Packet:
        """A packet that has arrived.

        Raises:
            HandError: Another mark, length or checksum.
        """
        least = _HEAD.size + _TAIL.size
        if len(data) < least:
            raise HandError(f"a packet of {len(data)} bytes is too short; it has at least {least}")
        mark, kind, number, time, n = _HEAD.unpack_from(data)
        if mark != MARK:
            raise HandError(f"a packet begins with {shown(mark)}; ours begin with {MARK!r}")
        if len(data) != least + 8 * n:
            raise HandError(f"a packet of {n} numbers has {len(data)} bytes, not {least + 8 * n}")
        if _TAIL.pack(zlib.crc32(data[: -_TAIL.size])) != data[-_TAIL.size :]:
            raise HandError("the checksum of a packet is wrong: it was damaged on its way")
        values = np.frombuffer(data, dtype="<f8", count=n, offset=_HEAD.size)
        return cls(kind=kind, number=number, time=time, values=values.astype(np.float64))


MOST_JUMP = 1000
"""Numbers by which a packet may be ahead of the newest, or behind it: a second and more of readings
at the rates of hands, after which a run has ended by a stale reading."""


class Inbox:
    """Keeps the newest of the packets that arrive, and counts.

    A number that is out of the series is not believed: one such packet would make all that follow
    "overtaken". Where the next packet goes on from it, the sender has begun anew, or nobody was
    listening meanwhile, and the series goes on there. A sender that begins anew within its first
    ``MOST_JUMP`` packets is "overtaken" until it has caught up: give it a link of its own.

    Attributes:
        newest: The packet with the highest number so far; None before the first.
        arrived: Packets of ours that arrived, whatever their order.
        malformed: What arrived beside them, refused.
        overtaken: Packets that arrived after a newer one, ignored.
        out_of_series: Packets whose number jumps by more than ``MOST_JUMP``, ignored.
    """

    def __init__(self) -> None:
        """Nothing has arrived."""
        self.newest: Packet | None = None
        self.arrived = self.malformed = self.overtaken = self.out_of_series = 0
        self._first = 0
        self._elsewhere: int | None = None

    def take(self, data: bytes) -> Packet | None:
        """The packet in these bytes, if it is newer than all before; None if it is not used."""
        try:
            packet = Packet.of(data)
        except HandError:
            self.malformed += 1
            return None
        lost = self.lost
        self.arrived += 1
        if self.newest is None:
            self._first = packet.number
        elif abs(packet.number - self.newest.number) > MOST_JUMP:
            before, self._elsewhere = self._elsewhere, packet.number
            if before is None or not 0 < packet.number - before <= MOST_JUMP:
                self.out_of_series += 1
                return None
            self._first = packet.number + 1 - self.arrived - lost
        elif packet.number <= self.newest.number:
            self.overtaken += 1
            return None
        self.newest, self._elsewhere = packet, None
        return packet

    @property
    def lost(self) -> int:
        """Numbers between the first and the newest packet that have not arrived (yet) as sent."""
        if self.newest is None:
            return 0
        return max(0, self.newest.number - self._first + 1 - self.arrived)


class LossyLink:
    """A network in one direction: loses, damages and delays what is sent, by a seed.

    What is sent later may arrive earlier, where ``jitter`` is larger than the time between.
    """

    def __init__(
        self,
        *,
        loss: float = 0.0,
        damage: float = 0.0,
        latency: float = 0.0,
        jitter: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Prepare.

        Args:
            loss: Share of packets that never arrive, in [0, 1].
            damage: Share of packets of which the last byte is missing, in [0, 1].
            latency: Least time on the way, s.
            jitter: Further time on the way, uniformly from 0 to this, s.
            seed: Of chance.
        """
        for name, share in (("loss", loss), ("damage", damage)):
            checked_number(name, share, least=0.0, most=1.0, error=TaskError)
        for name, delay in (("latency", latency), ("jitter", jitter)):
            checked_number(name, delay, least=0.0, unit="s", error=TaskError)
        self._loss, self._damage = loss, damage
        self._latency, self._jitter = latency, jitter
        self._rng = np.random.default_rng(seed)
        self._under_way: list[tuple[float, int, bytes]] = []
        self._count = 0

    def send(self, data: bytes, now: float) -> None:
        """Send bytes at a time, s."""
        lost, damaged, late = self._rng.random(3)
        self._count += 1
        if lost >= self._loss:
            arrival = now + self._latency + self._jitter * late
            kept = data[:-1] if damaged < self._damage else data
            heapq.heappush(self._under_way, (arrival, self._count, kept))

    def arrived(self, now: float) -> list[bytes]:
        """What has arrived until a time (s) and was not asked for before, in order of arrival."""
        out = []
        while self._under_way and self._under_way[0][0] <= now:
            out.append(heapq.heappop(self._under_way)[2])
        return out


def reading_values(reading: HandReading, actuators: int, fingers: int) -> FloatArray:
    """Numbers of a reading: joints, velocities, efforts, touch, poses of base and object.

    Its time goes into the packet; twist of the object and pads are left out.

    Args:
        reading: What was read.
        actuators: How many actuators the hand has.
        fingers: How many fingers it feels with.
    """
    return np.concatenate(
        [
            reading.joints,
            reading.velocities,
            np.full(actuators, np.nan) if reading.efforts is None else reading.efforts,
            np.full(fingers, np.nan) if reading.touch is None else reading.touch,
            _numbers(reading.T_world_base),
            _numbers(reading.T_world_object),
        ]
    )


def reading_of(
    values: FloatArray, time: float, joints: int, actuators: int, fingers: int
) -> HandReading:
    """The reading of some numbers.

    Args:
        values: As ``reading_values`` gives them.
        time: When it was measured, s, on the loop's clock.
        joints: How many joints the hand has.
        actuators: How many actuators.
        fingers: How many fingers it feels with.

    Raises:
        HandError: Another count of numbers.
    """
    sizes = (joints, joints, actuators, fingers, POSE, POSE)
    if values.shape != (sum(sizes),):
        raise HandError(f"a reading of {values.size} numbers arrived; this hand has {sum(sizes)}")
    q, v, efforts, touch, base, item = np.split(values, np.cumsum(sizes)[:-1])
    return HandReading(
        time=time,
        joints=q,
        velocities=v,
        efforts=_read(efforts),
        touch=_read(touch),
        T_world_base=_pose(base),
        T_world_object=_pose(item),
    )


def _numbers(pose: SE3 | None) -> FloatArray:
    return np.full(POSE, np.nan) if pose is None else np.concatenate(pose_to_wxyz(pose))


def _pose(numbers: FloatArray) -> SE3 | None:
    return None if np.isnan(numbers).all() else pose_from_wxyz(numbers[:3], numbers[3:])


def _read(numbers: FloatArray) -> FloatArray | None:
    return None if not numbers.size or np.isnan(numbers).all() else numbers


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
