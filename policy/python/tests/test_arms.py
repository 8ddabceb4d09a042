"""Arms in this process, a controller of the test's own beside them, and the program's."""

from __future__ import annotations

import ctypes
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trocar
from conftest import SLOW_MOTION
from trocar import messages
from trocar.arms import StopPlayer, arms_of, stop_at
from trocar.messages import ArmFeedback, ArmSetpoint, AxisStop
from trocar.topics import Node, TopicError

pytestmark = pytest.mark.clock

SAFETY = Path(__file__).parents[3] / "config/tasks/needle-lift/safety.toml"
README = Path(__file__).parent.parent / "README.md"

PERIOD_NS = 1_000_000
JAW = 6

#: A stop from 0.2 rad/s: brake, hold the brake, release it. What it takes from the velocity is JERK * RAMP_S * (RAMP_S + HOLD_S).
RAMP_S, HOLD_S = 0.02, 0.01
SPEED = 0.2
JERK = SPEED / (RAMP_S * (RAMP_S + HOLD_S))
STOP_S = 2 * RAMP_S + HOLD_S


def until(condition: Callable[[], Any], within_s: float = 30.0) -> Any:
    """What `condition` gives once it gives something."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.002)
    raise AssertionError(f"it did not come about within {within_s} s")


def moving(stamp: int, at: float = 0.1) -> ArmSetpoint:
    """A set-point of an arm whose axes move at SPEED, each from a place of its own, with the stop from there."""
    setpoint = ArmSetpoint(stamp=stamp, jaw_position=at + JAW, jaw_velocity=SPEED, enabled=1, stop_stamp=stamp, stop_enabled=1)
    for axis in range(JAW + 1):
        if axis < JAW:
            setpoint.position[axis], setpoint.velocity[axis] = at + axis, SPEED
        setpoint.stop[axis] = AxisStop(at + axis, SPEED, 0.0, (RAMP_S, HOLD_S, RAMP_S), (-JERK, 0.0, JERK))
    return setpoint


class Rests:
    """Arms of which each is at once where it is commanded to be; keeps what they were commanded."""

    def __init__(self, count: int = 1) -> None:
        self.positions = [np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.1 * arm]) for arm in range(count)]
        self.jaws = [0.3] * count
        self.asked: list[Sequence[trocar.ArmCommand] | None] = []
        self.fault: tuple[int, int] | None = None
        self.over = threading.Event()

    @property
    def commands(self) -> list[trocar.ArmCommand]:
        """What the first arm was commanded."""
        return [commands[0] for commands in list(self.asked) if commands is not None]

    def exchange(self, commands: Sequence[trocar.ArmCommand] | None) -> list[trocar.ArmState]:
        if self.over.is_set():
            raise KeyboardInterrupt
        self.asked.append(commands)
        states = []
        for arm in range(len(self.positions)):
            velocity, jaw_velocity = np.zeros(6), 0.0
            if commands is not None and commands[arm].enabled:
                self.positions[arm], velocity = commands[arm].position, commands[arm].velocity
                self.jaws[arm], jaw_velocity = commands[arm].jaw_position, commands[arm].jaw_velocity
            states.append(
                trocar.ArmState(self.positions[arm], velocity, np.full(6, 0.5), self.jaws[arm], jaw_velocity, -0.1, fault=self.fault)
            )
        return states


@pytest.fixture
def serving(name: str) -> Iterator[Callable[..., None]]:
    """Serves arms in threads, none of which outlives the test."""
    begun: list[tuple[Rests, threading.Thread, list[int]]] = []

    def start(arms: Rests, **options: Any) -> None:
        periods: list[int] = []
        thread = threading.Thread(target=lambda: periods.append(trocar.serve_arms(arms, name, **options)))
        begun.append((arms, thread, periods))
        thread.start()

    yield start
    for arms, thread, periods in begun:
        arms.over.set()
        thread.join(30.0)
        assert periods == [len(arms.asked)]


class Controller:
    """The controller's end of the topics of one arm."""

    def __init__(self, name: str, arm: str = "psm1") -> None:
        node = Node(arms_of(name))
        self.setpoints = node.publisher(ArmSetpoint, arm)
        self.feedback = node.subscriber(ArmFeedback, arm)

    def measured(self) -> ArmFeedback:
        """The next feedback that comes."""
        self.feedback.newest()
        found = until(self.feedback.newest)
        assert isinstance(found, ArmFeedback)
        return found


