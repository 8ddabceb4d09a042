"""The policy's end of the topics: hello, episodes, observations, and replies."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Union

import numpy as np

from . import messages as m
from .policy import POLICY_STEP_NS, Arm, Array, Frame, Observation, arm_of, checked_step_ns, chunk_of
from .topics import FrameSubscriber, Node

#: Seconds between two looks at whether the session is there, between two signs of life, and between two hellos to late readers.
_ALIVE_EVERY_S = 0.2
_STATUS_EVERY_S = 0.05

#: Longest time between two looks at the topics, s: for writers that wake nobody, and for signals.
_LOOK_S = 0.01


@dataclass(frozen=True)
class Begins:
    """An episode begins: forget the past, and draw everything random from `seed`. Wants `Peer.ready`."""

    seed: int


@dataclass(frozen=True)
class Asked:
    """An observation that wants an answer."""

    observation: Observation


@dataclass(frozen=True)
class Shown:
    """An observation of the history, before the next that wants an answer. Wants `Peer.observed`."""

    observation: Observation


@dataclass(frozen=True)
class Ended:
    """The session is over."""

    #: Whether it said so itself; its process may also have died.
    in_peace: bool


Event = Union[Begins, Asked, Shown, Ended]


class Peer:
    """Takes part in sessions on the topics of a name, one after another.

    The turns of a policy are stretches of `query_every` policy steps. The first whole observation of a turn wants an answer; of the others
    those that precede the next turn by at most `history` steps are shown. Rows of an answer are `step_ns` apart: that has nothing to do with
    the policy steps, which are the session's.

    Raises ValueError for numbers outside their ranges.
    """

    def __init__(
        self,
        name: str,
        *,
        cameras: Sequence[str] = (),
        query_every: int = 1,
        history: int = 0,
        arms: int = 0,
        step_ns: int = POLICY_STEP_NS,
        title: str = "python policy",
    ) -> None:
        if len(cameras) > m.CAMERAS_MAX:
            raise ValueError(f"cameras: {len(cameras)} are given, there can be {m.CAMERAS_MAX}")
        if query_every < 1 or history < 0:
            raise ValueError(f"query_every = {query_every}, history = {history}: allowed are 1 or more, and 0 or more")
        self._query_every = query_every
        self._history = history
        self._step_ns = checked_step_ns(step_ns)
        self._node = Node(name)
        self._events = self._node.events()
        first = m.ARM_NAMES[0]
        self._control = self._node.subscriber(m.RunControl, first)
        self._sessions = self._node.subscriber(m.SessionHello, first)
        self._reports = [self._node.subscriber(m.ArmReport, arm) for arm in m.ARM_NAMES]
        self._cameras: dict[str, FrameSubscriber] = {camera: self._node.camera(camera) for camera in cameras}
        self._chunks = [self._node.publisher(m.Chunk, arm) for arm in m.ARM_NAMES]
        self._status = self._node.publisher(m.PolicyStatus, first)
        self._reply = self._node.publisher(m.PolicyReply, first)
        self._hello = self._node.publisher(m.PolicyHello, first)
        self._session: m.SessionHello | None = None
        self._waiting: m.RunControl | None = None
        #: The newest reports of each arm: a frame comes after those of its instant, and others may have come meanwhile.
        self._past: list[deque[m.ArmReport]] = [deque(maxlen=m.ArmReport.UNREAD) for _ in m.ARM_NAMES]
        self._episode = 0
        self._running = False
        self._turn: int | None = None
        self._shown: int | None = None
        self._sequence = 0
        self._stamp = 0
        self._queries = 0
        self._said = 0
        self._asked_at = 0.0
        self._infer_ns = 0
        self._looked = self._told = 0.0
        hello = m.PolicyHello(
            pid=os.getpid(),
            arm_count=arms,
            query_every_steps=query_every,
            history_steps=history,
            camera_count=len(cameras),
            name=m.Line.of(title),
        )
        for index, camera in enumerate(cameras):
            hello.cameras[index] = m.Line.of(camera)
        self._hello.publish(hello)

    @property
    def session(self) -> m.SessionHello | None:
        """The session that takes part, once there is one."""
        return self._session

    def wait(self, timeout_s: float | None = None) -> Event | None:
        """The next event; None if there is none for `timeout_s` seconds."""
        begun = time.monotonic()
        while True:
            event = self.poll()
            if event is not None:
                return event
            left_s = _LOOK_S if timeout_s is None else timeout_s - (time.monotonic() - begun)
            if left_s <= 0.0:
                return None
            self._events.wait(min(left_s, _LOOK_S))

    def poll(self) -> Event | None:
        """The next event, if there is one."""
        now = time.monotonic()
        event = self._controlled()
        if event is not None:
            return event
        if self._running:
            event = self._observed()
            if event is not None:
                return event
        if now - self._told > _STATUS_EVERY_S:
            self._told = now
            self._hello.keep_alive()
            self._reply.keep_alive()
            if self._running:
                self._say(m.READY)
            else:
                self._status.keep_alive()
        if self._session is not None and now - self._looked > _ALIVE_EVERY_S:
            self._looked = now
            if not self._node.is_alive(self._session.pid):
                self._node.remove_dead()
                return self._end(in_peace=False)
        return None

    def ready(self) -> None:
        """The policy has reset for the episode that begins."""
        self._running = True
        self._say(m.READY)

    def answer(self, targets: Sequence[Array]) -> None:
        """Answers the observation that wants an answer: absolute targets (steps, 8) for each arm."""
        self._required()
        self._queries += 1
        self._infer_ns = int(1e9 * (time.monotonic() - self._asked_at))
        for publisher, rows in zip(self._chunks, targets):
            publisher.publish(chunk_of(rows, self._stamp, self._queries, self._step_ns))
        self._replies(m.ANSWERED, len(targets))
        self._say(m.READY)

    def observed(self) -> None:
        """The policy remembers the observation that it was shown."""
        self._replies(m.OBSERVED)

    def fail(self, text: str) -> None:
        """The policy can't go on: ends the session, with `text` as the reason."""
        self._replies(m.FAILED, text=text)

    def abandon(self) -> None:
        """Ends the episode."""
        self._running = False
        self._replies(m.ABANDONED)

    def _required(self) -> m.SessionHello:
        if self._session is None:
            raise RuntimeError("there is no session")
        return self._session

    def _replies(self, code: int, chunk_count: int = 0, text: str = "") -> None:
        self._reply.publish(
            m.PolicyReply(
                episode=self._episode,
                sequence=self._sequence,
                chunk_count=chunk_count,
                code=code,
                text=m.Line.of(text),
            )
        )

    def _say(self, code: int) -> None:
        self._said += 1
        self._status.publish(
            m.PolicyStatus(
                sequence=self._said,
                episode=self._episode,
                queries=self._queries,
                infer_ns=self._infer_ns,
                code=code,
            )
        )

    def _controlled(self) -> Event | None:
        session = self._sessions.newest()
        if session is not None:
            self._session = session
        control = self._control.newest()
        if control is not None:
            if control.code == m.STOP or control.code not in (m.WAIT, m.RUN):
                # One that wants nothing of this policy says no more than hello before.
                mine = self._session is not None and control.episode >> 32 == self._session.session >> 32
                return self._end(in_peace=True) if mine else None
            if control.code == m.RUN and control.episode != self._episode:
                self._waiting = control
        if self._waiting is None:
            return None
        if self._session is None or self._session.session >> 32 != self._waiting.episode >> 32:
            return None
        self._episode, seed = self._waiting.episode, self._waiting.seed
        self._waiting = None
        self._running = False
        self._turn = self._shown = None
        self._queries = self._sequence = 0
        self._forget()
        return Begins(seed)

    def _end(self, in_peace: bool) -> Ended:
        self._session = self._waiting = None
        self._running = False
        self._forget()
        return Ended(in_peace)

    def _forget(self) -> None:
        """What has been published so far is of no interest any more."""
        for reports, past in zip(self._reports, self._past):
            reports.newest()
            past.clear()
        for camera in self._cameras.values():
            camera.look()
            camera.drop()

    def _observed(self) -> Event | None:
        session = self._required()
        fresh = False
        for index in range(session.arm_count):
            for report in self._reports[index].unread():
                self._past[index].append(report)
                fresh = True
        for camera in self._cameras.values():
            fresh |= camera.look()
        if not fresh:
            return None
        headers = [camera.header for camera in self._cameras.values()]
        if any(header is None for header in headers):
            return None
        stamps = [header.stamp for header in headers if header is not None]
        # The arms were measured when the first camera took its frame.
        reports = _of_one_instant(self._past[: session.arm_count], stamps[0] if stamps else None)
        if not reports:
            return None
        stamp, sequence = reports[0].stamp, reports[0].sequence
        if any(abs(other - stamp) > session.frames_within_ns for other in stamps[1:]):
            return None
        turn, since = divmod(sequence, self._query_every)
        if turn != self._turn:
            self._turn = turn
            asked = True
        elif since and self._query_every - since <= self._history and sequence != self._shown:
            self._shown = sequence
            asked = False
        else:
            return None
        self._sequence, self._stamp = sequence, stamp
        self._asked_at = time.monotonic()
        arms: tuple[Arm, ...] = tuple(arm_of(report) for report in reports)
        frames = {name: _frame(camera) for name, camera in self._cameras.items()}
        instruction = session.instruction.text
        observation = Observation(stamp, sequence, arms, frames, instruction)
        return Asked(observation) if asked else Shown(observation)


def _of_one_instant(past: Sequence[deque[m.ArmReport]], stamp: int | None) -> list[m.ArmReport]:
    """The newest reports, one an arm, that are of one instant, that of `stamp` if it is given; none if there are none."""
    for first in reversed(past[0]) if past else ():
        if stamp is not None and first.stamp != stamp:
            continue
        instant = (first.stamp, first.sequence)
        reports = [next((one for one in reversed(arm) if (one.stamp, one.sequence) == instant), None) for arm in past]
        found = [report for report in reports if report is not None]
        if len(found) == len(past):
            return found
    return []


def _frame(camera: FrameSubscriber) -> Frame:
    header = camera.header
    assert header is not None
    colour, depth_m, instance = camera.planes()
    lens = header.intrinsics
    return Frame(
        colour=colour,
        depth_m=depth_m,
        instance=instance,
        intrinsics=(lens.fx, lens.fy, lens.cx, lens.cy),
        distortion=(lens.distortion.k1, lens.distortion.k2, lens.distortion.p1, lens.distortion.p2),
        camera_in_scene=np.array([*header.position_m, *header.rotation_xyzw]),
        stamp_ns=header.stamp,
    )
