"""What the tests share: the program, topics of one's own, and an alarm, since nothing here may hang."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import uuid
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

#: How long a test may take that reads a clock, and one that has only the processor time that others leave.
ALARM_S, PATIENT_ALARM_S = 300, 900

#: How many times slower than the machine's the clocks of sessions run, so that a busy machine loses none of their time.
SLOW_MOTION = 2


#: For how long a session without a clock waits for its policy.
PATIENT = ["--policy-timeout", "240"]

#: For how long this process then waits for its session, s.
PATIENT_S = {"trocar.server._LINGER_S": 300.0, "trocar.env._BEGIN_S": 600.0, "trocar.env._END_S": 600.0}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """A test without a clock waits longer for its session, in fixtures of its module as well."""
    with pytest.MonkeyPatch.context() as patch:
        if item.get_closest_marker("clock") is None:
            for limit, seconds in PATIENT_S.items():
                patch.setattr(limit, seconds)
        return (yield)


@pytest.fixture(autouse=True)
def alarm(request: pytest.FixtureRequest) -> Iterator[None]:
    """A test that hangs fails."""
    seconds = ALARM_S if request.node.get_closest_marker("clock") else PATIENT_ALARM_S

    def ring(*_: object) -> None:
        raise TimeoutError(f"the test has taken {seconds} s")

    signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    yield
    signal.alarm(0)


@pytest.fixture(scope="session")
def binary() -> str:
    """The trocar program that TROCAR names."""
    path = os.environ.get("TROCAR")
    if not path:
        pytest.fail("TROCAR names no trocar program; make test-python does")
    return path


@pytest.fixture
def name() -> str:
    """A name for topics that no other test has."""
    return f"test-{os.getpid()}-{uuid.uuid4().hex[:8]}"


class Session:
    """A session of the program beside this process."""

    def __init__(self, binary: str, arguments: list[str]) -> None:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        environment = {**os.environ, "TROCAR_SLOW_MOTION": str(SLOW_MOTION)}
        self.process = subprocess.Popen([binary, *arguments], env=environment, **pipes)  # type: ignore[call-overload]

    def end(self, timeout_s: float = 600.0) -> tuple[int, str, str]:
        """Waits for its end: exit code, standard output, standard error."""
        out, err = self.process.communicate(timeout=timeout_s)
        return self.process.returncode, out, err


@pytest.fixture
def session(binary: str, request: pytest.FixtureRequest) -> Iterator[type]:
    """Starts sessions, none of which outlives the test. Only a test with the marker `clock` has runs in real time."""
    begun: list[Session] = []
    clock = request.node.get_closest_marker("clock") is not None

    def start(*arguments: str) -> Session:
        if arguments[0] == "run" and "--lockstep" not in arguments and not clock:
            pytest.fail("a run in real time: mark the test with `pytest.mark.clock`, or give the run --lockstep")
        begun.append(Session(binary, list(arguments)))
        return begun[-1]

    yield start  # type: ignore[misc]
    for one in begun:
        if one.process.poll() is None:
            one.process.kill()
            one.process.wait()


@pytest.fixture
def beside(tmp_path: Path) -> Iterator[type]:
    """Runs Python code in processes of their own, none of which outlives the test."""
    begun: list[subprocess.Popen[str]] = []

    def start(code: str) -> subprocess.Popen[str]:
        file = tmp_path / f"beside_{len(begun)}.py"
        file.write_text(textwrap.dedent(code))
        begun.append(subprocess.Popen([sys.executable, str(file)], stderr=subprocess.PIPE, text=True))
        return begun[-1]

    yield start  # type: ignore[misc]
    for one in begun:
        if one.poll() is None:
            one.kill()
        one.wait()


def short(seconds: float = 1.0) -> list[str]:
    """Options for a task whose time is up after so long."""
    return ["--set", f"scene.episode.time_limit_s={seconds}"]