@pytest.mark.parametrize(
    ("message", "size", "offsets"),
    [
        # 2 words, 3 times 6 joints, 3 of the jaw, 2 of the fault.
        (ArmFeedback, 8 * (2 + 18 + 3 + 2), {"position": 16, "effort": 112, "jaw_position": 160, "fault": 184, "fault_code": 192}),
        (AxisStop, 8 * 9, {"position": 0, "acceleration": 16, "duration_s": 24, "jerk": 48}),
        # 2 words, 3 times 6 joints, 2 of the jaw, 3 words, 7 stops.
        (ArmSetpoint, 8 * (2 + 18 + 2 + 3) + 7 * 72, {"position": 16, "jaw_position": 160, "enabled": 176, "stop_stamp": 184, "stop": 200}),
    ],
)
def test_messages_lie_as_repr_c_has_them(message: type[messages.Message], size: int, offsets: dict[str, int]) -> None:
    assert ctypes.sizeof(message) == size and ctypes.alignment(message) == 8
    assert {field: getattr(message, field).offset for field in offsets} == offsets


def braking(time_s: float) -> tuple[float, float]:
    """How far a stop from SPEED has led after `time_s`, and the velocity there: the cubics of its three phases."""
    brake = JERK * RAMP_S
    first = SPEED * RAMP_S - JERK * RAMP_S**3 / 6, SPEED - JERK * RAMP_S**2 / 2
    second = first[0] + first[1] * HOLD_S - brake * HOLD_S**2 / 2, first[1] - brake * HOLD_S
    if time_s <= 0.0:
        return 0.0, SPEED
    if time_s <= RAMP_S:
        return SPEED * time_s - JERK * time_s**3 / 6, SPEED - JERK * time_s**2 / 2
    if time_s <= RAMP_S + HOLD_S:
        held = time_s - RAMP_S
        return first[0] + first[1] * held - brake * held**2 / 2, first[1] - brake * held
    # By symmetry: what is left of the last phase, played backwards from rest.
    left = max(STOP_S - time_s, 0.0)
    whole = second[0] + JERK * RAMP_S**3 / 6
    return whole - JERK * left**3 / 6, JERK * left**2 / 2


def test_the_stop_is_three_cubics_and_ends_at_rest() -> None:
    setpoint = moving(stamp=5_000_000_000)
    for ms in (-3.0, 0.0, 7.5, 20.0, 24.0, 30.0, 41.0, 49.9, 50.0, 60.0, 1e6):
        command = stop_at(setpoint, setpoint.stamp + int(1e6 * ms))
        way, speed = braking(1e-3 * ms)
        np.testing.assert_allclose(command.position, 0.1 + np.arange(6) + way, rtol=0, atol=1e-12)
        np.testing.assert_allclose(command.velocity, speed, rtol=0, atol=1e-12)
        assert command.jaw_position == pytest.approx(6.1 + way, abs=1e-12)
        assert command.jaw_velocity == pytest.approx(speed, abs=1e-12)
        assert command.stamp_ns == setpoint.stamp + int(1e6 * ms) and command.enabled
    # As much brake as release: half the speed on average.
    assert command.position[0] == pytest.approx(0.1 + SPEED * STOP_S / 2)
    assert not command.velocity.any() and not command.acceleration.any() and command.jaw_velocity == 0.0


def test_a_phase_that_lasts_less_than_no_time_is_left_out() -> None:
    setpoint = ArmSetpoint(stop_stamp=0)
    setpoint.stop[0] = AxisStop(0.5, 0.1, 0.0, (-1.0, 0.2, -1.0), (9.0, -5.0, 9.0))
    assert stop_at(setpoint, 100_000_000).position[0] == pytest.approx(0.5 + 0.01 - 5 * 0.1**3 / 6)
    assert stop_at(setpoint, 300_000_000).position[0] == pytest.approx(0.5 + 0.02 - 5 * 0.2**3 / 6)


