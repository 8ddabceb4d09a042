"""A CANopen master written with python canopen: puts CiA 402 drives through everything that a master does with them.

    python3 master.py --eds peer_drive.eds --nodes 1,2 --channel vcan0

In turn: boot-up and identity, SDO (expedited, segmented, refused, a wrong toggle bit), NMT states and heartbeats, PDO remapping, the power
state machine, motion in cyclic synchronous position mode, quick stop, a following error with its EMCY and reset, and a master that falls
silent. It goes by the EDS file alone. A line is printed for each thing seen; the first that is not as it should be ends it with exit code 1.
"""

import argparse
import logging
import math
import queue
import sys
import threading
import time

import canopen
from canopen.objectdictionary import VISIBLE_STRING, ODVariable
from canopen.profiles.p402 import BaseNode402
from canopen.sdo import SdoAbortedError

PATIENCE_S = 20.0
# A busy machine makes a drive slow, not wrong.
BaseNode402.TIMEOUT_SWITCH_STATE_SINGLE = PATIENCE_S
BaseNode402.TIMEOUT_SWITCH_STATE_FINAL = PATIENCE_S
BaseNode402.TIMEOUT_CHECK_TPDO = PATIENCE_S

CSP = 8
BOOT_UP = 0
EMCY_FOLLOWING_ERROR = 0x8611
# SYNC, RPDO and heartbeat that stay away
EMCY_SILENCE = (0x8700, 0x8250, 0x8130)


class Wrong(Exception):
    """A drive that does something else than it should."""


def check(fact, message):
    if not fact:
        raise Wrong(message)


def wait_for(condition, message):
    give_up = time.monotonic() + PATIENCE_S
    while not condition():
        check(time.monotonic() < give_up, message)
        time.sleep(0.01)


def refused(codes, what, action):
    """`action` must be answered with one of the abort codes."""
    try:
        action()
    except SdoAbortedError as abort:
        check(abort.code in codes, f"{what}: aborted with {abort.code:08X}h, not one of {[f'{code:08X}h' for code in codes]}")
    else:
        raise Wrong(f"{what}: was accepted")


def order(node, command, expected):
    """Gives an NMT command and waits until a heartbeat, or for 0 a boot-up message, tells that it was followed."""
    seen = []
    node.nmt.add_heartbeat_callback(seen.append)
    node.nmt.state = command
    wait_for(lambda: expected in seen, f"after the command {command} node {node.id} never says state {expected}")


class Cycle:
    """SYNC, every drive's TPDO 1, then an RPDO 1 for each; again after a while, as long as it is not paused.

    Since each SYNC waits for all answers to the last, a drive's delay is a number of cycles, however slow the machine is.
    """

    def __init__(self, network, nodes, period_s):
        self.network, self.nodes, self.period_s = network, nodes, period_s
        self.count = 0
        self.targets = None
        self.failure = None
        self.running = threading.Event()
        self.answered = {node.id: threading.Event() for node in nodes}
        threading.Thread(target=self.run, daemon=True).start()

    def start(self):
        for node in self.nodes:
            node.tpdo[1].add_callback(lambda _pdo, answered=self.answered[node.id]: answered.set())
        self.running.set()

    def run(self):
        while self.failure is None:
            self.running.wait()
            for answered in self.answered.values():
                answered.clear()
            self.network.sync.transmit()
            for node in self.nodes:
                if not self.answered[node.id].wait(PATIENCE_S):
                    self.failure = f"node {node.id} does not answer SYNC with TPDO 1"
            for node in self.nodes:
                if self.targets is not None:
                    node.rpdo[1][0x607A].raw = self.targets(node, self.count)
                node.rpdo[1].transmit()
            self.count += 1
            time.sleep(self.period_s)

    def wait(self, cycles):
        until = self.count + cycles
        while self.count < until:
            check(self.failure is None, self.failure)
            time.sleep(0.01)


def identity(node, dictionary):
    order(node, "RESET COMMUNICATION", BOOT_UP)
    check(node.sdo[0x1000].raw & 0xFFFF == 402, "device type 1000h is not that of CiA 402")
    information = dictionary.device_information
    for sub, expected in ((1, information.vendor_number), (2, information.product_number), (3, information.revision_number)):
        found = node.sdo[0x1018][sub].raw
        check(found == expected, f"1018h:{sub} is {found:#x}, the EDS says {expected:#x}")
    check(node.sdo[0x6502].raw >> (CSP - 1) & 1, "6502h: cyclic synchronous position is not supported")


