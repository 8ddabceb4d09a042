"""Policies in this process, sessions of the program beside it."""

from __future__ import annotations

import ctypes
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import iceoryx2 as iox2
import numpy as np
import pytest
import trocar
from conftest import PATIENT, SLOW_MOTION, short
from trocar import messages
from trocar.topics import Node


class Wander:
    """Moves each tip by a random walk that hangs on the seed."""

    def __init__(self) -> None:
        self.seeds: list[int] = []

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        self.random = np.random.default_rng(seed)

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        answer = []
        for arm in observation.arms:
            steps = np.cumsum(self.random.uniform(-5e-4, 5e-4, (10, 3)), axis=0)
            rows = np.zeros((10, trocar.RELATIVE))
            rows[:, :3], rows[:, 6] = steps, arm.jaw
            answer.append(rows)
        return answer


class Holds:
    """Holds each arm, and keeps what it is shown."""

    def __init__(self) -> None:
        self.asked: list[int] = []
        self.shown: list[int] = []
        self.last: trocar.Observation | None = None

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        self.asked.append(observation.step)
        self.look(observation)
        return [np.repeat(arm.here[None], 25, axis=0) for arm in observation.arms]

    def observe(self, observation: trocar.Observation) -> None:
        self.shown.append(observation.step)
        self.look(observation)

    def look(self, observation: trocar.Observation) -> None:
        self.last = observation


def evaluation(name: str, *more: str, task: str = "needle-lift", trials: int = 2) -> list[str]:
    policy = ["--policy", f"external:{name}", *PATIENT]
    return ["eval", "--task", task, *policy, "--trials", str(trials), "--json", "-", *short(), *more]


def hashes(out: str) -> list[str]:
    return [episode["command_hash"] for episode in json.loads(out)["episodes"]]


def test_two_evaluations_have_the_same_command_hashes(name: str, session: Callable[..., Any]) -> None:
    seen = []
    for _ in range(2):
        running = session(*evaluation(name))
        policy = Wander()
        assert trocar.serve(policy, name, query_every=5, sessions=1) == 1
        code, out, err = running.end()
        assert code == 0, err
        assert policy.seeds == [1_000_000, 1_000_001]
        seen.append(hashes(out))
    assert seen[0] == seen[1]
    assert seen[0][0] != seen[0][1]


def test_one_server_serves_one_session_after_another(name: str, session: Callable[..., Any]) -> None:
    ends: list[tuple[int, str, str]] = []

    def two() -> None:
        for _ in range(2):
            ends.append(session(*evaluation(name, trials=1)).end())

    sessions = threading.Thread(target=two)
    sessions.start()
    assert trocar.serve(Wander(), name, query_every=5, sessions=2) == 2
    sessions.join()
    assert [code for code, _, _ in ends] == [0, 0], ends
    assert hashes(ends[0][1]) == hashes(ends[1][1])


def test_frames_are_read_only_views_of_the_wanted_cameras(name: str, session: Callable[..., Any], tmp_path: Path) -> None:
    class Looks(Holds):
        def look(self, observation: trocar.Observation) -> None:
            super().look(observation)
            frame = observation.frames["endoscope"]
            assert list(observation.frames) == ["endoscope", "wrist"]
            assert frame.colour.shape == (512, 512, 3) and frame.colour.dtype == np.uint8
            assert frame.depth_m.shape == frame.instance.shape == (512, 512)
            assert not (frame.colour.flags.writeable or frame.depth_m.flags.writeable or frame.instance.flags.writeable)
            assert frame.colour.base is not None
            assert frame.stamp_ns == observation.stamp_ns
            # The organ fills the picture, a hand's breadth or two away.
            assert frame.colour.std() > 5 and 0.05 < np.median(frame.depth_m) < 0.5
            assert frame.instance.max() > 0
            assert not np.array_equal(frame.colour, observation.frames["wrist"].colour)

    policy = Looks()
    running = session(*evaluation(name, "--set", "scene.rendering.shading=plain", trials=1))
    assert trocar.serve(policy, name, cameras=["endoscope", "wrist"], query_every=10, history=2, sessions=1) == 1
    code, _, err = running.end()
    assert code == 0, err
    assert policy.asked == [0, 10, 20]
    assert policy.shown == [8, 9, 18, 19]


