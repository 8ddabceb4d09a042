"""CiA 402 drives written with python canopen: an independent peer that a CANopen master can be tested against.

    python3 peer_drive.py --eds peer_drive.eds --nodes 1,2 --channel vcan0

Each node answers NMT, sends its boot-up message and heartbeat, serves SDO (expedited, segmented, refused with abort codes), lets its
PDOs be remapped, and is a drive in cyclic synchronous position mode (and homing method 37): the power state machine, a following
error that faults, EMCY, fault reset, quick stop, and a fault when SYNC stays away while it is enabled. Its motor follows the target
exactly, up to the speed of object 607Fh, counts/s. It says "ready" on standard output when it can be spoken to, and ends with its input.
"""

import argparse
import logging
import sys
import threading
import time

import canopen
from canopen.sdo import SdoAbortedError, SdoVariable

NMT_OPERATIONAL = "OPERATIONAL"
MODE_HOMING, MODE_CSP = 6, 8
PDO_INVALID = 0x80000000
# CiA 301 table 22
READ_ONLY_WHILE_VALID = 0x08000022
NO_OBJECT, NOT_MAPPABLE, MAPPING_TOO_LONG = 0x06020000, 0x06040041, 0x06040042
VALUE_TOO_HIGH, VALUE_TOO_LOW = 0x06090031, 0x06090032
# CiA 301 table 26, CiA 402-2
EMCY_PDO_LENGTH, EMCY_FOLLOWING_ERROR, EMCY_SYNC = 0x8210, 0x8611, 0x8700

SWITCH_ON_DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT = range(6)
# Statusword 6041h of each state, with voltage enabled (bit 4) where it is and remote (bit 9).
STATUS = {SWITCH_ON_DISABLED: 0x240, READY: 0x231, SWITCHED_ON: 0x233, ENABLED: 0x237, QUICK_STOP: 0x217, FAULT: 0x208}


def next_state(state, word, was, quick_stop_option):
    """The state that controlword 6040h `word` leads to, when the one before it was `was` (CiA 402-2, table 7)."""
    if state == FAULT:
        return SWITCH_ON_DISABLED if word & ~was & 0x80 else FAULT
    if state == SWITCH_ON_DISABLED:
        return READY if word & 0x07 == 0x06 else state
    if not word & 0x02:
        return SWITCH_ON_DISABLED
    if not word & 0x04:
        return QUICK_STOP if state in (ENABLED, QUICK_STOP) else SWITCH_ON_DISABLED
    if state == QUICK_STOP:
        return ENABLED if word & 0x0F == 0x0F and quick_stop_option >= 5 else state
    if not word & 0x01:
        return READY
    return ENABLED if word & 0x08 else SWITCHED_ON