def test_a_player_plays_the_stop_from_the_period_after_the_last_set_point() -> None:
    player = StopPlayer(PERIOD_NS)
    assert player.next_period() is None
    for stamp in (7_000_000, 8_000_000):
        player.write(moving(stamp, at=1e-9 * stamp))
    given = [player.next_period() for _ in range(4)]
    assert [one.stamp_ns for one in given if one] == [8_000_000, 9_000_000, 10_000_000, 11_000_000]
    assert given[0] is not None and given[0].position[0] == 0.008 and given[0].enabled
    assert given[1] is not None and given[1].position[0] == pytest.approx(0.008 + braking(0.001)[0], abs=1e-12)


def test_an_arm_whose_stop_is_disabled_lets_go() -> None:
    player = StopPlayer(PERIOD_NS)
    setpoint = moving(stamp=0)
    setpoint.stop_enabled = 0
    player.write(setpoint)
    first, second = player.next_period(), player.next_period()
    assert first is not None and first.enabled and second is not None and not second.enabled


@pytest.mark.parametrize("place", ["velocity", "jaw", "stop"])
@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_set_point_that_is_not_finite_is_none(place: str, number: float) -> None:
    player = StopPlayer(PERIOD_NS)
    bad = moving(stamp=4_000_000)
    if place == "velocity":
        bad.velocity[5] = number
    elif place == "jaw":
        bad.jaw_position = number
    else:
        bad.stop[JAW].jerk[2] = number
    player.write(bad)
    assert player.next_period() is None
    player.write(moving(stamp=1_000_000))
    player.write(bad)
    given = [player.next_period() for _ in range(2)]
    player.write(bad)
    given.append(player.next_period())
    assert [one.stamp_ns for one in given if one] == [1_000_000, 2_000_000, 3_000_000]


