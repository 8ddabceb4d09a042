"""The recipes that converters of `policy/convert/` write, without torch; networks: tests/scripts/converters.py."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CONVERT = Path(__file__).parents[2] / "convert"


@pytest.fixture
def recipe(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module `recipe`, imported as the converters beside it do."""
    monkeypatch.syspath_prepend(str(CONVERT))
    import recipe

    return recipe


@pytest.fixture
def given(recipe: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., argparse.Namespace]:
    """What a converter makes of a command line."""

    def parsed(*arguments: str) -> argparse.Namespace:
        parser = argparse.ArgumentParser()
        recipe.add_options(parser)
        monkeypatch.setattr(sys, "argv", ["converter", *arguments])
        options: argparse.Namespace = recipe.parsed(parser)
        return options

    return parsed


@pytest.mark.parametrize(("fps", "step_ns", "asked"), [(25, 40_000_000, 50), (15, 66_666_666, 50), (50, 20_000_000, 25)])
def test_a_converted_policy_has_the_rate_that_is_given(
    fps: int, step_ns: int, asked: int, recipe: Any, given: Callable[..., argparse.Namespace], tmp_path: Path
) -> None:
    options = given("--actions", "observation_relative", "--fps", str(fps))
    recipe.write(tmp_path, options, "policy_best.ckpt", "paper", ["observation.images.endoscope"], (640, 480), 7, 50, {})
    made = json.loads((tmp_path / "trocar.json").read_text())
    assert (made["step_ns"], made["query_every_steps"], made["dataset"]["fps"]) == (step_ns, asked, fps)
    assert made["cameras"] == [{"feature": "observation.images.endoscope", "width": 640, "height": 480}]


def test_a_rate_is_asked_for_wherever_actions_have_a_meaning(
    given: Callable[..., argparse.Namespace], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="--fps must be given with --actions"):
        given("--actions", "observation_relative")
    assert given().fps is None
    for fps in ("0", "-25", "1001", "12.5", "fast"):
        with pytest.raises(SystemExit) as ended:
            given("--actions", "observation_relative", "--fps", fps)
        assert ended.value.code == 2 and f"{fps}: allowed are 1 to 1000" in capsys.readouterr().err


def test_a_policy_that_lerobot_trained_gets_its_datasets_rate(tmp_path: Path) -> None:
    features = {"observation.state": {"type": "STATE", "shape": [14]}, "observation.images.left": {"type": "VISUAL", "shape": [3, 96, 128]}}
    outputs = {"action": {"type": "ACTION", "shape": [16]}}
    (tmp_path / "config.json").write_text(json.dumps({"type": "act", "chunk_size": 30, "input_features": features, "output_features": outputs}))
    command = [sys.executable, "-B", str(CONVERT / "lerobot_recipe.py"), str(tmp_path), "--actions", "absolute_pose"]
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode == 2 and "--fps" in refused.stderr
    refused = subprocess.run([*command, "--fps", "0"], capture_output=True, text=True)
    assert refused.returncode == 2 and "0: allowed are 1 to 1000" in refused.stderr
    done = subprocess.run([*command, "--fps", "15"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    made = json.loads((tmp_path / "trocar.json").read_text())
    assert (made["step_ns"], made["query_every_steps"], made["arms"]) == (66_666_666, 15, 2)
    assert made["cameras"] == [{"feature": "observation.images.left", "width": 128, "height": 96}]
