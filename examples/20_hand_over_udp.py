"""Drive a hand in another process over UDP, with lost, late, overtaken and damaged packets.

That process simulates the hand in real time. Both are started here and talk on 127.0.0.1 only, on a
port that the system chooses. Of all packets 5 % are lost and 1 % damaged, each way; they take 5 to
15 ms. ``udp_hand.py`` beside this script has the format (mark, kind, number, time, numbers,
checksum) and the kinds. Malformed packets are refused, overtaken ones ignored. Prints what
loop and network did, and whether the object is held all the same: the fingers' servos hold the last
command that arrived, and the next one comes 10 ms later.
"""

from __future__ import annotations

import multiprocessing
import socket
import time
from contextlib import closing, suppress
from multiprocessing.connection import Connection

from udp_hand import Inbox, LossyLink, Packet, UdpHand, reading_values

from planner import GraspTask, plan_grasp
from planner.errors import HandError
from planner.files import read_plan, write_plan
from sim.controllers import PHASES, GraspController
from sim.real_hand import RealClock, Safety, SimulatedHand, run_controller
from sim.trial import Timeline, Trial

RATE = 100.0  # of the loop, Hz
PERIOD = 0.005  # between two readings, s
FAULTS = {"loss": 0.05, "damage": 0.01, "latency": 0.005, "jitter": 0.010}  # shares (-), s
TIMELINE = Timeline.quick()
PLAN = "udp_plan.json"


def obey(hand: SimulatedHand, packet: Packet) -> None:
    """Do what a packet says."""
    if packet.kind == b"S":
        hand.stop()
    if packet.kind == b"C":
        phase, progress, per_second = packet.values[-3:].tolist()
        hand.carry(PHASES[int(phase)], progress, per_second)
        with suppress(HandError):  # the torque was taken off
            hand.write(packet.values[:-3])


def serve(pipe: Connection) -> None:
    """The other process: the hand, and the network with its faults."""
    pipe.recv()  # the plan is written
    hand = SimulatedHand(Trial(read_plan(PLAN), timeline=TIMELINE), clock=RealClock())
    sizes = len(hand.actuator_names), len(hand.finger_names)
    there, back = LossyLink(**FAULTS, seed=0), LossyLink(**FAULTS, seed=1)
    inbox, number, due = Inbox(), 0, 0.0
    client: tuple[str, int] | None = None
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    link.settimeout(0.001)
    pipe.send(link.getsockname()[1])
    while inbox.newest is None or inbox.newest.kind != b"E":
        with suppress(TimeoutError):
            data, client = link.recvfrom(65536)
            there.send(data, time.monotonic())
        if client is not None:
            if time.monotonic() >= due:
                due, number, reading = time.monotonic() + PERIOD, number + 1, hand.read()
                values = reading_values(reading, *sizes)
                packet = Packet(kind=b"R", number=number, time=reading.time, values=values)
                back.send(packet.to_bytes(), time.monotonic())
            for data in back.arrived(time.monotonic()):
                link.sendto(data, client)
        for data in there.arrived(time.monotonic()):
            newer = inbox.take(data)
            if newer is not None:
                obey(hand, newer)
    report = hand.report()
    pipe.send((report.reason or "held", report.largest_slip[0], inbox.lost, inbox.malformed))


def main() -> None:
    """Start the other process, plan, drive its hand."""
    processes = multiprocessing.get_context("spawn")
    ours, theirs = processes.Pipe()
    other = processes.Process(target=serve, args=(theirs,), daemon=True)
    other.start()  # it loads what it needs while we plan
    plan = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=0)
    write_plan(plan, PLAN)
    ours.send(PLAN)
    with closing(UdpHand(plan.task.hand, plan.task.finger_names, ours.recv())) as hand:
        report = run_controller(
            hand,
            GraspController(plan),
            plan,
            rate_hz=RATE,
            timeline=TIMELINE,
            carry=hand.carry,
            safety=Safety(max_age=1.0, misses_in_a_row=100),  # generous: this machine may be busy
        )
        while other.is_alive() and not ours.poll(0.01):  # some may be lost
            hand.send(b"E")
    print(report)
    print(f"latency p50 / p99 / worst {report.latency_us}; slots skipped {report.skipped}")
    print(
        f"oldest reading {report.oldest_reading_ms:.0f} ms, used again {report.repeated_readings}"
    )
    outcome, slip, lost, malformed = ours.recv()
    inbox = hand.inbox
    print(f"readings: {inbox.arrived} arrived, {inbox.lost} lost, {inbox.malformed} malformed")
    print(f"commands: {hand.sent} sent, {lost} lost, {malformed} malformed")
    print(f"the object: {outcome}, slip {slip:.2f} mm")


if __name__ == "__main__":
    main()
