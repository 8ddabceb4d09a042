"""The same chunks make the same commands, bit for bit: a policy's of the program, served from here, and an environment's own, served from here."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trocar
from conftest import PATIENT, short

STEP_NS = 40_000_000
PLAIN = ["--set", "scene.rendering.shading=plain", "--set", "control.aggregation.mode=newest"]


class Repeats:
    """Answers each observation with the chunks that a log has of it."""

    def __init__(self, log: Path, topics: list[str]) -> None:
        tables = trocar.read_log(log, topics)
        self.chunks = [
            {at: np.array(rows) for at, rows in zip(tables[topic]["observed_at_ns"], tables[topic]["targets"])}
            for topic in topics
        ]
        assert all((tables[topic]["step_ns"] == STEP_NS).all() for topic in topics)
        self.asked: list[int] = []

    @property
    def every(self) -> int:
        """Policy steps from one query to the next."""
        first, second, *_ = self.chunks[0]
        return (second - first) // STEP_NS

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        self.asked.append(observation.stamp_ns)
        # What was still on its way at the end is not in the log, and moves nothing.
        return [chunks.get(observation.stamp_ns, arm.here[None]) for chunks, arm in zip(self.chunks, observation.arms)]


@pytest.mark.parametrize(
    ("task", "policy", "latency_ms", "seconds", "topics"),
    [
        ("needle-lift", "expert", 0, 12.0, ["/policy/chunk"]),
        ("needle-handover", "random", 160, 2.0, ["/policy/chunk", "/policy/chunk/psm2"]),
        ("needle-lift", "needle-lift/act-compact", 160, 2.3, ["/policy/chunk"]),
    ],
    ids=["expert", "two arms", "network"],
)
def test_a_served_policys_chunks_make_the_same_commands(
    task: str,
    policy: str,
    latency_ms: int,
    seconds: float,
    topics: list[str],
    name: str,
    session: Callable[..., Any],
    tmp_path: Path,
) -> None:
    log = tmp_path / "own.mcap"

    def run(policy: str, *more: str) -> Any:
        delay = ["--latency-ms", str(latency_ms), "--seed", "7", "--json", "-"]
        return session("run", "--task", task, "--policy", policy, "--lockstep", *delay, *short(seconds), *PLAIN, *more)

    _, out, err = run(policy, "--log", str(log)).end()
    own = json.loads(out)
    repeats = Repeats(log, topics)
    served = run(f"external:{name}", *PATIENT)
    assert trocar.serve(repeats, name, query_every=repeats.every, sessions=1) == 1
    code, out, err = served.end()
    theirs = json.loads(out)
    assert theirs["command_hash"] == own["command_hash"], err
    assert [theirs[key] for key in ("success", "reason", "seconds")] == [own[key] for key in ("success", "reason", "seconds")]
    assert code == (0 if own["success"] else 1) and own["success"] == (policy == "expert")
    assert all(set(chunks) <= set(repeats.asked) for chunks in repeats.chunks)
    assert len(repeats.chunks[0]) >= 3


@pytest.mark.parametrize("every", [1, 2, 5])
def test_an_environments_actions_are_chunks_without_delay(every: int, name: str, binary: str, session: Callable[..., Any]) -> None:
    """An action is one target, so an environment can't be given another policy's chunks; what it does is what a policy does that is asked
    at each step, and whose chunk goes from where the arm is to that target and stays there. Steps of 80 and 200 ms are those of a policy of 12.5
    and 5 steps a second that a session asks at every second and fifth of its own."""
    step_ns = every * STEP_NS
    goals: dict[int, np.ndarray] = {}
    random = np.random.default_rng(3)
    env = trocar.make("needle-lift", binary=binary, control="absolute", step_ns=step_ns, options=[*short(2.0), *PLAIN])
    observation, _ = env.reset(seed=7)
    ended, step = False, 0
    while not ended:
        goals[step] = np.append(observation["tip"][0], 0.4)
        goals[step][:3] += every * random.uniform(-1e-3, 1e-3, 3)
        observation, _, terminated, truncated, info = env.step(goals[step])
        ended, step = terminated or truncated, step + 1
    env.close()

    class Goes:
        def infer(self, observation: trocar.Observation) -> np.ndarray:
            goal = goals[observation.stamp_ns // step_ns]
            return np.array([observation.arms[0].here, goal, goal])

    delay = [*PATIENT, "--latency-ms", "0", "--seed", "7", "--json", "-"]
    served = session("run", "--task", "needle-lift", "--policy", f"external:{name}", "--lockstep", *delay, *short(2.0), *PLAIN)
    assert trocar.serve(Goes(), name, query_every=every, step_ns=step_ns, sessions=1) == 1
    _, out, err = served.end()
    assert json.loads(out)["command_hash"] == info["command_hash"], err
