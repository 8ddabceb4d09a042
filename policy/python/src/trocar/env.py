"""The tasks as Gymnasium environments: an episode in lockstep, a step of which is 40 ms or another time."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import shutil
import subprocess
import tempfile
import time
import uuid
from collections.abc import Mapping, Sequence
from typing import IO, Any, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from .messages import JOINT_COUNT
from .peer import Asked, Begins, Ended, Peer
from .policy import POLICY_STEP_NS, Observation, checked_step_ns, targets_of

#: The built-in tasks and how many arms each has.
TASKS: Mapping[str, int] = {
    "needle-lift": 1,
    "needle-handover": 2,
    "tissue-retraction": 1,
    "suture-pad": 1,
    "block-transfer": 1,
}

#: A relative step of 40 ms: translation along each axis, m; rotation about each, rad; a step of another length has as much more or less.
#: The range of the jaw, rad.
STEP_M_MAX = 0.002
STEP_RAD_MAX = 0.05
JAW_RAD = (-0.35, 1.4)

#: Where absolute targets may be in the RCM frame, m.
REACH_M = 0.25

#: The child process has this long to begin an episode, and to say how it ended, s.
_BEGIN_S = 120.0
_END_S = 30.0


class SessionFailed(RuntimeError):
    """The session behind an environment ended; the message has what it said."""


def find_binary(binary: str | os.PathLike[str] | None = None) -> str:
    """The ``trocar`` program: `binary`, or what TROCAR names, or the one on the path."""
    found = binary or os.environ.get("TROCAR") or shutil.which("trocar")
    if not found:
        raise FileNotFoundError("no trocar program: give binary=..., set TROCAR, or put it on the path")
    return os.fspath(found)


def frames_a_second(step_ns: int) -> float:
    """How many steps of `step_ns` there are a second, as an integer where that is what is meant: 30 of 33 333 333 ns."""
    whole = round(1e9 / step_ns)
    return whole if 1_000_000_000 // whole == step_ns else 1e9 / step_ns


class TrocarEnv(gym.Env[dict[str, Any], NDArray[Any]]):
    """A task in lockstep: the same seed and the same actions give the same episode, bit for bit.

    An action is, for each arm one after another, where the tip is to be a step of `step_ns` later (40 ms), and the jaw angle. ``control="relative"``: 7 numbers,
    translation from the tip as measured along the axes of the RCM frame (m), rotation vector in the tip's frame (rad), jaw (rad).
    ``control="absolute"``: 8 numbers, position (m) and quaternion x, y, z, w in the RCM frame, jaw (rad). What the tip does is what the
    controller lets through: gate, safety filter, smoother and guard are those of every run.

    An observation has ``joints`` (rad, insertion m), ``jaw`` (rad) and ``tip`` (x, y, z in m, quaternion x, y, z, w) of each arm, and an
    image of each of `cameras`. With ``layout="lerobot"`` it has LeRobot's keys instead, with the numbers of Trocar's datasets: ``agent_pos``
    (joints and jaw of each arm), ``tip_pose`` and ``pixels`` by camera; absolute actions are then what such a dataset's ``action`` holds, which
    is the target at its own frame: step k takes that of frame k + 1. The reward is 1 in the step in which the task is done, and 0 otherwise.
    The verdict terminates an episode, the task's time limit truncates it; ``info`` then has ``success``, ``reason``, ``seconds`` and ``command_hash``.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": frames_a_second(POLICY_STEP_NS)}

    def __init__(
        self,
        task: str = "needle-lift",
        *,
        cameras: Sequence[str] = (),
        control: str = "relative",
        layout: str = "named",
        render_mode: str | None = None,
        render_camera: str = "endoscope",
        image_size: tuple[int, int] = (512, 512),
        arms: int | None = None,
        binary: str | os.PathLike[str] | None = None,
        options: Sequence[str] = (),
        instruction: str | None = None,
        step_ns: int = POLICY_STEP_NS,
    ) -> None:
        """An environment of `task`, a built-in one or a folder (then with its number of `arms`).

        `image_size` is the height and the width of all images, 16 to 2048 pixels. `options` are further ones of ``trocar eval`` that choose
        a scene: ``--scene``, ``--needle``, ``--view``, ``--vary``, ``--config``, ``--set``. Images take less time if they are small, and with
        ``--set scene.rendering.shading=plain``. `instruction` is what is to be done, in words; the task's name if not given. `step_ns` is how
        long a step is, 1 ms to 1 s: ``1_000_000_000 // 30`` for a policy of 30 steps a second. The controller has ticks of 1 ms: each step begins
        at the tick that is nearest to its time, so that steps of 33.3 ms last 33 or 34 ticks, and 30 of them a second.

        Raises ValueError for what is not allowed.
        """
        if control not in ("relative", "absolute"):
            raise ValueError(f"control = {control!r}: allowed are 'relative' and 'absolute'")
        if layout not in ("named", "lerobot"):
            raise ValueError(f"layout = {layout!r}: allowed are 'named' and 'lerobot'")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = {render_mode!r}: allowed are None and 'rgb_array'")
        count = arms if arms is not None else TASKS.get(task)
        if count is None:
            raise ValueError(f"task {task}: how many arms it has must be said, with arms=1 or arms=2")
        self.render_mode = render_mode
        self._step_ns = checked_step_ns(step_ns)
        self.metadata = {**self.metadata, "render_fps": frames_a_second(step_ns)}
        self._task = task
        self._arms = count
        self._cameras = list(cameras)
        self._render_camera = render_camera
        self._seen = list(cameras)
        if render_mode is not None and render_camera not in self._seen:
            self._seen.append(render_camera)
        self._relative = control == "relative"
        self._lerobot = layout == "lerobot"
        self._binary = find_binary(binary)
        height, width = image_size
        sized = ["--image-height", str(height), "--image-width", str(width)]
        self._options = ["--step-ns", str(step_ns), *sized, *options]
        #: What is to be done, in words.
        self.instruction = instruction or task
        if instruction:
            self._options += ["--instruction", instruction]
        self._child: _Child | None = None
        self._peer: Peer | None = None
        self._observation: Observation | None = None
        self._pending = False
        self._picture: NDArray[np.uint8] | None = None
        self.action_space = cast("spaces.Space[NDArray[Any]]", _action_space(count, self._relative, step_ns))
        image = spaces.Box(0, 255, (height, width, 3), np.uint8)
        images: dict[str, spaces.Space[Any]] = {camera: image for camera in self._cameras}
        parts: dict[str, spaces.Space[Any]]
        if self._lerobot:
            parts = {
                "agent_pos": spaces.Box(-np.inf, np.inf, (count * (JOINT_COUNT + 1),), np.float32),
                "tip_pose": spaces.Box(-np.inf, np.inf, (count * 7,), np.float32),
            }
            if images:
                parts["pixels"] = spaces.Dict(images)
        else:
            parts = {
                "joints": spaces.Box(-np.inf, np.inf, (count, JOINT_COUNT), np.float64),
                "jaw": spaces.Box(-np.inf, np.inf, (count,), np.float64),
                "tip": spaces.Box(-np.inf, np.inf, (count, 7), np.float64),
                **images,
            }
        self.observation_space = cast("spaces.Space[dict[str, Any]]", spaces.Dict(parts))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begins an episode: that of `seed`, or the next one that follows from the last seed."""
        super().reset(seed=seed)
        episode = seed if seed is not None else int(self.np_random.integers(2**31))
        child, peer = self._started()
        if self._pending:
            self._pending = False
            peer.abandon()
            # Said later, it would be taken for the end of the next.
            if child.line(_END_S) is None:
                self._child = self._peer = None
                raise SessionFailed(f"the end of the episode before was not said within {_END_S:.0f} s: {child.last_words()}")
        child.begin(episode)
        self._await(Begins)
        peer.ready()
        self._see(self._await(Asked))
        self._pending = True
        return self._seen_now(), {"seed": episode}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Goes on by a step towards `action`."""
        if not self._pending or self._peer is None or self._child is None or self._observation is None:
            raise RuntimeError("the episode is over or has not begun: call reset first")
        before = self._observation
        numbers = np.asarray(action, dtype=np.float64).reshape(self._arms, -1)
        goals = targets_of([row[None] for row in numbers], before)
        here = [arm.here[None] for arm in before.arms]
        self._peer.answer([np.concatenate([now, goal, goal]) for now, goal in zip(here, goals)])
        event = self._await(Asked)
        self._see(event)
        # The end of an episode is said before what it looks like is shown.
        end = self._child.line(0.0)
        if end is None:
            return self._seen_now(), 0.0, False, False, {}
        self._pending = False
        late = bool(end["time_limit"])
        info = {key: end[key] for key in ("seed", "success", "invalid", "reason", "seconds", "command_hash")}
        info["is_success"] = end["success"]
        return self._seen_now(), float(end["success"]), not late, late, info

    def render(self) -> NDArray[np.uint8] | None:
        """What the camera for rendering sees."""
        return None if self.render_mode is None else self._picture

    def close(self) -> None:
        """Ends the session."""
        if self._child is not None:
            if self._pending and self._peer is not None and self._child.lives():
                self._peer.abandon()
            self._child.end()
        self._child = self._peer = None
        self._pending = False

    def _started(self) -> tuple[_Child, Peer]:
        if self._child is None or self._peer is None:
            name = f"gym-{os.getpid()}-{uuid.uuid4().hex[:8]}"
            self._peer = Peer(name, cameras=self._seen, step_ns=self._step_ns, title="Gymnasium environment")
            self._child = _Child(self._binary, self._task, name, self._options)
        return self._child, self._peer

    def _await(self, kind: type[Any]) -> Any:
        child, peer = self._started()
        begun = time.monotonic()
        while time.monotonic() - begun < _BEGIN_S:
            event = peer.wait(0.25)
            if isinstance(event, kind):
                return event
            if isinstance(event, Ended) or not child.lives():
                self._child = self._peer = None
                self._pending = False
                raise SessionFailed(child.last_words())
        child.end()
        self._child = self._peer = None
        self._pending = False
        raise SessionFailed(f"the session has published nothing for {_BEGIN_S:.0f} s")

    def _see(self, event: Asked) -> None:
        """Keeps what is to be kept: the frames themselves are valid until the next step alone."""
        self._observation = event.observation
        frames = event.observation.frames
        self._images = {camera: frames[camera].colour.copy() for camera in self._cameras}
        if self.render_mode is not None:
            kept = self._images.get(self._render_camera)
            self._picture = frames[self._render_camera].colour.copy() if kept is None else kept

    def _seen_now(self) -> dict[str, Any]:
        assert self._observation is not None
        arms = self._observation.arms
        if self._lerobot:
            state = np.concatenate([np.append(arm.joints, arm.jaw) for arm in arms])
            tips = np.concatenate([arm.tip for arm in arms])
            seen: dict[str, Any] = {"agent_pos": state.astype(np.float32), "tip_pose": tips.astype(np.float32)}
            if self._images:
                seen["pixels"] = dict(self._images)
            return seen
        return {
            "joints": np.array([arm.joints for arm in arms]),
            "jaw": np.array([arm.jaw for arm in arms]),
            "tip": np.array([arm.tip for arm in arms]),
            **self._images,
        }