def test_two_arms_are_commanded_together(name: str, session: Callable[..., Any]) -> None:
    policy = Wander()
    running = session(*evaluation(name, task="needle-handover", trials=1))
    assert trocar.serve(policy, name, query_every=5, arms=2, sessions=1) == 1
    code, out, err = running.end()
    assert code == 0, err
    assert len(hashes(out)) == 1


def test_each_job_has_a_policy_of_its_own(name: str, session: Callable[..., Any], beside: Callable[..., Any]) -> None:
    serve = """
        import numpy as np, trocar
        class Holds:
            def infer(self, observation):
                return [np.repeat(arm.here[None], 25, axis=0) for arm in observation.arms]
        trocar.serve(Holds(), "{name}", query_every=10, sessions=1)
    """
    alone = session(*evaluation(name, trials=3))
    beside(serve.format(name=name))
    code, out, err = alone.end()
    assert code == 0, err
    jobs = session(*evaluation(name, "--jobs", "2", trials=3))
    for job in (1, 2):
        beside(serve.format(name=f"{name}-{job}"))
    code, both, err = jobs.end()
    assert code == 0, err
    assert hashes(both) == hashes(out)


@pytest.mark.parametrize("told", ["grasp the needle and lift it by 20 mm ✓", None], ids=["told", "untold"])
def test_a_policy_is_told_what_to_do(told: str | None, name: str, session: Callable[..., Any]) -> None:
    policy = Holds()
    running = session(*evaluation(name, *(["--instruction", told] if told else []), trials=1))
    assert trocar.serve(policy, name, query_every=10, sessions=1) == 1
    code, _, err = running.end()
    assert code == 0, err
    assert policy.last is not None and policy.last.instruction == (told or "needle-lift")


@pytest.mark.parametrize(
    ("policy", "text", "said"),
    [("expert", "lift", "only external policies read one"), ("external", "é" * 125, "250 bytes of text: allowed are 1 to 248")],
    ids=["no reader", "too long"],
)
def test_an_instruction_that_nobody_can_read_is_bad_usage(
    policy: str, text: str, said: str, session: Callable[..., Any]
) -> None:
    code, _, err = session("eval", "--task", "needle-lift", "--policy", policy, "--instruction", text).end()
    assert code == 2 and said in err


class Late:
    """Raises the tip from where it was at the observation, and says so only after a while."""

    def __init__(self, relative: bool, seconds: float) -> None:
        self.relative, self.seconds = relative, seconds
        self.tips: list[np.ndarray] = []

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        time.sleep(self.seconds)
        (arm,) = observation.arms
        self.tips.append(arm.tip)
        rise = 0.0005 * np.arange(100)
        if self.relative:
            rows = np.zeros((100, trocar.RELATIVE))
            rows[:, 2], rows[:, 6] = rise, arm.jaw
            return [rows]
        rows = np.repeat(arm.here[None], 100, axis=0)
        rows[:, 2] += rise
        return [rows]


def test_late_answers_mean_the_same_relative_or_absolute(name: str, session: Callable[..., Any]) -> None:
    """Relative to the tip as it was observed, wherever it is by the time the answer comes."""
    seen = []
    for relative in (True, False):
        newest = ["--set", "control.aggregation.mode=newest", "--latency-ms", "400"]
        running = session(*evaluation(name, *newest, trials=1))
        policy = Late(relative, seconds=0.0)
        assert trocar.serve(policy, name, query_every=15, sessions=1) == 1
        code, out, err = running.end()
        assert code == 0, err
        assert len(policy.tips) == 2 and policy.tips[1][2] > policy.tips[0][2] + 1e-3
        seen.append(hashes(out))
    assert seen[0] == seen[1]


