"""Whether an arm may be commanded: its CRTK operating state, and the fault that a run ends with when it may not."""

from __future__ import annotations

from enum import IntEnum

from .dds import Ros, RosError
from .messages import OperatingState
from .notes import Unused

#: How long a fault is shown at least, ns: as long as a run may need to see it and to let go.
FAULT_NS_MIN = 1_000_000_000


class Fault(IntEnum):
    """Why a run ended, as the code of the fault of axis 0."""

    #: `operating_state` says DISABLED.
    DISABLED = 0xC001
    #: It says PAUSED.
    PAUSED = 0xC002
    #: It says FAULT.
    FAULT = 0xC003
    #: It says ENABLED, but the arm is not homed any more.
    NOT_HOMED = 0xC004
    #: It says something that CRTK does not have.
    UNKNOWN = 0xC005


def fault_of(state: OperatingState) -> Fault | None:
    """What keeps an arm in `state` from being commanded, if anything does."""
    if state.state == "ENABLED":
        return None if state.is_homed else Fault.NOT_HOMED
    return Fault[state.state] if state.state in ("DISABLED", "PAUSED", "FAULT") else Fault.UNKNOWN


class Operating:
    """The newest operating state of an arm."""

    def __init__(self, ros: Ros, topic: str, unused: Unused) -> None:
        # The dVRK's is latched; that of a simulator may be published again and again instead.
        self._reader = ros.reader(topic, OperatingState, latched=True)
        self._unused = unused
        self.newest: OperatingState | None = None

    @property
    def topic(self) -> str:
        """Its topic."""
        return self._reader.topic

    @property
    def fault(self) -> Fault | None:
        """What keeps the arm from being commanded, if anything is known to."""
        return None if self.newest is None else fault_of(self.newest)

    @property
    def is_busy(self) -> bool:
        """Whether the arm moves by itself: it homes, or does a move_jp."""
        return self.newest is not None and self.newest.is_busy

    def look(self) -> bool:
        """Takes what has come; whether the state or homed has changed."""
        before = self._known()
        try:
            self.newest = self._reader.newest() or self.newest
        except RosError as error:
            self._unused.add(self.topic, str(error))
        return self._known() != before

    def __str__(self) -> str:
        known = self._known()
        return "unknown" if known is None else f"{known[0]}, {'homed' if known[1] else 'not homed'}{', busy' if self.is_busy else ''}"

    def _known(self) -> tuple[str, bool] | None:
        return None if self.newest is None else (self.newest.state, self.newest.is_homed)


class Latch:
    """A fault that stays until the arm may be commanded again, for `FAULT_NS_MIN` at least, and the run that it ended is over."""

    def __init__(self) -> None:
        self.fault: Fault | None = None
        self._seen_ns = 0

    def update(self, fault: Fault | None, now_ns: int, *, run_over: bool) -> bool:
        """Takes note of `fault` at `now_ns`; whether a fault has come up or gone."""
        before = self.fault
        if fault is not None:
            self._seen_ns = now_ns
            self.fault = self.fault or fault
        elif run_over and now_ns - self._seen_ns >= FAULT_NS_MIN:
            self.fault = None
        return self.fault is not before
