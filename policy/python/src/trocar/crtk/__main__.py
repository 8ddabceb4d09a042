"""``python -m trocar.crtk``: bridges between CRTK over ROS 2 and the topics of a run."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Sequence

from ..arms import DEFAULT_TOPICS
from ..topics import TopicError
from .arms import bridge_arms
from .cameras import bridge_cameras, cameras_of
from .dds import RosError
from .notes import say_on_stderr
from .pictures import Size
from .state import RATE_HZ, bridge_state


def _options() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--topics", default=DEFAULT_TOPICS, metavar="NAME", help="the topics of the run (default: %(default)s)")
    common.add_argument("--domain", type=int, metavar="ID", help="the ROS domain (default: ROS_DOMAIN_ID, or 0)")
    parser = argparse.ArgumentParser(prog="python -m trocar.crtk", description=__doc__.split(": ", 1)[1] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    arms = commands.add_parser("arms", parents=[common], help="serve CRTK arms to `trocar run --backend topics`")
    arms.add_argument("arms", nargs="+", metavar="ARM", help="the arm's namespace, PSM1: its topics are /PSM1/measured_js and so on")
    cameras = commands.add_parser("cameras", parents=[common], help="show ROS images as cameras of a run")
    cameras.add_argument("cameras", nargs="+", metavar="CAMERA=TOPIC", help="endoscope=/ECM/left/image_raw")
    cameras.add_argument("--size", metavar="WxH", help="shrink images by a whole factor and crop them to the middle")
    state = commands.add_parser("state", parents=[common], help="publish the arms of a run as CRTK")
    state.add_argument("--as", dest="arms", nargs="+", default=["PSM1"], metavar="ARM", help="their namespaces (default: PSM1)")
    state.add_argument("--rate-hz", type=float, default=RATE_HZ, metavar="HZ", help="default: %(default)s")
    return parser


def _ending() -> threading.Event:
    """Is set by Ctrl-C and SIGTERM, the first time; a second one ends the process at once, and no third one disturbs the arms' hold."""
    ending = threading.Event()
    numbers = signal.SIGINT, signal.SIGTERM

    def interrupt(number: int, _: object) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    def ring(number: int, _: object) -> None:
        signal.signal(number, interrupt)
        ending.set()

    for number in numbers:
        signal.signal(number, ring)
    return ending


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line; its exit code."""
    options = _options().parse_args(arguments)
    ending = _ending()
    try:
        if options.command == "arms":
            bridge_arms(options.arms, options.topics, domain=options.domain, ending=ending)
        elif options.command == "cameras":
            size = Size.parse(options.size) if options.size else None
            bridge_cameras(cameras_of(options.cameras), options.topics, size=size, domain=options.domain, ending=ending)
        else:
            bridge_state(options.arms, options.topics, rate_hz=options.rate_hz, domain=options.domain, ending=ending)
    except (RosError, TopicError) as error:
        say_on_stderr(str(error))
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