def _action_space(arms: int, relative: bool, step_ns: int) -> spaces.Box[Any]:
    if relative:
        longer = step_ns / POLICY_STEP_NS
        step = [longer * STEP_M_MAX] * 3 + [longer * STEP_RAD_MAX] * 3
        low = [-most for most in step] + [JAW_RAD[0]]
        high = step + [JAW_RAD[1]]
    else:
        low = [-REACH_M] * 3 + [-1.0] * 4 + [JAW_RAD[0]]
        high = [REACH_M] * 3 + [1.0] * 4 + [JAW_RAD[1]]
    bounds = [np.tile(np.array(bound, dtype=np.float32), arms) for bound in (low, high)]
    return spaces.Box(bounds[0], bounds[1], dtype=np.float32)


class _Child:
    """The session's process: seeds on its standard input, ends of episodes on its standard output."""

    def __init__(self, binary: str, task: str, name: str, options: Sequence[str]) -> None:
        self._said: IO[bytes] = tempfile.TemporaryFile()
        # The learner may think for longer than any time-out; if it dies, that is noticed.
        awaited = ["--policy-timeout", str(24 * 3600)]
        command = [binary, "environment", "--task", task, "--topics", name, *awaited, *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, bufsize=0
        )
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._out, selectors.EVENT_READ)
        self._rest = b""

    @property
    def _out(self) -> Any:
        assert self._process.stdout is not None
        return self._process.stdout

    def lives(self) -> bool:
        return self._process.poll() is None

    def begin(self, seed: int) -> None:
        assert self._process.stdin is not None
        # If it is gone, whoever waits for the episode says so.
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(f"{seed}\n".encode())

    def line(self, timeout_s: float) -> dict[str, Any] | None:
        """The next line that it has said, if there is one within `timeout_s`."""
        while b"\n" not in self._rest:
            if not self._selector.select(timeout_s):
                return None
            more = os.read(self._out.fileno(), 65536)
            if not more:
                return None
            self._rest += more
        line, self._rest = self._rest.split(b"\n", 1)
        return dict(json.loads(line))

    def last_words(self) -> str:
        """How it ended, with what it said."""
        try:
            code: int | None = self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            code = None
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip()
        self.end()
        state = "does not end" if code is None else f"has ended with exit code {code}"
        return f"the session {state}: {said or 'it said nothing'}"

    def end(self) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._selector.close()
        self._out.close()
        self._said.close()


def make(task: str = "needle-lift", **kwargs: Any) -> TrocarEnv:
    """A Gymnasium environment of `task`; see `TrocarEnv`."""
    return TrocarEnv(task, **kwargs)


def register() -> None:
    """Registers the built-in tasks with Gymnasium, as ``trocar/needle-lift-v0`` and so on; importing this module does."""
    for task in TASKS:
        name = f"trocar/{task}-v0"
        if name not in gym.registry:
            gym.register(id=name, entry_point="trocar.env:TrocarEnv", kwargs={"task": task})


register()
