"""Logs and results of the program as tables."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trocar
from conftest import short


def test_a_log_is_a_table_a_topic(session: Callable[..., Any], tmp_path: Path) -> None:
    log, result = tmp_path / "run.mcap", tmp_path / "run.json"
    written = ["--log", str(log), "--json", str(result), "--set", "scene.rendering.shading=plain"]
    code, _, err = session("run", "--task", "needle-lift", "--policy", "expert", "--lockstep", *written, *short()).end()
    assert code == 1, err
    summary = trocar.read_results(result)
    assert len(summary) == 1 and summary["policy.name"][0] == "expert"
    ticks = int(summary["ticks"][0])
    tables = trocar.read_log(log)
    measured, commanded = tables["/psm1/measured_js"], tables["/psm1/setpoint_js"]
    assert len(measured) == len(commanded) == len(tables["/psm1/tick"]) == ticks
    assert measured.index[1] - measured.index[0] == pytest.approx(1e-3)
    moved = np.abs(measured["yaw.position"] - commanded["yaw.position"])
    assert moved.max() < 0.02 and np.ptp(commanded["insertion.position"]) > 1e-4
    tip = tables["/psm1/measured_cp"]
    np.testing.assert_allclose(np.linalg.norm(tip[["qx", "qy", "qz", "qw"]], axis=1), 1.0)
    chunks = tables["/policy/chunk"]
    assert list(chunks["sequence"]) == list(range(1, len(chunks) + 1))
    assert tables.metadata["outcome"]["command_hash"] == summary["command_hash"][0]
    assert "/camera/endoscope" not in tables
    alone = trocar.read_log(log, ["/camera/endoscope"])
    assert list(alone) == ["/camera/endoscope"]


def test_the_trials_of_an_evaluation_are_rows(session: Callable[..., Any], tmp_path: Path) -> None:
    result = tmp_path / "eval.json"
    asked = ["eval", "--task", "tissue-retraction", "--policy", "noop", "--trials", "3", "--seed", "5"]
    code, _, err = session(*asked, "--json", str(result), *short()).end()
    assert code == 0, err
    trials = trocar.read_results(result)
    assert list(trials["seed"]) == [5, 6, 7] and not trials["success"].any()
    assert trials.attrs["task"] == "tissue-retraction" and trials.attrs["policy"] == "noop"
    assert trials["command_hash"].str.len().eq(16).all()


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.json"
    file.write_text(json.dumps([1, 2]))
    with pytest.raises(ValueError, match="other.json: no result"):
        trocar.read_results(file)