def transfers(node, dictionary):
    window = node.sdo[0x6065].raw
    node.sdo[0x6065].raw = 4321
    check(node.sdo[0x6065].raw == 4321, "6065h does not keep what was written")
    node.sdo.download(0x6065, 0, window.to_bytes(4, "little"), force_segment=True)
    check(node.sdo[0x6065].raw == window, "6065h does not keep what was written in segments")
    name = node.sdo[0x1008].raw
    check(len(name) > 4 and name == dictionary[0x1008].default, f"1008h is {name!r}, the EDS says {dictionary[0x1008].default!r}")
    for entry in dictionary.values():
        if isinstance(entry, ODVariable) and entry.data_type == VISIBLE_STRING and entry.writable:
            text = "a name of more than one segment, " + "and then some more"
            node.sdo[entry.index].raw = text
            check(node.sdo[entry.index].raw == text, f"{entry.index:04X}h does not keep a long string")


def refusals(node):
    sdo = node.sdo
    refused([0x06020000], "reading 5FFFh, which is not there", lambda: sdo.upload(0x5FFF, 0))
    refused([0x06090011], "reading 1018h:9, which is not there", lambda: sdo.upload(0x1018, 9))
    refused([0x06010002], "writing the statusword", lambda: sdo.download(0x6041, 0, b"\0\0"))
    refused([0x06070010, 0x06070012, 0x06070013], "two bytes into 6065h", lambda: sdo.download(0x6065, 0, b"\0\0"))
    refused([0x06090030, 0x06090031], "mode of operation 99", lambda: sdo.download(0x6060, 0, b"\x63"))
    refused([0x05040001, 0x06010000], "a block download", lambda: block_download(sdo))
    answers = queue.Queue()
    listener = lambda _id, data, _time: answers.put(bytes(data))
    node.network.subscribe(0x580 + node.id, listener)
    node.network.send_message(0x600 + node.id, bytes([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]))
    check(answers.get(timeout=PATIENCE_S)[0] == 0x41, "1008h is not uploaded in segments")
    node.network.send_message(0x600 + node.id, bytes([0x70, 0, 0, 0, 0, 0, 0, 0]))
    answer = answers.get(timeout=PATIENCE_S)
    check(answer[0] == 0x80 and answer[4:] == bytes.fromhex("00000305"), f"a wrong toggle bit is answered with {answer.hex()}")
    node.network.unsubscribe(0x580 + node.id, listener)
    # The library's own client heard these answers too.
    sdo.responses = queue.Queue()


def block_download(sdo):
    with sdo.open(0x6065, 0, "wb", size=4, block_transfer=True) as stream:
        stream.write(b"\0\0\0\0")


def states(node):
    node.sdo[0x1017].raw = 50
    for command, expected in (("OPERATIONAL", 5), ("STOPPED", 4), ("PRE-OPERATIONAL", 127)):
        order(node, command, expected)
        if command == "STOPPED":
            node.sdo.RESPONSE_TIMEOUT, node.sdo.MAX_RETRIES = 0.3, 1
            try:
                node.sdo.upload(0x1000, 0)
            except canopen.SdoCommunicationError:
                pass
            else:
                raise Wrong("SDO is served in the state STOPPED")
            node.sdo.RESPONSE_TIMEOUT, node.sdo.MAX_RETRIES = PATIENCE_S, 1


def map_pdos(node, feedback):
    """The command in RPDO 1, `feedback` in TPDO 1, both at every SYNC, all others off."""
    node.rpdo.read()
    node.tpdo.read()
    for pdo in (*node.rpdo.values(), *node.tpdo.values()):
        if pdo.enabled:
            pdo.enabled = False
            pdo.save()
    for pdo, objects in ((node.rpdo[1], (0x6040, 0x607A)), (node.tpdo[1], feedback)):
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
        pdo.trans_type = 1
        pdo.enabled = True
        pdo.save()


