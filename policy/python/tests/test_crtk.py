"""CRTK over ROS 2: arms of a dVRK that is played in a process of its own, ROS images, and a run's arms for ROS tools.

Every test has a ROS domain of its own, on the loopback interface only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trocar
from test_arms import until
from trocar.arms import arms_of
from trocar.messages import ArmFeedback, ArmSetpoint
from trocar.topics import Node, TopicError

pytest.importorskip("cyclonedds")

from trocar.crtk import CrtkArms, Fault, RosError
from trocar.crtk.__main__ import _ending, main
from trocar.crtk.cameras import cameras_of, exposure_ns
from trocar.crtk.dds import Ros, domain_id
from trocar.crtk.joints import Measured, joints_of
from trocar.crtk.messages import CameraInfo, Header, Image, JointState, OperatingState, RegionOfInterest, Time
from trocar.crtk.notes import UnusableError, Unused
from trocar.crtk.pictures import Lens, Size, colour_of, fitted, lens_of
from trocar.crtk.readiness import FAULT_NS_MIN, Latch, fault_of
from trocar.crtk.servo import Servo, close_all

pytestmark = pytest.mark.clock

CONFIG = Path(__file__).parents[3] / "config"
SAFETY = CONFIG / "tasks/needle-lift/safety.toml"
PSM = Path(__file__).parent / "crtk_psm.py"

#: More than other sessions: between a dVRK's message and the controller there are two processes of Python that a busy machine may keep waiting.
SLOW_MOTION = 4

LOOPBACK = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address="localhost"/></Peers></Discovery></Domain></CycloneDDS>"""


@pytest.fixture(autouse=True)
def slow_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clocks of sessions run as slowly as those of the bridges."""
    monkeypatch.setattr("conftest.SLOW_MOTION", SLOW_MOTION)


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain that no other test has."""
    number = random.SystemRandom().randint(1, 200)
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    return number


