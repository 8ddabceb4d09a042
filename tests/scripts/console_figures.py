#!/usr/bin/env python3
"""What a console costs a run and how late it shows it: prints the figures of one machine.

    tests/scripts/console_figures.py [--trocar target/release/trocar] [--seconds 20] [--mutated 1000000] [PART ...]

The parts, all of them if none is named: `frames` (pictures a second with one and with five pages, and while a hand steers; camera to page; hand
to command), `timing` (the control thread's tick and wake-up in one run, first without a page and then with five, from its log, for which `zstd`
has to be there), `mutated` (so many broken messages of the page that steers, between whole ones whose clutch is open; how many are refused, resident
memory, engagements, by how much the tip moved at most while the clutch was open, by the log, for which `zstd` has to be there, and what `verify` says of
the log, on which the exit code depends). Pages are WebSocket clients that take what they are sent and
draw nothing.
"""

import argparse
import json
import math
import os
import random
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# What a broken message was made of; {t} is the page's time, ms.
WHOLE = [
    '{"hands":{"t":{t},"arms":[{"clutch":true,"at":[0.5,0.5,0.5],"turn":[0,0,0,1],"jaw":0.5}]}}',
    '{"hands":{"t":{t},"arms":[null,{"clutch":true,"at":[0,0,0],"turn":[0,0,0,1],"jaw":0}]}}',
    '{"command":"pause"}',
    '{"show":[[0,"colour"]]}',
    '{"shown":[0,1.5]}',
    '{"seen":4}',
    '{"scale":0.4}',
    '{"align":30}',
    '{"label":"first try"}',
    '{"episode":"start"}',
    '{"hand_back":true}',
    '{"open":0}',
    '{"at":1.5}',
    '{"hands_off":true}',
]
# A hand that lets go: a broken message after it may take the clutch.
OPEN = '{"hands":{"t":{t},"arms":[{"clutch":false,"at":[0.5,0.5,0.5],"turn":[0,0,0,1],"jaw":0.5}]}}'
# A message whose answer comes after those to all before it.
LAST = {"command": "is that all"}
# Messages that a page may send at once before it is sent away as too talkative: 300, of which some take the seat.
STORE = 280
PATIENCE_S = 600