def remapping(node):
    for feedback, length in (((0x6041, 0x6064, 0x6077), 8), ((0x6041, 0x6064), 6)):
        map_pdos(node, feedback)
        seen = queue.Queue()
        listener = lambda _id, data, _time: seen.put(len(data))
        node.network.subscribe(0x180 + node.id, listener)
        node.nmt.state = "OPERATIONAL"
        # The state must have come before the SYNC does; they go out in this order.
        node.network.sync.transmit()
        found = seen.get(timeout=PATIENCE_S)
        check(found == length, f"TPDO 1 has {found} bytes after it was mapped to {length}")
        node.nmt.state = "PRE-OPERATIONAL"
        node.network.unsubscribe(0x180 + node.id, listener)
    enabled = node.tpdo[1].cob_id
    refused([0x08000022, 0x06010000, 0x06090030], "a mapping of a PDO that is on", lambda: write(node, 0x1A00, 1, 0x60410010))
    refused([0x08000022, 0x06090030], "another COB-ID for a PDO that is on", lambda: write(node, 0x1800, 1, 0x40000000 | enabled + 1))
    write(node, 0x1800, 1, 0xC0000000 | enabled)
    write(node, 0x1A00, 0, 0, 1)
    refused([0x06040041], "mapping 1018h:1, which can't be mapped", lambda: write(node, 0x1A00, 1, 0x10180120))
    refused([0x06020000], "mapping 5FFFh, which is not there", lambda: write(node, 0x1A00, 1, 0x5FFF0020))
    for sub in (1, 2, 3):
        write(node, 0x1A00, sub, 0x60640020)
    refused([0x06040042], "mapping 96 bits", lambda: write(node, 0x1A00, 0, 3, 1))
    map_pdos(node, (0x6041, 0x6064))


def write(node, index, sub, value, size=4):
    node.sdo.download(index, sub, value.to_bytes(size, "little"))


def preload(nodes):
    """A drive that is enabled goes to its target: that must be where it is."""
    for node in nodes:
        node.rpdo[1][0x607A].raw = node.sdo[0x6064].raw


