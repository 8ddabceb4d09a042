"""What a bridge says on standard error: each thing once."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable

Say = Callable[[str], None]


def say_on_stderr(line: str) -> None:
    """Prints `line` on standard error, at once."""
    print(f"trocar.crtk: {line}", file=sys.stderr, flush=True)


#: Whoever waits for longer wants to know for what, s.
PATIENCE_S = 0.5


class UnusableError(ValueError):
    """A message can't be used; says why."""


class Unused:
    """Messages that were not used, counted by topic and reason; the first of each is named."""

    def __init__(self, say: Say) -> None:
        self.say = say
        self.counts: Counter[tuple[str, str]] = Counter()

    def add(self, topic: str, reason: str) -> None:
        """A message of `topic` was not used because of `reason`."""
        self.counts[topic, reason] += 1
        if self.counts[topic, reason] == 1:
            self.say(f"/{topic}: a message is not used: {reason} (said once)")

    def sum_up(self) -> None:
        """Says how many there were."""
        for (topic, reason), count in self.counts.items():
            self.say(f"/{topic}: {count} messages were not used: {reason}")
