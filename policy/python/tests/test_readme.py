"""The examples of the README run."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import PATIENT, short
from trocar.topics import Node

README = Path(__file__).parent.parent / "README.md"


def example(heading: str) -> str:
    """The Python code under `heading`."""
    text = README.read_text().split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    found = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert found, heading
    return found[1]


def test_the_policy_of_the_readme_runs(name: str, session: Callable[..., Any]) -> None:
    code = example("A policy").replace("trocar.serve(Lowers(), ", f'trocar.serve(Lowers(), "{name}", ')
    assert name in code
    running = session("eval", "--task", "needle-lift", "--policy", f"external:{name}", *PATIENT, "--trials", "1", *short())
    exec(compile(code, README, "exec"), {})
    exit_code, _, err = running.end()
    assert exit_code == 0, err


def test_the_camera_of_the_readme_is_seen(name: str) -> None:
    code = example("A camera").replace('"lab"', f'"{name}"').replace("0.04", "0")
    assert name in code
    seen = Node(name).camera("endoscope")
    found: dict[str, Any] = {}
    exec(compile(code, README, "exec"), found)
    assert seen.look() and seen.header is not None and seen.header.sequence == 512
    assert (seen.planes()[0] == 255).all()


def test_the_environment_of_the_readme_runs(binary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TROCAR", binary)
    found: dict[str, Any] = {}
    exec(compile(example("An environment"), README, "exec"), found)
    assert found["observation"]["endoscope"].shape == (96, 96, 3)
    assert not (found["terminated"] or found["truncated"])
