"""A PSM of the dVRK's own stack, as far as CRTK shows one: follows servo_jp at once, holds on silence, keeps what it was sent.

Its messages are defined here once more, from the .msg files, so that a wrong name or order in ``trocar.crtk`` shows. Lines on
standard input change it: ``state FAULT 1 0`` (state, homed, busy), ``measure {"position": [...]}`` (lists and stamp of its measured_js),
``silent 1``; ``mark`` notes how much it was sent so far. It says when it is sent a velocity, 0.2 rad/s of yaw or pitch, and no velocity
any more, ends with the input, and then writes what it was sent.
"""

import argparse
import dataclasses
import json
import os
import sys
import threading
import time
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclasses.dataclass
class Stamp(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: types.int32
    nanosec: types.uint32


@dataclasses.dataclass
class Head(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Stamp
    frame_id: str


@dataclasses.dataclass
class Joints(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Head
    name: types.sequence[str]
    position: types.sequence[types.float64]
    velocity: types.sequence[types.float64]
    effort: types.sequence[types.float64]


@dataclasses.dataclass
class State(IdlStruct, typename="crtk_msgs::msg::dds_::OperatingState_"):
    header: Head
    state: str
    is_homed: bool
    is_busy: bool


#: rclcpp's default: reliable, volatile; and transient local where a publisher is latched.
DEFAULT = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Durability.Volatile, Policy.History.KeepLast(100))
LATCHED = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Durability.TransientLocal, Policy.History.KeepLast(100))
NAMES = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]


def head(stamp: str = "now") -> Head:
    sec, nanosec = {"zero": (0, 0), "back": (1, 0)}.get(stamp) or divmod(time.time_ns(), 10**9)
    return Head(Stamp(sec, nanosec), "PSM1_base")


def taken(reader: DataReader) -> list[Joints]:
    """What has come; a publisher that ends leaves a sample without data."""
    return [sample for sample in reader.take(1000) if isinstance(sample, Joints)]


class Psm:
    def __init__(self, name: str, state: str, homed: bool) -> None:
        participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        parts = ("measured_js", "jaw/measured_js", "servo_jp", "jaw/servo_jp")
        topic = {part: Topic(participant, f"rt/{name}/{part}", Joints) for part in parts}
        self.measured, self.measured_jaw = (DataWriter(participant, topic[part], DEFAULT) for part in ("measured_js", "jaw/measured_js"))
        self.servo, self.servo_jaw = (DataReader(participant, topic[part], DEFAULT) for part in ("servo_jp", "jaw/servo_jp"))
        self.operating = DataWriter(participant, Topic(participant, f"rt/{name}/operating_state", State), LATCHED)
        self.position, self.velocity, self.jaw = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0], [0.0] * 6, 0.3
        self.wrong: dict[str, Any] = {}
        self.silent, self.motion = False, "resting"
        self.marks: list[int] = []
        self.head = head()
        self.sent: list[dict[str, Any]] = []
        self.sent_jaw: list[dict[str, Any]] = []
        self.set_state(state, homed)

    def set_state(self, state: str, homed: bool, busy: bool = False) -> None:
        self.ready = state == "ENABLED" and homed
        self.operating.write(State(head(), state, homed, busy))

    def obey(self, line: str) -> None:
        word, _, rest = line.strip().partition(" ")
        if word == "state":
            state, homed, busy = rest.split()
            self.set_state(state, homed == "1", busy == "1")
        elif word == "measure":
            self.wrong = json.loads(rest)
        elif word == "silent":
            self.silent = rest == "1"
        elif word == "mark":
            self.marks.append(len(self.sent))

    def say(self, velocity: list[float]) -> None:
        before = self.motion
        if not any(velocity):
            self.motion = "resting"
        elif max(map(abs, velocity[:2])) >= 0.2:
            self.motion = "fast"
        elif before == "resting":
            self.motion = "moving"
        if self.motion != before:
            print(self.motion, file=sys.stderr, flush=True)

    def step(self) -> None:
        for message in taken(self.servo):
            self.sent.append({"position": message.position, "velocity": message.velocity, "ready": self.ready})
            self.say(message.velocity)
            if self.ready:
                self.position, self.velocity = message.position, message.velocity
        for message in taken(self.servo_jaw):
            self.sent_jaw.append({"position": message.position, "velocity": message.velocity, "ready": self.ready})
            if self.ready:
                (self.jaw,) = message.position
        if self.silent:
            return
        lists = {"name": NAMES, "position": self.position, "velocity": self.velocity, "effort": [0.1] * 6, "stamp": "now", **self.wrong}
        stamp = lists.pop("stamp")
        self.head = self.head if stamp == "same" else head(stamp)
        self.measured.write(Joints(self.head, **lists))
        self.measured_jaw.write(Joints(head(), ["jaw"], [self.jaw], [0.0], [-0.01]))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("file")
    parser.add_argument("--state", nargs=2, default=["ENABLED", "1"])
    parser.add_argument("--hz", type=float, default=250.0)
    options = parser.parse_args()
    psm = Psm(options.name, options.state[0], options.state[1] == "1")
    lines: list[str] = []
    ended = threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            lines.append(line)
        ended.set()

    threading.Thread(target=listen, daemon=True).start()
    while not ended.is_set() or lines:
        while lines:
            psm.obey(lines.pop(0))
        psm.step()
        time.sleep(1.0 / options.hz)
    with open(options.file, "w") as file:
        json.dump({"sent": psm.sent, "jaw": psm.sent_jaw, "position": psm.position, "marks": psm.marks}, file)


if __name__ == "__main__":
    main()