def test_an_arm_is_measured_commanded_and_left_to_its_stop(name: str, serving: Callable[..., None]) -> None:
    arms = Rests()
    before = time.monotonic_ns()
    serving(arms)
    controller = Controller(name)
    first, second = controller.measured(), controller.measured()
    assert before <= first.stamp < second.stamp <= time.monotonic_ns() and first.sequence < second.sequence
    assert list(first.position) == [0.0, 0.0, 0.12, 0.0, 0.0, 0.0] and list(first.effort) == [0.5] * 6
    assert (first.jaw_position, first.jaw_effort, first.fault) == (0.3, -0.1, 0)
    assert set(arms.asked) == {None}

    # However long this takes, no set-point is too old.
    begin_ns = time.monotonic_ns() + 10**9
    sent = [moving(stamp=begin_ns + period * PERIOD_NS, at=1e-3 * SPEED * period) for period in range(30)]
    for last in sent:
        controller.setpoints.publish(last)
        time.sleep(1e-3)
    # The newest set-point comes, and what follows is its stop, period by period, and rest.
    rest_ns = last.stamp + 100 * PERIOD_NS
    until(lambda: arms.commands and arms.commands[-1].stamp_ns > rest_ns)
    # Where it came late, the stop of the one before it was played in its place first.
    taken = max(index for index, command in enumerate(arms.commands) if command.stamp_ns == last.stamp)
    for command in arms.commands[:taken]:
        if command.stamp_ns >= last.stamp:
            stops = [stop_at(one, command.stamp_ns) for one in sent[:-1]]
            assert any(np.array_equal(command.position, stop.position) for stop in stops)
    played = arms.commands[taken:]
    stamps = [command.stamp_ns for command in played]
    assert stamps == [last.stamp + index * PERIOD_NS for index in range(len(played))]
    for command in played:
        expected = stop_at(last, command.stamp_ns)
        np.testing.assert_array_equal(command.position, expected.position)
        np.testing.assert_array_equal(command.velocity, expected.velocity)
        assert (command.jaw_position, command.jaw_velocity) == (expected.jaw_position, expected.jaw_velocity)
        assert command.enabled
    end = np.array(last.position) + SPEED * STOP_S / 2
    np.testing.assert_allclose(controller.measured().position, end, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(controller.measured().velocity, 0.0)

    # What is not finite changes nothing; what is moves the arm again.
    bad = moving(stamp=rest_ns + 10**9)
    bad.position[2] = float("nan")
    controller.setpoints.publish(bad)
    seen = len(arms.asked)
    until(lambda: len(arms.asked) > seen + 50)
    stamps = [command.stamp_ns for command in arms.commands[taken:]]
    assert stamps == [last.stamp + index * PERIOD_NS for index in range(len(stamps))]
    old = moving(stamp=1, at=0.9)
    controller.setpoints.publish(old)
    seen = len(arms.asked)
    until(lambda: len(arms.asked) > seen + 50)
    assert not any(command.position[0] == 0.9 for command in arms.commands), "a set-point of a controller that is gone"
    again = moving(stamp=rest_ns + 2 * 10**9, at=0.7)
    controller.setpoints.publish(again)
    until(lambda: arms.commands[-1].stamp_ns >= again.stamp)
    assert next(one for one in arms.commands if one.stamp_ns == again.stamp).position[0] == 0.7


def test_a_failed_drive_is_published_with_its_axis_and_code(name: str, serving: Callable[..., None]) -> None:
    arms = Rests()
    serving(arms)
    controller = Controller(name)
    assert controller.measured().fault == 0
    arms.fault = (6, 0x8611)
    found = until(lambda: (feedback := controller.measured()).fault and feedback)
    assert (found.fault, found.fault_code) == (7, 0x8611)
    arms.fault = (0, 1)
    assert until(lambda: (feedback := controller.measured()).fault == 1 and feedback).fault_code == 1


def test_an_arm_that_nobody_commands_stays_without_torque_beside_another(name: str, serving: Callable[..., None]) -> None:
    arms = Rests(count=2)
    serving(arms, count=2)
    second = Controller(name, "psm2")
    assert second.measured().position[5] == 0.1
    second.setpoints.publish(moving(stamp=time.monotonic_ns() + 10**8))
    until(lambda: arms.commands)
    (command, other) = until(lambda: arms.asked[-1])
    assert other.enabled and not command.enabled
    assert list(command.position) == [0.0, 0.0, 0.12, 0.0, 0.0, 0.0] and command.jaw_position == 0.3
    assert Controller(name).measured().stamp >= command.stamp_ns - 10**9


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ([], "0 arms were measured, expected 1"),
        ([trocar.ArmState(np.zeros(7), np.zeros(6), np.zeros(6), 0.0)], r"psm1: joints of shape \(7,\)"),
        ([trocar.ArmState(np.zeros(6), np.zeros(6), np.zeros(6), 0.0, fault=(7, 1))], "psm1: fault of axis 7"),
    ],
    ids=["no arm", "seven joints", "no such axis"],
)
def test_what_is_no_measurement_is_named(state: list[trocar.ArmState], said: str, name: str) -> None:
    class Wrong:
        def exchange(self, commands: Sequence[trocar.ArmCommand] | None) -> list[trocar.ArmState]:
            return state

    with pytest.raises(ValueError, match=said):
        trocar.serve_arms(Wrong(), name)


@pytest.mark.parametrize(("option", "number"), [("count", 0), ("count", 3), ("period_s", 0.0), ("period_s", float("nan"))])
def test_options_that_mean_nothing_are_refused(option: str, number: float, name: str) -> None:
    with pytest.raises(ValueError, match=option):
        trocar.serve_arms(Rests(), name, **{option: number})  # type: ignore[arg-type]


def test_periods_that_were_missed_are_left_out(name: str) -> None:
    class Late(Rests):
        def exchange(self, commands: Sequence[trocar.ArmCommand] | None) -> list[trocar.ArmState]:
            if not self.asked:
                time.sleep(0.1)
            return super().exchange(commands)

    # Of 20 periods of 10 ms those that begin at 10 to 90 ms are gone.
    assert 1 <= trocar.serve_arms(Late(), name, period_s=0.01, seconds=0.2) <= 11