class Chunked(Late):
    """As real-time chunking has it: what will be past or under way when the answer comes stays as it was, and the rest joins there."""

    #: Rows kept: 400 ms of delay.
    KEPT = 10

    def __init__(self) -> None:
        super().__init__(relative=False, seconds=0.0)
        self.left_over: list[int] = []
        self.answers: list[np.ndarray] = []

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        (rows,), (left,) = super().infer(observation), observation.left_over
        self.left_over.append(len(left))
        kept = left[: self.KEPT]
        if len(kept):
            rows[:, :3] += kept[-1, :3] + [0, 0, 0.0005] - rows[len(kept), :3]
            rows[: len(kept)] = kept
        self.answers.append(rows)
        return [rows]


def test_chunks_may_overlap_as_real_time_chunking_has_it(name: str, session: Callable[..., Any]) -> None:
    newest = ["--set", "control.aggregation.mode=newest", "--latency-ms", "400"]
    running = session("run", "--task", "needle-lift", "--lockstep", "--policy", f"external:{name}", *PATIENT, *newest, *short(3.0))
    policy = Chunked()
    assert trocar.serve(policy, name, query_every=15, sessions=1) == 1
    _, _, err = running.end()
    assert policy.left_over[0] == 0 and set(policy.left_over[1:]) == {85}, err
    # At no change of chunks does what is wanted leap: rows rise by half a millimetre each.
    assert len(policy.answers) >= 4
    for before, after in zip(policy.answers, policy.answers[1:]):
        assert np.array_equal(after[: Chunked.KEPT], before[15 : 15 + Chunked.KEPT])
        assert np.allclose(np.diff(after[:, 2]), 0.0005)


class Rises:
    """Answers once with where the tip is and half a millimetre above each row's predecessor."""

    ROWS = 60

    def __init__(self) -> None:
        self.answers: list[np.ndarray] = []
        self.left_over: list[np.ndarray] = []

    def infer(self, observation: trocar.Observation) -> np.ndarray:
        self.left_over.append(observation.left_over[0])
        rows = np.repeat(observation.arms[0].here[None], self.ROWS, axis=0)
        rows[:, 2] += 0.0005 * np.arange(self.ROWS)
        self.answers.append(rows)
        return rows