def power_up(nodes, cycle):
    for node in nodes:
        node.setup_pdos(upload=False)
        node.sdo[0x6060].raw = CSP
        node.sdo[0x60C2][1].raw = round(cycle.period_s * 1000)
        node.sdo[0x60C2][2].raw = -3
        node.nmt.state = "OPERATIONAL"
    preload(nodes)
    cycle.start()
    for node in nodes:
        for state in ("SWITCH ON DISABLED", "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            if node.state != state:
                node.state = state
    wait_for(lambda: all(node.sdo[0x6061].raw == CSP for node in nodes), "6061h does not say that the mode is cyclic synchronous position")


def motion(nodes, cycle, amplitude, tolerance, cycles=100):
    """One wave with a whole period, each drive with its own height, so that none can be mistaken for another."""
    start = {node.id: node.tpdo[1][0x6064].raw for node in nodes}
    height = {node.id: amplitude * (1 + place) / len(nodes) for place, node in enumerate(nodes)}
    begun = cycle.count + 2
    sent = {node.id: [start[node.id]] * 4 for node in nodes}
    largest = {node.id: 0 for node in nodes}
    wrong = []

    def target(node, count):
        phase = min(max(count - begun, 0), cycles) / cycles
        value = start[node.id] + round(height[node.id] * 0.5 * (1.0 - math.cos(2.0 * math.pi * phase)))
        actual = node.tpdo[1][0x6064].raw
        recent = sent[node.id]
        if not min(recent) - tolerance <= actual <= max(recent) + tolerance:
            wrong.append(f"node {node.id} is at {actual}, its last targets were {recent}")
        largest[node.id] = max(largest[node.id], actual - start[node.id])
        sent[node.id] = [*recent[1:], value]
        return value

    cycle.targets = target
    cycle.wait(cycles + 10)
    cycle.targets = None
    check(not wrong, wrong and wrong[0])
    for node in nodes:
        check(abs(largest[node.id] - height[node.id]) <= 0.05 * height[node.id] + tolerance,
              f"node {node.id} moved {largest[node.id]} of {height[node.id]}")
        check(abs(node.tpdo[1][0x6064].raw - start[node.id]) <= tolerance, f"node {node.id} did not come back")
        check(node.state == "OPERATION ENABLED", f"node {node.id} is in {node.state} after its motion")


def quick_stop(nodes, cycle):
    for node in nodes:
        node.controlword = 0x02
    for node in nodes:
        wait_for(lambda: node.state in ("QUICK STOP ACTIVE", "SWITCH ON DISABLED"), f"node {node.id} does not stop: {node.state}")
    for node in nodes:
        node.controlword = 0x00
        wait_for(lambda: node.state == "SWITCH ON DISABLED", f"node {node.id} stays in {node.state}")
    preload(nodes)
    for node in nodes:
        node.state = "OPERATION ENABLED"


def following_error(node, others, cycle):
    heard = len(node.emcy.log)
    window = node.sdo[0x6065].raw
    node.sdo[0x6065].raw = 1
    node.rpdo[1][0x607A].raw = node.sdo[0x6064].raw + 4 * window
    wait_for(lambda: node.state == "FAULT", f"a motor that lags behind a jump leaves node {node.id} in {node.state}")
    node.sdo[0x6065].raw = window
    wait_for(lambda: len(node.emcy.log) > heard, "no EMCY tells of the fault")
    code = node.emcy.log[heard].code
    check(code == EMCY_FOLLOWING_ERROR, f"the EMCY says {code:04X}h")
    check(node.sdo[0x603F].raw == code, "603Fh is not what the EMCY said")
    check(node.sdo[0x1001].raw & 1, "the error register 1001h does not say that there is an error")
    # An enable command is no reset.
    node.controlword = 0x0F
    cycle.wait(5)
    check(node.state == "FAULT", f"a fault was left without a reset, for {node.state}")
    for other in others:
        check(other.state == "OPERATION ENABLED", f"node {other.id} went to {other.state} by the fault of node {node.id}")
    preload([node])
    node.controlword = 0x00
    cycle.wait(3)
    node.controlword = 0x80
    wait_for(lambda: node.state == "SWITCH ON DISABLED", f"a fault reset leads to {node.state}")
    node.controlword = 0x00
    wait_for(lambda: node.emcy.log[-1].code == 0, "no EMCY tells that the fault is over")
    preload([node])
    node.state = "OPERATION ENABLED"


def silence(nodes, cycle):
    heard = {node.id: len(node.emcy.log) for node in nodes}
    cycle.running.clear()
    for node in nodes:
        wait_for(lambda: node.sdo[0x6041].raw & 0x6F != 0x27, f"node {node.id} stays enabled without SYNC")
        wait_for(lambda: len(node.emcy.log) > heard[node.id], f"node {node.id} says nothing of the silence")
        code = node.emcy.log[heard[node.id]].code
        check(code in EMCY_SILENCE, f"node {node.id} calls the silence {code:04X}h")
    cycle.running.set()
    cycle.wait(10)
    for node in nodes:
        check(node.sdo[0x6041].raw & 0x6F != 0x27, f"node {node.id} enabled itself when SYNC came back")
    cycle.running.clear()


def reset(node):
    order(node, "RESET", BOOT_UP)
    check(node.sdo[0x1A00][0].raw == node.object_dictionary[0x1A00][0].default, "1A00h:0 is not at its default after a reset")
    check(node.sdo[0x6060].raw == node.object_dictionary[0x6060].default, "6060h is not at its default after a reset")
    check(node.sdo[0x6041].raw & 0x4F == 0x40, "the drive is not in SWITCH ON DISABLED after a reset")


def exercise(network, nodes, arguments):
    cycle = Cycle(network, nodes, arguments.period)

    def each(what, step, *rest):
        for node in nodes:
            step(node, *rest)
            print(f"node {node.id}: {what}", flush=True)

    each("boot-up and identity", lambda node: identity(node, node.object_dictionary))
    each("SDO transfers, expedited and segmented", lambda node: transfers(node, node.object_dictionary))
    each("SDO refusals", refusals)
    each("NMT states and heartbeats", states)
    each("PDO remapping", remapping)
    power_up(nodes, cycle)
    print("power-up in cyclic synchronous position mode", flush=True)
    motion(nodes, cycle, arguments.amplitude, arguments.tolerance)
    print("motion", flush=True)
    quick_stop(nodes, cycle)
    print("quick stop", flush=True)
    each("following error, EMCY and reset", lambda node: following_error(node, [other for other in nodes if other is not node], cycle))
    silence(nodes, cycle)
    print("a silent master", flush=True)
    each("reset to defaults", reset)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--eds", required=True, help="EDS file of the drives")
    parser.add_argument("--nodes", default="1", help="node ids, separated by commas")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--period", type=float, default=0.01, help="SYNC period, s")
    parser.add_argument("--amplitude", type=float, default=10000, help="height of the motion, counts")
    parser.add_argument("--tolerance", type=float, default=0, help="how far from its last targets a drive may be, counts")
    arguments = parser.parse_args()
    # What the library would complain of is refused on purpose here.
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    network = canopen.Network()
    network.connect(interface="socketcan", channel=arguments.channel)
    nodes = [network.add_node(BaseNode402(int(node), arguments.eds)) for node in arguments.nodes.split(",")]
    for node in nodes:
        node.sdo.RESPONSE_TIMEOUT, node.sdo.MAX_RETRIES = PATIENCE_S, 1
    try:
        exercise(network, nodes, arguments)
        network.check()
    except (Wrong, RuntimeError, canopen.SdoCommunicationError, SdoAbortedError, canopen.nmt.NmtError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    network.disconnect()
    print("all as it should be", flush=True)


if __name__ == "__main__":
    main()