class Process:
    """A process whose lines on standard error are read as they come."""

    def __init__(self, *arguments: str) -> None:
        self.raw = subprocess.Popen(
            [sys.executable, "-B", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TROCAR_SLOW_MOTION": str(SLOW_MOTION)},
            # Whoever runs this test may ignore Ctrl-C.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        self.lines: list[str] = []
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self.raw.stderr is not None
        self.lines.extend(self.raw.stderr)

    def said(self, text: str, within_s: float = 60.0) -> str:
        """The line with `text` in it, once there is one."""
        end = time.monotonic() + within_s
        while time.monotonic() < end:
            if found := [line for line in list(self.lines) if text in line]:
                return found[0]
            assert self.raw.poll() is None, f"it ended without {text!r}: {self.lines}"
            time.sleep(0.01)
        raise AssertionError(f"{text!r} was not said: {self.lines}")

    def tell(self, line: str) -> None:
        assert self.raw.stdin is not None
        self.raw.stdin.write(line + "\n")
        self.raw.stdin.flush()

    def end(self, number: signal.Signals | None = None) -> int:
        """Closes its input or sends it a signal; its exit code."""
        if number is not None:
            self.raw.send_signal(number)
        assert self.raw.stdin is not None
        self.raw.stdin.close()
        code = self.raw.wait(60.0)
        self._thread.join(60.0)
        return code


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """Starts processes of Python, none of which outlives the test."""
    begun: list[Process] = []

    def start(*arguments: str) -> Process:
        begun.append(Process(*arguments))
        return begun[-1]

    yield start
    for process in begun:
        if process.raw.poll() is None:
            process.raw.kill()
        process.raw.wait()


class Psm:
    """The dVRK's PSM beside the test."""

    def __init__(self, start: Callable[..., Process], file: Path, *options: str) -> None:
        self.file = file
        self.process = start(str(PSM), "PSM1", str(file), *options)

    def state(self, state: str, homed: bool = True, busy: bool = False) -> None:
        self.process.tell(f"state {state} {int(homed)} {int(busy)}")

    def measures(self, **lists: Any) -> None:
        self.process.tell(f"measure {json.dumps(lists)}")

    def moves(self, running: Any) -> None:
        """Waits until it is sent 0.2 rad/s for yaw or pitch in the session `running`."""
        until(lambda: self.process.lines[-1:] == ["fast\n"] or running.process.poll() is not None, 60.0)
        assert running.process.poll() is None, running.end()[2]

    def rests(self) -> None:
        """Waits until it is sent none any more."""
        until(lambda: self.process.lines[-1:] == ["resting\n"], 60.0)

    def mark(self) -> None:
        """Notes how much it was sent so far."""
        self.process.tell("mark")

    def end(self) -> dict[str, Any]:
        """What it was sent."""
        assert self.process.end() == 0, self.process.lines
        found: dict[str, Any] = json.loads(self.file.read_text())
        return found


@pytest.fixture
def psm(start: Callable[..., Process], tmp_path: Path) -> Callable[..., Psm]:
    """Starts a PSM."""
    return lambda *options: Psm(start, tmp_path / "psm.json", *options)


def bridge(start: Callable[..., Process], name: str) -> Process:
    return start("-m", "trocar.crtk", "arms", "PSM1", "--topics", name)


def served(start: Callable[..., Process], psm: Callable[..., Psm], name: str) -> tuple[Psm, Process]:
    """A PSM, and the bridge that serves it."""
    arm, serving = psm(), bridge(start, name)
    serving.said("serving PSM1")
    return arm, serving


def run(session: Callable[..., Any], name: str, seconds: float) -> Any:
    on = ["--backend", "topics", "--topics", name, "--safety", str(SAFETY), "--no-log"]
    return session("run", *on, "--policy", "random", "--seconds", str(seconds), "--json", "-")


def limits() -> tuple[np.ndarray, float]:
    """The velocities that config/control.toml allows the joints and the jaw."""
    found = tomllib.loads((CONFIG / "control.toml").read_text())["limits"]
    joints = [found[axis] for axis in ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")]
    return np.array([axis.get("velocity_rad_s") or axis["velocity_m_s"] for axis in joints]), found["jaw"]["velocity_rad_s"]


def test_a_run_moves_a_psm_within_limits_and_leaves_it_at_rest(
    name: str, session: Callable[..., Any], start: Callable[..., Process], psm: Callable[..., Psm]
) -> None:
    arm, serving = served(start, psm, name)
    code, out, err = run(session, name, 2).end()
    assert code == 0, err
    assert json.loads(out)["reason"] == "the 2 s are over"
    assert serving.end(signal.SIGINT) == 0
    found = arm.end()
    velocity = np.array([sample["velocity"] for sample in found["sent"]])
    position = np.array([sample["position"] for sample in found["sent"]])
    jaw = np.array([sample["velocity"][0] for sample in found["jaw"]])
    most, most_jaw = limits()
    assert len(velocity) > 500 and velocity.shape == position.shape == (len(velocity), 6)
    assert (np.abs(velocity) <= most + 1e-9).all() and (np.abs(jaw) <= most_jaw + 1e-9).all()
    assert np.abs(position - position[0]).max() > 1e-3 and np.abs(velocity).max() > 0.0
    assert not velocity[-1].any() and jaw[-1] == 0.0
    assert found["position"] == found["sent"][-1]["position"] != [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
    # Where it was when it was first commanded.
    np.testing.assert_allclose(position[0], [0.0, 0.0, 0.12, 0.0, 0.0, 0.0], atol=1e-6)


def test_an_arm_that_leaves_enabled_ends_the_run_and_is_sent_nothing(
    name: str, session: Callable[..., Any], start: Callable[..., Process], psm: Callable[..., Psm]
) -> None:
    arm, serving = served(start, psm, name)
    running = run(session, name, 60)
    arm.moves(running)
    arm.state("PAUSED")
    code, _, err = running.end()
    assert code != 0 and f"fault {int(Fault.PAUSED):#06x}" in err, err
    assert "0xc002 (PAUSED)" in serving.said("PSM1: fault")
    # Ready again, it is sent nothing before another run commands it.
    arm.state("ENABLED")
    serving.said("PSM1: ready for another run")
    arm.mark()
    code, _, err = run(session, name, 0.5).end()
    assert code == 0, err
    assert serving.end(signal.SIGTERM) == 0
    found = arm.end()
    (mark,), sent = found["marks"], found["sent"]
    before, after = sent[:mark], sent[mark:]
    # Since it stopped being ready it was sent what was under way, and then its last position without velocity.
    late = [sample for sample in before if not sample["ready"]]
    assert 0 < len(late) < 20 and before[-len(late) :] == late
    *moving, held = before[-len(late) - 1 :]
    assert all(any(sample["velocity"]) for sample in moving)
    assert held["position"] == moving[-1]["position"] and not any(held["velocity"])
    assert [sample for sample in found["jaw"] if not sample["ready"]][-1]["velocity"] == [0.0]
    assert all(sample["ready"] for sample in after) and not any(after[-1]["velocity"])


def test_a_dead_controller_and_ctrl_c_leave_the_arm_at_rest(
    name: str, session: Callable[..., Any], start: Callable[..., Process], psm: Callable[..., Psm]
) -> None:
    arm, serving = served(start, psm, name)
    killed = run(session, name, 60)
    arm.moves(killed)
    arm.mark()
    killed.process.kill()
    arm.rests()
    arm.mark()
    running = run(session, name, 60)
    arm.moves(running)
    arm.mark()
    assert serving.end(signal.SIGINT) == 0
    code, _, err = running.end()
    assert code != 0 and "no measurement for 0.05" in err, err
    found = arm.end()
    velocity = np.array([sample["velocity"] for sample in found["sent"]])
    kill, rest, ctrl_c = found["marks"]
    # No more than the limits on acceleration allow in 20 periods is no jump.
    jump = 20 * 4.0 * 1e-3
    assert np.abs(np.diff(velocity[:, :2], axis=0)).max() < jump
    for stop in (velocity[kill:rest], velocity[ctrl_c:]):
        speed = np.abs(stop[:, :2]).max(axis=1)
        assert speed.max() > jump and not stop[-1].any()
        resting = int(np.flatnonzero(~stop.any(axis=1))[0])
        assert resting - int(np.flatnonzero(speed > jump)[-1]) >= 5


def test_what_is_waited_for_is_said_until_it_is_there(name: str, start: Callable[..., Process], psm: Callable[..., Psm]) -> None:
    serving = bridge(start, name)
    waits = serving.said("waiting for")
    topics = "/PSM1/measured_js and /PSM1/jaw/measured_js and /PSM1/operating_state and a subscriber of /PSM1/servo_jp and a subscriber"
    assert topics in waits and f"ROS domain {os.environ['ROS_DOMAIN_ID']}" in waits
    arm = psm("--state", "DISABLED", "0")
    serving.said("/PSM1/operating_state to be ENABLED, homed, not busy; it is DISABLED, not homed")
    arm.state("ENABLED", homed=False)
    serving.said("it is ENABLED, not homed")
    assert not any("serving" in line for line in serving.lines)
    arm.measures(position=[0.0] * 7)
    serving.said("position has 7 entries, expected 6")
    serving.said("waiting for /PSM1/measured_js (")
    arm.state("ENABLED", busy=True)
    for stamp, said in (("same", "stamp is that of the message before"), ("zero", "stamp is zero"), ("back", "stamp goes back")):
        arm.measures(stamp=stamp)
        serving.said(said)
    arm.measures()
    serving.said("it is ENABLED, homed, busy")
    assert not any("serving" in line for line in serving.lines)
    arm.state("ENABLED")
    serving.said("serving PSM1")
    arm.state("ENABLED", busy=True)
    time.sleep(0.2)
    assert not any("PSM1 is" in line or "PSM1: fault" in line for line in serving.lines)
    assert serving.end(signal.SIGINT) == 0
    assert any("/PSM1/measured_js: " in line and "messages were not used: position has 7" in line for line in serving.lines)
    assert arm.end()["sent"] == []


DOUBLED = ("servo_jp", "jaw/servo_jp", "measured_js", "jaw/measured_js")


@pytest.mark.parametrize("topic", DOUBLED)
def test_a_second_publisher_is_refused_by_name(name: str, topic: str, start: Callable[..., Process], psm: Callable[..., Psm]) -> None:
    arm = psm()
    other = Ros().writer(f"PSM1/{topic}", JointState)
    serving = bridge(start, name)
    line = serving.said("is published by")
    assert f"/{other.topic} is published by" in line and f"pid {os.getpid()}" in line
    assert (f"pid {arm.process.raw.pid}" in line) == ("measured_js" in topic)
    assert serving.end() == 1


def test_a_second_publisher_that_comes_later_is_named_and_the_run_goes_on(
    name: str, session: Callable[..., Any], start: Callable[..., Process], psm: Callable[..., Psm]
) -> None:
    arm, serving = served(start, psm, name)
    running = run(session, name, 5)
    arm.moves(running)
    ros = Ros()
    others = [ros.writer(f"PSM1/{topic}", JointState) for topic in DOUBLED]
    for other in others:
        assert f"pid {os.getpid()}" in serving.said(f"/{other.topic} is published by")
    assert running.process.poll() is None
    code, _, err = running.end()
    assert code == 0, err
    assert serving.end(signal.SIGINT) == 0


def test_measurements_that_end_end_the_run(
    name: str, session: Callable[..., Any], start: Callable[..., Process], psm: Callable[..., Psm]
) -> None:
    arm, serving = served(start, psm, name)
    running = run(session, name, 60)
    arm.moves(running)
    arm.process.tell("silent 1")
    code, _, err = running.end()
    assert code != 0 and "no measurement for 0.05" in err, err
    serving.said("/PSM1/measured_js and /PSM1/jaw/measured_js: not there any more")
    assert serving.end(signal.SIGINT) == 0
    assert not any(arm.end()["sent"][-1]["velocity"])


def test_messages_are_ros_2s_to_the_byte() -> None:
    """Digests of what the typestore ROS2_JAZZY of rosbags 0.11, which has the .msg files, serializes."""
    header, nine = Header(Time(5, 7), "abc"), [float(number) for number in range(9)]
    region = RegionOfInterest(1, 2, 3, 4, True)
    twelve = [*nine, 9.0, 10.0, 11.0]
    lens = CameraInfo(header, 8, 12, "plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.5], nine, nine, twelve, 1, 2, region)
    image = Image(header, 2, 3, "rgb8", 0, 9, bytes(range(18)))
    for message, expected in [
        (JointState(header, ["a", "bcd"], [1.0, 2.0], [3.0, 4.0]), (88, "79213cac466d6a6e")),
        (OperatingState(header, "ENABLED", True, False), (34, "ff31f999d9ad6110")),
        (image, (66, "151a0deb02cd6d16")),
        (lens, (357, "1b69c8e1a54aec55")),
    ]:
        data = message.serialize(use_version_2=False)
        assert (len(data), hashlib.sha256(data).hexdigest()[:16]) == expected, type(message).__name__
        again = type(message).deserialize(data)
        assert dataclasses.replace(again, **({"data": bytes(again.data)} if message is image else {})) == message


class Sent:
    """A ROS domain of ready arms that keeps what is published; `raises` has what is raised instead, by topic, first to last."""

    domain = 0

    def __init__(self, **raises: list[type[BaseException]]) -> None:
        self.topics: dict[str, list[Any]] = {}
        self.raises = {topic.replace("__", "/"): list(found) for topic, found in raises.items()}
        self.waited: list[dict[str, int]] = []

    def publishers(self, topic: str) -> list[str]:
        return []

    def reader(self, topic: str, message: type[Any], **_: bool) -> Any:
        count = 1 if "jaw" in topic else 6

        def newest() -> Any:
            header = Header(Time.of(time.time_ns()))
            if message is OperatingState:
                return OperatingState(header, "ENABLED", True, False)
            return JointState(header, [], [0.1] * count, [0.0] * count, [0.0] * count)

        return SimpleNamespace(topic=topic, newest=newest)

    def writer(self, topic: str, message: type[Any], *, depth: int = 1) -> Any:
        kept, raises = self.topics.setdefault(topic, []), self.raises.setdefault(topic, [])

        def publish(message: Any) -> None:
            if raises and len(kept):
                raise raises.pop(0)
            kept.append(message)

        def wait(timeout_s: float) -> bool:
            self.waited.append({topic: len(kept) for topic, kept in self.topics.items()})
            return True

        return SimpleNamespace(topic=topic, matched=True, publish=publish, wait=wait)

    def assert_held(self, *topics: str) -> None:
        for topic in topics:
            moving, held = self.topics[topic][-2:]
            assert any(moving.velocity) and held.position == moving.position and not any(held.velocity), topic


def command(ms: int, position: float = 0.1, velocity: float = 0.0, enabled: bool = True) -> trocar.ArmCommand:
    return trocar.ArmCommand(10**6 * ms, np.full(6, position), np.full(6, velocity), np.zeros(6), 0.5, velocity, enabled)


def test_set_points_are_sent_in_motion_and_for_a_while_at_rest() -> None:
    ros = Sent()
    servo = Servo(ros, "PSM1")  # type: ignore[arg-type]
    sent = ros.topics["PSM1/servo_jp"]
    servo.follow(None, withheld=False)
    servo.follow(command(0, enabled=False), withheld=False)
    assert not sent and servo.is_over
    for ms in range(1, 11):
        servo.follow(command(ms, 0.1 + 1e-3 * ms, 0.5), withheld=False)
    assert len(sent) == 10 and sent[-1].velocity == [0.5] * 6 and sent[-1].header.stamp.ns > 0 and not servo.is_over
    for ms in range(11, 1100):
        servo.follow(command(ms), withheld=False)
    assert len(sent) == len(ros.topics["PSM1/jaw/servo_jp"]) == 110 and servo.is_over
    servo.follow(command(1100, 0.2), withheld=False)
    assert sent[-1].position == [0.2] * 6 and not servo.is_over
    close_all([servo])
    assert len(sent) == 111


@pytest.mark.parametrize("end", ["without torque", "nobody", "closed"])
def test_no_velocity_is_left_behind(end: str) -> None:
    ros = Sent()
    servo = Servo(ros, "PSM1")  # type: ignore[arg-type]
    servo.follow(command(1, 0.3, 0.5), withheld=False)
    if end == "closed":
        close_all([servo])
    else:
        servo.follow(command(2, 0.4, enabled=False) if end == "without torque" else None, withheld=False)
    for sent in ros.topics.values():
        assert len(sent) == 2 and sent[1].position == sent[0].position and not any(sent[1].velocity)


def test_withheld_set_points_are_not_sent_afterwards() -> None:
    ros = Sent()
    servo = Servo(ros, "PSM1")  # type: ignore[arg-type]
    servo.follow(command(1, 0.3, 0.5), withheld=False)
    for ms in range(2, 1200):
        servo.follow(command(ms), withheld=True)
    assert servo.is_over
    servo.follow(command(1200), withheld=False)
    close_all([servo])
    ros.assert_held("PSM1/servo_jp", "PSM1/jaw/servo_jp")
    assert len(ros.topics["PSM1/servo_jp"]) == len(ros.topics["PSM1/jaw/servo_jp"]) == 2


def test_an_arm_whose_writer_raises_keeps_no_other_from_being_held(monkeypatch: pytest.MonkeyPatch) -> None:
    ros = Sent(PSM1__servo_jp=[OSError] * 9)
    monkeypatch.setattr("trocar.crtk.arms.Ros", lambda domain: ros)
    arms = CrtkArms(["PSM1", "PSM2"], say=lambda line: None)
    arms.exchange([command(1, 0.3, 0.5)] * 2)
    with pytest.raises(OSError):
        arms.exchange([command(2, 0.4, 0.5)] * 2)
    with pytest.raises(OSError):
        arms.close()
    held = "PSM1/jaw/servo_jp", "PSM2/servo_jp", "PSM2/jaw/servo_jp"
    ros.assert_held(*held)
    # Nothing is waited for before.
    assert ros.waited == [{"PSM1/servo_jp": 1} | dict.fromkeys(held, 2)] * 4


@pytest.mark.parametrize("interruptions", [1, 2])
@pytest.mark.parametrize("topic", ["servo_jp", "jaw__servo_jp"])
def test_an_interruption_leaves_no_velocity_behind(topic: str, interruptions: int) -> None:
    ros = Sent(**{f"PSM1__{topic}": [KeyboardInterrupt] * interruptions})
    servo = Servo(ros, "PSM1")  # type: ignore[arg-type]
    servo.follow(command(1, 0.3, 0.5), withheld=False)
    # Between joints and jaw, or before both: what was to be sent may be without velocity already.
    with pytest.raises(KeyboardInterrupt):
        servo.follow(command(2, 0.3, 0.0 if topic == "servo_jp" else 0.5), withheld=False)
    with pytest.raises(KeyboardInterrupt) if interruptions == 2 else contextlib.nullcontext():
        close_all([servo])
    ros.assert_held("PSM1/servo_jp", "PSM1/jaw/servo_jp")


def measured(*messages: JointState) -> tuple[Measured, list[str]]:
    """After a look at each of `messages`; and what was said."""
    said: list[str] = []
    left = list(messages)
    ros = SimpleNamespace(reader=lambda topic, message: SimpleNamespace(topic=topic, newest=lambda: left.pop(0)))
    found = Measured(ros, "PSM1/measured_js", 6, Unused(said.append))  # type: ignore[arg-type]
    for look in range(len(messages)):
        found.look(look)
    return found, said


def test_a_stamp_that_goes_back_is_not_used() -> None:
    stamps = [5, 7, 6, 7, 4, 8, 7]
    found, said = measured(*(JointState(Header(Time(stamp)), [], [0.1 * stamp] * 6, [0.0] * 6, [0.0] * 6) for stamp in stamps))
    assert found.newest is not None and found.newest.stamp_ns == 5 and found.newest.position[0] == 0.8
    assert ["goes back" in line for line in said] == [True, False] and "that of the message before" in said[1]


def test_what_a_simulator_lacks_is_said_once() -> None:
    found, said = measured(*(JointState(Header(Time(stamp)), [], [0.1] * 6) for stamp in (0, 1, 2, 3)))
    assert found.newest is None and len(said) == 3
    assert "stamp is zero" in said[0] and "has no effort" in said[1] and "velocity has 0 entries, expected 6" in said[2]
    found, said = measured(*(JointState(Header(Time(stamp)), [], [0.1] * 6, [0.0] * 6) for stamp in (1, 2, 3)))
    assert found.newest is not None and len(said) == 1 and "has no effort" in said[0]


def test_a_fault_stays_until_its_run_is_over() -> None:
    latch = Latch()
    assert not latch.update(None, 0, run_over=True) and latch.fault is None
    assert latch.update(Fault.PAUSED, 1, run_over=False) and latch.fault is Fault.PAUSED
    # What comes first is what ended the run.
    assert not latch.update(Fault.FAULT, 2, run_over=True) and latch.fault is Fault.PAUSED
    assert not latch.update(None, 1 + FAULT_NS_MIN, run_over=True) and latch.fault is Fault.PAUSED
    assert not latch.update(None, 2 + FAULT_NS_MIN, run_over=False) and latch.fault is Fault.PAUSED
    assert latch.update(None, 2 + FAULT_NS_MIN, run_over=True) and latch.fault is None


@pytest.mark.parametrize(
    ("state", "homed", "fault"),
    [
        ("ENABLED", True, None),
        ("ENABLED", False, Fault.NOT_HOMED),
        ("DISABLED", True, Fault.DISABLED),
        ("PAUSED", True, Fault.PAUSED),
        ("FAULT", False, Fault.FAULT),
        ("HOMING", True, Fault.UNKNOWN),
    ],
)
def test_operating_states_have_faults(state: str, homed: bool, fault: Fault | None) -> None:
    assert fault_of(OperatingState(state=state, is_homed=homed)) is fault


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (JointState(Header(), [], [0.0] * 6, [0.0] * 6), "stamp is zero"),
        (JointState(Header(Time(1)), [], [0.0] * 7, [0.0] * 6), "position has 7 entries, expected 6"),
        (JointState(Header(Time(1)), [], [0.0] * 6, []), "velocity has 0 entries"),
        (JointState(Header(Time(1)), ["yaw"], [0.0] * 6, [0.0] * 6), "name has 1 entries"),
        (JointState(Header(Time(1)), [], [0.0] * 6, [0.0] * 6, [0.0]), "effort has 1 entries"),
        (JointState(Header(Time(1)), [], [0.0] * 6, [float("nan")] * 6), "velocity is not finite"),
    ],
)
def test_joint_states_that_cannot_be_used(message: JointState, said: str) -> None:
    with pytest.raises(UnusableError, match=said):
        joints_of(message, 6, 0)


@pytest.mark.parametrize("text", ["233", "-1", "one"])
def test_a_domain_that_ros_does_not_have_is_refused(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(RosError, match="ROS_DOMAIN_ID.*0 to 232"):
        domain_id()


@pytest.fixture
def handlers() -> Iterator[None]:
    """What handles signals is afterwards what it was before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("arguments", "said"), [(["PSM1", "PSM1"], "different"), (["PSM-1"], "no ROS name")])
@pytest.mark.usefixtures("handlers")
def test_arms_that_cannot_be_named(arguments: list[str], said: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["arms", *arguments]) == 1
    assert said in capfd.readouterr().err


@pytest.mark.usefixtures("handlers")
def test_a_second_signal_interrupts_and_a_third_does_not() -> None:
    ending = _ending()
    signal.raise_signal(signal.SIGINT)
    assert ending.is_set()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_a_frame_is_read_as_it_was_published(name: str) -> None:
    camera, reader = trocar.CameraPublisher("endoscope", name), Node(name).camera("endoscope")
    colour, depth_m = noise(16, 24), np.linspace(0.05, 0.2, 16 * 24, dtype=np.float32).reshape(16, 24)
    instance = noise(16, 24)[:, :, 0]
    for sequence, planes in enumerate([{}, {"depth_m": depth_m, "instance": instance}, {}], 1):
        camera.publish(colour, stamp_ns=7 * sequence, intrinsics=(30, 31, 12, 8), distortion=(0.1, 0.2, 0.3, 0.4), **planes)
        assert reader.look() and reader.header is not None
        header, (seen, seen_depth, seen_instance) = reader.header, reader.planes()
        assert seen.tobytes() == colour.tobytes()
        np.testing.assert_array_equal(seen_depth, planes.get("depth_m", np.zeros((16, 24))))
        np.testing.assert_array_equal(seen_instance, planes.get("instance", np.zeros((16, 24))))
        lens = header.intrinsics
        assert (header.stamp, header.sequence) == (7 * sequence, sequence)
        assert (lens.width, lens.height, lens.fy, lens.distortion.p2) == (24, 16, 31, 0.4)
        assert list(header.position_m) == [0, 0, 0] and list(header.rotation_xyzw) == [0, 0, 0, 1]


def test_frames_of_another_shape_and_second_publishers_are_refused(name: str) -> None:
    camera = trocar.CameraPublisher("endoscope", name)
    camera.publish(noise(16, 24))
    with pytest.raises(TopicError, match="24x32 pixels after those of 24x16"):
        camera.publish(noise(32, 24))
    with pytest.raises(TopicError, match=r"colour of shape \(16, 24\)"):
        camera.publish(noise(16, 24)[:, :, 0])
    with pytest.raises(TopicError, match=r"plane of shape \(24, 16\)"):
        camera.publish(noise(16, 24), depth_m=np.zeros((24, 16), np.float32))
    with pytest.raises(TopicError, match="2 numbers of a lens"):
        camera.publish(noise(16, 24), intrinsics=(1, 2))
    # What was refused is in nobody's way.
    camera.publish(noise(16, 24))
    with pytest.raises(TopicError, match="does another process publish it"):
        trocar.CameraPublisher("endoscope", name).publish(noise(16, 24))


def image_of(colour: np.ndarray, encoding: str, padding: int = 0) -> Image:
    channels = {"rgb8": colour, "bgr8": colour[:, :, ::-1], "mono8": colour[:, :, :1]}
    alpha = np.full((*colour.shape[:2], 1), 9, np.uint8)
    channels |= {f"{order}a8": np.concatenate([channels[f"{order}8"], alpha], 2) for order in ("rgb", "bgr")}
    rows = channels[encoding].reshape(colour.shape[0], -1)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return Image(Header(Time.of(time.time_ns())), *colour.shape[:2], encoding, 0, data.shape[1], data.tobytes())


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8"])
@pytest.mark.parametrize("padding", [0, 3])
def test_encodings_are_red_green_and_blue(encoding: str, padding: int) -> None:
    colour = noise(4, 6)
    expected = np.repeat(colour[:, :, :1], 3, 2) if encoding == "mono8" else colour
    np.testing.assert_array_equal(colour_of(image_of(colour, encoding, padding)), expected)


def test_images_that_cannot_be_told_are_refused() -> None:
    image = image_of(noise(4, 6), "rgb8")
    for encoding in ("8UC3", "16UC1", "yuv422_yuy2", "bayer_rggb8", ""):
        with pytest.raises(UnusableError, match="allowed are rgb8"):
            colour_of(dataclasses.replace(image, encoding=encoding))
    with pytest.raises(UnusableError, match="6x4 pixels of 4 bytes in rows of 18 bytes"):
        colour_of(dataclasses.replace(image, encoding="rgba8"))
    with pytest.raises(UnusableError, match="with 71 bytes"):
        colour_of(dataclasses.replace(image, data=image.data[1:]))


def info_of(width: int, height: int, *coefficients: float, model: str = "plumb_bob") -> CameraInfo:
    k = [300.0, 0.0, 5.5, 0.0, 310.0, 3.5, 0.0, 0.0, 1.0]
    return CameraInfo(Header(Time(1)), height, width, model, list(coefficients), k)


def test_lenses_are_of_pixels_whose_centres_lie_at_halves() -> None:
    assert lens_of(info_of(12, 8)) == (Lens((300, 310, 6, 4)), None)
    assert lens_of(info_of(12, 8, 0.1, 0.2, 0.3, 0.4, 0.0)) == (Lens((300, 310, 6, 4), (0.1, 0.2, 0.3, 0.4)), None)
    lens, lost = lens_of(info_of(12, 8, 0.1, 0.2, 0.3, 0.4, 0.5))
    assert lens.distortion == (0.1, 0.2, 0.3, 0.4) and lost is not None and "k3" in lost
    lens, lost = lens_of(info_of(12, 8, 0.1, 0.2, 0.3, 0.4, model="equidistant"))
    assert not any(lens.distortion) and lost is not None and "equidistant" in lost
    assert lens_of(CameraInfo()) == (Lens(), "it is not calibrated")


def test_frames_are_means_of_the_middle_and_keep_their_lens() -> None:
    colour, lens = np.zeros((9, 14, 3), np.uint8), Lens((300, 310, 7, 4.5))
    colour[:4, 1:3] = 10
    colour[0, 1] = 13
    small, fitted_lens = fitted(colour, lens, Size(6, 4))
    assert small.shape == (4, 6, 3) and small[0, 0].tolist() == [11] * 3 and small[1, 0].tolist() == [10] * 3 and not small[:, 1:].any()
    # The middle of 14x9 begins at column 1, row 0.
    assert fitted_lens.intrinsics == (150, 155, 3, 2.25)
    with pytest.raises(UnusableError, match="at least 15x4"):
        fitted(colour, lens, Size(15, 4))
    with pytest.raises(RosError, match="512x512"):
        Size.parse("big")


def test_stamps_of_this_machines_clock_are_kept() -> None:
    now = time.time_ns()
    assert abs(trocar.now_ns() - exposure_ns(Header(Time.of(now - 10**8))) - 10**8) < 5 * 10**7
    for other in (0, now - 2 * 10**9, now + 10**9):
        assert abs(trocar.now_ns() - exposure_ns(Header(Time.of(other)))) < 5 * 10**7


def test_cameras_are_named_with_their_topics() -> None:
    assert cameras_of(["left=/ECM/left/image_raw", "right=/ECM/right/image_raw"])["right"] == "/ECM/right/image_raw"
    for texts in (["left"], ["=/a"], ["left="], ["left=/a", "left=/b"]):
        with pytest.raises(RosError):
            cameras_of(texts)


def test_a_ros_image_becomes_a_frame(name: str, start: Callable[..., Process]) -> None:
    ros, reader = Ros(), Node(name).camera("endoscope")
    images, infos = ros.writer("ECM/left/image_raw", Image), ros.writer("ECM/left/camera_info", CameraInfo)
    showing = start("-m", "trocar.crtk", "cameras", "endoscope=/ECM/left/image_raw", "--topics", name, "--size", "6x4")
    showing.said("waiting for /ECM/left/image_raw")
    colour = noise(8, 12)

    def shown() -> Any:
        images.publish(image_of(colour, "bgr8") if not refused else dataclasses.replace(image_of(colour, "bgr8"), encoding="8UC3"))
        infos.publish(info_of(12, 8))
        return reader.look() and reader.header is not None and reader.header.intrinsics.fx

    refused = False
    assert until(shown) == 150
    assert reader.header is not None and 0 <= time.monotonic_ns() // SLOW_MOTION - reader.header.stamp < 10**9
    means = colour.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.abs(reader.planes()[0] - means).max() <= 0.5
    refused = True
    until(lambda: [shown(), any("8UC3" in line for line in showing.lines)][1])
    assert showing.end(signal.SIGINT) == 0
    assert any("camera endoscope: 6x4 pixels of /ECM/left/image_raw" in line for line in showing.lines)


def test_a_runs_arms_are_published_as_crtk(name: str, start: Callable[..., Process]) -> None:
    node, ros = Node(arms_of(name)), Ros()
    feedback, setpoints = node.publisher(ArmFeedback, "psm1"), node.publisher(ArmSetpoint, "psm1")
    topics = ("measured_js", "jaw/measured_js", "setpoint_js", "jaw/setpoint_js")
    readers = {topic: ros.reader(f"PSM3/{topic}", JointState) for topic in topics}
    publishing = start("-m", "trocar.crtk", "state", "--topics", name, "--as", "PSM3")
    publishing.said("publishing PSM3")
    numbers = [0.1 * axis for axis in range(6)]
    found: dict[str, Any] = {}

    def seen(*topics: str, enabled: int) -> bool:
        stamp = time.monotonic_ns() // SLOW_MOTION
        feedback.publish(ArmFeedback(stamp=stamp, position=tuple(numbers), effort=(2.0,) * 6, jaw_position=0.4, jaw_effort=-0.1))
        setpoints.publish(ArmSetpoint(stamp=stamp, position=tuple(numbers), velocity=(0.3,) * 6, jaw_position=0.5, enabled=enabled))
        for topic, reader in readers.items():
            if message := reader.newest():
                found[topic] = message
        return all(topic in found for topic in topics)

    until(lambda: seen("measured_js", "jaw/measured_js", enabled=0))
    assert found["measured_js"].position == numbers and found["measured_js"].effort == [2.0] * 6
    assert found["measured_js"].name == ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    assert abs(time.time_ns() - found["measured_js"].header.stamp.ns) < 10**9
    assert (found["jaw/measured_js"].position, found["jaw/measured_js"].effort) == ([0.4], [-0.1])
    assert "setpoint_js" not in found
    until(lambda: seen("setpoint_js", "jaw/setpoint_js", enabled=1))
    assert found["setpoint_js"].velocity == [0.3] * 6 and found["jaw/setpoint_js"].position == [0.5]
    assert publishing.end(signal.SIGINT) == 0
    # A dVRK of that name would be published twice.
    other = ros.writer("PSM3/measured_js", JointState)
    refused = start("-m", "trocar.crtk", "state", "--topics", name, "--as", "PSM3")
    assert f"/{other.topic} is published by" in refused.said("already")
    assert refused.end() == 1
