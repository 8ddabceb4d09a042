"""Serves a policy: answers what sessions of ``--policy external`` ask."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from .peer import Asked, Begins, Ended, Peer, Shown
from .policy import ABSOLUTE, POLICY_STEP_NS, Array, Observation, Policy, later, targets_of

#: How long a session that was told of a failure has time to take note, s.
_LINGER_S = 1.0


def serve(
    policy: Policy,
    name: str = "external",
    *,
    cameras: Sequence[str] = (),
    query_every: int = 1,
    history: int = 0,
    arms: int = 0,
    step_ns: int = POLICY_STEP_NS,
    sessions: int | None = None,
    title: str | None = None,
) -> int:
    """Serves `policy` on the topics `name`, to ``trocar run`` and ``trocar eval`` with ``--policy external:NAME``.

    `cameras` are the task's cameras that it looks through, `query_every` are policy steps of 40 ms from one query to the next, `history`
    are steps before a query that its ``observe`` is shown too. `arms` are those that it commands, 0 if it takes any number. `step_ns` is
    the time between two rows of its answers, 1 ms to 1 s: ``1_000_000_000 // 15`` of a policy trained at 15 frames a second; observations
    are 40 ms apart all the same. Ends after `sessions` sessions, or with Ctrl-C; the number of sessions that were served.

    Raises ValueError for numbers outside their ranges, what the policy raises, and PolicyError for an answer that can't be used; the session
    is told of both and ends with that reason.
    """
    peer = Peer(
        name,
        cameras=cameras,
        query_every=query_every,
        history=history,
        arms=arms,
        step_ns=step_ns,
        title=title or type(policy).__name__,
    )
    served, answers = 0, _Answers(step_ns)
    while sessions is None or served < sessions:
        try:
            if _served(peer, policy, answers):
                served += 1
        except KeyboardInterrupt:
            _tell(peer, "it was stopped by a signal")
            break
        except BaseException as error:
            _tell(peer, f"{type(error).__name__}: {error}")
            raise
    return served


class _Answers:
    """The newest answer of an episode, of which a part is still to come."""

    def __init__(self, step_ns: int) -> None:
        self.step_ns = step_ns
        self.stamp_ns = 0
        self.targets: list[Array] = []

    def before(self, observation: Observation) -> Observation:
        """`observation` with what is left of the answer before."""
        targets = self.targets or [np.empty((0, ABSOLUTE))] * len(observation.arms)
        past_ns = max(observation.stamp_ns - self.stamp_ns, 0)
        return dataclasses.replace(observation, left_over=tuple(later(rows, past_ns, self.step_ns) for rows in targets))


def _served(peer: Peer, policy: Any, answers: _Answers) -> bool:
    """Deals with one event; whether a session has ended with it."""
    event = peer.wait()
    if isinstance(event, Begins):
        answers.targets = []
        reset = getattr(policy, "reset", None)
        if reset is not None:
            reset(event.seed)
        peer.ready()
    elif isinstance(event, Asked):
        observation = answers.before(event.observation)
        answers.targets = targets_of(policy.infer(observation), observation)
        answers.stamp_ns = observation.stamp_ns
        peer.answer(answers.targets)
    elif isinstance(event, Shown):
        observe = getattr(policy, "observe", None)
        if observe is not None:
            observe(event.observation)
        peer.observed()
    return isinstance(event, Ended)


def _tell(peer: Peer, text: str) -> None:
    if peer.session is None:
        return
    peer.fail(text)
    # What it was told lies in this process's memory.
    begun = time.monotonic()
    while time.monotonic() - begun < _LINGER_S:
        if isinstance(peer.wait(0.05), Ended):
            return
