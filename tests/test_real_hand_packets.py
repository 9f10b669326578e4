"""Packets to and from a hand elsewhere: the damaged are refused, the lost are counted."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from udp_hand import Inbox, LossyLink, Packet, UdpHand, reading_of, reading_values

from planner.errors import HandError
from planner.hand_loading import load_hand
from planner.spatial import SE3
from sim.real_hand import HandReading

HAND = load_hand("allegro_hand")
FINGERS = ("thumb", "index", "middle", "ring")


def packet(number: int, kind: bytes = b"R") -> Packet:
    values = np.array([number, np.nan, -1e300, np.inf])
    return Packet(kind=kind, number=number, time=12.5, values=values)


@given(
    st.binary(min_size=1, max_size=1),
    st.integers(0, 2**32 - 1),
    st.floats(allow_nan=False),
    st.lists(st.floats(), max_size=40),
)
def test_a_packet_arrives_as_it_was_sent(
    kind: bytes, number: int, moment: float, values: list[float]
) -> None:
    sent = Packet(kind=kind, number=number, time=moment, values=np.array(values))
    got = Packet.of(sent.to_bytes())
    assert (got.kind, got.number, got.time) == (kind, number, moment)
    np.testing.assert_array_equal(got.values, np.array(values))  # NaN is the same NaN


@given(st.data())
def test_a_packet_that_was_damaged_is_refused(data: st.DataObject) -> None:
    whole = packet(7).to_bytes()
    how = data.draw(st.sampled_from(["bit", "cut", "more"]))
    if how == "bit":
        place = data.draw(st.integers(0, len(whole) - 1))
        bit = 1 << data.draw(st.integers(0, 7))
        bad = whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :]
    elif how == "cut":
        bad = whole[: data.draw(st.integers(0, len(whole) - 1))]
    else:
        bad = whole + data.draw(st.binary(min_size=1, max_size=9))
    with pytest.raises(HandError, match="a packet"):
        Packet.of(bad)


@given(st.binary(max_size=200))
def test_anything_else_is_refused(data: bytes) -> None:
    inbox = Inbox()
    assert inbox.take(data) is None
    assert (inbox.arrived, inbox.malformed) == (0, 1)


def test_losses_and_packets_that_were_overtaken_are_counted() -> None:
    inbox = Inbox()
    for number in (3, 4, 6, 5, 9):  # 7 and 8 are lost, 5 comes too late
        inbox.take(packet(number).to_bytes())
    assert inbox.newest is not None and inbox.newest.number == 9
    assert (inbox.arrived, inbox.overtaken, inbox.lost) == (5, 1, 2)


def test_a_lossy_link_loses_delays_and_reorders_by_its_seed() -> None:
    sent = [packet(k).to_bytes() for k in range(2000)]

    def through(seed: int) -> list[bytes]:
        link = LossyLink(loss=0.05, damage=0.02, latency=0.005, jitter=0.010, seed=seed)
        out = []
        for k, data in enumerate(sent):
            link.send(data, 0.001 * k)
            out += link.arrived(0.001 * k)
        assert not link.arrived(2.0 + 0.0039)[10:]  # the last ones are still under way
        return out + link.arrived(10.0)

    arrived = through(0)
    assert arrived == through(0) != through(1)
    assert len(arrived) == pytest.approx(1900, abs=50)
    inbox = Inbox()
    for data in arrived:
        inbox.take(data)
    assert inbox.malformed == pytest.approx(38, abs=25)
    assert inbox.overtaken > 500
    quick = LossyLink()
    quick.send(b"x", 0.0)
    assert quick.arrived(0.0) == [b"x"]
    slow = LossyLink(latency=0.005)
    slow.send(b"x", 0.0)
    assert slow.arrived(0.004) == [] and slow.arrived(0.005) == [b"x"]


def reading(**changes: object) -> HandReading:
    pose = SE3(pin.exp3(np.array([0.1, -0.4, 0.8])), np.array([0.1, 0.2, 0.3]))
    known: dict[str, object] = {
        "time": 3.0,
        "joints": np.linspace(0.0, 1.0, 16),
        "velocities": np.linspace(-1.0, 1.0, 16),
        "efforts": np.linspace(-0.5, 0.5, 16),
        "touch": np.arange(4.0),
        "T_world_base": pose,
        "T_world_object": pose.inverse(),
    }
    return HandReading(**(known | changes))  # type: ignore[arg-type]


def test_a_reading_is_the_same_after_its_way() -> None:
    sent = reading()
    got = reading_of(reading_values(sent, 16, 4), 3.0, 16, 16, 4)
    for name in ("joints", "velocities", "efforts", "touch"):
        np.testing.assert_array_equal(getattr(got, name), getattr(sent, name))
    for name in ("T_world_base", "T_world_object"):
        assert getattr(got, name).isApprox(getattr(sent, name), 1e-12)
    bare = reading(efforts=None, touch=None, T_world_base=None, T_world_object=None)
    got = reading_of(reading_values(bare, 16, 4), 3.0, 16, 16, 4)
    assert got.efforts is None and got.touch is None
    assert got.T_world_base is None and got.T_world_object is None
    with pytest.raises(HandError, match="this hand has 66"):
        reading_of(reading_values(bare, 16, 4)[:-1], 3.0, 16, 16, 4)


# a hand elsewhere: a thread that answers


class Answers(threading.Thread):
    """Sends a reading for every packet that comes, and keeps what came."""

    def __init__(self) -> None:
        """Bind to a port that the system chooses."""
        super().__init__(daemon=True)
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.bind(("127.0.0.1", 0))
        self.link.settimeout(0.2)
        self.port: int = self.link.getsockname()[1]
        self.got: list[Packet] = []
        self.over = False

    def run(self) -> None:
        values = reading_values(reading(), 16, 4)
        while not self.over:
            try:
                data, client = self.link.recvfrom(65536)
            except TimeoutError:
                continue
            self.got.append(Packet.of(data))
            self.link.sendto(b"noise", client)
            answer = Packet(
                kind=b"R", number=len(self.got), time=1.0 * len(self.got), values=values
            )
            self.link.sendto(answer.to_bytes(), client)


@pytest.fixture
def other() -> Iterator[Answers]:
    thread = Answers()
    thread.start()
    yield thread
    thread.over = True
    thread.join()
    thread.link.close()


def wait_for(count: int, other: Answers) -> None:
    until = time.monotonic() + 60.0
    while len(other.got) < count and time.monotonic() < until:
        time.sleep(0.005)


def test_a_hand_over_udp_reads_and_writes(other: Answers) -> None:
    with closing(UdpHand(HAND, FINGERS, other.port)) as hand:
        assert hand.read().joints == pytest.approx(np.linspace(0.0, 1.0, 16))
        hand.carry("squeeze", 0.25, 2.0)
        hand.write(np.arange(16.0))
        wait_for(hand.sent, other)
        last = other.got[-1]
        assert last.kind == b"C" and last.number == hand.sent - 1
        assert last.values.tolist() == [*range(16), 2.0, 0.25, 2.0]
        until = time.monotonic() + 60.0
        while hand.read().time < hand.sent and time.monotonic() < until:
            time.sleep(0.005)
        assert hand.inbox.malformed >= 1  # the noise did no harm
        hand.stop()
        wait_for(hand.sent, other)
        assert [p.kind for p in other.got[-10:]] == [b"S"] * 10
        with pytest.raises(HandError, match="torque of this hand was taken off"):
            hand.write(np.zeros(16))


def test_nobody_at_the_other_end_is_told_in_time() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as silent:
        silent.bind(("127.0.0.1", 0))
        with pytest.raises(HandError, match="is the other process running"):
            UdpHand(HAND, FINGERS, silent.getsockname()[1], patience=0.1)


def test_one_number_out_of_the_series_silences_nobody() -> None:
    inbox = Inbox()
    for number in (3, 4, 2**32 - 1, 5, 6, 2**31, 7):
        inbox.take(packet(number).to_bytes())
    assert inbox.newest is not None and inbox.newest.number == 7
    assert (inbox.out_of_series, inbox.overtaken) == (2, 0)


@pytest.mark.parametrize("begin", [0, 5000])
def test_a_sender_that_begins_anew_or_went_on_unheard_is_heard_again(begin: int) -> None:
    inbox = Inbox()
    for number in (*range(2000, 2010), *range(begin, begin + 5)):
        inbox.take(packet(number).to_bytes())
    assert inbox.newest is not None and inbox.newest.number == begin + 4
    assert (inbox.out_of_series, inbox.overtaken, inbox.lost) == (1, 0, 0)