class Page:
    """A page's end of the WebSocket."""

    def __init__(self, port: int, token: str) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        head = [
            "GET /socket HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            f"Origin: http://127.0.0.1:{port}",
            f"Cookie: trocar_console_{port}={token}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
        ]
        self.socket.sendall("\r\n".join([*head, "", ""]).encode())
        self.stream = self.socket.makefile("rb", buffering=1 << 18)
        if b" 101 " not in self.stream.readline():
            raise EOFError
        while self.stream.readline() != b"\r\n":
            pass
        self.sending = threading.Lock()

    def say(self, message: bytes | dict, kind: int = 1) -> None:
        text = json.dumps(message).encode() if isinstance(message, dict) else message
        size = bytes([0x80 | len(text)]) if len(text) < 126 else bytes([0x80 | 126]) + struct.pack(">H", len(text))
        with self.sending:
            self.socket.sendall(bytes([0x80 | kind]) + size + b"\0\0\0\0" + text)

    def close(self) -> None:
        """Ends the connection, which the stream holds too."""
        self.socket.shutdown(socket.SHUT_RDWR)
        self.stream.close()
        self.socket.close()

    def take(self, count: int) -> bytes:
        taken = self.stream.read(count)
        if len(taken) < count:
            raise EOFError
        return taken

    def hear(self) -> tuple[int, bytes]:
        """The next message, and its kind: 1 text, 2 binary."""
        while True:
            first, size = self.take(2)
            if size == 126:
                (size,) = struct.unpack(">H", self.take(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self.take(8))
            kind, data = first & 15, self.take(size)
            if kind == 9:
                self.say(data, 10)
            elif kind == 8:
                raise EOFError
            else:
                return kind, data


class Watcher(threading.Thread):
    """A page that looks at the first camera until the run ends, and steers if it `moves`."""

    def __init__(self, run: "Run", moves: bool = False) -> None:
        super().__init__(daemon=True)
        self.page = Page(run.port, run.token)
        self.moves = moves
        self.came: list[float] = []
        self.state: dict = {}
        self.ended = False
        self.page.say({"steer": moves})
        self.page.say({"show": [[0, "colour"]]})
        self.start()

    def run(self) -> None:
        if self.moves:
            threading.Thread(target=self.move, daemon=True).start()
        try:
            while True:
                self.look(*self.page.hear())
        except (EOFError, OSError):
            self.ended = True

    def look(self, kind: int, data: bytes) -> None:
        if kind == 2:
            self.came.append(time.monotonic())
            if self.moves and len(self.came) % 5 == 0:
                self.page.say({"shown": [0, struct.unpack("<d", data[8:16])[0]]})
        else:
            told = json.loads(data)
            if told["kind"] in ("answer", "problem", "end"):
                return
            if told["kind"] == "state":
                self.state = told
        self.page.say({"seen": 1})

    def move(self) -> None:
        """A hand that goes up and down by 2 cm, fifty times a second."""
        began = time.monotonic()
        for count in range(1 << 30):
            arms = self.state.get("arms")
            clutch = bool(arms) and arms[0]["state"] == "ENABLED" and count > 50
            height = 0.0004 * abs(count % 100 - 50)
            hand = {"clutch": clutch, "at": [0, height, 0], "turn": [0, 0, 0, 1], "jaw": 0.5}
            try:
                self.page.say({"hands": {"t": (time.monotonic() - began) * 1e3, "arms": [hand]}})
            except OSError:
                return
            time.sleep(max(0.0, began + 0.02 * (count + 1) - time.monotonic()))

    def rate(self) -> float:
        """Pictures a second, without the first second's; 0 if there were too few."""
        came = [at for at in self.came if at > self.came[0] + 1] if self.came else []
        return (len(came) - 1) / (came[-1] - came[0]) if len(came) > 1 else 0.0


class Run:
    """A run of needle lift with a console."""

    def __init__(self, trocar: str, policy: str, seconds: float, log: bool = False) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.trocar = trocar
        self.result = Path(self.folder.name, "run.json")
        self.log = Path(self.folder.name, "run.mcap")
        environment = os.environ | {"XDG_STATE_HOME": self.folder.name, "XDG_RUNTIME_DIR": self.folder.name}
        # A hand has ten times the task's time.
        limit = max(1.0, seconds / 10) if policy == "teleop" else seconds
        words = [trocar, "run", "--task", "needle-lift", "--policy", policy, "--seed", "7", "--json", str(self.result)]
        words += ["--set", f"scene.episode.time_limit_s={limit}", "--console", "127.0.0.1:0"]
        words += ["--log", str(self.log)] if log else []
        self.process = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for line in self.process.stderr:
            found = re.search(r"console: http://127.0.0.1:(\d+)/\?token=(\w+)", line)
            if found:
                self.port, self.token = int(found[1]), found[2]
                threading.Thread(target=self.process.stderr.read, daemon=True).start()
                return
        sys.exit(f"{trocar}: no console")

    def rss_mb(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) / 1024

    def end(self) -> dict:
        self.process.wait(timeout=PATIENCE_S)
        return json.loads(self.result.read_text())


def frames(args: argparse.Namespace) -> None:
    for pages in (1, 5):
        run = Run(args.trocar, "random", args.seconds)
        watchers = [Watcher(run) for _ in range(pages)]
        reason = run.end()["reason"]
        rates = sorted(watcher.rate() for watcher in watchers)
        print(f"pages {pages}: {rates[0]:.1f} to {rates[-1]:.1f} pictures a second each ({reason})")
    run = Run(args.trocar, "teleop", args.seconds)
    watcher = Watcher(run, moves=True)
    teleop = run.end()["teleop"]
    print(f"a hand steers: {watcher.rate():.1f} pictures a second, {teleop['engagements']} engagements")
    print(f"camera to page, ms: {teleop.get('camera_to_page_ms')}; hand to command, ms: {teleop['hand_to_command_ms']}")


def percentiles(values: list[int]) -> str:
    values = sorted(values)
    at = [values[int(share * (len(values) - 1))] / 1e3 for share in (0.5, 0.99)]
    return f"p50 {at[0]:.1f}, p99 {at[1]:.1f} us"


def records(log: Path) -> Iterator[tuple[int, bytes]]:
    """The records in an MCAP file's chunks, each with its kind, a chunk at a time."""
    with log.open("rb") as file:
        file.seek(8)
        while len(head := file.read(9)) == 9:
            kind, size = struct.unpack("<BQ", head)
            if kind != 6:
                file.seek(size, os.SEEK_CUR)
                continue
            chunk = file.read(size)
            (name,) = struct.unpack_from("<I", chunk, 28)
            data = chunk[32 + name + 8 :]
            if name:
                data = subprocess.run(["zstd", "-dc"], input=data, stdout=subprocess.PIPE, check=True).stdout
            at = 0
            while at + 9 <= len(data):
                kind, size = struct.unpack_from("<BQ", data, at)
                yield kind, data[at + 9 : at + 9 + size]
                at += 9 + size


def fields(message: bytes) -> Iterator[tuple[int, int | float | bytes]]:
    """The fields of a protobuf message, with their numbers."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = message[at]
            value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
            if byte < 128:
                return value

    while at < len(message):
        number, form = divmod(varint(), 8)
        if form == 0:
            yield number, varint()
        elif form == 1:
            yield number, struct.unpack_from("<d", message, at)[0]
            at += 8
        elif form == 5:
            yield number, struct.unpack_from("<I", message, at)[0]
            at += 4
        else:
            size = varint()
            yield number, message[at : at + size]
            at += size


def told(log: Path, topics: list[str]) -> Iterator[tuple[str, float, dict]]:
    """The messages of these topics: topic, seconds, and the last field of each number."""
    channels = {}
    for kind, data in records(log):
        if kind == 4:
            channel, _schema, size = struct.unpack_from("<HHI", data)
            channels[channel] = data[8 : 8 + size].decode()
        elif kind == 5:
            channel, _sequence, at_ns = struct.unpack_from("<HIQ", data)
            if (topic := channels[channel]) in topics:
                yield topic, at_ns * 1e-9, dict(fields(data[22:]))


def ways_mm(log: Path, since: float, until: float) -> tuple[list[float], list[float]]:
    """How far the measured tip was, at each tick in which no hand was engaged, from where it was as the clutch was opened last, and at each tick from
    where it was at first, mm."""
    engaged, opened, first = False, None, None
    while_open, all_ways = [], []
    # Events reach the log a little later than ticks.
    for topic, seconds, message in sorted(told(log, ["/events", "/psm1/measured_cp"]), key=lambda it: it[1]):
        if topic == "/events":
            text = message.get(3, b"").decode()
            if text.startswith("psm1: the operator"):
                engaged, opened = text.endswith("hand engaged"), None
        elif since < seconds < until:
            place = dict(fields(dict(fields(message[3]))[1]))
            tip = [place.get(axis, 0.0) for axis in (1, 2, 3)]
            first = first or tip
            all_ways.append(1e3 * math.dist(first, tip))
            if not engaged:
                opened = opened or tip
                while_open.append(1e3 * math.dist(opened, tip))
    return while_open, all_ways


def chunks(log: bytes) -> bytes:
    """The records of an MCAP file's chunks."""
    at, packed = 8, []
    while at + 9 <= len(log):
        kind, size = log[at], struct.unpack_from("<Q", log, at + 1)[0]
        if kind == 6:
            (name,) = struct.unpack_from("<I", log, at + 9 + 28)
            packed.append(log[at + 9 + 32 + name + 8 : at + 9 + size])
        at += 9 + size
    return subprocess.run(["zstd", "-dc"], input=b"".join(packed), stdout=subprocess.PIPE, check=True).stdout


def timing(args: argparse.Namespace) -> None:
    run = Run(args.trocar, "random", 2 * args.seconds, log=True)
    time.sleep(args.seconds)
    watchers = [Watcher(run) for _ in range(5)]
    while not all(watcher.came for watcher in watchers):
        time.sleep(0.01)
    opened = int(1000 * watchers[0].state["seconds"])
    run.end()
    form = rb'\{"tick":(\d+),"period_ns":\d+,"wake_ns":(\d+),"compute_ns":(\d+)\}'
    ticks = [[int(number) for number in found] for found in re.findall(form, chunks(run.log.read_bytes()))]
    for name, part in (
        ("no page", [tick for tick in ticks if 1000 < tick[0] < opened - 1000]),
        ("five pages", [tick for tick in ticks if tick[0] > opened]),
    ):
        tick, wake = percentiles([tick[2] for tick in part]), percentiles([tick[1] for tick in part])
        print(f"{name}, {len(part)} ticks: tick {tick}; wake-up {wake}")


def now_in(message: str) -> bytes:
    return message.replace("{t}", f"{time.monotonic() * 1e3:.5f}").encode()


def mutated(dice: random.Random) -> bytes:
    message = bytearray(now_in(dice.choice(WHOLE)))
    digits = [at for at, byte in enumerate(message) if 48 <= byte <= 57]
    if digits and dice.randrange(2):
        # Another value, of which many are still read.
        message[dice.choice(digits)] = dice.choice(b"0123456789.-e")
        return bytes(message)
    for _ in range(dice.randrange(1, 4)):
        at, byte = dice.randrange(len(message)), dice.randrange(32, 127)
        if (way := dice.randrange(4)) == 0:
            message[at] = byte
        elif way == 1 and len(message) > 1:
            del message[at]
        elif way == 2:
            message.insert(at, byte)
        else:
            message[at:at] = message[at : at + 8]
    return bytes(message)


class Breaker(threading.Thread):
    """A page that steers and counts those of its messages that are none, and those refused for what they say, until the answer to the last one."""

    def __init__(self, run: Run) -> None:
        super().__init__(daemon=True)
        self.page = Page(run.port, run.token)
        self.unparsed = self.refused = 0
        self.answered = False
        self.page.say({"steer": True})
        while not (told := self.told()).get("steers"):
            # The page before may not be known to be gone.
            self.page.say({"steer": True} if told.get("kind") == "seat" else {"seen": 1})
        self.page.say({"command": "resume"})
        self.start()

    def told(self) -> dict:
        kind, data = self.page.hear()
        return json.loads(data) if kind == 1 else {}

    def run(self) -> None:
        try:
            while not self.answered:
                told = self.told()
                self.answered = told.get("command") == LAST["command"]
                text = told.get("text") or ""
                unparsed = text.startswith("no message of the console")
                failed = told.get("kind") == "answer" and not told["ok"] and not self.answered
                self.unparsed += unparsed
                self.refused += failed or (told.get("kind") == "problem" and not unparsed)
        except (EOFError, OSError):
            pass


def break_messages(args: argparse.Namespace) -> None:
    run = Run(args.trocar, "teleop", 3600, log=True)
    dice = random.Random(7)
    watcher = Watcher(run)
    while not any(arm["state"] == "ENABLED" for arm in watcher.state.get("arms", [])):
        time.sleep(0.01)
    # The arm rests.
    time.sleep(2)
    since = watcher.state["seconds"]
    before, most, sent, unparsed, refused, away = run.rss_mb(), 0.0, 0, 0, 0, 0
    while sent < args.mutated:
        breaker = Breaker(run)
        try:
            for _ in range(STORE // 2):
                breaker.page.say(now_in(OPEN))
                breaker.page.say(mutated(dice))
                sent += 1
            breaker.page.say(LAST)
        except OSError:
            # It was sent away.
            pass
        breaker.join()
        breaker.page.close()
        unparsed, refused, away = unparsed + breaker.unparsed, refused + breaker.refused, away + (not breaker.answered)
        most = max(most, run.rss_mb())
    after, until = run.rss_mb(), watcher.state["seconds"]
    page = Page(run.port, run.token)
    page.say({"command": "stop"})
    teleop = run.end()["teleop"]
    verified = subprocess.run([args.trocar, "verify", str(run.log)], stdout=subprocess.PIPE, text=True)
    # Whole ones are refused too, after a broken one whose time is ahead of theirs.
    print(f"{sent} broken messages, {sent - unparsed} parsed; with as many whole ones {refused} refused for what they say; {away} pages sent away")
    print(f"resident memory: {before:.0f} MB before, {after:.0f} after, {most:.0f} at most")
    print(f"engagements {teleop['engagements']}; verify {verified.returncode}: {verified.stdout.strip().splitlines()[0]}")
    while_open, ways = ways_mm(run.log, since, until)
    print(f"the tip: {max(while_open):.4f} mm at most while the clutch is open ({len(while_open)} ticks), {max(ways):.4f} mm from where it was at first")
    if verified.returncode:
        sys.exit(1)


PARTS = {"frames": frames, "timing": timing, "mutated": break_messages}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--mutated", type=int, default=1_000_000)
    parser.add_argument("part", nargs="*")
    args = parser.parse_args()
    if unknown := set(args.part) - set(PARTS):
        parser.error(f"{', '.join(sorted(unknown))}: no part; there are {', '.join(PARTS)}")
    for part in args.part or PARTS:
        PARTS[part](args)


main()