class Pdo:
    """One PDO as the drive's own object dictionary describes it."""

    def __init__(self, node, communication, mapping):
        def read(index, sub):
            return int.from_bytes(node.get_data(index, sub), "little")

        identifier = read(communication, 1)
        self.valid = not identifier & PDO_INVALID
        self.cob_id = identifier & 0x7FF
        self.kind = read(communication, 2)
        entries = [read(mapping, sub) for sub in range(1, read(mapping, 0) + 1)]
        self.entries = [(entry >> 16, entry >> 8 & 0xFF, (entry & 0xFF) // 8) for entry in entries]
        self.length = sum(size for _, _, size in self.entries)
        self.pending = None
        self.sent = None
        self.syncs = 0


class Drive:
    """One drive on a network."""

    def __init__(self, network, node_id, eds, silence_s):
        self.network = network
        self.silence_s = silence_s
        self.lock = threading.RLock()
        self.node = network.create_node(node_id, eds)
        self.received = {}
        self.sent = []
        self.node.add_write_callback(self.check_write)
        # The library's server would answer in the state "stopped" too, and its NMT slave does not boot up again after a reset.
        network.unsubscribe(self.node.sdo.rx_cobid, self.node.sdo.on_request)
        network.subscribe(self.node.sdo.rx_cobid, self.on_sdo)
        network.subscribe(0x000, self.on_nmt)
        network.subscribe(0x080, self.on_sync)
        self.boot()

    # Object dictionary

    def get(self, index, sub=0):
        entry = self.node.sdo[index]
        return entry.raw if isinstance(entry, SdoVariable) else entry[sub].raw

    def put(self, index, value):
        if index in self.node.object_dictionary:
            self.node.sdo[index].raw = value

    def check_write(self, index, subindex, od, data):
        """Refuses what a drive refuses; the library has checked existence, access and length."""
        if od.data_type in canopen.objectdictionary.INTEGER_TYPES:
            value = od.decode_raw(data)
            if od.max is not None and value > od.max:
                raise SdoAbortedError(VALUE_TOO_HIGH)
            if od.min is not None and value < od.min:
                raise SdoAbortedError(VALUE_TOO_LOW)
            if index == 0x6060 and value not in (0, MODE_HOMING, MODE_CSP):
                raise SdoAbortedError(VALUE_TOO_HIGH if value > MODE_CSP else VALUE_TOO_LOW)
            if 0x1400 <= index < 0x1C00:
                self.check_pdo_write(index, subindex, value)

    def check_pdo_write(self, index, subindex, value):
        communication = index & ~0x200
        valid = not self.get(communication, 1) & PDO_INVALID
        if index == communication:
            if valid and (subindex != 1 or (value ^ self.get(index, 1)) & 0x1FFFFFFF):
                raise SdoAbortedError(READ_ONLY_WHILE_VALID)
        elif valid or (subindex and self.get(index, 0)):
            raise SdoAbortedError(READ_ONLY_WHILE_VALID)
        elif subindex:
            mapped, mapped_sub, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
            if value == 0:
                return
            if mapped not in self.node.object_dictionary:
                raise SdoAbortedError(NO_OBJECT)
            entry = self.node.object_dictionary[mapped]
            if not isinstance(entry, canopen.objectdictionary.ODVariable):
                if mapped_sub not in entry:
                    raise SdoAbortedError(NO_OBJECT)
                entry = entry[mapped_sub]
            # An RPDO can't write what may only be read.
            if not entry.pdo_mappable or len(entry) != bits or (index < 0x1800 and not entry.writable):
                raise SdoAbortedError(NOT_MAPPABLE)
        elif sum(self.get(index, sub) & 0xFF for sub in range(1, value + 1)) > 64:
            raise SdoAbortedError(MAPPING_TOO_LONG)

    # Network management

    def boot(self):
        self.node.nmt.stop_heartbeat()
        self.node.data_store.clear()
        self.drop_pdos()
        self.state, self.word = SWITCH_ON_DISABLED, 0
        self.actual, self.speed, self.homed = 0, 0, False
        self.heard = time.monotonic()
        self.publish()
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def on_nmt(self, _cob_id, data, _timestamp):
        with self.lock:
            if len(data) != 2 or data[1] not in (0, self.node.id):
                return
            self.drop_pdos()
            if data[0] in (0x81, 0x82):
                self.boot()
            elif self.node.nmt.state == NMT_OPERATIONAL:
                self.take_pdos()
            elif self.state == ENABLED:
                self.state = SWITCH_ON_DISABLED
                self.publish()

    def on_sdo(self, *message):
        with self.lock:
            if self.node.nmt.state != "STOPPED":
                self.node.sdo.on_request(*message)

    # Process data

    def take_pdos(self):
        dictionary = self.node.object_dictionary
        for number in (n for n in range(0x200) if 0x1400 + n in dictionary):
            pdo = Pdo(self.node, 0x1400 + number, 0x1600 + number)
            if pdo.valid:
                self.received[pdo.cob_id] = pdo
                self.network.subscribe(pdo.cob_id, self.on_rpdo)
        for number in (n for n in range(0x200) if 0x1800 + n in dictionary):
            pdo = Pdo(self.node, 0x1800 + number, 0x1A00 + number)
            if pdo.valid:
                self.sent.append(pdo)
        self.heard = time.monotonic()

    def drop_pdos(self):
        for cob_id in self.received:
            self.network.unsubscribe(cob_id, self.on_rpdo)
        self.received, self.sent = {}, []

    def on_rpdo(self, cob_id, data, _timestamp):
        with self.lock:
            pdo = self.received.get(cob_id)
            if pdo is None:
                return
            if len(data) < pdo.length:
                self.node.emcy.send(EMCY_PDO_LENGTH, 0x11)
            elif pdo.kind <= 240:
                pdo.pending = bytes(data)
            else:
                self.apply(pdo, bytes(data))

    def apply(self, pdo, data):
        for index, sub, size in pdo.entries:
            self.node.set_data(index, sub, data[:size])
            data = data[size:]

    def on_sync(self, _cob_id, _data, _timestamp):
        """Actual values go out first, then the targets that came since the last SYNC count."""
        with self.lock:
            if self.node.nmt.state != NMT_OPERATIONAL:
                return
            self.heard = time.monotonic()
            self.transmit()
            for pdo in self.received.values():
                if pdo.pending is not None:
                    self.apply(pdo, pdo.pending)
                    pdo.pending = None
            self.cycle()

    def transmit(self):
        for pdo in self.sent:
            data = b"".join(self.node.get_data(index, sub)[:size] for index, sub, size in pdo.entries)
            pdo.syncs += 1
            if pdo.syncs >= pdo.kind if 1 <= pdo.kind <= 240 else data != pdo.sent:
                pdo.syncs, pdo.sent = 0, data
                self.network.send_message(pdo.cob_id, data)

    # The drive

    def period_s(self):
        return self.get(0x60C2, 1) * 10.0 ** self.get(0x60C2, 2)

    def cycle(self):
        """One interpolation period: the controlword, then the motor."""
        word, was = self.get(0x6040), self.word
        self.word = word
        before = self.state
        # With these options a quick stop ends where it no longer turns, which is at once.
        if before == QUICK_STOP and self.get(0x605A) <= 4:
            self.state = SWITCH_ON_DISABLED
        else:
            self.state = next_state(before, word, was, self.get(0x605A))
        if before == FAULT != self.state:
            self.put(0x603F, 0)
            self.put(0x1001, 0)
            self.node.emcy.reset()
        mode = self.get(0x6060)
        self.put(0x6061, mode)
        self.speed = 0
        if self.state == ENABLED and mode == MODE_CSP:
            self.follow()
        if self.state == ENABLED and mode == MODE_HOMING and word & 0x10:
            self.actual, self.homed = 0, True
        self.publish()

    def follow(self):
        period_s = self.period_s()
        reach = round(self.get(0x607F) * period_s)
        target = self.get(0x607A)
        step = max(-reach, min(reach, target - self.actual))
        self.actual += step
        self.speed = round(step / period_s)
        self.put(0x60F4, target - self.actual)
        if abs(target - self.actual) > self.get(0x6065):
            self.fault(EMCY_FOLLOWING_ERROR, 0x21)

    def fault(self, code, register):
        self.state, self.speed = FAULT, 0
        self.put(0x603F, code)
        self.put(0x1001, register)
        self.node.emcy.send(code, register)

    def publish(self):
        status = STATUS[self.state]
        if self.state == ENABLED:
            if self.get(0x6060) == MODE_CSP:
                status |= 0x1000
            elif self.get(0x6060) == MODE_HOMING and self.homed:
                status |= 0x1400
        self.put(0x6041, status)
        self.put(0x6064, self.actual)
        self.put(0x606C, self.speed)

    def watch(self):
        """A drive whose master falls silent does not stay enabled."""
        with self.lock:
            silent = time.monotonic() - self.heard > self.silence_s
            if silent and self.state == ENABLED and self.node.nmt.state == NMT_OPERATIONAL:
                self.fault(EMCY_SYNC, 0x11)
                self.publish()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--eds", required=True, help="EDS file that the drives are built from")
    parser.add_argument("--nodes", default="1", help="node ids, separated by commas")
    parser.add_argument("--channel", default="vcan0")
    parser.add_argument("--silence", type=float, default=3.0, help="time without SYNC after which an enabled drive faults, s")
    arguments = parser.parse_args()
    # A master's wrong requests are its own affair.
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    network = canopen.Network()
    network.connect(interface="socketcan", channel=arguments.channel)
    drives = [Drive(network, int(node), arguments.eds, arguments.silence) for node in arguments.nodes.split(",")]
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    print("ready", flush=True)
    while not ended.wait(0.02):
        network.check()
        for drive in drives:
            drive.watch()
    network.disconnect()


if __name__ == "__main__":
    main()