@pytest.mark.parametrize("fps", [25, 15, 10])
def test_rows_are_due_at_the_rate_that_they_are_served_with(
    fps: int, name: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    delay = [*PATIENT, "--latency-ms", "0", "--log", str(log)]
    running = session("run", "--task", "needle-lift", "--lockstep", "--policy", f"external:{name}", *delay, *short(2.0))
    policy = Rises()
    assert trocar.serve(policy, name, query_every=50, step_ns=1_000_000_000 // fps, sessions=1) == 1
    _, _, err = running.end()
    assert len(policy.answers) == 1, err
    tables = trocar.read_log(log, ["/policy/chunk", "/psm1/measured_cp"])
    assert list(tables["/policy/chunk"]["step_ns"]) == [1_000_000_000 // fps]
    height = tables["/psm1/measured_cp"]["z"].to_numpy()
    # Once it is under way, and before the end: metres a second of the 1 kHz record.
    speed = (height[1800] - height[1000]) / 0.8
    assert speed == pytest.approx(0.0005 * fps, rel=0.02)


def test_what_is_left_over_is_due_at_the_policys_own_rate(name: str, session: Callable[..., Any]) -> None:
    """At 15 rows a second a query each 160 ms comes at row 2.4 of the answer before."""
    running = session("run", "--task", "needle-lift", "--lockstep", "--policy", f"external:{name}", *PATIENT, *short(1.0))
    policy = Rises()
    assert trocar.serve(policy, name, query_every=4, step_ns=1_000_000_000 // 15, sessions=1) == 1
    _, _, err = running.end()
    assert len(policy.left_over[0]) == 0 and len(policy.answers) >= 5, err
    for rows, left in zip(policy.answers, policy.left_over[1:]):
        assert left.shape == (Rises.ROWS - 3, 8)
        np.testing.assert_allclose(left[:, 2] - rows[0, 2], 0.0005 * (2.4 + np.arange(len(left))), atol=1e-9)
        np.testing.assert_allclose(left[:, 3:], rows[3:, 3:], atol=1e-12)


@pytest.mark.clock
@pytest.mark.parametrize("relative", [True, False], ids=["relative", "absolute"])
def test_a_policy_may_answer_late_in_real_time(
    relative: bool, name: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    result = tmp_path / "run.json"
    newest = ["--set", "control.aggregation.mode=newest", "--json", str(result)]
    running = session("run", "--task", "needle-lift", "--policy", f"external:{name}", *newest, *short(3.0))
    policy = Late(relative, seconds=0.4 * SLOW_MOTION)
    assert trocar.serve(policy, name, query_every=25, sessions=1) == 1
    code, _, err = running.end()
    summary = json.loads(result.read_text())["policy"]
    assert code == 1 and summary["queries"] >= 2 and summary["refused"] == 0, err
    assert summary["latency_ms"]["p50"] >= 400
    heights = [tip[2] for tip in policy.tips]
    # The rows that were due while it thought are left out: the tip does not wait for the first.
    assert heights == sorted(heights) and heights[-1] > heights[0] + 1e-3


class Fails:
    def __init__(self, answer: Callable[[list[np.ndarray]], Any]) -> None:
        self.answer = answer

    def infer(self, observation: trocar.Observation) -> Any:
        return self.answer([np.repeat(arm.here[None], 3, axis=0) for arm in observation.arms])


def nan(arms: list[np.ndarray]) -> list[np.ndarray]:
    arms[0][1, 2] = np.nan
    return arms


def boom(arms: list[np.ndarray]) -> list[np.ndarray]:
    raise RuntimeError("the weights are gone")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (nan, "arm 0, step 1: number 2 of the answer is nan"),
        (lambda arms: [np.repeat(arms[0][:1], 200, axis=0)], "200 steps: allowed are 1 to 128"),
        (lambda arms: arms * 2, "arrays for 2 arms, there are 1"),
        (lambda arms: None, "the answer is None"),
        (boom, "RuntimeError: the weights are gone"),
    ],
    ids=["nan", "too many steps", "too many arms", "none", "exception"],
)
def test_a_policy_that_fails_ends_the_session_by_name(
    answer: Callable[..., Any], said: str, name: str, session: Callable[..., Any]
) -> None:
    running = session(*evaluation(name))
    with pytest.raises((trocar.PolicyError, RuntimeError)):
        trocar.serve(Fails(answer), name)
    code, _, err = running.end()
    assert code == 1
    assert said in err and f'external policy "{name}"' in err and "Fails" in err


@pytest.mark.clock
@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("time.sleep(600)", "has not answered the observation of step 0 for 10 s"),
        ("os._exit(3)", "ended"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "ended"),
    ],
    ids=["sleeps", "exits", "killed"],
)
def test_a_policy_that_hangs_or_dies_is_named(
    does: str, said: str, name: str, session: Callable[..., Any], beside: Callable[..., Any]
) -> None:
    policy = ["--policy", f"external:{name}", "--policy-timeout", "10"]
    running = session("eval", "--task", "needle-lift", *policy, *short())
    beside(
        f"""
        import os, signal, time, trocar
        class Gone:
            def infer(self, observation):
                {does}
        trocar.serve(Gone(), "{name}")
        """
    )
    code, _, err = running.end()
    assert code == 1
    assert said in err and f'external policy "{name}"' in err


@pytest.mark.clock
def test_a_policy_that_does_not_appear_is_named(name: str, session: Callable[..., Any]) -> None:
    running = session("run", "--task", "needle-lift", "--lockstep", "--policy", f"external:{name}", "--policy-timeout", "1")
    code, _, err = running.end()
    assert code == 1
    assert f'external policy "{name}": has not appeared for 1 s' in err
    assert f'waits for an external policy on topics "{name}"' in err


def test_another_version_of_a_message_is_refused_by_name(name: str, session: Callable[..., Any]) -> None:
    class Chunk2(messages.Chunk):
        NAME = "trocar/chunk/2"

    node = Node(name)
    other = node.publisher(Chunk2, "psm1")
    hello = node.publisher(messages.PolicyHello, "psm1")
    hello.publish(messages.PolicyHello(query_every_steps=1))
    running = session(*evaluation(name))
    while running.process.poll() is None:
        hello.keep_alive()
    code, _, err = running.end()
    assert code == 1
    assert f"'trocar/{name}/psm1/chunk' carries another type" in err
    with pytest.raises(trocar.TopicError, match="psm1/chunk' carries another type"):
        node.subscriber(messages.Chunk, "psm1")
    del other


@pytest.mark.parametrize(
    ("wish", "code", "said"),
    [
        ({"arms": 2}, 2, "commands 2 arms, there are 1"),
        ({"cameras": ["microscope"]}, 2, "microscope"),
        ({"query_every": 100_000}, 2, "query interval of 100000 steps: allowed are 1 to 10000"),
    ],
    ids=["arms", "camera", "interval"],
)
def test_a_policy_for_something_else_is_refused(
    wish: dict[str, Any], code: int, said: str, name: str, session: Callable[..., Any]
) -> None:
    running = session(*evaluation(name))
    trocar.serve(Holds(), name, sessions=1, **wish)
    found, _, err = running.end()
    assert found == code and said in err


@pytest.mark.parametrize(("task", "warned"), [("needle-lift", True), ("tissue-retraction", False)])
def test_a_checkpoint_by_hand_says_what_task_it_was_trained_on(
    task: str, warned: bool, name: str, session: Callable[..., Any]
) -> None:
    """Nothing refuses it: it may be meant. Who serves it is told."""
    server = session("policy", "--policy", "tissue-retraction/act-small", "--name", name, "--sessions", "1")
    asks = session(*evaluation(name, "--set", "scene.rendering.shading=plain", task=task, trials=1))
    code, _, err = asks.end()
    assert code == 0, err
    said = server.end()[2]
    assert f'task "{task}"' in said
    assert ('; the network was trained on task "tissue-retraction"' in said) == warned, said


def test_a_session_that_is_killed_is_noticed(name: str, session: Callable[..., Any]) -> None:
    running = session(*evaluation(name))

    class Kills(Holds):
        def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
            running.process.kill()
            return super().infer(observation)

    assert trocar.serve(Kills(), name, sessions=1) == 1
    assert running.end()[0] < 0


@pytest.mark.clock
def test_in_real_time_it_takes_the_place_of_the_policy_process(
    name: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    log, result = tmp_path / "run.mcap", tmp_path / "run.json"
    wanted = ["--policy", f"external:{name}", "--log", str(log), "--json", str(result)]
    running = session("run", "--task", "needle-lift", *wanted, "--set", "scene.rendering.shading=plain", *short(3.0))
    policy = Holds()
    assert trocar.serve(policy, name, cameras=["endoscope"], query_every=10, sessions=1) == 1
    code, _, err = running.end()
    summary = json.loads(result.read_text())
    assert code == 1 and "within 3 s" in summary["reason"], err
    assert summary["policy"]["name"] == f"external:{name}"
    assert summary["policy"]["queries"] >= 1 and summary["policy"]["refused"] == 0
    assert policy.asked == sorted(set(policy.asked)) and len({step // 10 for step in policy.asked}) == len(policy.asked)
    replayed = session("replay", str(log)).end()
    assert replayed[0] == 0, replayed


@pytest.mark.clock
def test_in_real_time_who_asks_is_said_to_a_policy_that_listens_late(name: str, session: Callable[..., Any]) -> None:
    """Once a session had heard a policy's hello, it repeated what to do and not who it was: one that missed that waited in vain."""
    running = session("run", "--task", "needle-lift", "--policy", f"external:{name}", "--policy-timeout", "20")
    node = Node(name)
    hello = node.publisher(messages.PolicyHello, "psm1")
    hello.publish(messages.PolicyHello(pid=os.getpid(), query_every_steps=1))
    control = node.subscriber(messages.RunControl, "psm1")
    while control.newest() is None:
        hello.keep_alive()
    sessions = node.subscriber(messages.SessionHello, "psm1")
    while (said := sessions.newest()) is None:
        pass
    assert said.pid == running.process.pid and said.task.text == "needle-lift"


@pytest.mark.clock
def test_a_failure_in_real_time_ends_the_run_by_name(name: str, session: Callable[..., Any]) -> None:
    running = session("run", "--task", "needle-lift", "--policy", f"external:{name}")
    with pytest.raises(RuntimeError):
        trocar.serve(Fails(boom), name)
    code, out, err = running.end()
    assert code == 1
    assert "the weights are gone" in out + err and name in out + err


@pytest.mark.clock
@pytest.mark.parametrize(
    ("does", "said"),
    [("time.sleep(600)", "has sent no heartbeat for"), ("os._exit(3)", "ended")],
    ids=["sleeps", "exits"],
)
def test_a_policy_that_hangs_or_dies_in_real_time_is_named(
    does: str, said: str, name: str, session: Callable[..., Any], beside: Callable[..., Any]
) -> None:
    policy = ["--policy", f"external:{name}", "--policy-timeout", "12"]
    running = session("run", "--task", "needle-lift", *policy, *short(60.0))
    gone = beside(
        f"""
        import os, time, trocar
        class Gone:
            def infer(self, observation):
                {does}
        trocar.serve(Gone(), "{name}")
        """
    )
    code, out, err = running.end()
    assert code == 1
    assert said in out + err and f'"{name}"' in out + err and "Gone" in out + err
    assert gone.poll() is None or "exit" in does


def test_a_name_that_is_none_is_bad_usage(session: Callable[..., Any]) -> None:
    code, _, err = session("eval", "--task", "needle-lift", "--policy", "external:a/b").end()
    assert code == 2 and "'a/b' cannot name a topic" in err


def test_what_gets_past_the_package_is_refused_by_the_gate(name: str, session: Callable[..., Any]) -> None:
    policy = ["--policy", f"external:{name}", *PATIENT]
    running = session("run", "--task", "needle-lift", "--lockstep", *policy, "--json", "-", *short())
    peer = trocar.Peer(name, query_every=5)
    while not isinstance(event := peer.wait(), trocar.Ended):
        if isinstance(event, trocar.Begins):
            peer.ready()
        elif isinstance(event, trocar.Asked):
            peer.answer([np.full((3, trocar.ABSOLUTE), np.nan)])
    code, out, err = running.end()
    summary = json.loads(out)
    assert code == 1 and "within 1 s" in summary["reason"], err
    assert summary["policy"]["refused"] == summary["policy"]["queries"] == 5


def mapped_from(address: int) -> str:
    """The file that the memory at `address` is mapped from."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, *_, file = line.split(maxsplit=5)
        first, last = (int(part, 16) for part in span.split("-"))
        if first <= address < last:
            return file
    raise AssertionError(f"nothing is mapped at {address:#x}")


class Camera:
    """A camera of 24 x 16 pixels."""

    pixels = 24 * 16

    def __init__(self, node: Node, camera: str) -> None:
        topic = f"trocar/{node.name}/{camera}/frame"
        service = node._open(topic, iox2.Slice[ctypes.c_float], messages.FrameHeader)
        self.publisher = service.publisher_builder().initial_max_slice_len(2 * self.pixels).create()

    def show(self, stamp: int) -> np.ndarray:
        """Shows noise; the bytes of it."""
        written = np.random.default_rng(3).integers(0, 256, 8 * self.pixels, dtype=np.uint8)
        loan = self.publisher.loan_slice_uninit(2 * self.pixels)
        header = loan.user_header().contents
        header.stamp, header.intrinsics.width, header.intrinsics.height = stamp, 24, 16
        ctypes.memmove(loan.payload_ptr, written.ctypes.data, written.size)
        loan.assume_init().send()
        return written


def test_a_reader_sees_the_writers_bytes_where_they_lie(name: str) -> None:
    """The arrays begin in the sample that the transport hands out, in shared memory: nothing is copied on the way."""
    writer, reader = Node(name), Node(name)
    camera, subscriber = Camera(writer, "endoscope"), reader.camera("endoscope")
    written = camera.show(stamp=7)
    assert subscriber.look() and subscriber.header is not None and subscriber.header.stamp == 7
    colour, depth_m, instance = subscriber.planes()
    begin = subscriber._sample.payload_ptr
    pixels = Camera.pixels
    for plane, offset, size in [(depth_m, 0, 4), (colour, 4 * pixels, 3), (instance, 7 * pixels, 1)]:
        assert plane.__array_interface__["data"] == (begin + offset, True)
        assert plane.tobytes() == written[offset : offset + size * pixels].tobytes()
    assert mapped_from(begin).startswith("/dev/shm/")


@pytest.mark.clock
def test_a_frame_is_seen_with_the_arms_of_its_instant(name: str) -> None:
    """Its arms have been measured twice more by the time that it is drawn."""
    node = Node(name)
    peer = trocar.Peer(name, cameras=["endoscope"])
    hello = node.publisher(messages.SessionHello, "psm1")
    control = node.publisher(messages.RunControl, "psm1")
    state = node.publisher(messages.ArmReport, "psm1")
    camera = Camera(node, "endoscope")
    hello.publish(messages.SessionHello(session=5 << 32, pid=os.getpid(), arm_count=1, step_ns=40_000_000))
    control.publish(messages.RunControl(episode=(5 << 32) + 1, seed=3, code=messages.RUN))
    assert isinstance(peer.wait(5.0), trocar.Begins)
    peer.ready()
    for step in (4, 5, 6):
        state.publish(messages.ArmReport(stamp=40 * step, sequence=step, jaw_position=0.1 * step))
    assert peer.wait(0.1) is None
    camera.show(stamp=40 * 4)
    event = peer.wait(5.0)
    assert isinstance(event, trocar.Asked) and event.observation.step == 4
    assert event.observation.arms[0].jaw == pytest.approx(0.4)
    # One of no instant at which the arms were measured belongs to none.
    camera.show(stamp=40 * 5 + 1)
    assert peer.wait(0.1) is None


@pytest.mark.clock
def test_arms_are_seen_where_no_camera_can_be_drawn(
    name: str, session: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arms' state comes past the cameras: a policy that looks through none needs no renderer."""
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, "/dev/null")
    real_time = ["run", "--task", "needle-lift", "--policy", f"external:{name}", "--json", "-", *short(2.0)]
    policy = Holds()
    running = session(*real_time)
    assert trocar.serve(policy, name, query_every=5, sessions=1) == 1
    code, out, err = running.end()
    assert code == 1 and json.loads(out)["policy"]["refused"] == 0, err
    # A busy machine may make it see a step after the one that was its turn, but no turn twice.
    turns = [step // 5 for step in policy.asked]
    assert len(turns) >= 5 and turns == sorted(set(turns)) and any(step % 5 == 0 for step in policy.asked)
    looks = session(*real_time)
    trocar.serve(Holds(), name, cameras=["endoscope"], sessions=1)
    code, _, err = looks.end()
    assert code == 1 and "no Vulkan device" in err
