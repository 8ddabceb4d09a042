"""What a policy may answer, without a session."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
import trocar
from trocar import messages
from trocar.policy import Arm, Observation, chunk_of, later, targets_of


def seen(*tips: list[float]) -> Observation:
    blank = np.zeros(6)
    arms = tuple(Arm(blank, blank, blank, 0.4, 0.0, 0.0, np.array(tip)) for tip in tips)
    return Observation(stamp_ns=0, step=0, arms=arms, frames={})


HOME = [0.01, -0.02, -0.1, 0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4)]
HERE = [*HOME, 0.4]


def test_absolute_targets_pass_with_unit_quaternions() -> None:
    scaled = np.array([HERE, HERE])
    scaled[:, 3:7] *= 3.0
    (targets,) = targets_of(scaled, seen(HOME))
    np.testing.assert_allclose(targets, [HERE, HERE])


def test_relative_targets_move_in_rcm_axes_and_turn_in_the_tips_frame() -> None:
    (targets,) = targets_of([np.array([[0.001, 0.002, 0.003, 0.0, 0.0, np.pi / 2, 0.7]])], seen(HOME))
    np.testing.assert_allclose(targets[0, :3], [0.011, -0.018, -0.097])
    # A quarter turn about z on top of a quarter turn about z.
    np.testing.assert_allclose(targets[0, 3:], [0.0, 0.0, 1.0, 0.0, 0.7], atol=1e-12)
    (targets,) = targets_of([np.array([[0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.7]])], seen(HOME))
    # The tip's x axis is the RCM frame's y axis.
    np.testing.assert_allclose(targets[0, 3:7], [0.5, 0.5, 0.5, 0.5], atol=1e-12)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (None, "None"),
        (3.0, "float"),
        ([], "0 arms, there are 2"),
        ([[HERE]], "1 arms, there are 2"),
        ([[HERE], [[*HERE[:7], float("nan")]]], "arm 1, step 0: number 7 of the answer is nan"),
        ([[HERE, [float("inf"), *HERE[1:]]], [HERE]], "arm 0, step 1: number 0 of the answer is inf"),
        ([[HERE], [HERE] * 129], "arm 1: the answer has 129 steps: allowed are 1 to 128"),
        ([[HERE], np.zeros((0, 8))], "arm 1: the answer has 0 steps"),
        ([[HERE], [[1.0, 2.0]]], "arm 1: the answer has shape (1, 2)"),
        ([[HERE], ["text"]], "arm 1"),
        ([[HERE], [[*HERE[:3], 0.0, 0.0, 0.0, 0.0, 0.4]]], "arm 1, step 0: the quaternion has no length"),
    ],
)
def test_what_is_no_answer_is_named(answer: object, said: str) -> None:
    with pytest.raises(trocar.PolicyError, match=None) as raised:
        targets_of(answer, seen(HOME, HOME))
    assert said in str(raised.value)


def test_what_is_still_to_come_lies_evenly_between_rows() -> None:
    turn = lambda degrees: [0.0, 0.0, np.sin(np.radians(degrees / 2)), np.cos(np.radians(degrees / 2))]  # noqa: E731
    rows = np.array([[0.0, 0.0, 0.0, *turn(0), 0.0], [0.4, 0.0, 0.0, *turn(120), 0.8], [0.8, 0.0, 0.0, *turn(160), 0.8]])
    np.testing.assert_array_equal(later(rows, 0, 100), rows)
    np.testing.assert_array_equal(later(rows, 100, 100), rows[1:])
    first, second = later(rows, 25, 100)
    np.testing.assert_allclose(first, [0.1, 0.0, 0.0, *turn(30), 0.2], atol=1e-12)
    np.testing.assert_allclose(second, [0.5, 0.0, 0.0, *turn(130), 0.8], atol=1e-12)
    # A quaternion and its negative are one rotation.
    opposite = rows * [1, 1, 1, -1, -1, -1, -1, 1]
    np.testing.assert_allclose(later(np.array([rows[0], opposite[1]]), 25, 100)[0], first, atol=1e-12)
    assert later(rows, 175, 100).shape == (1, 8)
    assert later(rows, 200, 100).shape == (1, 8) and later(rows, 250, 100).shape == later(rows, 900, 100).shape == (0, 8)


def test_a_chunk_carries_its_targets_and_blanks() -> None:
    chunk = chunk_of(np.array([HERE, HERE]), 80, 3, 40)
    assert (chunk.observed_at, chunk.sequence, chunk.step_ns, chunk.len) == (80, 3, 40, 2)
    assert list(chunk.targets[1].position_m) == HERE[:3]
    assert chunk.targets[1].jaw == 0.4
    assert list(chunk.targets[2].rotation_xyzw) == [0.0, 0.0, 0.0, 1.0]


def test_a_line_keeps_whole_characters() -> None:
    assert messages.Line.of("needle lift").text == "needle lift"
    assert messages.Line.of("ä" * 200).text == "ä" * 124
    wild = messages.Line(length=2**63)
    ctypes.memset(wild.bytes, 0xFF, messages.LINE_BYTES_MAX)
    assert wild.text == "\ufffd" * 248


def test_bad_names_and_numbers_are_refused() -> None:
    with pytest.raises(trocar.TopicError, match="cannot name topics"):
        trocar.Peer("a/b")
    with pytest.raises(ValueError, match="query_every = 0"):
        trocar.Peer("x", query_every=0)
    with pytest.raises(ValueError, match="cameras: 9"):
        trocar.Peer("x", cameras=["endoscope"] * 9)
    for step_ns in (0, 999_999, 1_000_000_001):
        with pytest.raises(ValueError, match=f"step_ns = {step_ns}: allowed are 1000000 to 1000000000"):
            trocar.Peer("x", step_ns=step_ns)
