"""What a run and a log tell Foxglove, read with the SDKs of Foxglove and MCAP."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import short

VIEWER = Path(__file__).parents[3] / "tests/scripts/foxglove_viewer.py"

#: What every run tells, of an arm and of the whole.
TOPICS = ["/tf", "/psm1/measured_js", "/psm1/setpoint_js", "/psm1/measured_cp", "/safety", "/events", "/camera/endoscope"]


def viewed(place: str) -> str:
    """What the viewer says of a live stream or a log; it fails if a message can't be read, or frames are no tree."""
    done = subprocess.run([sys.executable, "-B", str(VIEWER), place], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.clock
@pytest.mark.parametrize("task, arms", [("needle-lift", 1), ("needle-handover", 2), ("tissue-retraction", 1)])
def test_a_live_run_is_read(session: Callable[..., Any], task: str, arms: int) -> None:
    policy = ["--policy", "expert", "--foxglove", "127.0.0.1:0", "--no-log"]
    run = session("run", "--task", task, *policy, "--set", "scene.rendering.shading=plain")
    lines = iter(run.process.stderr.readline, "")
    url = next(line.split("foxglove: ")[1].strip() for line in lines if "foxglove: ws" in line)
    said = viewed(url)
    for arm in range(1, arms + 1):
        assert f"/psm{arm}/measured_js" in said, said
    assert "foxglove.SceneUpdate" in said and "frames in one tree" in said, said
    assert ("shapes that bend: " in said) == (task == "tissue-retraction"), said


def test_a_log_is_read(session: Callable[..., Any], tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    asked = ["run", "--task", "needle-handover", "--policy", "expert", "--lockstep", "--log", str(log)]
    code, _, err = session(*asked, "--set", "scene.rendering.shading=plain", *short()).end()
    assert code == 1, err
    said = viewed(str(log))
    assert "frames in one tree" in said, said
    for topic in TOPICS:
        assert topic in said, topic
