"""Policies, arms and cameras of one's own for Trocar, its tasks as Gymnasium environments, and its logs and results as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .arms import ArmCommand, Arms, ArmState, now_ns, serve_arms
from .cameras import CameraPublisher
from .peer import Asked, Begins, Ended, Peer, Shown
from .policy import ABSOLUTE, RELATIVE, Answer, Arm, Frame, Observation, Policy, PolicyError
from .server import serve
from .topics import TopicError

if TYPE_CHECKING:
    from .env import TrocarEnv, make
    from .logs import Log, read_log, read_results

__all__ = [
    "ABSOLUTE",
    "RELATIVE",
    "Answer",
    "Arm",
    "ArmCommand",
    "ArmState",
    "Arms",
    "Asked",
    "Begins",
    "CameraPublisher",
    "Ended",
    "Frame",
    "Log",
    "Observation",
    "Peer",
    "Policy",
    "PolicyError",
    "Shown",
    "TopicError",
    "TrocarEnv",
    "make",
    "now_ns",
    "read_log",
    "read_results",
    "serve",
    "serve_arms",
]

# What needs an extra is imported when it is used.
_EXTRAS = {"TrocarEnv": "env", "make": "env", "Log": "logs", "read_log": "logs", "read_results": "logs"}


def __getattr__(name: str) -> Any:
    if name not in _EXTRAS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_EXTRAS[name]}", __name__), name)