def test_only_one_serves_and_ctrl_c_ends_it(name: str, beside: Callable[..., Any]) -> None:
    process = beside(
        f"""
        import numpy as np, signal, trocar
        # Whoever runs this test may ignore Ctrl-C.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        class Still:
            def exchange(self, commands):
                return [trocar.ArmState(np.full(6, 0.25), np.zeros(6), np.zeros(6), 0.5, stamp_ns=7)]
        assert trocar.serve_arms(Still(), "{name}") > 0
        """
    )
    controller = Controller(name)
    feedback = controller.measured()
    assert (list(feedback.position), feedback.jaw_position, feedback.stamp) == ([0.25] * 6, 0.5, 7)
    with pytest.raises(TopicError, match="does another process publish it"):
        trocar.serve_arms(Rests(), name)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60.0)
    assert (process.returncode, err) == (0, "")
    # Its place is free.
    assert trocar.serve_arms(Rests(), name, seconds=0.01) > 0


def test_serving_that_is_ended_plays_the_stops_to_rest(name: str) -> None:
    """Set-points that come after that are not followed."""
    ending, begin_ns = threading.Event(), time.monotonic_ns() + 10**9
    controllers = [Controller(name, arm) for arm in ("psm1", "psm2")]
    last = moving(stamp=begin_ns + 2 * PERIOD_NS)

    class Led(Rests):
        def exchange(self, commands: Sequence[trocar.ArmCommand] | None) -> list[trocar.ArmState]:
            period = len(self.asked)
            if period == 3:
                ending.set()
            for controller in controllers:
                controller.setpoints.publish(last if period == 2 else moving(begin_ns + period * PERIOD_NS, at=0.9))
            return super().exchange(commands)

    arms = Led(count=2)
    periods = trocar.serve_arms(arms, name, count=2, ending=ending)
    assert periods == len(arms.asked) == 4 + round(1e9 * STOP_S / PERIOD_NS)
    for index, commands in enumerate(arms.asked[3:]):
        assert commands is not None and len(commands) == 2
        for command in commands:
            expected = stop_at(last, last.stamp + index * PERIOD_NS)
            np.testing.assert_array_equal(command.position, expected.position)
            assert command.enabled and command.rests == (index == periods - 4)


def test_the_arm_of_the_readme_follows(name: str) -> None:
    text = README.read_text().split("## An arm\n", 1)[1].split("```python\n", 1)[1].split("```", 1)[0]
    code = text.replace('trocar.serve_arms(Follows(), "lab")', f'periods = trocar.serve_arms(Follows(), "{name}", seconds=0.05)')
    assert name in code
    found: dict[str, Any] = {}
    exec(compile(code, README, "exec"), found)
    assert found["periods"] > 0
    arm, stop = found["Follows"](), stop_at(moving(stamp=0), 0)
    assert list(arm.exchange(None)[0].position) == [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
    (state,) = arm.exchange([stop])
    assert state.position is stop.position and state.velocity is stop.velocity and state.jaw_position == stop.jaw_position


def test_a_run_moves_an_arm_and_leaves_it_without_torque(
    name: str, session: Callable[..., Any], serving: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    # By the session's clock, which is slowed down.
    monkeypatch.setattr("trocar.arms._SLOW_MOTION", SLOW_MOTION)
    arms = Rests()
    home = arms.positions[0]
    serving(arms)
    on = ["--backend", "topics", "--topics", name, "--safety", str(SAFETY)]
    code, out, err = session("run", *on, "--policy", "random", "--seconds", "2", "--json", "-").end()
    assert code == 0, err
    summary = json.loads(out)
    assert summary["reason"] == "the 2 s are over" and "success" not in summary, err
    assert summary["ticks"] > 1000 and summary["policy"]["queries"] > 5, out
    enabled = [command for command in arms.commands if command.enabled]
    assert len(enabled) > 500
    assert np.abs(arms.positions[0] - home).max() > 1e-4
    until(lambda: not arms.commands[-1].enabled)
